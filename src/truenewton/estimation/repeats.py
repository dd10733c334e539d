"""Rows by the group that they repeat, a block of groups after the other.

Rows with the same load, SHAPE and SIGN are a group. Groups are worked through in the order in which
they come, so that rows are read where they stand; a block after the other, so that all rows of a
group are in the cache, and of those on disk no more in memory, while their mean and then their
deviations from it are taken. Where rows are left out, their blocks alone are read again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.displaced_rows import BalancedRows, common_reference, is_displaced
from truenewton.files.stored_rows import BLOCK_BYTES
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]
SAMPLE_ROWS = 1000  # whose deviations are held: they tell a variance of three degrees to 3 %


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`; 1 for all where one of the files declares nothing, since it could
    be anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def row_groups(
    campaign: Campaign,
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[NDArray[np.int64]]]:
    """Return the groups of a campaign's rows.

    Returns
    -------
    labels, first, groups
        (g, 3) index of the load, SHAPE, SIGN; sorted. (g,) first row, of all that count. For each
        cycle, (N,) group of its rows that count.
    """
    names = [
        np.column_stack([np.full(np.count_nonzero(c.valid), k), c.shape[c.valid], c.sign[c.valid]])
        for c, k in zip(campaign.cycles, campaign.load_index, strict=True)
    ]
    whole, ends = np.concatenate(names), np.cumsum([len(name) for name in names])[:-1]
    span = int(whole[:, 1].max()) + 1
    if span > 2**40:  # shapes may be numbered at will
        _, first, group = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    else:
        codes = 2 * (span * whole[:, 0] + whole[:, 1]) + (whole[:, 2] > 0)
        _, first, group = np.unique(codes, return_index=True, return_inverse=True)
    return whole[first], first, np.split(group.ravel(), ends)


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Rows of one cycle that were read of a block of groups, no group twice.

    Attributes
    ----------
    cycle_index, rows
        The cycle, and (m,) which of its rows that count.
    group
        (m,) their groups, from the first of the block.
    force, known
        (m, n) c (1 + COILGRAD z) [N], and (m, 3) A (BIASGRAD z) or None.
    weight
        Of a row.
    whole
        Whether every group of the block has a row.
    """

    cycle_index: int
    rows: NDArray[np.int64]
    group: NDArray[np.int64]
    force: Array
    known: Array | None
    weight: float
    whole: bool

    @property
    def at(self) -> slice | NDArray[np.int64]:
        """The same as ``group``, for indexing: without a copy where it can be."""
        return slice(None) if self.whole else self.group

    def only(self, some: NDArray[np.bool_]) -> BlockRows:
        """Return (m,) some of the rows."""
        if some.all():
            return self
        return replace(
            self,
            rows=self.rows[some],
            group=self.group[some],
            force=self.force[some],
            known=None if self.known is None else self.known[some],
            whole=False,
        )


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
        rows, group = self.rows[first:end], self.group[first:end] - block.start
        force, known = self.balanced.at(slice(rows[0], rows[-1] + 1) if self.inorder else rows)
        whole = end - first == block.stop - block.start
        return BlockRows(self.cycle_index, rows, group, force, known, self.weight, whole)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of rows in none of which a group stands twice; mostly one set of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]


