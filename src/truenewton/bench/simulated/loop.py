"""Closed loop: sensors, control, DAC, coils and glass, from sample to sample.

A loop is stable if its roots, in z, are inside the unit circle. Readings are means over the samples
of a record. Shapes advance together, one a column. Unless said otherwise:

shapes
    (n, batch) commanded displacements from the flat mirror [m].
load_force
    (n, batch) or (n, 1) true forces that hold the flat mirror under its load, the bias magnets'
    included [N].
noise
    One generator a shape, see `row_noise`; none for no noise.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, repeat

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, expm

from truenewton.arrays import Array
from truenewton.bench.protocol import BATCHES, error_of_mean
from truenewton.bench.simulated.electronics import (
    SAMPLES,
    Coils,
    Control,
    Sensors,
    counts,
    dac,
    gain,
    out_of_range,
    ramp,
    reading,
    saturated,
    true_force,
)
from truenewton.errors import BenchFault, LoopUnstable

STATIC_STREAM, LOOP_STREAM = 1, 2  # streams, beside that from which the truth is drawn
NOISE_BLOCK = 16  # samples of noise drawn at once
# Multiplications beyond which OpenBLAS starts threads: of products as small as ours they cost more
# than they bring, ten times the work itself where others want the cores.
SINGLE_THREAD_SIZE = 2**18
MIN_COLUMNS = 8  # in one product; of larger mirrors threads are worth it
MAX_DENSE_ACTUATORS = 100  # actuators, up to which the whole matrix is taken
RAMP_TIME = 2e-3  # after which commands and filters stand still [s, derived]
CREEP_TIMES = 8.0  # time constants of the slowest motion, which leave 3e-4 of it [derived]
RELEASE_TIME = 12e-3  # with the pseudo-integrator let go, before the first sample [s, derived]
MAX_DRIFT = 1e-9  # between the halves of a record, of what has settled [m, derived]
MAX_GROWTH = 1.5  # of the noise between the halves, of what is stable
MIN_GROWING_NOISE = 10e-3  # twice the usual scatter of force; below it nothing is said to grow [N]


@dataclass(frozen=True, eq=False)
class Loop:
    """A mirror in closed loop; `check_stability` says whether its gains hold it.

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
        """(2n, 3n) of the glass, from one sample to the next (`advance`)."""
        return advance(self.stiffness, self.mass, self.damping, self.control.period)


def advance(stiffness: Array, mass: Array, damping: Array, period: float) -> Array:
    """Return S, (..., 2n, 3n), of the glass from one sample to the next: after = S [state; force].

    The state is (z, period z'), both in metres; the force is held for the period of a sample [s],
    over which the matrix exponential is exact. Of (..., n, n) K [N/m], M [kg], C [N s/m].
    """
    n = stiffness.shape[-1]
    joint = np.zeros((*stiffness.shape[:-2], 3 * n, 3 * n))
    joint[..., :n, n : 2 * n] = np.eye(n)
    joint[..., n : 2 * n, :n] = -(period**2) * np.linalg.solve(mass, stiffness)
    joint[..., n : 2 * n, n : 2 * n] = -period * np.linalg.solve(mass, damping)
    joint[..., n : 2 * n, 2 * n :] = period**2 * np.linalg.inv(mass)
    return np.asarray(expm(joint)[..., : 2 * n, :])


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
    For the samples ``held`` the pseudo-integrator stands at what it comes to in the end. A coil
    that saturates, a gap that closes, or a sensor out of range is a `BenchFault`.
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
    width = SINGLE_THREAD_SIZE // step.size
    if width < MIN_COLUMNS:
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


def row_noise(
    seed: int, load: str, cycle: int, shape: int, sign: int, stream: int = LOOP_STREAM
) -> np.random.Generator:
    """Return the noise of one row, which its labels alone decide; of the load its key."""
    return np.random.default_rng([seed, stream, zlib.crc32(load.encode()), cycle, shape, sign + 1])


