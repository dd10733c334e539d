"""The simulated mirror in static equilibrium: every shape is held exactly, the readings are noisy.

A shape z is held by the true forces f = K z + f_load. f_load balances the weight of the glass,
spread evenly, the magnets and bias magnets at the actuators, and the weight tool on three wedges.
The bias magnets change by BIASGRAD z. The electronics record c = f / (alpha (1 + COILGRAD z)).
In both, z is relative to the coils, which shift as the mirror leans.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.bench.simulated.loop import (
    LOOP_STREAM,
    REFERENCE_TEMPERATURE,
    SAMPLES,
    STATIC_STREAM,
    Coils,
    Control,
    Loop,
    Record,
    Sensors,
    draw_sensors,
    equilibrium,
    gain,
    record,
    row_noise,
)
from truenewton.bench.simulated.truth import SegmentTruth, Truth
from truenewton.errors import BenchFault, GeometryError, LimitExceeded
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.shell_model import (
    ExternalForces,
    ShellModel,
    external_resultants,
    forces_under,
    model_shell,
    moving_mass,
    static_shapes,
    weight_on,
)
from truenewton.quantities import taking_units
from truenewton.records.cycle import Cycle, Segment, sums_of
from truenewton.statics.arms import effective_weight, external_load
from truenewton.statics.load import Load
from truenewton.statics.modes import scaled_modes, stiffness_modes

START = datetime.datetime(2026, 1, 1, 9, 0, tzinfo=datetime.UTC)  # of the simulated clock
SECONDS_PER_SHAPE = 0.5
PAUSE = datetime.timedelta(minutes=30)  # in which someone lifts the glass to put the ring on it
CENTRING_ERROR = 0.3e-3  # of the tool, each axis [m, guess]
BIAS_SCATTER = 0.05  # relative, of the bias magnets [guess]
SENSOR_NOISE = 3e-9 / np.sqrt(SAMPLES)  # 3 nm a sample [paper]
SEEDS_PER_MIRROR = 1000  # more segments would share their noise


@dataclass(frozen=True, eq=False)
class StaticBench:
    """A mirror, its truth, and the shapes that its limits allow."""

    mirror: Mirror
    truth: Truth
    glass: ShellModel
    coils: Coils
    sensors: Sensors
    loads: tuple[Load, ...]  # as declared
    shapes: Array  # (shapes, n) readings along z [m]: stiffness modes, softest first
    load_force: Array  # (L, n) true forces that hold the flat mirror under each load [N]
    coil_shift: Array  # (L,) true displacement of the coils along +z under each load [m]
    force_noise: float  # standard deviation of one commanded-force reading [N]


@taking_units(stroke="m", force_limit="N", force_noise="N", temperature="deg_C")
def static_bench(
    mirror: Mirror,
    seed: int,
    *,
    loads: Sequence[Load] = (),
    stroke: float = 1e-6,
    force_limit: float = 0.4,
    force_noise: float = 1e-4,
    temperature: float = REFERENCE_TEMPERATURE,
    glass: ShellModel | None = None,
) -> StaticBench:
    """Draw the truth of a mirror and plan its stiffness modes within stroke and force.

    Parameters
    ----------
    mirror
        The nominal mirror.
    seed
        Of all that is random: alpha, bias magnets, sensors, errors of weights and tool, noise.
    loads
        The loads as declared; by default without and with the mirror's own tool.
    stroke, force_limit
        Largest displacement [m], and force, true and commanded [N], of an actuator in any shape.
    force_noise
        Standard deviation of one commanded-force reading [N].
    temperature
        Of magnets and coils [deg C].
    glass
        The shell model of the mirror, if there is one already.

    Raises
    ------
    GeometryError, LimitExceeded
        A shell or actuators that are not valid; static forces that alone are too large.

    Examples
    --------
    >>> tn.static_bench(tn.mirrors.p45(), seed=1).truth.loads
    ('bare', 'ring')
    """
    random = np.random.default_rng([seed, 0])
    layout, n = mirror.layout, mirror.layout.n
    ring = Load("ring", mirror.added_weight, mirror.added_weight_error, tool="ring")
    loads = tuple(loads) or (Load("bare"), ring)
    _refuse_closed_gap(mirror, stroke)
    alpha = random.uniform(*mirror.alpha_range, n)
    weight = float(random.normal(mirror.weight, mirror.weight_error))
    bias = mirror.bias_force * random.normal(1.0, BIAS_SCATTER, n)
    glass = glass or model_shell(mirror)
    added, tilt, external = _drawn_loads(mirror, loads, weight, bias, random)
    load_force = np.array([forces_under(glass, each) for each in external])
    shift = np.array([_drawn_shift(load, random) for load in loads])
    k = np.array([external_resultants(mirror, each) for each in external])
    coils = Coils(alpha, bias_gradient=mirror.bias_gradient,
                  coil_gradient=mirror.coil_gradient, temperature=temperature)  # fmt: skip
    sensors = draw_sensors(n, mirror.gap, random)
    warm = gain(coils)[:, 0]
    room = _room_for_shapes(mirror, warm, load_force, force_noise, force_limit)
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
    load_force += coils.bias_gradient * shift[:, None]
    return StaticBench(
        mirror, truth, glass, coils, sensors, loads, shapes, load_force, shift, force_noise
    )


def _drawn_shift(load: Load, random: np.random.Generator) -> float:
    """Return how far the coils are shifted under a load [m], drawn within its error."""
    shift = load.coil_shift or 0.0
    return shift + random.normal(0.0, load.coil_shift_error) if load.coil_shift_error else shift


def _drawn_loads(
    mirror: Mirror, loads: Sequence[Load], weight: float, bias: Array, random: np.random.Generator
) -> tuple[Array, Array, list[ExternalForces]]:
    """Return (L,) true Q [N] and tilt [deg], and the forces on the glass, the tool off centre.

    One tool has the same error under all loads.
    """
    error = {load.tool or load.key: random.standard_normal() for load in loads}
    added = [load.added + load.added_error * error[load.tool or load.key] for load in loads]
    tilt = [load.tilt + load.tilt_error * random.standard_normal() for load in loads]
    external = []
    for q, cosine in zip(added, np.cos(np.radians(tilt)), strict=True):
        centre = random.normal(0.0, CENTRING_ERROR, 2)
        external.append(weight_on(mirror, weight, q, cosine=cosine, off_centre=centre, bias=bias))
    return np.array(added), np.array(tilt), external


def _refuse_closed_gap(mirror: Mirror, stroke: float) -> None:
    if mirror.gap - stroke <= 0:
        raise GeometryError(
            f"a stroke of {stroke:g} m closes the gap of {mirror.gap:g} m",
            remedy="take smaller shapes or a larger gap",
        )


def _room_for_shapes(
    mirror: Mirror, alpha: Array, load_force: Array, noise: float, limit: float
) -> Array:
    """Return the (n,) true forces that loads and limit leave to shapes [N]."""
    # The recorded force must stay under the limit too, with its noise.
    room = limit * np.minimum(alpha, 1.0) - 5 * noise - np.abs(load_force).max(axis=0)
    if (room <= 0).any():
        raise LimitExceeded(
            f"holding the mirror alone takes actuator {mirror.layout.id[room.argmin()]} beyond the"
            f" limit of {limit:g} N",
            remedy="take a lighter weight, less noise, or a higher limit",
        )
    return np.asarray(room)


def loop_of(bench: StaticBench) -> Loop:
    """Close the loop around the glass of a bench, its feed-forward as a calibration gives it."""
    shapes = static_shapes(bench.glass)
    mass, pucks = moving_mass(bench.glass, shapes)
    # M z'' + c S' S z' + K~ z = S' f, in terms of f
    to_forces = np.asarray(np.linalg.inv(pucks.T), dtype=float)
    softer = bench.glass.stiffness - bench.coils.bias_gradient * np.eye(bench.mirror.layout.n)
    feed_forward = softer / bench.coils.alpha[:, None] * bench.sensors.gain
    return Loop(
        softer,
        to_forces @ mass,
        bench.mirror.damping * pucks,
        bench.coils,
        bench.sensors,
        Control(feed_forward),
    )


def rest_displacement(bench: StaticBench) -> Array:
    """Return (L, n) true displacements of the flat mirror in closed loop, under each load [m].

    A campaign in closed loop finds alpha (1 + COILGRAD z) there; `Truth.alpha` is that at z = 0.
    """
    flat = np.zeros((bench.mirror.layout.n, len(bench.loads)))
    return equilibrium(loop_of(bench), flat, bench.load_force.T)[0].T


def held_command(bench: StaticBench, load_index: int, position: Array) -> Array:
    """Return the (rows, n) commands that hold (rows, n) readings under a load, noiseless [N]."""
    z = position * bench.sensors.gain
    true_force = z @ bench.glass.stiffness.T + bench.load_force[load_index]
    true_force -= bench.coils.bias_gradient * z
    nearer = z - bench.coil_shift[load_index]
    return np.asarray(true_force / (bench.truth.alpha * (1 + bench.coils.coil_gradient * nearer)))


def take(
    bench: StaticBench,
    loop: Loop | None,
    load_index: int,
    position: Array,
    labels: Iterable[tuple[str, int, int, int]],
    samples: int = SAMPLES,
) -> Record:
    """Return the readings of (N, n) shapes [m] under a load, held exactly if there is no loop.

    The noise of a row depends on its labels: key of the load, cycle, shape and sign.
    """
    stream = STATIC_STREAM if loop is None else LOOP_STREAM
    noise = [row_noise(bench.truth.seed, *label, stream) for label in labels]
    if loop is not None:
        load_force = bench.load_force[load_index, :, None]
        nearer = 1.0 - loop.coils.coil_gradient * bench.coil_shift[load_index]
        loop = replace(loop, coils=replace(loop.coils, alpha=nearer * loop.coils.alpha))
        return record(loop, position.T, load_force, noise, samples=samples)
    n = bench.mirror.layout.n
    drawn = np.array([row.standard_normal(2 * n) for row in noise]) * np.sqrt(SAMPLES / samples)
    force = held_command(bench, load_index, position) + bench.force_noise * drawn[:, :n]
    return Record(
        force=force.T,
        force_scatter=np.broadcast_to(bench.force_noise * np.sqrt(SAMPLES), force.T.shape),
        position=(position + SENSOR_NOISE * drawn[:, n:]).T,
        position_scatter=np.broadcast_to(SENSOR_NOISE * np.sqrt(SAMPLES), force.T.shape),
        settled=np.ones(len(force), dtype=bool),
        force_error=np.broadcast_to(bench.force_noise * np.sqrt(SAMPLES / samples), force.T.shape),
    )


def run_cycles(bench: StaticBench, cycles: int, loop: Loop | None = None) -> Iterator[Cycle]:
    """Yield the cycles of a campaign: every shape and its negative, under each load in turn.

    In a loop, rows that have not settled are marked as not valid, and the noise of the forces is
    not recorded.

    Parameters
    ----------
    bench
        From `static_bench`.
    cycles
        Of each load.
    loop
        From `loop_of`; if None, shapes are held exactly.

    Raises
    ------
    LoopUnstable, BenchFault
        In a loop only.

    Examples
    --------
    >>> bench = tn.static_bench(tn.mirrors.p45(), seed=1)
    >>> [(cycle.load.name, cycle.number) for cycle in tn.run_cycles(bench, 2)]
    [('bare', 1), ('bare', 2), ('ring', 1), ('ring', 2)]
    """
    shape, sign, position = rows_of_cycle(bench)
    mirror, start, time = bench.mirror, START, SECONDS_PER_SHAPE * np.arange(1.0, len(shape) + 1)

    def cycle(load_index: int, load: Load, number: int) -> Cycle:
        labels = ((load.key, number, int(k), int(s)) for k, s in zip(shape, sign, strict=True))
        taken = take(bench, loop, load_index, position, labels)
        return Cycle(
            instrument=mirror.name, date=start, number=number, load=load,
            weight=mirror.weight, weight_error=mirror.weight_error, layout=mirror.layout,
            time=time, shape=shape, sign=sign, force=taken.force.T, valid=taken.settled,
            temperature=np.full(len(shape), bench.coils.temperature),
            position=taken.position.T, gap=mirror.gap,
            force_error=(bench.force_noise or None) if loop is None else None,
            coil_gradient=bench.coils.coil_gradient, bias_gradient=bench.coils.bias_gradient,
        )  # fmt: skip

    for load_index, load in enumerate(bench.loads):
        for number in range(1, cycles + 1):
            yield cycle(load_index, load, number)
            start += datetime.timedelta(seconds=SECONDS_PER_SHAPE * (len(shape) + 1))
        start += PAUSE


def rows_of_cycle(bench: StaticBench) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return SHAPE, SIGN (N,) and the (N, n) commanded readings [m]."""
    count = len(bench.shapes)
    shape, sign = np.repeat(np.arange(1, count + 1), 2), np.tile([1, -1], count)
    return shape, sign, np.asarray(sign[:, None] * bench.shapes[shape - 1])