class RepeatSums:
    """Sums over the rows of each group of a campaign, which are read a block of groups at a time.

    Attributes
    ----------
    campaign, reference
        The campaign; (n,) readings from which displacements count [m], see `common_reference`.
    labels
        (g, 3) load, SHAPE, SIGN of the groups; sorted.
    mean, known
        (g, n) and (g, 3) mean of force and of the balance known beforehand, see `Moments`.
    scatter
        (n,) weighted sum of squared deviations of rows from their group's mean [N^2].
    furthest
        (blocks, n) largest distance of a row from its group's mean, as seen from the rest of the
        group and divided by its noise over that of a row of weight 1 [N].
    samples
        (m, n) deviations of some repeated rows of each block, see `deviations`; together they stand
        evenly among all rows.
    stale
        Whether what was left out has emptied a group or moved the reference: the sums must be made
        of the rest anew.
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign, self.reference, self.stale = campaign, common_reference(campaign), False
        self.labels, first, groups_of_rows = row_groups(campaign)
        self._coming = np.argsort(first)  # groups, as they come
        turn = np.argsort(self._coming)
        turns = [turn[group] for group in groups_of_rows]
        self._layers = list(_layers(campaign, self.reference, turns))
        groups, n = len(self.labels), len(self.reference)
        self._number, self._weight = np.zeros(groups, dtype=np.int64), np.zeros(groups)
        for layer in self._layers:
            self._number[layer.group] += 1
            self._weight[layer.group] += layer.weight
        self._stride = max(1, self._number.sum() // SAMPLE_ROWS)
        self._lost: list[RejectedRow] = []
        self.mean, self.known = np.empty((groups, n)), np.zeros((groups, 3))
        most = int(np.clip(BLOCK_BYTES // (8 * n * self._number.max()), 1, ROWS_AT_ONCE))
        starts = range(0, groups, most)
        self._blocks = [slice(start, min(start + most, groups)) for start in starts]
        self.scatter, self._scatter_of = np.zeros(n), np.zeros((len(self._blocks), n))
        self.furthest = np.zeros((len(self._blocks), n))
        self.samples = [np.empty((0, n))] * len(self._blocks)
        for block in range(len(self._blocks)):
            self._sum(block, self.read(block))

    @property
    def rows(self) -> NDArray[np.int64]:
        """(g,) number of rows."""
        return self._number[np.argsort(self._coming)]

    @property
    def weight(self) -> Array:
        """(g,) sum of the weights of the rows."""
        return self._weight[np.argsort(self._coming)]

    def read(self, block: int) -> list[BlockRows]:
        """Read the rows of a block of groups that are not left out."""
        parts = (layer.within(self._blocks[block]) for layer in self._layers)
        return [self._without(part, self._lost) for part in parts if part is not None]

    def _without(self, part: BlockRows, rejected: list[RejectedRow]) -> BlockRows:
        here = [row.row for row in rejected if row.cycle == part.cycle_index]
        return part.only(~np.isin(self.row(part), here)) if here else part

    def row(self, part: BlockRows) -> NDArray[np.int64]:
        """Return (m,) rows of MEASUREMENTS."""
        return np.flatnonzero(self.campaign.cycles[part.cycle_index].valid)[part.rows]

    def number(self, block: int, part: BlockRows) -> NDArray[np.int64]:
        """Return (m,) the number of rows in the groups of some rows."""
        return self._number[self._blocks[block]][part.group]

    def deviations(self, block: int, part: BlockRows) -> Array:
        """Return (m, n) deviations of rows from the others of their groups, at weight 1 [N].

        The mean holds the row itself: seen from the others it lies further out, so that these have
        the variance of a reading of weight 1. 0 for a row without others.
        """
        mean = self.mean[self._coming[self._blocks[block]]]
        further = np.sqrt(self._further(block, part.weight))
        return np.asarray((part.force - mean[part.at]) * further[part.at][:, None])

    def _further(self, block: int, weight: float) -> Array:
        """Return, for each group, how much larger the square of a deviation is for the others."""
        total = self._weight[self._blocks[block]]
        return np.asarray(weight * total / np.where(total > weight, total - weight, np.inf))

    def leave_out(self, block: int, read: list[BlockRows], rejected: list[RejectedRow]) -> None:
        """Leave some rows out of what was read of a block, and sum the rest anew."""
        self._lost += rejected
        kept = [self._without(part, rejected) for part in read]
        number, weight = self._number[self._blocks[block]], self._weight[self._blocks[block]]
        number[:], weight[:] = 0, 0.0
        for part in kept:
            number[part.group] += 1
            weight[part.group] += part.weight
        displaced = any(is_displaced(self.campaign.cycles[row.cycle]) for row in rejected)
        self.stale |= displaced or not number.all()
        if not self.stale:
            self._sum(block, kept)
            self.scatter = self._scatter_of.sum(axis=0)

    def _sum(self, block: int, read: list[BlockRows]) -> None:
        """Sum over the rows that were read of a block of groups."""
        groups = self._blocks[block]
        weight, size = self._weight[groups], groups.stop - groups.start
        heaviest = max(layer.weight for layer in self._layers)
        centre, known = np.zeros((size, self.mean.shape[1])), np.zeros((size, 3))
        for part in read:
            share = part.weight / heaviest
            centre[part.at] += part.force if share == 1.0 else share * part.force
            if part.known is not None:
                known[part.at] += part.weight * part.known
        centre *= (heaviest / weight)[:, None]
        self.mean[self._coming[groups]] = centre
        self.known[self._coming[groups]] = known / weight[:, None]
        self._scatter_of[block], self.furthest[block], sample = 0.0, 0.0, []
        for part in reversed(read):  # the last are in the cache still
            further = self._further(block, part.weight)
            apart = part.force - centre[part.at]
            chosen = (part.rows % self._stride == 0) & (self.number(block, part) > 1)
            sample.append(apart[chosen] * np.sqrt(further[part.group[chosen]])[:, None])
            apart *= apart
            scatter = part.weight * (np.ones(len(apart)) @ apart)
            self.scatter += scatter
            self._scatter_of[block] += scatter
            if not (further == further[0]).all():
                apart *= further[part.at][:, None]
                further = np.ones(1)
            furthest = np.sqrt(apart.max(axis=0, initial=0.0) * further[0])
            np.maximum(self.furthest[block], furthest, out=self.furthest[block])
        self.samples[block] = np.concatenate(sample)


def _layers(
    campaign: Campaign, reference: Array, turns: list[NDArray[np.int64]]
) -> Iterator[DistinctRows]:
    """Yield the rows of each cycle, which come when the (N,) turn of their group comes."""
    a, weights = enabled_arms(campaign.layout), row_weights(campaign)
    for k, (cycle, group) in enumerate(zip(campaign.cycles, turns, strict=True)):
        balanced = BalancedRows(cycle, a, reference)
        for rows in distinct(group):
            yield DistinctRows(k, balanced, rows, group[rows], weights[k])
