"""Closed loop: sensors, control, DAC, coils and glass, from sample to sample.

Capacitive sensors turn the distance of the glass into counts, and these into a displacement:

    distance = d0 / (v ADC / codes - c)            reading = gap - distance, along +z (plate above)

True displacement = gain x reading, except for an offset of each sensor. The control of an actuator
gets its own sensor (y, a displacement along +z) and the command of the whole mirror (z_c, its
shape; K_c, the feed-forward):

    c = r_f(t) K_c z_c + k_p L(r_p(t) z_c - y) - k_d D y

r_p and r_f are the ramps of position and force; L = g (1 + s/w) / (1 + s g/w) is the
pseudo-integrator, of gain g far below w and 1 above; D = s / (1 + s/p)^2 the derivative. Poles are
mapped to samples exactly (z = exp(s period)); the derivative is a backward difference. The DAC
passes c on in whole steps. With z the displacement along +z and T the temperature:

    true force = alpha c (1 + k_T (T - 20 degC)) (1 + COILGRAD z)        bias = b + BIASGRAD z

Readings are means over the samples of a record. Shapes advance together, one per column:

shapes
    (n, batch) commanded displacements from the flat mirror [m].
load_force
    (n, batch) or (n, 1) true forces, bias magnets included, that hold the flat mirror under its
    load [N].
noise
    One generator per shape, see `row_noise`; none for no noise.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, repeat

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from truenewton.arrays import Array
from truenewton.bench.protocol import BATCHES, error_of_mean
from truenewton.errors import BenchFault, LoopUnstable
from truenewton.linalg import threads

SAMPLES = 2048  # of a reading [conf]
GAIN_SCATTER = 0.004  # relative, after calibration: 0.25-0.5 % [derived], 2 % before
OFFSET_SCATTER = 0.5e-6  # of what a sensor reads on the flat mirror [m, guess]
REFERENCE_TEMPERATURE = 20.0  # at which alpha holds [degC]


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of a mirror as they truly are, and the law that the electronics apply.

    The constants of the law are those of 16 bit [conf]; one count is 2.2 nm at 68 um.
    """

    gain: Array  # (n,) true displacement / reading
    offset: Array  # (n,) reading of the flat mirror [m]
    gap: float  # distance of the flat mirror [m]; 68 um on P45 [paper]
    noise: float = 3e-9  # standard deviation of one sample [m]; [paper]
    d0: float = 65e-6  # [m], about
    c: float = 0.1364
    v: float = 2.0
    codes: int = 65536


def draw_sensors(n: int, gap: float, random: np.random.Generator) -> Sensors:
    """Draw the gains and offsets of n calibrated sensors at a nominal gap [m]."""
    return Sensors(
        gain=random.normal(1.0, GAIN_SCATTER, n),
        offset=random.normal(0.0, OFFSET_SCATTER, n),
        gap=gap,
    )


def counts(sensors: Sensors, displacement: Array, noise: Array | float = 0.0) -> Array:
    """Return the (n, batch) counts of the ADC, whole numbers, of true displacements along +z [m].

    Noise is (n, batch) of unit standard deviation. Counts are infinite if the gap is closed;
    those beyond codes - 1 an ADC does not have: see `out_of_range`.
    """
    distance = (sensors.gap - sensors.offset)[:, None] - displacement / sensors.gain[:, None]
    distance = distance + sensors.noise * noise
    with np.errstate(divide="ignore"):
        inverse = np.where(distance > 0, sensors.d0 / distance, np.inf)
    return np.asarray(np.rint((inverse + sensors.c) * (sensors.codes / sensors.v)))


def out_of_range(sensors: Sensors, counted: Array) -> Array:
    """Return which (n, batch) counts the ADC does not have: the glass is too near, or touches."""
    return np.asarray(~(counted <= sensors.codes - 1))


def reading(sensors: Sensors, counted: Array) -> Array:
    """Return the displacement along +z [m] that the electronics make of (n, batch) counts."""
    distance = sensors.d0 / (counted * (sensors.v / sensors.codes) - sensors.c)
    return np.asarray(sensors.gap - distance)


