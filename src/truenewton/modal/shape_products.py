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
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.readings.repeats import row_groups, row_weights
from truenewton.estimation.readings.row_readers import RowBlock
from truenewton.estimation.readings.rows import distinct
from truenewton.files.stored_rows import blocks
from truenewton.records.campaign import Campaign


class Products:
    """Sums over rows of c_i^2 (n,), c z' and z z' (n, n); at first over none."""

    def __init__(self, n: int) -> None:
        self.cc, (self.cz, self.zz) = np.zeros(n), np.zeros((2, n, n))

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
    until then rows count from that of its first rows, and then the sums are set right.

    Parameters
    ----------
    campaign, sound
        What is going to be read; the same, rows that take no part marked as not valid.
    positioned
        Which of its cycles hold POSITION; if none does, there is nothing but ``force_at_rest``.
    rejected
        Rows left out of these; their cycles count among them.
    """

    def __init__(
        self,
        campaign: Campaign,
        sound: Campaign,
        positioned: Sequence[int] = (),
        rejected: tuple[RejectedRow, ...] = (),
    ) -> None:
        self.sound, self.rejected = sound, rejected
        self.positioned = tuple(sound.cycles[k] for k in positioned)
        self._counts = [
            cycle.valid[given.valid]
            for cycle, given in zip(sound.cycles, campaign.cycles, strict=True)
        ]
        n = int(campaign.layout.enabled.sum())
        self._rest = np.zeros((len(sound.cycles), n))
        self._groups: dict[int, NDArray[np.int64]] = {}
        if positioned:
            of_these = Campaign(self.positioned)
            self._labels, _, groups = row_groups(of_these)
            self._groups = dict(zip(positioned, groups, strict=True))
            self._weights = dict(zip(positioned, row_weights(of_these), strict=True))
            self._force, self._position = np.zeros((2, len(self._labels), n))  # means
            self._weight, self._within = np.zeros(len(self._labels)), Products(n)
            self._begin_cycle()

    def _begin_cycle(self) -> None:
        n = self._rest.shape[1]
        self._near_rest: Array | None = None
        self._unshifted = np.ones(len(self._labels))  # how little of its rest each mean holds
        self._sum_force, self._sum_position, self._sum = np.zeros(n), np.zeros(n), 0.0

    def take(self, block: RowBlock) -> None:
        """Take the next rows in."""
        k, cycle = block.cycle_index, self.sound.cycles[block.cycle_index]
        counts = self._counts[k][block.rows]
        first = np.count_nonzero(self._counts[k][: block.rows.start])
        force, own = block.force[counts], slice(first, first + np.count_nonzero(counts))
        if cycle.position is not None:
            z = block.position[counts] - cycle.rest_position
            force *= 1.0 + (cycle.coil_gradient or 0.0) * z
        at_rest = force[cycle.paired_rows[own]]
        self._rest[k] += at_rest.sum(axis=0)
        if k in self._groups and len(force):
            if self._near_rest is None:
                self._near_rest = (at_rest if len(at_rest) else force).mean(axis=0)
            force -= self._near_rest
            group = self._groups[k][own]
            for rows in distinct(group):
                self._add(force[rows], z[rows], group[rows], self._weights[k])
        if block.last:
            self._end_cycle(k)

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

    def _end_cycle(self, cycle_index: int) -> None:
        """Count the rows of the cycle from its own rest."""
        rest = self._rest[cycle_index]
        rest /= np.count_nonzero(self.sound.cycles[cycle_index].paired_rows)
        if cycle_index in self._groups and self._near_rest is not None:
            shift = rest - self._near_rest
            self._within.cz -= np.outer(shift, self._sum_position)
            self._within.cc += shift * (self._sum * shift - 2.0 * self._sum_force)
            self._force -= np.outer(1.0 - self._unshifted, shift)
            self._begin_cycle()

    @property
    def force_at_rest(self) -> Array:
        """(n,) commanded force at rest under the first load, the bare one [N].

        The mean over its cycles: it carries the mirror, and holds it flat.
        """
        return np.asarray(self._rest[np.equal(self.sound.load_index, 0)].mean(axis=0))

    def products(self) -> ShapeProducts:
        """Return what the regression needs, all rows having come."""
        label, heavy, n = self._labels, self._weight, self._rest.shape[1]
        edge = np.flatnonzero(np.append(True, (label[1:, :2] != label[:-1, :2]).any(axis=1)))
        ends = np.append(edge, len(label))
        signed, total = label[:, 2] * heavy, np.add.reduceat(heavy, edge)
        between, uneven = Products(n), 0.0
        for some in blocks(len(edge), 4 * 8 * n):
            rows = slice(ends[some.start], ends[some.stop])
            force, position = self._force[rows], self._position[rows]
            uneven += float(heavy[rows] @ np.sum(position**2, axis=1))
            c, z = (
                np.add.reduceat(signed[rows, None] * mean, edge[some] - rows.start)
                / np.sqrt(total[some])[:, None]
                for mean in (force, position)
            )
            between.add(c, z)
            uneven -= float(np.sum(z**2))
        count, within = sum(map(len, self._groups.values())), self._within
        alike = count - len(edge)
        loads = {cycle.load.key for cycle in self.positioned}
        return ShapeProducts(
            between=between,
            within=within,
            shapes=len(edge),
            rows=count,
            spare=count - len(label) - (len(self.positioned) - len(loads)),
            weight=float(heavy.sum()),
            position_variance=(
                (float(np.trace(within.zz)) + uneven) / (n * alike) if alike else np.nan
            ),
        )