# Segmented mirrors


@dataclass(frozen=True, eq=False)
class SegmentedBench:
    """A segmented mirror: a bench for each segment, which move together.

    Nothing acts between segments. All take the shape of the same number at once.
    """

    mirror: SegmentedMirror
    benches: tuple[StaticBench, ...]
    seed: int  # segment k has that of `seed_of`

    @property
    def shapes(self) -> Array:
        """(shapes, n) readings along z of all actuators [m]."""
        return np.concatenate([bench.shapes for bench in self.benches], axis=1)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of a segment of a mirror."""
    return SEEDS_PER_MIRROR * seed + number


def bench_of(
    mirror: Mirror | SegmentedMirror, seed: int, *, force_noise: float, temperature: float
) -> StaticBench | SegmentedBench:
    """Return the static bench of a mirror in one piece or in segments, as `static_bench`.

    All segments have as many shapes: one with fewer takes its first ones again.
    """
    if not isinstance(mirror, SegmentedMirror):
        return static_bench(mirror, seed, force_noise=force_noise, temperature=temperature)
    glasses: dict[int, ShellModel] = {}
    for part, alike in mirror.kinds:
        glasses |= dict.fromkeys(alike, model_shell(part))
    benches = [
        static_bench(
            segment,
            seed_of(seed, k),
            force_noise=force_noise,
            temperature=temperature,
            glass=glasses[k],
        )
        for k, segment in enumerate(mirror.segments, 1)
    ]
    most = max(len(bench.shapes) for bench in benches)
    filled = (
        replace(bench, shapes=bench.shapes[np.arange(most) % len(bench.shapes)])
        for bench in benches
    )
    return SegmentedBench(mirror, tuple(filled), seed)


def campaign_on(
    bench: StaticBench | SegmentedBench, cycles: int, fidelity: str = "static"
) -> Iterator[Cycle]:
    """Return the cycles of a campaign on a bench, as `run_cycles`; not in a loop if segmented."""
    if isinstance(bench, StaticBench):
        return run_cycles(bench, cycles, loop_of(bench) if fidelity == "loop" else None)
    if fidelity == "loop":
        raise BenchFault(
            f"{bench.mirror.name} is in segments, whose loop is not simulated",
            remedy="leave --fidelity out, or give the file of one segment",
        )
    first, *others = (run_cycles(one, cycles) for one in bench.benches)
    # Only the first segment of the last cycle stays in memory while the next one is made.
    return (_joined(bench.mirror, [part, *map(next, others)]) for part in first)


def _joined(mirror: SegmentedMirror, parts: Sequence[Cycle]) -> Cycle:
    """Join the cycles of all segments."""
    segments = tuple(
        Segment(k, part.weight, part.weight_error, part.load.added, part.load.added_error)
        for k, part in enumerate(parts, 1)
    )
    sums, first = sums_of(segments), parts[0]
    return replace(
        first,
        instrument=mirror.name,
        load=replace(first.load, added=sums["added"], added_error=sums["added_error"]),
        weight=sums["weight"],
        weight_error=sums["weight_error"],
        layout=mirror.layout,
        force=np.concatenate([part.force for part in parts], axis=1),
        position=np.concatenate([np.asarray(part.position) for part in parts], axis=1),
        segments=segments,
    )


def truth_of(bench: StaticBench | SegmentedBench) -> Truth:
    """Return the true values of a bench."""
    if isinstance(bench, StaticBench):
        return bench.truth
    truths = [one.truth for one in bench.benches]
    widest = max(len(truth.alpha) for truth in truths)
    padded = [np.pad(one.stiffness, ((0, 0), (0, widest - len(one.alpha)))) for one in truths]
    places = [place.motion for place in bench.mirror.places]
    torques = np.array([_torques_about_axis(*each) for each in zip(truths, places, strict=True)])
    segments = [
        SegmentTruth(k, load, truth.weight, float(added), truth.bias_force, *torque)
        for k, (truth, of_loads) in enumerate(zip(truths, torques.tolist(), strict=True), 1)
        for load, added, torque in zip(truth.loads, truth.added, of_loads, strict=True)
    ]
    return replace(
        truths[0],
        instrument=bench.mirror.name,
        layout=bench.mirror.layout,
        alpha=np.concatenate([truth.alpha for truth in truths]),
        stiffness=np.concatenate(padded),
        sensor_gain=np.concatenate([truth.sensor_gain for truth in truths]),
        weight=sum(truth.weight for truth in truths),
        added=np.sum([truth.added for truth in truths], axis=0),
        bias_force=sum(truth.bias_force for truth in truths),
        torque_y=torques[..., 0].sum(axis=0),
        torque_x=torques[..., 1].sum(axis=0),
        seed=bench.seed,
        segments=tuple(segments),
    )


def _torques_about_axis(truth: Truth, motion: Array) -> Array:
    """Return (L, 2) M_y and M_x under each load about the origin of the mirror [N m]."""
    weight = effective_weight(truth.weight, truth.added, truth.tilt)
    load = external_load(weight, truth.bias_force, truth.torque_y, truth.torque_x)
    _, along_x, along_y = motion @ load.T
    return np.stack([along_x, -along_y], axis=1)