def _noise(
    random: Sequence[np.random.Generator], n: int, batch: int
) -> Iterator[tuple[Array | float, Array | float]]:
    """Yield (n, batch) of unit standard deviation for sensors and drivers, sample by sample."""
    if len(random) not in (0, batch):
        raise ValueError(f"{len(random)} generators of noise for {batch} shapes")
    while random:
        rows = [row.standard_normal((NOISE_BLOCK, 2, n)) for row in random]
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


def state_matrix(step: Array, alpha: Array, sensor_gain: Array, control: Control) -> Array:
    """Return what takes the closed loop, at rest commands, from one sample to the next.

    (..., m, m) of m = (5 + delay) n states: z, period z', both filters of the derivative, the
    pseudo-integrator, the forces on their way. Coils' gradient, steps and limits are left out: they
    are not linear. Of (..., 2n, 3n) steps of the glass, from `advance`, and (..., n) alpha and
    sensor gain.
    """
    n, delay = step.shape[-2] // 2, control.delay
    size = (5 + delay) * n
    z, once, twice, slow_error = (slice(k * n, (k + 1) * n) for k in (0, 2, 3, 4))
    swift, slow = control.swift, control.slow
    now = np.broadcast_to(np.eye(size), (*step.shape[:-2], size, size))
    # Rows: what each quantity is, in terms of the state before.
    y = now[..., z, :] / sensor_gain[..., None]
    once_after = (1 - swift) * now[..., once, :] + swift * y
    change = swift * (once_after - now[..., twice, :])
    slow_after = (1 - slow) * now[..., slow_error, :] - slow * y
    force = (
        control.proportional * (-y + (control.slow_gain - 1) * slow_after)
        - control.derivative * control.rate * change
    )
    queue = [now[..., (5 + k) * n : (6 + k) * n, :] for k in range(delay)] + [force]
    pushed = alpha[..., None] * queue[0]
    glass = step @ np.concatenate([now[..., : 2 * n, :], pushed], axis=-2)
    twice_after = now[..., twice, :] + change
    return np.concatenate([glass, once_after, twice_after, slow_after, *queue[1:]], axis=-2)


def roots(loop: Loop) -> Array:
    """Return the roots of a closed loop in z; it is stable while all are within the unit circle.

    Up to `MAX_DENSE_ACTUATORS` these are the (m,) eigenvalues of `state_matrix`. Of more actuators
    each mode of the glass is taken alone, with the lowest and with the highest alpha / sensor gain
    of all actuators and with its own part of damping: exact where mass, damping, alpha and gain are
    even, an approximation otherwise.
    """
    alpha, sensor_gain, control = loop.coils.alpha, loop.sensors.gain, loop.control
    stiffness, mass, n = loop.stiffness, loop.mass, len(loop.stiffness)
    if n <= MAX_DENSE_ACTUATORS:
        return np.asarray(np.linalg.eigvals(state_matrix(loop.step, alpha, sensor_gain, control)))
    # Sensors beside pucks leave both a little unlike their transposes, of which eigh would see one
    # triangle; the symmetric part has the same roots to second order. Modes' M modes = 1.
    values, modes = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
    own_damping = np.einsum("ik,ij,jk->k", modes, loop.damping, modes, optimize=True)
    step = advance(
        values[:, None, None], np.ones((n, 1, 1)), own_damping[:, None, None], control.period
    )
    reach = np.sum(modes**2, axis=0)[:, None]
    strength = alpha / sensor_gain
    return np.concatenate(
        [
            np.linalg.eigvals(state_matrix(step, extreme * reach, np.ones((n, 1)), control))
            for extreme in (strength.min(), strength.max())
        ],
        axis=None,
    )


def check_stability(loop: Loop) -> None:
    """Refuse a loop that the gains do not hold: with a root on or outside the unit circle."""
    every = roots(loop)
    worst = every[np.abs(every).argmax()]
    radius = float(np.abs(worst))
    frequency = abs(np.angle(worst)) * loop.control.rate / (2 * np.pi)
    if not radius < 1:
        raise LoopUnstable(
            f"the loop does not hold: a motion at {frequency:.0f} Hz grows by a factor of"
            f" {radius:.4g} a sample",
            remedy="lower the gains, shorten the delay or damp the glass more"
            if frequency > 0
            else "raise the proportional gain",
            got=radius,
            want=1.0,
        )


