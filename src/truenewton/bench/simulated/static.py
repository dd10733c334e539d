"""The simulated mirror in static equilibrium: every shape is held exactly, the readings are noisy.

A shape z is held by the true forces f = K z + f_load, where f_load carries what else acts on the
shell: the weight of the glass, spread evenly; magnets and bias magnets, each at its actuator; the
weight tool on three wedges. The bias magnets change by BIASGRAD z, and the electronics record
c = f / (alpha (1 + COILGRAD z)).
"""

from __future__ import annotations

import datetime
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.bench.simulated.coils import REFERENCE_TEMPERATURE, Coils, gain
from truenewton.bench.simulated.sensors import Sensors, draw_sensors
from truenewton.bench.simulated.truth import Truth
from truenewton.errors import GeometryError, LimitExceeded
from truenewton.mirrors.known import GRAVITY, Mirror
from truenewton.mirrors.shell.held_glass import HeldGlass, forces_under, held_glass
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import resultants
from truenewton.statics.load import Load
from truenewton.statics.modes import stiffness_modes

START = datetime.datetime(2026, 1, 1, 9, 0, tzinfo=datetime.UTC)  # of the simulated clock
SECONDS_PER_SHAPE = 0.5
PAUSE = datetime.timedelta(minutes=30)  # in which someone lifts the glass to put the ring on it
WEDGE_MARGIN = 1.5e-3  # wedges of the tool outside the inner edge of the shell [m, guess]
CENTRING_ERROR = 0.3e-3  # of the tool, each axis [m, guess]
BIAS_SCATTER = 0.05  # relative, of the bias magnets [guess]
SENSOR_NOISE = 3e-9 / np.sqrt(2048)  # 3 nm a sample [paper], the mean of 2,048 [conf]


@dataclass(frozen=True, eq=False)
class StaticBench:
    """A mirror, its truth, and the plan of shapes that its limits allow.

    Attributes
    ----------
    mirror, truth
        What is known of it, and what is true.
    glass, coils, sensors
        What holds and reads it, as it truly is.
    loads
        The loads, as declared.
    shapes
        (shapes, n) readings along z [m]: stiffness modes, softest first.
    load_force
        (L, n) true forces that hold the flat mirror under each load [N].
    force_noise
        Standard deviation of one commanded-force reading [N].
    temperature
        [deg C]
    """

    mirror: Mirror
    truth: Truth
    glass: HeldGlass
    coils: Coils
    sensors: Sensors
    loads: tuple[Load, ...]
    shapes: Array
    load_force: Array
    force_noise: float
    temperature: float


def static_bench(
    mirror: Mirror,
    seed: int,
    *,
    loads: Sequence[Load] = (),
    stroke: float = 1e-6,
    force_limit: float = 0.4,
    force_noise: float = 1e-4,
    temperature: float = REFERENCE_TEMPERATURE,
) -> StaticBench:
    """Draw the truth of a mirror and plan its stiffness modes within stroke and force.

    Parameters
    ----------
    mirror
        What is known of the mirror.
    seed
        Decides everything random: alpha, the bias magnets, sensors, the true weights within their
        errors, how the tool is centred, the noise.
    loads
        The loads as declared; without and with the mirror's own tool unless told.
    stroke
        Largest displacement of an actuator [m].
    force_limit
        Largest force, true and commanded, of an actuator in any shape [N].
    force_noise
        Standard deviation of one commanded-force reading [N].
    temperature
        Of magnets and coils [deg C].

    Raises
    ------
    GeometryError
        A shell or actuators that cannot be.
    LimitExceeded
        The static forces alone are too large.
    """
    random = np.random.default_rng([seed, 0])
    layout, n = mirror.layout, mirror.layout.n
    loads = tuple(loads) or (
        Load("bare"),
        Load("ring", mirror.added_weight, mirror.added_weight_error, tool="ring"),
    )
    if mirror.gap - stroke <= 0:
        raise GeometryError(
            f"a stroke of {stroke:g} m closes the gap of {mirror.gap:g} m",
            remedy="take smaller shapes or a larger gap",
            got=stroke,
            want=mirror.gap,
        )
    alpha = random.uniform(*mirror.alpha_range, n)
    weight = float(random.normal(mirror.weight, mirror.weight_error))
    bias = mirror.bias_force * random.normal(1.0, BIAS_SCATTER, n)
    wrong = {load.tool or load.key: random.standard_normal() for load in loads}
    added = [load.added + load.added_error * wrong[load.tool or load.key] for load in loads]
    tilt = [load.tilt + load.tilt_error * random.standard_normal() for load in loads]

    glass = held_glass(mirror)
    magnets = np.full(n, -mirror.magnet_mass * GRAVITY)
    held, external = [], []
    for q, cosine in zip(added, np.cos(np.radians(tilt)), strict=True):
        spread = cosine * (weight - magnets.sum())
        off_x, off_y = random.normal(0.0, CENTRING_ERROR, 2)
        x, y = tool_wedges(mirror)
        wedges = (x + off_x, y + off_y)
        on_wedge = np.full(3, cosine * q / 3)
        # Taken up by each actuator itself, along its normal.
        local = cosine * magnets / layout.nz + bias
        held.append(forces_under(glass, spread, wedges, on_wedge) - local)
        of_tool = [spread + on_wedge.sum(), wedges[0] @ on_wedge, wedges[1] @ on_wedge]
        external.append(of_tool + resultants(layout, local))
    k = np.array(external)  # (W + B, M_y, -M_x) of each load
    load_force = np.array(held)
    coils = Coils(
        alpha, bias, bias_gradient=mirror.bias_gradient, coil_gradient=mirror.coil_gradient
    )
    sensors = draw_sensors(n, mirror.gap, random)
    warm = gain(coils, temperature)[:, 0]
    # What is recorded stays under the limit too, with room for its noise.
    room = force_limit * np.minimum(warm, 1.0) - 5 * force_noise - np.abs(load_force).max(axis=0)
    if (room <= 0).any():
        raise LimitExceeded(
            f"holding the mirror alone takes actuator {layout.id[room.argmin()]} beyond the limit"
            f" of {force_limit:g} N",
            remedy="take a lighter weight, less noise, or a higher limit",
            got=float(np.abs(load_force).max()),
            want=force_limit,
        )
    truth = Truth(
        instrument=mirror.name,
        layout=layout,
        alpha=warm,
        stiffness=glass.stiffness,
        sensor_gain=sensors.gain,
        weight=weight,
        added=np.array(added),
        tilt=np.array(tilt),
        loads=tuple(load.name for load in loads),
        bias_force=float(layout.nz @ bias),
        torque_y=k[:, 1],
        torque_x=-k[:, 2],
        seed=seed,
    )
    held_by = (glass.stiffness - coils.bias_gradient * np.eye(n)) * sensors.gain
    room /= 1 + coils.coil_gradient * stroke
    shapes = _scaled_modes(glass.stiffness, held_by, stroke, room)
    return StaticBench(
        mirror, truth, glass, coils, sensors, loads, shapes, load_force, force_noise, temperature
    )