@dataclass(frozen=True, eq=False)
class Control:
    """What runs in the electronics. Numbers are [conf] unless they are [guess]."""

    feed_forward: Array  # (n, n) K_c, commanded force per measured displacement [N/m]
    proportional: float = 0.13e6  # k_p, commanded force per displacement [N/m]
    derivative: float = 30.0  # k_d [N s/m]; of the measured displacement alone [guess]
    derivative_pole: float = 15e3  # both [Hz]
    # Of the pseudo-integrator: g and w / 2 pi [Hz]. That its gain is back at 1 above w, its pole so
    # at w / g = 2 Hz, is how we read that [guess].
    slow_gain: float = 5.0
    slow_corner: float = 10.0
    position_ramp: float = 0.1e-3  # [s], half a cosine wave [guess]
    force_ramp: float = 0.75e-3  # likewise
    rate: float = 71.6e3  # samples a second
    delay: int = 1  # whole samples between a reading and the force that answers it [guess]

    @property
    def period(self) -> float:
        """Between samples [s]."""
        return 1 / self.rate

    @property
    def swift(self) -> float:
        """How much of a step each derivative pole follows in one sample."""
        return float(1 - np.exp(-2 * np.pi * self.derivative_pole / self.rate))

    @property
    def slow(self) -> float:
        """The same of the pseudo-integrator's pole, w / g."""
        return float(1 - np.exp(-2 * np.pi * self.slow_corner / self.slow_gain / self.rate))


def ramp(time: float, duration: float) -> float:
    """Return how much of a step has been commanded: half a cosine wave from 0 to 1."""
    return float(0.5 - 0.5 * np.cos(np.pi * min(time / duration, 1.0)))


@dataclass(frozen=True, eq=False)
class Coils:
    """The actuators of a mirror as they truly are."""

    # (n,) true Newton / commanded Newton at 20 degC, mirror flat; 0.70 to 1.10 on P45 [paper]. The
    # scatter of 1.2 % of the force per ampere [conf] is part of it.
    alpha: Array
    # BIASGRAD, change of one bias force per displacement along +z [N/m]; plate above, so that
    # -31 N/m of gap [conf] is +31.
    bias_gradient: float = 31.0
    # COILGRAD, relative change of one coil's force per displacement along +z [1/m]; plate above, so
    # that -0.6 % for 10 um of gap [conf] is +600.
    coil_gradient: float = 600.0
    magnet_coefficient: float = -1.1e-3  # relative change of force [1/K]; NdFeB [lit]
    dac_step: float = 41.6e-6  # of the commanded force [N]; 16 bit [conf]
    saturation: float = 0.8  # largest commanded force, either sign [N]; [conf]
    # Standard deviation of one sample of the force that the drivers add, in commanded Newtons [N].
    driver_noise: float = 30e-6  # [guess]
    temperature: float | Array = REFERENCE_TEMPERATURE  # of magnets and coils [deg C], or (batch,)


def gain(coils: Coils) -> Array:
    """Return (n, batch) true Newton / commanded Newton, mirror flat; batch 1 at one temperature."""
    warmer = np.atleast_1d(coils.temperature) - REFERENCE_TEMPERATURE
    return np.asarray(coils.alpha[:, None] * (1 + coils.magnet_coefficient * warmer))


def true_force(coils: Coils, force: Array, displacement: Array) -> Array:
    """Return the coils' (n, batch) force on the glass [N]; the bias magnets not included.

    Of (n, batch) commanded forces at the coils [N] and displacements along +z [m].
    """
    return np.asarray(gain(coils) * force * (1 + coils.coil_gradient * displacement))


def saturated(coils: Coils, force: Array) -> Array:
    """Return which (n, batch) commanded forces are more than the coils can give."""
    return np.asarray(~(np.abs(force) <= coils.saturation))  # not a number: as bad as too much


def dac(coils: Coils, force: Array) -> Array:
    """Return the (n, batch) commanded forces [N] that the DAC takes: whole steps, clipped."""
    most = np.floor(coils.saturation / coils.dac_step)
    return np.asarray(coils.dac_step * np.clip(np.rint(force / coils.dac_step), -most, most))


STATIC_STREAM, LOOP_STREAM = 1, 2  # streams of random numbers; stream 0 is for the truth
NOISE_BLOCK = 16  # samples of noise drawn at once
MIN_ACTUATORS_FOR_THREADS = 200  # products of smaller mirrors are slower in several threads of BLAS
RAMP_TIME = 2e-3  # after which commands and filters are constant [s, derived]
CREEP_TIMES = 8.0  # time constants of the slowest motion, which leave 3e-4 of it [derived]
RELEASE_TIME = 12e-3  # from the release of the pseudo-integrator to the first sample [s, derived]
MAX_DRIFT = 1e-9  # between the halves of a record, of what has settled [m, derived]
MAX_GROWTH = 1.5  # of the noise between the halves, if the loop is stable
MIN_GROWING_NOISE = 10e-3  # [N]: twice the usual scatter of force


@dataclass(frozen=True, eq=False)
class Loop:
    """A mirror in closed loop."""

    stiffness: Array  # (n, n) K of the glass less the gradient of the bias magnets [N/m]
    mass: Array  # (n, n) [kg]
    damping: Array  # (n, n) [N s/m]
    coils: Coils
    sensors: Sensors
    control: Control

    @cached_property
    def step(self) -> Array:
        """(2n, 3n) of the glass, from one sample to the next (`advance`)."""
        return advance(self.stiffness, self.mass, self.damping, self.control.period)


