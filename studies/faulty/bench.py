"""A static bench on which things go wrong, written for `faults.py` alone.

The glass, its stiffness K and what it takes to hold a force at a point of it are the library's; all
else is made here, so that a fault enters as physics. Rows of all files of a campaign are handled
together. With z the displacements of a row, the true forces of the coils are

    f = K z + (what holds weight, ring and whatever touches the glass) - (forces of bias magnets)

which balance whatever acts on the glass, exactly; and what the electronics record is

    c = f / (alpha gain law(c)) + zero + noise

A fault is a function that changes a `Day` before its forces are read, or what was read.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import truenewton as tn
from studies.accuracy import rings336
from truenewton.mirrors.known import Mirror, p45
from truenewton.mirrors.shell.shell_model import (
    ExternalForces,
    ShellModel,
    external_resultants,
    forces_under,
    model_shell,
    tool_wedges,
    weight_on,
)
from truenewton.statics.arms import arms
from truenewton.statics.modes import scaled_modes, stiffness_modes

SEED = 14
START = datetime.datetime(2026, 3, 2, 8, 0, tzinfo=datetime.UTC)
HOURS_OF_FILE, HOURS_OF_MOUNTING = 0.375, 0.5  # two hours from load to load, of four files each
STROKE, LARGEST_FORCE = 1e-6, 0.3  # of a shape [m], [N]
BIAS_SCATTER = 0.05  # relative, of the bias magnets
CENTRING = 0.15e-3  # of the ring, each axis [m]
SENSOR_NOISE, SENSOR_GAIN, SENSOR_OFFSET = 0.07e-9, 3e-3, 1e-6  # [m], relative, [m]
TEMPERATURE = 20.0  # [deg C]

Array = np.ndarray
Points = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Bench:
    """A mirror and what its glass does: the same for all seeds."""

    mirror: Mirror
    glass: ShellModel
    _held: dict[bytes, tuple[Array, Array]] = field(default_factory=dict)

    @cached_property
    def arms(self) -> Array:
        """(3, n) nz, x, y."""
        return arms(self.mirror.layout)

    @cached_property
    def shapes(self) -> Array:
        """(shapes, n) displacements of the stiffness modes [m], each held with both signs."""
        stiffness = self.glass.stiffness
        return scaled_modes(stiffness_modes(stiffness).modes.T, stiffness, STROKE, LARGEST_FORCE)

    @cached_property
    def elastic(self) -> Array:
        """(n, n) projector on the forces of null sum and torques."""
        return np.eye(self.arms.shape[1]) - np.linalg.pinv(self.arms) @ self.arms

    @cached_property
    def weight(self) -> tuple[Array, Array]:
        """(n,) forces that hold the bare mirror [N], (3,) its weight and moments."""
        external = weight_on(self.mirror, self.mirror.weight)
        return forces_under(self.glass, external), external_resultants(self.mirror, external)

    def holding(self, at: Points) -> tuple[Array, Array]:
        """Return (n,) and (3,) of 1 N shared evenly by points of the glass, along +z."""
        key = np.array(at).tobytes()
        if key not in self._held:  # the wedges of a seed are the same for many faults
            count, n = np.size(at[0]), self.arms.shape[1]
            each = np.full(count, 1.0 / count)
            external = ExternalForces(0.0, (np.atleast_1d(at[0]), np.atleast_1d(at[1])), each,
                                      np.zeros(n))  # fmt: skip
            resultants = external_resultants(self.mirror, external)
            self._held[key] = forces_under(self.glass, external), resultants
        return self._held[key]


@cache
def bench_of(name: str) -> Bench:
    """Return P45 with B = 3.6 N, or 336 actuators on rings without bias magnets."""
    mirror = rings336() if name == "336" else replace(p45(), bias_force=0.080)
    return Bench(mirror, model_shell(mirror))


@dataclass(eq=False)
class Day:
    """A campaign as it truly happens; N rows of all files together, n actuators.

    Attributes
    ----------
    order
        Index of the load of each file, in the order in which the files are taken.
    noise
        Standard deviation of one reading [N], as declared.
    alpha
        (n,) true Newton / commanded Newton.
    file, load, mounting, shape, sign, hours
        (N,) of each row: index of its file, of what truly hangs on the glass, of how often that was
        changed; SHAPE, SIGN; time [h].
    z, bias
        (N, n) true displacements [m]; forces of the bias magnets [N], (1, n) where they stay.
    held, external
        (N, n) forces of the coils that hold weights and contacts, (N, 3) force and moments of
        these [N], [N m]; added to by `push`, `push_at` and `carry`.
    gain, elastic_gain, law
        What a coil gives of alpha: (N or 1, n), of all of its force and of the elastic part alone;
        and by its commanded force.
    zero, error
        (N or 1, n) added to the readings [N].
    loads, label, layout
        As declared: the loads, the index of that of each file, the actuators.
    sensor_gain, sensor_offset, sensor_noise, has_position, warmth, has_temperature, valid, declared
        POSITION, TEMPERATURE [deg C], VALID and keywords of the files.
    judged, where
        (n,) which actuators count; what must stand in a word that is right.
    """

    bench: Bench
    seed: int
    noise: float
    order: Sequence[int]

    def __post_init__(self) -> None:
        self.random = random = np.random.default_rng([SEED, self.seed])
        mirror = self.bench.mirror
        self.n, files, each = mirror.layout.n, len(self.order), 2 * len(self.bench.shapes)
        self.alpha = random.uniform(*mirror.alpha_range, self.n)
        order = np.array(self.order)
        self.file = np.repeat(np.arange(files), each)
        self.load = order[self.file]
        self.mounting = np.concatenate([[0], np.cumsum(np.diff(order) != 0)])[self.file]
        self.shape = np.tile(np.repeat(np.arange(1, each // 2 + 1), 2), files)
        self.sign = np.tile([1, -1], len(self.shape) // 2)
        self.hours = (
            np.arange(len(self.shape)) * HOURS_OF_FILE / each + self.mounting * HOURS_OF_MOUNTING
        )
        # What happens.
        self.z = self.sign[:, None] * self.bench.shapes[self.shape - 1]
        self.bias = mirror.bias_force * random.normal(1.0, BIAS_SCATTER, (1, self.n))
        self.held, self.external = np.zeros((len(self.z), self.n)), np.zeros((len(self.z), 3))
        self.gain, self.elastic_gain = np.ones((1, self.n)), np.ones((1, self.n))
        self.law: Callable[[Array], Array | float] = lambda _: 1.0
        self.zero = np.zeros((1, self.n))
        self.error = self.noise * random.standard_normal(self.z.shape)
        self.carry(1.0, *self.bench.weight)
        x, y = tool_wedges(mirror)
        centres = random.normal(0.0, CENTRING, (len(set(self.order)), 2))
        self.wedges: list[Points] = [(x + dx, y + dy) for dx, dy in centres]  # of each load
        for load in range(1, len(centres)):
            self.push(load * mirror.added_weight * (self.load == load), self.wedges[load])
        # What the files say.
        ring, double = (tn.Load(name, k * mirror.added_weight, 0.0, tool=name)
                        for k, name in enumerate(("ring", "two rings"), 1))  # fmt: skip
        self.loads = [tn.Load("bare"), ring, double]
        self.label = order.copy()
        self.layout = mirror.layout
        self.sensor_gain = random.normal(1.0, SENSOR_GAIN, self.n)
        self.sensor_offset = random.normal(0.0, SENSOR_OFFSET, self.n)
        self.sensor_noise = SENSOR_NOISE * random.standard_normal(self.z.shape)
        self.has_position = True
        self.warmth = TEMPERATURE + 0.02 * random.standard_normal(len(self.z))
        self.has_temperature = True
        self.valid = np.ones(len(self.z), dtype=bool)
        self.declared: dict[str, Any] = {"force_error": self.noise}
        # How it is judged.
        self.judged = np.ones(self.n, dtype=bool)
        self.where: tuple[str, ...] = ()
        self._read: Array | None = None

    def under(self, load: int = 1) -> NDArray[np.bool_]:
        """Return the (N, 1) rows under a load."""
        return self.load[:, None] == load

    def actuator(self) -> int:
        """Draw an actuator."""
        return int(self.random.integers(self.n))

    def somewhere(self) -> Points:
        """Draw a point of the glass between the sensors, evenly over the area."""
        mirror, random = self.bench.mirror, self.random
        ends = (mirror.shell.inner_radius + 5e-3) ** 2, (mirror.shell.outer_radius - 2e-3) ** 2
        while True:
            radius, angle = np.sqrt(random.uniform(*ends)), random.uniform(0, 2 * np.pi)
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            away = np.hypot(mirror.layout.x - x, mirror.layout.y - y)
            if away.min() > 1.05 * mirror.sensor.outer_radius:
                return np.array([x]), np.array([y])

    def rim(self) -> Points:
        """Draw a point of the rim, 2 mm inside the edge."""
        radius = self.bench.mirror.shell.outer_radius - 2e-3
        angle = self.random.uniform(0, 2 * np.pi)
        return np.array([radius * np.cos(angle)]), np.array([radius * np.sin(angle)])

    def carry(self, force: Array | float, held: Array, external: Array) -> None:
        """Bear (N,) times external forces and moments (3,), held by (n,) forces of the coils."""
        self.held += np.multiply.outer(force, held)
        self.external += np.multiply.outer(force, external)

    def push(self, force: Array, at: Points) -> None:
        """Push the glass with (N,) forces along +z [N] at points that share them."""
        self.carry(force, *self.bench.holding(at))

    def push_at(self, actuator: int, force: Array) -> None:
        """Push the glass with (N,) forces at an actuator [N]; its coil alone takes them up."""
        self.held[:, actuator] -= force
        self.external += np.multiply.outer(force, self.bench.arms[:, actuator])

    @property
    def true_force(self) -> Array:
        """(N, n) forces of the coils on the glass [N]."""
        return self.z @ self.bench.glass.stiffness.T + self.held - self.bias

    @property
    def imbalance(self) -> Array:
        """(N, 3) force [N] and moments [N m] of all that acts on the glass: nothing."""
        return (self.true_force + self.bias) @ self.bench.arms.T + self.external

    @property
    def truth(self) -> Array:
        """(n,) true Newton / commanded Newton, the mean over the campaign."""
        return self.alpha * self.gain.mean(axis=0)

    @property
    def readings(self) -> Array:
        """(N, n) commanded forces as recorded [N]; a fault may write to them."""
        if self._read is None:
            elastic = self.z @ self.bench.glass.stiffness.T
            force = elastic / self.elastic_gain + (self.true_force - elastic)
            linear = force / (self.alpha * self.gain)
            commanded = linear
            for _ in range(12):  # a law is within 2 % of 1: more than a digit a step
                commanded = linear / self.law(commanded)
            self._read = commanded + self.zero + self.error
        return self._read

    def number(self, file: int) -> int:
        """Return CYCLE of a file: they count under each label."""
        return int((self.label[: file + 1] == self.label[file]).sum())

    def strike(self, *actuators: int, judged: bool = True) -> None:
        """Note which actuators must be named, and whether they are judged."""
        self.where = tuple(str(self.layout.id[k]) for k in actuators)
        self.judged[list(actuators)] = judged

    def campaign(self) -> tn.Campaign:
        """Return the files."""
        position = self.z / self.sensor_gain + self.sensor_offset + self.sensor_noise
        made = []
        for file, load in enumerate(self.label):
            rows = np.flatnonzero(self.file == file)
            made.append(
                tn.Cycle(
                    instrument=self.bench.mirror.name,
                    date=START + datetime.timedelta(hours=float(self.hours[rows[0]])),
                    number=self.number(file),
                    load=self.loads[load],
                    weight=self.bench.mirror.weight,
                    weight_error=0.0,
                    layout=self.layout,
                    time=3600 * (self.hours[rows] - self.hours[rows[0]]),
                    shape=self.shape[rows],
                    sign=self.sign[rows],
                    force=self.readings[rows],
                    valid=self.valid[rows],
                    temperature=self.warmth[rows] if self.has_temperature else None,
                    position=position[rows] if self.has_position else None,
                    **self.declared,
                )
            )
        return tn.Campaign(tuple(made))