def tool_wedges(mirror: Mirror) -> tuple[Array, Array]:
    """Return x, y [m] of the tool's three wedges, 120 degrees apart, well centred."""
    angle = np.radians([90.0, 210.0, 330.0])
    radius = mirror.shell.inner_radius + WEDGE_MARGIN
    return radius * np.cos(angle), radius * np.sin(angle)


def _scaled_modes(stiffness: Array, held_by: Array, stroke: float, room: Array) -> Array:
    """Return the stiffness modes, each as large as stroke and force allow.

    Forces are (n, n) ``held_by`` times the readings.
    """
    modes = stiffness_modes(stiffness).modes.T
    force = np.abs(modes @ held_by.T)
    largest = np.abs(modes).max(axis=1)
    amplitude = np.minimum(
        stroke / largest, (room / np.maximum(force, 1e-12 * room.max())).min(axis=1)
    )
    return np.asarray(modes * amplitude[:, None])


def held_command(bench: StaticBench, place: int, position: Array) -> Array:
    """Return the (rows, n) commands that hold (rows, n) readings under a load, noiseless [N]."""
    z = position * bench.sensors.gain
    true_force = z @ bench.glass.stiffness.T + bench.load_force[place]
    true_force -= bench.coils.bias_gradient * z
    return np.asarray(true_force / (bench.truth.alpha * (1 + bench.coils.coil_gradient * z)))


def row_noise(seed: int, load: Load, cycle: int, shape: int, sign: int) -> np.random.Generator:
    """Return the noise of one row: its own, so that rows can be taken again in any order."""
    return np.random.default_rng([seed, 1, zlib.crc32(load.key.encode()), cycle, shape, sign + 1])


def run_cycles(bench: StaticBench, cycles: int) -> Iterator[Cycle]:
    """Yield the cycles of a campaign: every shape and its negative, under each load in turn."""
    for place, number, start in schedule(bench, cycles):
        shape, sign, position = rows_of_cycle(bench)
        n = bench.shapes.shape[1]
        noise = np.array(
            [
                row_noise(bench.truth.seed, bench.loads[place], number, k, s).standard_normal(2 * n)
                for k, s in zip(shape.tolist(), sign.tolist(), strict=True)
            ]
        )
        force = held_command(bench, place, position) + bench.force_noise * noise[:, :n]
        read = position + SENSOR_NOISE * noise[:, n:]
        settled = np.ones(len(shape), dtype=bool)
        yield cycle_of(bench, place, number, start, force, read, settled, bench.force_noise)


def schedule(bench: StaticBench, cycles: int) -> Iterator[tuple[int, int, datetime.datetime]]:
    """Yield place of the load, number and start of each cycle."""
    start = START
    for place in range(len(bench.loads)):
        for number in range(1, cycles + 1):
            yield place, number, start
            start += datetime.timedelta(seconds=SECONDS_PER_SHAPE * (2 * len(bench.shapes) + 1))
        start += PAUSE


def rows_of_cycle(bench: StaticBench) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return SHAPE, SIGN (N,) and the (N, n) readings asked for [m]."""
    count = len(bench.shapes)
    shape, sign = np.repeat(np.arange(1, count + 1), 2), np.tile([1, -1], count)
    return shape, sign, np.asarray(sign[:, None] * bench.shapes[shape - 1])


def cycle_of(
    bench: StaticBench,
    place: int,
    number: int,
    start: datetime.datetime,
    force: Array,
    position: Array,
    valid: NDArray[np.bool_],
    force_error: float,
) -> Cycle:
    """Return the record of one cycle, with what the files declare of the mirror."""
    shape, sign, _ = rows_of_cycle(bench)
    mirror = bench.mirror
    return Cycle(
        instrument=mirror.name,
        date=start,
        number=number,
        load=bench.loads[place],
        weight=mirror.weight,
        weight_error=mirror.weight_error,
        layout=mirror.layout,
        time=SECONDS_PER_SHAPE * np.arange(1.0, len(shape) + 1),
        shape=shape,
        sign=sign,
        force=force,
        valid=valid,
        temperature=np.full(len(shape), bench.temperature),
        position=position,
        gap=mirror.gap,
        force_error=force_error or None,
        coil_gradient=bench.coils.coil_gradient,
        bias_gradient=bench.coils.bias_gradient,
    )
