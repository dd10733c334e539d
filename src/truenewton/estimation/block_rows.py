"""Rows of a cycle, read a block of groups at a time: no group twice, in the order of the groups."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.displaced_rows import BalancedRows


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Rows of one cycle that were read of a block of groups, no group twice.

    Attributes
    ----------
    cycle_index, rows
        The cycle, and (m,) which of its rows that count.
    at
        (m,) their groups, from the first of the block.
    force, known
        (m, n) c (1 + COILGRAD z) [N], and (m, 3) A (BIASGRAD z) or None.
    weight
        Of a row.
    """

    cycle_index: int
    rows: NDArray[np.int64]
    at: slice | NDArray[np.int64]
    force: Array
    known: Array | None
    weight: float

    def without(self, lost: NDArray[np.bool_]) -> BlockRows:
        """Return the rows that are not (m,) lost."""
        known = None if self.known is None else self.known[~lost]
        at = np.arange(len(lost))[~lost] if isinstance(self.at, slice) else self.at[~lost]
        return replace(self, rows=self.rows[~lost], at=at, force=self.force[~lost], known=known)


@dataclass(frozen=True, eq=False)
class DistinctRows:
    """Rows of a cycle in none of which a group stands twice, in the order of their groups."""

    cycle_index: int
    balanced: BalancedRows
    rows: NDArray[np.int64]
    group: NDArray[np.int64]
    weight: float

    @cached_property
    def inorder(self) -> bool:
        """Whether the rows follow each other."""
        return bool((np.diff(self.rows) == 1).all())

    def within(self, block: slice) -> BlockRows | None:
        """Read the rows of a block of groups; None where none stands in it."""
        first, end = self.group.searchsorted((block.start, block.stop)).tolist()
        if first == end:
            return None
        whole = end - first == block.stop - block.start
        at = slice(None) if whole else self.group[first:end] - block.start  # a slice copies nothing
        rows = self.rows[first:end]
        force, known = self.balanced.at(slice(rows[0], rows[-1] + 1) if self.inorder else rows)
        return BlockRows(self.cycle_index, rows, at, force, known, self.weight)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of the (N,) rows in none of which a group stands twice; mostly one of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
