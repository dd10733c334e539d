"""What repeats of shapes boil down to where force and position both count: sums, row by row.

Rows with the same load, SHAPE and SIGN repeat each other, and what they deviate from their mean is
noise. A shape and its negative together, c and z counted from rest, are one shape: what they have
in common (the coils' and the sensors' laws, no stiffness) drops out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.moments import groups_of
from truenewton.estimation.repeats import distinct, row_weights
from truenewton.estimation.row_readers import RowBlock
from truenewton.estimation.sifted import Sifted
from truenewton.files.stored_rows import blocks
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


@dataclass(eq=False)
class Products:
    """Sums over rows of c_i^2 (n,), c z' and z z' (n, n)."""

    cc: Array
    cz: Array
    zz: Array

    @classmethod
    def zeros(cls, n: int) -> Products:
        """Return sums over no row."""
        return cls(np.zeros(n), *np.zeros((2, n, n)))

    def add(self, c: Array, z: Array) -> None:
        """Count (m, n) rows in."""
        self.cc += np.einsum("ri,ri->i", c, c)
        self.cz += c.T @ z
        self.zz += z.T @ z

    def unexplained(self, k: Array) -> Array:
        """Return (n,) the sum of (c - K z)^2."""
        left = self.cc - np.einsum("ij,ij->i", k, 2 * self.cz - k @ self.zz)
        return np.asarray(np.maximum(left, 0.0))


@dataclass(frozen=True, eq=False)
class ShapeProducts:
    """What the regression needs.

    Attributes
    ----------
    between, within
        Sums over distinct shapes, and over deviations of rows from their repeats.
    shapes, rows, spare
        Number of distinct shapes, of rows, and of rows beyond what repeats and cycles take.
    weight
        Sum of the weights of the rows.
    position_variance
        Of a reading in a row of weight 1, as far as shapes and their negatives tell; NaN where
        neither is there [m^2].
    """

    between: Products
    within: Products
    shapes: int
    rows: int
    spare: int
    weight: float
    position_variance: float


class MotionReader:
    """Sums up force and displacement of the rows of a campaign, from rest, while they are read.

    Each row moves the means of its group; what it adds to the sums about them is exact. Rest is the
    mean of c (1 + COILGRAD z) over the rows that have their opposite, known once a cycle is over:
    until then rows count from a rest nearby, and then the sums are set right.

    Parameters
    ----------
    sifted
        The campaign that is going to be read.
    sound
        The same, with the rows that take no part marked as not valid.
    positioned
        Which of its cycles hold POSITION; if none does, there is nothing but ``rest_force``.
    rejected
        Rows left out of these; their cycles count among them.

    Attributes
    ----------
    rest_force
        (cycles, n) commanded force at rest of each cycle [N].
    """

    def __init__(
        self,
        sifted: Sifted,
        sound: Campaign,
        positioned: Sequence[int] = (),
        rejected: tuple[RejectedRow, ...] = (),
    ) -> None:
        self.sound, self.rejected, self._positioned = sound, rejected, tuple(positioned)
        moments, n = sifted.moments, sifted.moments.mean.shape[1]
        self.rest_force = np.zeros((len(sound.cycles), n))
        self._counts = [
            cycle.valid[given.valid]
            for cycle, given in zip(sound.cycles, sifted.campaign.cycles, strict=True)
        ]
        self._group = [
            groups_of(cycle, load_index, moments)
            for cycle, load_index in zip(sound.cycles, sound.load_index, strict=True)
        ]
        self._labels, groups = moments.labels, len(moments.labels) if positioned else 0
        self._near_rest = [
            moments.mean[moments.labels[:, 0] == load].mean(axis=0)
            for load in range(len(sound.loads))
        ]
        if positioned:
            of_these = row_weights(Campaign(tuple(sound.cycles[k] for k in positioned)))
            self._weights = dict(zip(positioned, of_these, strict=True))
        self._within = Products.zeros(n if positioned else 0)
        self._force, self._position = np.zeros((2, groups, n))  # means
        self._weight, self._rows = np.zeros(groups), 0
        self._begin_cycle()

    def _begin_cycle(self) -> None:
        n = self.rest_force.shape[1]
        self._row = 0  # of those that take part
        self._unshifted = np.ones(len(self._weight))  # share of its own rest missing in each mean
        self._sum_force, self._sum_position, self._sum = np.zeros(n), np.zeros(n), 0.0

    def take(self, block: RowBlock) -> None:
        """Take the next rows in."""
        k, cycle = block.cycle_index, self.sound.cycles[block.cycle_index]
        counts = self._counts[k][block.rows]
        own = slice(self._row, self._row + int(np.count_nonzero(counts)))
        self._row = own.stop
        force = block.force if counts.all() else block.force[counts]
        if cycle.position is not None:
            z = (block.position if counts.all() else block.position[counts]) - cycle.rest_position
            force = force * (1.0 + (cycle.coil_gradient or 0.0) * z)
        self.rest_force[k] += force[cycle.rest_rows[own]].sum(axis=0)
        if k in self._positioned:
            force = force - self._near_rest[self.sound.load_index[k]]
            group = self._group[k][own]
            for rows in distinct(group):
                self._add(force[rows], z[rows], group[rows], self._weights[k])

    def _add(self, force: Array, position: Array, group: NDArray[np.int64], weight: float) -> None:
        """Add (m, n) rows of one cycle, no group twice."""
        share = weight / (self._weight[group] + weight)
        force, position = force - self._force[group], position - self._position[group]
        self._force[group] += share[:, None] * force
        self._position[group] += share[:, None] * position
        size, missing = self._weight[group] * share, self._unshifted[group]
        root = np.sqrt(size)[:, None]
        self._within.add(root * force, root * position)
        self._sum_force += (size * missing) @ force
        self._sum_position += (size * missing) @ position
        self._sum += float(size @ missing**2)
        self._unshifted[group] = missing * (1.0 - share)
        self._weight[group] += weight
        self._rows += len(group)

    def end_cycle(self, cycle_index: int) -> None:
        """Count the rows of the cycle from its own rest."""
        cycle = self.sound.cycles[cycle_index]
        self.rest_force[cycle_index] /= np.count_nonzero(cycle.rest_rows)
        if cycle_index in self._positioned:
            load_index = self.sound.load_index[cycle_index]
            shift = self.rest_force[cycle_index] - self._near_rest[load_index]
            self._within.cz -= np.outer(shift, self._sum_position)
            self._within.cc += shift * (self._sum * shift - 2.0 * self._sum_force)
            self._force -= np.outer(1.0 - self._unshifted, shift)
        self._begin_cycle()

    @property
    def positioned(self) -> tuple[Cycle, ...]:
        """The cycles that hold POSITION, rows that take no part marked as not valid."""
        return tuple(self.sound.cycles[k] for k in self._positioned)

    @property
    def force_at_rest(self) -> Array:
        """(n,) commanded force at rest under the first load, the bare one [N].

        The mean over its cycles: it carries the mirror, and holds it flat.
        """
        first = [k for k, load in enumerate(self.sound.load_index) if load == 0]
        return np.asarray(np.mean(self.rest_force[first], axis=0))

    def products(self) -> ShapeProducts:
        """Return what the regression needs, all rows having come."""
        there = np.flatnonzero(self._weight)
        label, heavy, n = self._labels[there], self._weight[there], self.rest_force.shape[1]
        edge = np.flatnonzero(np.append(True, (label[1:, :2] != label[:-1, :2]).any(axis=1)))
        ends = np.append(edge, len(there))
        signed, total = label[:, 2] * heavy, np.add.reduceat(heavy, edge)
        between, uneven = Products.zeros(n), 0.0
        for some in blocks(len(edge), 4 * 8 * n):
            rows = slice(ends[some.start], ends[some.stop])
            force, position = (mean[there[rows]] for mean in (self._force, self._position))
            uneven += float(heavy[rows] @ np.sum(position**2, axis=1))
            c, z = (
                np.add.reduceat(signed[rows, None] * mean, edge[some] - rows.start)
                / np.sqrt(total[some])[:, None]
                for mean in (force, position)
            )
            between.add(c, z)
            uneven -= float(np.sum(z**2))
        alike, within = self._rows - len(edge), self._within
        loads = {self.sound.load_index[k] for k in self._positioned}
        return ShapeProducts(
            between=between,
            within=within,
            shapes=len(edge),
            rows=self._rows,
            spare=self._rows - len(there) - (len(self._positioned) - len(loads)),
            weight=float(heavy.sum()),
            position_variance=(
                (float(np.trace(within.zz)) + uneven) / (n * alike) if alike else np.nan
            ),
        )
