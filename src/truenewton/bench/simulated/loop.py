"""Closed loop: sensors, control, DAC, coils and glass, from sample to sample.

Shapes advance together, one a column. Unless said otherwise:

shapes
    (n, batch) commanded displacements from the flat mirror [m].
load_force
    (n, batch) or (n, 1) true forces that hold the flat mirror under its load, the bias magnets'
    included [N].
noise
    One generator a shape, see `noise.row_noise`; none for no noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.coils import Coils, dac, gain, saturated, true_force
from truenewton.bench.simulated.control import Control, ramp
from truenewton.bench.simulated.plant import advance
from truenewton.bench.simulated.sensors import Sensors, counts, out_of_range, reading
from truenewton.errors import BenchFault

BLOCK = 16  # samples of noise drawn at once
# Multiplications beyond which OpenBLAS starts threads: of products as small as ours they cost more
# than they bring, ten times the work itself where others want the cores.
SINGLE_THREAD = 2**18
FEWEST_COLUMNS = 8  # in one product; of larger mirrors threads are worth it


@dataclass(frozen=True, eq=False)
class Loop:
    """A mirror in closed loop; whether the gains hold it `stability.check_stability` says.

    Attributes
    ----------
    stiffness, mass, damping
        (n, n) K of the glass less the gradient of the bias magnets [N/m], M [kg], C [N s/m].
    coils, sensors, control
        What closes the loop.
    """

    stiffness: Array
    mass: Array
    damping: Array
    coils: Coils
    sensors: Sensors
    control: Control

    @cached_property
    def step(self) -> Array:
        """(2n, 3n) of the glass, from one sample to the next (`plant.advance`)."""
        return advance(self.stiffness, self.mass, self.damping, self.control.period)


def samples_of(
    loop: Loop,
    shapes: Array,
    load_force: Array,
    noise: Sequence[np.random.Generator],
    steps: int,
    *,
    held: int = 0,
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield commanded force [N], reading and true displacement [m], (n, batch), of each sample.

    The step to the shapes is commanded at the first sample, after a long rest on the flat mirror.
    For the samples ``held`` the pseudo-integrator stands at what it comes to in the end.

    Raises
    ------
    BenchFault
        A coil saturated, a gap closed, a sensor went out of range.
    """
    coils, sensors, control = loop.coils, loop.sensors, loop.control
    n, batch = shapes.shape
    flat = sensors.offset[:, None]
    feed_forward = control.feed_forward @ shapes
    k_p, k_d, g = control.proportional, control.derivative, control.slow_gain
    swift, slow = control.swift, control.slow
    z, force = equilibrium(loop, np.zeros_like(shapes), load_force)
    state = np.concatenate([z, np.zeros_like(z)])
    z_end, _ = equilibrium(loop, shapes, load_force)
    y, y_end = z / sensors.gain[:, None], z_end / sensors.gain[:, None]
    once, twice, slow_error = y.copy(), y.copy(), -y
    queue = [dac(coils, force)] * control.delay
    apart = _single_threaded(loop.step, batch)
    for k, (of_sensor, of_driver) in zip(range(steps), _noise(noise, n, batch), strict=False):
        time, z = k * control.period, state[:n]
        counted = counts(sensors, z, of_sensor)
        if (out := out_of_range(sensors, counted)).any():
            touches = "touches the plate or is too near for its sensor ({:.6g} counts)"
            raise _stopped(out, time, touches, counted, sensors.codes - 1)
        read = reading(sensors, counted)
        y = read - flat
        error = ramp(time, control.position_ramp) * shapes - y
        once += swift * (y - once)
        change = swift * (once - twice)
        twice += change
        slow_error += slow * (error - slow_error)
        if k < held:
            slow_error = shapes - y_end
        wanted = ramp(time, control.force_ramp) * feed_forward
        wanted += k_p * (error + (g - 1) * slow_error) - (k_d * control.rate) * change
        if (out := saturated(coils, wanted)).any():
            raise _stopped(out, time, "is asked for {:.3g} N", wanted, coils.saturation)
        force = dac(coils, wanted)
        queue.append(force)
        applied = queue.pop(0) + coils.driver_noise * of_driver
        pushed = true_force(coils, applied, z) - load_force
        yield force, read, z
        before = np.concatenate([state, pushed])
        state = np.concatenate([loop.step @ before[:, columns] for columns in apart], axis=1)


def _single_threaded(step: Array, batch: int) -> list[slice]:
    """Return the columns to be multiplied at once, so that OpenBLAS keeps to one thread."""
    width = SINGLE_THREAD // step.size
    if width < FEWEST_COLUMNS:
        return [slice(batch)]
    return [slice(first, first + width) for first in range(0, batch, width)]


def equilibrium(loop: Loop, shapes: Array, load_force: Array) -> tuple[Array, Array]:
    """Return true displacement [m] and commanded force [N], (n, batch), after a long rest.

    Solves K z + load = true force of c, c = K_c z_c + k_p g (z_c - z / gain), by Newton's method
    with the slope of the flat mirror; each turn leaves less than a hundredth.
    """
    coils, control = loop.coils, loop.control
    held = control.proportional * control.slow_gain
    back = held / loop.sensors.gain[:, None]
    mean_gain = gain(coils).mean(axis=1, keepdims=True)
    slope = np.linalg.inv(loop.stiffness + np.diagflat(mean_gain * back))
    z = np.zeros_like(shapes)
    for _ in range(8):
        force = control.feed_forward @ shapes + held * shapes - back * z
        z += slope @ (true_force(coils, force, z) - load_force - loop.stiffness @ z)
    return z, control.feed_forward @ shapes + held * shapes - back * z


def slowest_creep(loop: Loop) -> float:
    """Return the longest time constant of the glass where the pseudo-integrator stands still [s].

    Of (C + k_d alpha / gain) z' + (K + k_p alpha / gain) z = 0: what inertia there is makes it
    shorter.
    """
    answer = np.diag(gain(loop.coils).mean(axis=1) / loop.sensors.gain)
    held = loop.stiffness + loop.control.proportional * answer
    braked = loop.damping + loop.control.derivative * answer
    return float(np.linalg.eigvals(np.linalg.solve(held, braked)).real.max())


def _noise(
    random: Sequence[np.random.Generator], n: int, batch: int
) -> Iterator[tuple[Array | float, Array | float]]:
    """Yield (n, batch) of unit standard deviation for sensors and drivers, sample by sample."""
    if len(random) not in (0, batch):
        raise ValueError(f"{len(random)} generators of noise for {batch} shapes")
    while random:
        rows = [row.standard_normal((BLOCK, 2, n)) for row in random]
        yield from np.ascontiguousarray(np.moveaxis(np.array(rows), 0, -1))
    yield from repeat((0.0, 0.0))


def _stopped(which: Array, time: float, does: str, got: Array, want: float) -> BenchFault:
    actuator, column = np.argwhere(which)[0]
    value = float(got[actuator, column])
    return BenchFault(
        f"actuator {actuator} {does.format(value)} in shape {column}, {1e3 * time:.2f} ms after"
        " the command",
        remedy="command a smaller shape, or lower the gains",
        got=value,
        want=want,
    )
