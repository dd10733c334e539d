"""Rows of a cycle, a block of groups at a time: no group twice, in the order of the groups."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.displaced_rows import BalancedRows


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Rows of one cycle in a block of groups, no group twice: where they stand, not yet read.

    Attributes
    ----------
    cycle_index, row
        The cycle, and (m,) rows of its MEASUREMENTS.
    at
        (m,) their groups, from the first of the block.
    hour
        (m,) hours since the mean of all cycles.
    sampled
        (m,) whether their deviations are kept.
    printed
        (m,) their labels, SHAPE times SIGN, where prints are taken of them; else 0.
    weight
        Of a row.
    balanced
        What reads them.
    """

    cycle_index: int
    row: NDArray[np.int64]
    at: slice | NDArray[np.int64]
    hour: Array
    sampled: NDArray[np.bool_]
    printed: NDArray[np.int64]
    weight: float
    balanced: BalancedRows

    @property
    def where(self) -> slice | NDArray[np.int64]:
        """The (m,) rows, as a slice where they follow each other."""
        row = self.row
        follow = bool((np.diff(row) == 1).all())
        return slice(int(row[0]), int(row[-1]) + 1) if follow and row.size else row

    def read(self) -> tuple[Array, Array | None, Array]:
        """Return (m, n) c (1 + COILGRAD z) [N], (m, 3) A (BIASGRAD z) or None, and c of prints.

        Prints are of what was read: with displacements put to use no row repeats to the last bit.
        """
        raw, position = self.balanced.read(self.where)
        return *self.balanced.of(raw, position), raw[self.printed != 0]

    def without(self, lost: NDArray[np.bool_]) -> BlockRows:
        """Return the rows that are not (m,) lost."""
        at = np.arange(len(lost)) if isinstance(self.at, slice) else self.at
        kept = ~lost
        return replace(
            self,
            row=self.row[kept],
            at=at[kept],
            hour=self.hour[kept],
            sampled=self.sampled[kept],
            printed=self.printed[kept],
        )


@dataclass(frozen=True, eq=False)
class DistinctRows:
    """Rows of a cycle in none of which a group stands twice, in the order of their (m,) groups."""

    rows: BlockRows
    group: NDArray[np.int64]

    def within(self, block: slice) -> BlockRows | None:
        """Return the rows of a block of groups; None where none stands in it."""
        first, end = self.group.searchsorted((block.start, block.stop)).tolist()
        if first == end:
            return None
        whole = end - first == block.stop - block.start
        return replace(
            self.rows,
            row=self.rows.row[first:end],
            at=slice(None) if whole else self.group[first:end] - block.start,  # a slice: no copy
            hour=self.rows.hour[first:end],
            sampled=self.rows.sampled[first:end],
            printed=self.rows.printed[first:end],
        )


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of the (N,) rows in none of which a group stands twice; mostly one of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
