"""A bench in static equilibrium: every shape is held exactly, the readings are noisy.

A shape z is held by the true forces f = K z + f_load, where f_load carries what else acts on the
shell: the weight of the glass, spread evenly; magnets and bias magnets, each at its actuator; the
weight tool on three wedges. The electronics record c = f / alpha. The shell is a flat plate.
"""

from __future__ import annotations

import datetime
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truenewton.actuators import Array
from truenewton.bench.simulated.truth import Truth
from truenewton.errors import LimitExceeded
from truenewton.measurements import Cycle, Load
from truenewton.mirrors import GRAVITY, Mirror
from truenewton.modes import stiffness_modes
from truenewton.shell.condensation import condense, holding_forces
from truenewton.shell.fourier import influence, uniform_influence
from truenewton.statics import arms, resultants

START = datetime.datetime(2026, 1, 1, 9, 0, tzinfo=datetime.UTC)  # of the simulated clock
SECONDS_PER_SHAPE = 0.5
PAUSE = datetime.timedelta(minutes=30)  # in which someone lifts the glass to put the ring on it
WEDGE_MARGIN = 2.5e-3  # wedges of the tool outside the inner edge of the shell [m, guess]
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
    loads
        The loads, as declared.
    shapes
        (shapes, n) displacements along z [m]: stiffness modes, softest first.
    load_force
        (L, n) true forces that hold the flat mirror under each load [N].
    force_noise
        Standard deviation of one commanded-force reading [N].
    """

    mirror: Mirror
    truth: Truth
    loads: tuple[Load, ...]
    shapes: Array
    load_force: Array
    force_noise: float


def static_bench(
    mirror: Mirror,
    seed: int,
    *,
    loads: Sequence[Load] = (),
    stroke: float = 1e-6,
    force_limit: float = 0.4,
    force_noise: float = 1e-4,
) -> StaticBench:
    """Draw the truth of a mirror and plan its stiffness modes within stroke and force.

    Parameters
    ----------
    mirror
        What is known of the mirror.
    seed
        Decides everything random: alpha, the bias magnets, the true weights within their errors,
        how the tool is centred, the noise.
    loads
        The loads as declared; without and with the mirror's own tool unless told.
    stroke
        Largest displacement of an actuator [m].
    force_limit
        Largest force, true and commanded, of an actuator in any shape [N].
    force_noise
        Standard deviation of one commanded-force reading [N].

    Raises
    ------
    LimitExceeded
        The static forces alone are too large.
    """
    random = np.random.default_rng([seed, 0])
    layout, n = mirror.layout, mirror.layout.n
    loads = tuple(loads) or (
        Load("bare"),
        Load("ring", mirror.added_weight, mirror.added_weight_error, tool="ring"),
    )
    alpha = random.uniform(*mirror.alpha_range, n)
    weight = float(random.normal(mirror.weight, mirror.weight_error))
    bias = mirror.bias_force * random.normal(1.0, BIAS_SCATTER, n)
    wrong = {load.tool or load.key: random.standard_normal() for load in loads}
    added = [load.added + load.added_error * wrong[load.tool or load.key] for load in loads]
    tilt = [load.tilt + load.tilt_error * random.standard_normal() for load in loads]

    at = (layout.x, layout.y)
    condensed = condense(influence(mirror.shell, at, at), arms(layout))
    magnets = np.full(n, -mirror.magnet_mass * GRAVITY)
    glass = weight - magnets.sum()
    even = uniform_influence(mirror.shell, at)
    held, external = [], []
    for q, cosine in zip(added, np.cos(np.radians(tilt)), strict=True):
        wedges = _wedges(mirror, random)
        on_wedge = np.full(3, cosine * q / 3)
        bent = cosine * glass * even + influence(mirror.shell, at, wedges) @ on_wedge
        spread = np.array([cosine * glass, 0.0, 0.0]) + np.array(
            [on_wedge.sum(), wedges[0] @ on_wedge, wedges[1] @ on_wedge]
        )
        # Taken up by each actuator itself, along its normal.
        local = cosine * magnets / layout.nz + bias
        held.append(holding_forces(condensed, np.zeros(n), bent, spread) - local)
        external.append(spread + resultants(layout, local))
    k = np.array(external)  # (W + B, M_y, -M_x) of each load
    load_force = np.array(held)
    # What is recorded stays under the limit too, with room for its noise.
    room = force_limit * np.minimum(alpha, 1.0) - 5 * force_noise - np.abs(load_force).max(axis=0)
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
        alpha=alpha,
        stiffness=condensed.stiffness,
        weight=weight,
        added=np.array(added),
        tilt=np.array(tilt),
        loads=tuple(load.name for load in loads),
        bias_force=float(layout.nz @ bias),
        torque_y=k[:, 1],
        torque_x=-k[:, 2],
        seed=seed,
    )
    shapes = _scaled_modes(condensed.stiffness, stroke, room)
    return StaticBench(mirror, truth, loads, shapes, load_force, force_noise)


def _wedges(mirror: Mirror, random: np.random.Generator) -> tuple[Array, Array]:
    """Return x, y [m] of the tool's three wedges, 120 degrees apart, off centre a little."""
    angle = np.radians([90.0, 210.0, 330.0])
    radius = mirror.shell.inner_radius + WEDGE_MARGIN
    off_x, off_y = random.normal(0.0, CENTRING_ERROR, 2)
    return radius * np.cos(angle) + off_x, radius * np.sin(angle) + off_y


