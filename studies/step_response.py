"""How the closed loop answers steps: a soft, a middle and a stiff mode of the glass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.loop import Loop, samples_of
from truenewton.figures.style import COLOURS, FAINT, INK, STYLE, new_figure
from truenewton.statics.modes import stiffness_modes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


STROKE = 0.1e-6  # of the step, at the actuator that moves most [m]
DURATION = 8e-3  # [s]
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
    """Step the softest, the median and the stiffest mode of (n, n) K by `STROKE`, without noise."""
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


def plot_step_responses(
    time: Array, position: Array, stiffness: Array, ax: Axes | None = None
) -> Axes:
    """Draw how modes of (m,) stiffness answer a step, in units of what was commanded."""
    with mpl.rc_context(STYLE):
        ax = ax or new_figure(0.72).add_subplot()
        ax.axhspan(0.9, 1.1, color=FAINT, alpha=0.25, linewidth=0)
        ax.axhline(1.0, color=FAINT, linewidth=0.5)
        # Even in lightness apart, and told apart by their dashes in print.
        looks = zip(mpl.colormaps[COLOURS](np.linspace(0.0, 0.8, len(stiffness))),
                    ("-", "--", "-.") * len(stiffness), strict=False)  # fmt: skip
        for response, k, (colour, dashes) in zip(position.T, stiffness, looks, strict=True):
            power = int(np.floor(np.log10(k)))
            label = rf"${k / 10.0**power:.1f} \times 10^{power}$ N/m"
            ax.plot(1e3 * time, response, color=colour, linestyle=dashes, label=label)
        ax.set_xlabel("time since the command (ms)")
        ax.set_ylabel("displacement / command")
        ax.set_xlim(0, 1e3 * time[-1])
        ax.legend(title="stiffness of the mode", frameon=False, fontsize=6.5, title_fontsize=6.5)
        ax.set_title("band: ±10 %", loc="right", fontsize=6.5, color=INK)
    return ax