@dataclass(frozen=True, eq=False)
class Record:
    """Mean and standard deviation of a sample, (n, batch), of each shape."""

    force: Array  # that the DAC took [N]
    force_scatter: Array
    position: Array  # the reading along +z [m]
    position_scatter: Array
    # (batch,) no mean reading changed by more than `MAX_DRIFT` between the halves: through the air
    # film a steady drift pulls by 64 N s/m x 1 nm / 14 ms = 4 uN at most.
    settled: NDArray[np.bool_]
    # (n, batch) standard deviation of the mean force, by batch means [N]; None of a record too
    # short for it. Samples follow each other closely: of the forces, whose scatter is mostly what
    # the derivative makes of noise, it is far less than scatter / samples^1/2.
    force_error: Array | None


def record(
    loop: Loop,
    shapes: Array,
    load_force: Array,
    noise: Sequence[np.random.Generator] = (),
    *,
    settling: float | None = None,
    samples: int = SAMPLES,
) -> Record:
    """Step from the flat mirror to each shape, wait, and record.

    The pseudo-integrator would take some 100 ms. So it is put at once where it ends, which is
    known, and let go when the glass has crept there through the air film. Arguments are those of
    `samples_of`, the settling from the command to the first sample [s], by itself as long as that
    takes, and the samples of the record. Noise that grows during the record is `LoopUnstable`.
    """
    swift = RAMP_TIME + CREEP_TIMES * slowest_creep(loop)
    wait = round((swift + RELEASE_TIME if settling is None else settling) * loop.control.rate)
    held = min(round(swift * loop.control.rate), wait)
    steps = samples_of(loop, shapes, load_force, noise, wait + samples, held=held)
    recorded = (np.array([force, read]) for force, read, _ in islice(steps, wait, None))
    # Sums about the first sample, so that differences are not lost in rounding.
    first = next(recorded)
    total, square = (np.zeros((parts, 2, *shapes.shape)) for parts in (BATCHES, 2))
    for k, value in enumerate(recorded, start=1):
        off, batch = value - first, BATCHES * k // samples
        total[batch] += off
        square[2 * batch // BATCHES] += off * off
    size = np.bincount(BATCHES * np.arange(samples) // samples, minlength=BATCHES)
    halves = total.reshape(2, -1, *total.shape[1:]).sum(axis=1)
    in_half = np.maximum(size.reshape(2, -1).sum(axis=1), 1)[:, None, None, None]
    halves /= in_half
    _refuse_growth(np.sqrt(np.maximum(square / in_half - halves**2, 0))[:, 0])
    mean = total.sum(axis=0) / samples
    scatter = np.sqrt(np.maximum(square.sum(axis=0) / samples - mean**2, 0))
    batch_means = total[:, 0] / np.maximum(size, 1)[:, None, None]
    return Record(
        force=first[0] + mean[0],
        force_scatter=scatter[0],
        position=first[1] + mean[1],
        position_scatter=scatter[1],
        settled=np.abs(halves[1, 1] - halves[0, 1]).max(axis=0) <= MAX_DRIFT,
        force_error=error_of_mean(batch_means) if size.all() else None,
    )


def _refuse_growth(scatter: Array) -> None:
    """Refuse (2, n, batch) scatters of the force in both halves of which the second is larger."""
    grown = scatter[1] > np.maximum(MAX_GROWTH * scatter[0], MIN_GROWING_NOISE)
    if grown.any():
        actuator, column = np.argwhere(grown)[0]
        raise LoopUnstable(
            f"the noise of actuator {actuator} in shape {column} grows",
            remedy="lower the gains",
            got=float(scatter[1, actuator, column]),
            want=float(scatter[0, actuator, column]),
        )