def _scaled_modes(stiffness: Array, stroke: float, room: Array) -> Array:
    """Return the stiffness modes, each as large as stroke and force allow."""
    modes = stiffness_modes(stiffness).modes.T
    force = np.abs(modes @ stiffness)
    largest = np.abs(modes).max(axis=1)
    amplitude = np.minimum(
        stroke / largest, (room / np.maximum(force, 1e-12 * room.max())).min(axis=1)
    )
    return np.asarray(modes * amplitude[:, None])


def run_cycles(bench: StaticBench, cycles: int) -> Iterator[Cycle]:
    """Yield the cycles of a campaign: every shape and its negative, under each load in turn."""
    start = START
    for place in range(len(bench.loads)):
        for number in range(1, cycles + 1):
            cycle = _cycle(bench, place, number, start)
            yield cycle
            start += datetime.timedelta(seconds=SECONDS_PER_SHAPE * (len(cycle.time) + 1))
        start += PAUSE


def row_noise(seed: int, load: Load, cycle: int, shape: int, sign: int) -> np.random.Generator:
    """Return the noise of one row: its own, so that rows can be taken again in any order."""
    return np.random.default_rng([seed, 1, zlib.crc32(load.key.encode()), cycle, shape, sign + 1])


def _cycle(bench: StaticBench, place: int, number: int, start: datetime.datetime) -> Cycle:
    truth, load, mirror = bench.truth, bench.loads[place], bench.mirror
    count, n = bench.shapes.shape
    shape = np.repeat(np.arange(1, count + 1), 2)
    sign = np.tile([1, -1], count)
    position = sign[:, None] * bench.shapes[shape - 1]
    true_force = position @ truth.stiffness + bench.load_force[place]
    noise = np.array(
        [
            row_noise(truth.seed, load, number, k, s).standard_normal(2 * n)
            for k, s in zip(shape.tolist(), sign.tolist(), strict=True)
        ]
    )
    return Cycle(
        instrument=mirror.name,
        date=start,
        number=number,
        load=load,
        weight=mirror.weight,
        weight_error=mirror.weight_error,
        layout=mirror.layout,
        time=SECONDS_PER_SHAPE * np.arange(1, 2 * count + 1),
        shape=shape,
        sign=sign,
        force=true_force / truth.alpha + bench.force_noise * noise[:, :n],
        valid=np.ones(2 * count, dtype=bool),
        temperature=np.full(2 * count, 20.0),
        position=position + SENSOR_NOISE * noise[:, n:],
        gap=mirror.gap,
        force_error=bench.force_noise or None,
    )
