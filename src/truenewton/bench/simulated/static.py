"""The simulated mirror in static equilibrium: every shape is held exactly, the readings are noisy.

A shape z is held by the true forces f = K z + f_load, where f_load carries what else acts on the
shell: the weight of the glass, spread evenly; magnets and bias magnets, each at its actuator; the
weight tool on three wedges. The bias magnets change by BIASGRAD z, and the electronics record
c = f / (alpha (1 + COILGRAD z)).
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.bench.simulated.coils import REFERENCE_TEMPERATURE, Coils, gain
from truenewton.bench.simulated.noise import SAMPLES, STATIC, cycle_noise
from truenewton.bench.simulated.sensors import Sensors, draw_sensors
from truenewton.bench.simulated.truth import Truth
from truenewton.errors import GeometryError, LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shapes import scaled_modes
from truenewton.mirrors.shell.held_glass import (
    HeldGlass,
    external_resultants,
    forces_under,
    held_glass,
    weight_on,
)
from truenewton.records.cycle import Cycle
from truenewton.statics.load import Load
from truenewton.statics.modes import stiffness_modes

START = datetime.datetime(2026, 1, 1, 9, 0, tzinfo=datetime.UTC)  # of the simulated clock
SECONDS_PER_SHAPE = 0.5
PAUSE = datetime.timedelta(minutes=30)  # in which someone lifts the glass to put the ring on it
CENTRING_ERROR = 0.3e-3  # of the tool, each axis [m, guess]
BIAS_SCATTER = 0.05  # relative, of the bias magnets [guess]
SENSOR_NOISE = 3e-9 / np.sqrt(SAMPLES)  # 3 nm a sample [paper]


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
    loads = tuple(loads) or _bare_and_ring(mirror)
    _refuse_closed_gap(mirror, stroke)
    alpha = random.uniform(*mirror.alpha_range, n)
    weight = float(random.normal(mirror.weight, mirror.weight_error))
    bias = mirror.bias_force * random.normal(1.0, BIAS_SCATTER, n)
    added, tilt = _true_loads(loads, random)
    glass, external = held_glass(mirror), []
    for q, cosine in zip(added, np.cos(np.radians(tilt)), strict=True):
        centre = random.normal(0.0, CENTRING_ERROR, 2)
        external.append(weight_on(mirror, weight, q, cosine=cosine, off_centre=centre, bias=bias))
    load_force = np.array([forces_under(glass, each) for each in external])
    k = np.array([external_resultants(mirror, each) for each in external])
    coils = Coils(alpha, bias_gradient=mirror.bias_gradient, coil_gradient=mirror.coil_gradient)
    sensors = draw_sensors(n, mirror.gap, random)
    warm = gain(coils, temperature)[:, 0]
    # What is recorded stays under the limit too, with room for its noise.
    room = force_limit * np.minimum(warm, 1.0) - 5 * force_noise - np.abs(load_force).max(axis=0)
    _refuse_no_room(mirror, room, load_force, force_limit)
    truth = Truth(
        instrument=mirror.name,
        layout=layout,
        alpha=warm,
        stiffness=glass.stiffness,
        sensor_gain=sensors.gain,
        weight=weight,
        added=added,
        tilt=tilt,
        loads=tuple(load.name for load in loads),
        bias_force=float(layout.nz @ bias),
        torque_y=k[:, 1],
        torque_x=-k[:, 2],
        seed=seed,
    )
    by_reading = (glass.stiffness - coils.bias_gradient * np.eye(n)) * sensors.gain
    room /= 1 + coils.coil_gradient * stroke
    shapes = scaled_modes(stiffness_modes(glass.stiffness).modes.T, by_reading, stroke, room)
    return StaticBench(
        mirror, truth, glass, coils, sensors, loads, shapes, load_force, force_noise, temperature
    )


def _bare_and_ring(mirror: Mirror) -> tuple[Load, Load]:
    ring = Load("ring", mirror.added_weight, mirror.added_weight_error, tool="ring")
    return Load("bare"), ring


def _refuse_closed_gap(mirror: Mirror, stroke: float) -> None:
    if mirror.gap - stroke <= 0:
        raise GeometryError(
            f"a stroke of {stroke:g} m closes the gap of {mirror.gap:g} m",
            remedy="take smaller shapes or a larger gap",
            got=stroke,
            want=mirror.gap,
        )


def _refuse_no_room(mirror: Mirror, room: Array, load_force: Array, limit: float) -> None:
    if (room <= 0).any():
        raise LimitExceeded(
            f"holding the mirror alone takes actuator {mirror.layout.id[room.argmin()]} beyond the"
            f" limit of {limit:g} N",
            remedy="take a lighter weight, less noise, or a higher limit",
            got=float(np.abs(load_force).max()),
            want=limit,
        )


def _true_loads(loads: Sequence[Load], random: np.random.Generator) -> tuple[Array, Array]:
    """Return (L,) true Q [N] and tilt [deg]; one tool errs alike wherever it hangs."""
    error = {load.tool or load.key: random.standard_normal() for load in loads}
    added = [load.added + load.added_error * error[load.tool or load.key] for load in loads]
    tilt = [load.tilt + load.tilt_error * random.standard_normal() for load in loads]
    return np.array(added), np.array(tilt)


def held_command(bench: StaticBench, load_index: int, position: Array) -> Array:
    """Return the (rows, n) commands that hold (rows, n) readings under a load, noiseless [N]."""
    z = position * bench.sensors.gain
    true_force = z @ bench.glass.stiffness.T + bench.load_force[load_index]
    true_force -= bench.coils.bias_gradient * z
    return np.asarray(true_force / (bench.truth.alpha * (1 + bench.coils.coil_gradient * z)))


def run_cycles(bench: StaticBench, cycles: int) -> Iterator[Cycle]:
    """Yield the cycles of a campaign: every shape and its negative, under each load in turn."""
    shape, sign, position = rows_of_cycle(bench)
    rows, n = list(zip(shape.tolist(), sign.tolist(), strict=True)), bench.shapes.shape[1]
    for load_index, number, start in schedule(bench, cycles):
        key = bench.loads[load_index].key
        random = cycle_noise(bench.truth.seed, key, number, rows, STATIC)
        noise = np.array([row.standard_normal(2 * n) for row in random])
        force = held_command(bench, load_index, position) + bench.force_noise * noise[:, :n]
        read = position + SENSOR_NOISE * noise[:, n:]
        settled = np.ones(len(shape), dtype=bool)
        yield cycle_of(bench, load_index, number, start, force, read, settled, bench.force_noise)


def schedule(bench: StaticBench, cycles: int) -> Iterator[tuple[int, int, datetime.datetime]]:
    """Yield index of the load, number and start of each cycle."""
    start = START
    for load_index in range(len(bench.loads)):
        for number in range(1, cycles + 1):
            yield load_index, number, start
            start += datetime.timedelta(seconds=SECONDS_PER_SHAPE * (2 * len(bench.shapes) + 1))
        start += PAUSE


def rows_of_cycle(bench: StaticBench) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return SHAPE, SIGN (N,) and the (N, n) readings asked for [m]."""
    count = len(bench.shapes)
    shape, sign = np.repeat(np.arange(1, count + 1), 2), np.tile([1, -1], count)
    return shape, sign, np.asarray(sign[:, None] * bench.shapes[shape - 1])


def cycle_of(
    bench: StaticBench,
    load_index: int,
    number: int,
    start: datetime.datetime,
    force: Array,
    position: Array,
    valid: NDArray[np.bool_],
    force_error: float,
) -> Cycle:
    """Return the record of one cycle, with what the files declare of the mirror.

    Its (N, n) forces [N] and positions [m], (N,) rows valid or not; 0 for an unknown force error.
    """
    shape, sign, _ = rows_of_cycle(bench)
    mirror = bench.mirror
    return Cycle(
        instrument=mirror.name,
        date=start,
        number=number,
        load=bench.loads[load_index],
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