def advance(stiffness: Array, mass: Array, damping: Array, period: float) -> Array:
    """Return S, (2n, 3n), of the glass from one sample to the next: after = S [state; force].

    The state is (z, period z'), both in metres; the force is held for the period of a sample [s],
    over which the matrix exponential is exact. K [N/m], M [kg] and C [N s/m] are (n, n).
    """
    n = len(stiffness)
    joint = np.zeros((3 * n, 3 * n))
    joint[:n, n : 2 * n] = np.eye(n)
    joint[n : 2 * n, :n] = -(period**2) * np.linalg.solve(mass, stiffness)
    joint[n : 2 * n, n : 2 * n] = -period * np.linalg.solve(mass, damping)
    joint[n : 2 * n, 2 * n :] = period**2 * np.linalg.inv(mass)
    return np.asarray(expm(joint)[: 2 * n])


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
    For the samples ``held`` the pseudo-integrator is at its final value. A coil that saturates, a
    gap that closes, or a sensor out of range is a `BenchFault`.
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
    for k, (of_sensor, of_driver) in zip(range(steps), _noise(noise, n, batch), strict=False):
        time, z = k * control.period, state[:n]
        counted = counts(sensors, z, of_sensor)
        if (out := out_of_range(sensors, counted)).any():
            touches = "touches the plate or is too near for its sensor ({:.6g} counts)"
            raise _stopped(out, time, touches, counted)
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
            raise _stopped(out, time, "is asked for {:.3g} N", wanted)
        force = dac(coils, wanted)
        queue.append(force)
        applied = queue.pop(0) + coils.driver_noise * of_driver
        pushed = true_force(coils, applied, z) - load_force
        yield force, read, z
        state = loop.step @ np.concatenate([state, pushed])


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
    """Return the longest time constant of the glass, the pseudo-integrator constant [s].

    Of (C + k_d alpha / gain) z' + (K + k_p alpha / gain) z = 0; inertia makes it shorter.
    """
    answer = np.diag(gain(loop.coils).mean(axis=1) / loop.sensors.gain)
    held = loop.stiffness + loop.control.proportional * answer
    braked = loop.damping + loop.control.derivative * answer
    return float(np.linalg.eigvals(np.linalg.solve(held, braked)).real.max())


def row_noise(
    seed: int, load: str, cycle: int, shape: int, sign: int, stream: int = LOOP_STREAM
) -> np.random.Generator:
    """Return the noise of one row, which depends on its labels only; ``load`` is the key."""
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


def _stopped(which: Array, time: float, does: str, values: Array) -> BenchFault:
    actuator, column = np.argwhere(which)[0]
    return BenchFault(
        f"actuator {actuator} {does.format(values[actuator, column])} in shape {column},"
        f" {1e3 * time:.2f} ms after the command",
        remedy="command a smaller shape, or lower the gains",
    )


@dataclass(frozen=True, eq=False)
class Record:
    """Mean and standard deviation of a sample, (n, batch), of each shape."""

    force: Array  # that the DAC took [N]
    force_scatter: Array
    position: Array  # the reading along +z [m]
    position_scatter: Array
    # (batch,) no mean reading changed by more than `MAX_DRIFT` between the halves: against
    # the damping of P45 a steady drift pulls by 115 N s/m x 1 nm / 14 ms = 8 uN at most.
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
    """Step from the flat mirror to each shape, (n, batch) [m], wait, and record.

    The pseudo-integrator would take some 100 ms. It is therefore set to its known end, and released
    when the glass has crept there. ``settling`` is the time from the command
    to the first sample [s], by default what that takes. Growing noise is `LoopUnstable`.
    """
    swift = RAMP_TIME + CREEP_TIMES * slowest_creep(loop)
    wait = round((swift + RELEASE_TIME if settling is None else settling) * loop.control.rate)
    held = min(round(swift * loop.control.rate), wait)
    steps = samples_of(loop, shapes, load_force, noise, wait + samples, held=held)
    recorded = (np.array([force, read]) for force, read, _ in islice(steps, wait, None))
    # Sums about the first sample, so that differences are not lost in rounding.
    total, square = (np.zeros((parts, 2, *shapes.shape)) for parts in (BATCHES, 2))
    with threads(1) if len(shapes) < MIN_ACTUATORS_FOR_THREADS else nullcontext():
        first = next(recorded)
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
    """Refuse (2, n, batch) scatters of the force that are larger in the second half."""
    grown = scatter[1] > np.maximum(MAX_GROWTH * scatter[0], MIN_GROWING_NOISE)
    if grown.any():
        actuator, column = np.argwhere(grown)[0]
        raise LoopUnstable(
            f"the noise of actuator {actuator} in shape {column} grows", remedy="lower the gains"
        )
