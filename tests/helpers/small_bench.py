"""A bench of 14 actuators on which things go wrong, made by hand from the balance alone.

`SmallBench` holds what truly happens in all rows of a campaign, in time; a test changes it before
its files are taken. True forces are elastic ones, which balance, and the smallest that hold
whatever acts on the mirror besides; readings are c = f / (alpha gain) + zero + error.
"""

import datetime
from collections.abc import Callable

import numpy as np

from helpers.balanced import BIAS, LAYOUT, START, WEIGHT, arms_of, balanced_rows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

ADDED = -0.289
HOURS_OF_FILE, HOURS_OF_MOUNTING = 0.4, 0.5
SHAPES = 14


class SmallBench:
    """What happens in the N rows of a campaign; `order` is the load of each file."""

    def __init__(self, seed: int, noise: float = 1e-3, *, order=(0, 0, 0, 0, 1, 1, 1, 1)) -> None:
        self.random = random = np.random.default_rng([*np.atleast_1d(seed).tolist(), 14])
        self.order, self.layout, self.noise = np.array(order), LAYOUT, noise
        self.n, each, files = LAYOUT.n, 2 * SHAPES, len(order)
        self.alpha = random.uniform(0.7, 1.1, self.n)
        self.torques = random.normal(0.0, 0.05, (max(order) + 1, 2))
        self.elastic = balanced_rows(random, arms_of(LAYOUT), np.zeros(3), SHAPES)
        self.displaced = 1e-6 * random.standard_normal((SHAPES, self.n))
        self.file = np.repeat(np.arange(files), each)
        self.load = self.order[self.file]
        self.shape = np.tile(np.repeat(np.arange(1, SHAPES + 1), 2), files)
        self.sign = np.tile([1, -1], len(self.shape) // 2)
        mounting = np.concatenate([[0], np.cumsum(np.diff(order) != 0)])[self.file]
        self.hours = np.arange(len(self.file)) * HOURS_OF_FILE / each + mounting * HOURS_OF_MOUNTING
        self.size = np.ones(len(self.file))  # of the shapes
        self.arms = arms_of(LAYOUT)  # as they truly are
        self.external = np.zeros((len(self.file), 3))  # force and moments besides weight and B
        self.gain: np.ndarray | float = 1.0
        self.law: Callable[[np.ndarray], np.ndarray | float] = lambda _: 1.0
        self.zero: np.ndarray | float = 0.0
        self.error = noise * random.standard_normal((len(self.file), self.n))
        # As declared.
        self.added = ADDED * np.arange(max(order) + 1)
        self.label = self.order.copy()
        self.has_position = True

    @property
    def z(self) -> np.ndarray:
        """(N, n) displacements [m]."""
        return (self.size * self.sign)[:, None] * self.displaced[self.shape - 1]

    @property
    def true_force(self) -> np.ndarray:
        """(N, n) true forces of the coils [N]."""
        elastic = (self.size * self.sign)[:, None] * self.elastic[self.shape - 1]
        torque_y, torque_x = self.torques[self.load].T
        weight = WEIGHT + ADDED * self.load + BIAS
        k = np.stack([weight, torque_y, -torque_x], axis=1) + self.external
        return elastic - (elastic @ self.arms.T + k) @ np.linalg.pinv(self.arms).T

    @property
    def readings(self) -> np.ndarray:
        """(N, n) commanded forces as recorded [N]."""
        linear = self.true_force / (self.alpha * self.gain)
        commanded = linear
        for _ in range(12):
            commanded = linear / self.law(commanded)
        return np.asarray(commanded + self.zero + self.error)

    def campaign(self) -> Campaign:
        """Return the files."""
        readings, z, made = self.readings, self.z, []
        for file, load in enumerate(self.label):
            rows = self.file == file
            begun = self.hours[rows][0]
            added = float(self.added[load])
            made.append(
                Cycle(
                    instrument="SMALL",
                    date=START + datetime.timedelta(hours=float(begun)),
                    number=int((self.label[: file + 1] == load).sum()),
                    load=Load(f"load {load}", added, 0.0, tool="ring") if load else Load("bare"),
                    weight=WEIGHT,
                    weight_error=0.0,
                    layout=Layout(LAYOUT.id, LAYOUT.x, LAYOUT.y, LAYOUT.nz, LAYOUT.enabled),
                    time=3600 * (self.hours[rows] - begun),
                    shape=self.shape[rows],
                    sign=self.sign[rows],
                    force=readings[rows],
                    valid=np.ones(rows.sum(), dtype=bool),
                    position=z[rows] if self.has_position else None,
                )
            )
        return Campaign(tuple(made))
