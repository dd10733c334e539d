"""How the closed loop answers steps: a soft, a middle and a stiff mode of the glass."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truenewton.actuators import Array
from truenewton.bench.simulated.loop import Loop, samples_of
from truenewton.modes import stiffness_modes

STROKE = 0.1e-6  # of the step, at the actuator that moves most [m]
DURATION = 3e-3  # [s]
FINER = 1e-6  # than the true steps of DAC and ADC, so that they do not show
RIGID = 3  # piston and two tilts, the softest of all


@dataclass(frozen=True, eq=False)
class StepResponses:
    """Steps of modes, each commanded alone.

    Attributes
    ----------
    time
        (steps,) since the command [s].
    stiffness
        (3,) of the softest, the median and the stiffest mode that bends the glass [N/m].
    position
        (steps, 3) how much of the commanded mode the true displacement holds; 1 is all of it.
    """

    time: Array
    stiffness: Array
    position: Array


def step_responses(loop: Loop, stiffness: Array, *, duration: float = DURATION) -> StepResponses:
    """Step the softest, the median and the stiffest bending mode by `STROKE`, without noise.

    Parameters
    ----------
    loop
        The mirror in closed loop.
    stiffness
        (n, n) K of the glass [N/m], whose modes are taken.
    duration
        [s].

    Raises
    ------
    BenchFault
        As of `loop.record`.
    """
    found = stiffness_modes(stiffness)
    n = len(stiffness)
    which = [RIGID, (RIGID + n) // 2, n - 1]
    modes = found.modes[:, which]
    shapes = modes * (STROKE / np.abs(modes).max(axis=0))
    parts = modes / np.sum(modes * shapes, axis=0)
    fine = replace(
        loop,
        coils=replace(loop.coils, dac_step=loop.coils.dac_step * FINER),
        sensors=replace(loop.sensors, codes=round(loop.sensors.codes / FINER)),
    )
    steps = round(duration * loop.control.rate)
    position = [
        np.sum(parts * displacement, axis=0)
        for _, _, displacement in samples_of(fine, shapes, np.zeros_like(shapes), (), steps)
    ]
    time = np.arange(steps, dtype=float) * loop.control.period
    return StepResponses(time, found.stiffness[which], np.array(position))


def settling_time(time: Array, response: Array, band: float) -> Array:
    """Return when (steps, m) responses come within a band about 1 to stay [s].

    Infinite where they do not within ``time``.
    """
    outside = np.abs(response - 1) > band
    last = len(time) - 1 - np.argmax(outside[::-1], axis=0)
    after = np.append(time, np.inf)[last + 1]
    return np.asarray(np.where(outside.any(axis=0), after, time[0]))
