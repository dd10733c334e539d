"""Rows by the group that they repeat, a block of groups after the other.

Rows with the same load, SHAPE and SIGN are a group. Groups are worked through in the order in which
they come, so that rows are read where they stand; a block after the other, so that all rows of a
group are in the cache, and of those on disk no more in memory, while their mean and then their
deviations from it are taken. Where rows are left out, their blocks alone are read again.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.block_rows import BlockRows, DistinctRows, distinct
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.displaced_rows import (
    BalancedRows,
    common_reference,
    displacements,
    is_displaced,
)
from truenewton.estimation.moments import Moments, WithinGroups
from truenewton.estimation.rounding_steps import rounding_steps
from truenewton.estimation.row_prints import RowPrints
from truenewton.files.stored_rows import BLOCK_BYTES
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]
MOST_DISPLACED = 2**24  # means of displacements that are taken
SAMPLE_ROWS = 1000  # whose deviations are held: they tell a variance of three degrees to 3 %


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`; 1 for all where one of the files declares nothing, since it could
    be anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def hours(campaign: Campaign) -> tuple[Array, ...]:
    """Return for each cycle (N,) hours of its rows that count, since the mean of all cycles."""
    first = min(cycle.date for cycle in campaign.cycles)
    times = [
        (cycle.date - first).total_seconds() / 3600 + cycle.time[cycle.valid] / 3600
        for cycle in campaign.cycles
    ]
    mean = np.mean([time.mean() for time in times])
    return tuple(time - mean for time in times)


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


class RepeatSums:
    """Sums over the rows of each group of a campaign, which are read a block of groups at a time.

    Attributes
    ----------
    campaign
        The campaign.
    furthest
        (blocks, n) largest distance of a row from its group's mean, as seen from the rest of the
        group and divided by its noise over that of a row of weight 1 [N].
    samples
        (m, n) deviations of some repeated rows of each block, see `deviations`; together they stand
        evenly among all rows.
    prints
        Of some rows: copies, readings that freeze, and rounding are known by them.
    stale
        Whether what was left out has emptied a group or moved the reference: the sums must be made
        of the rest anew.
    """

    def __init__(self, campaign: Campaign, reference: Array | None = None) -> None:
        self.campaign, self.stale = campaign, False
        self._moments: Moments | None = None
        self._reference = common_reference(campaign) if reference is None else reference
        self._lost = list[RejectedRow]()
        self._labels, first, groups_of_rows = row_groups(campaign)
        self._coming = np.argsort(first)  # groups, as they come
        turn = np.argsort(self._coming)
        a, weights = enabled_arms(campaign.layout), row_weights(campaign)
        self._layers = [
            DistinctRows(k, balanced, rows, turn[group[rows]], weights[k])
            for k, (cycle, group) in enumerate(zip(campaign.cycles, groups_of_rows, strict=True))
            for balanced in [BalancedRows(cycle, a, self._reference)]
            for rows in distinct(turn[group])
        ]
        groups, n = len(first), a.shape[1]
        self._number, self._weight = np.zeros(groups, dtype=np.int64), np.zeros(groups)
        for layer in self._layers:
            self._number[layer.group] += 1
            self._weight[layer.group] += layer.weight
        self._stride = max(1, self._number.sum() // SAMPLE_ROWS)
        self._mean, self._known = np.empty((groups, n)), np.zeros((groups, 3))
        most = int(np.clip(BLOCK_BYTES // (8 * n * self._number.max()), 1, ROWS_AT_ONCE))
        starts = range(0, groups, most)
        self._blocks = [slice(start, min(start + most, groups)) for start in starts]
        self._scatter, self._scatter_of = np.zeros(n), np.zeros((len(starts), n))
        self._hours = hours(campaign)
        self._zero, self._gain = np.zeros((2, len(campaign.cycles) + 1, n))
        self.furthest = np.zeros((len(starts), n))
        self.prints = RowPrints(np.prod(self._labels[self._coming, 1:], axis=1))
        self.samples = [np.empty((0, n))] * len(starts)
        for block in range(len(starts)):
            self._sum(block, self.read(block))

    @cached_property
    def step(self) -> Array:
        """(n,) step of which the readings are multiples [N], or 0."""
        return rounding_steps(self.prints.of_first)

    @property
    def moments(self) -> Moments:
        """What the sums make up."""
        if self._moments is None:
            self._moments = self._made_up()
        return self._moments

    def _made_up(self) -> Moments:
        turn = np.argsort(self._coming)
        return Moments(
            loads=self.campaign.loads,
            labels=self._labels,
            rows=self._number[turn],
            weight=self._weight[turn],
            mean=self._mean,
            known=self._known,
            scatter=self._scatter,
            reference=self._reference,
            within=self._within(turn),
            step=self.step,
        )

    def _within(self, turn: NDArray[np.int64]) -> WithinGroups:
        """Return how rows of one group differ; (g,) groups in order, among those as they come."""
        weight, hours = np.zeros((2, len(self.campaign.cycles), len(self._number)))
        square = np.zeros(len(self._number))
        for layer in self._layers:
            k, counted = layer.cycle_index, self._counted(layer)
            group, hour = layer.group[counted], self._hours[k][layer.rows[counted]]
            weight[k, group] += layer.weight
            hours[k, group] += layer.weight * hour
            square[group] += layer.weight * hour**2
        weight, hours, square = weight[:, turn], hours[:, turn], square[turn]
        return WithinGroups(weight, hours, square, self._mean, self._zero, self._gain)

    def _counted(self, layer: DistinctRows) -> NDArray[np.bool_]:
        """Return (m,) which rows of a layer are not left out."""
        lost = [row.row for row in self._lost if row.cycle == layer.cycle_index]
        every = np.flatnonzero(self.campaign.cycles[layer.cycle_index].valid)
        return np.asarray(~np.isin(every[layer.rows], lost))

    def displacement(self) -> Array | None:
        """Return (g, n) mean displacements of the groups in their order [m]; None without POSITION.

        Nor beyond `MOST_DISPLACED` values: their reading would take as long as that of FORCE.
        """
        if self._mean.size > MOST_DISPLACED:
            return None
        moved = displacements(self.campaign)
        if moved is None:
            return None
        total, rows = np.zeros_like(self._mean), np.zeros(len(self._number))
        for layer in self._layers:
            counted = self._counted(layer)
            group = layer.group[counted]
            total[group] += layer.weight * moved[layer.cycle_index](layer.rows[counted])
            rows[group] += layer.weight
        return np.asarray((total / rows[:, None])[np.argsort(self._coming)])

    def read(self, block: int) -> list[BlockRows]:
        """Read the rows of a block of groups that are not left out."""
        parts = (layer.within(self._blocks[block]) for layer in self._layers)
        return [self._without(part, self._lost) for part in parts if part is not None]

    def _without(self, part: BlockRows, rejected: list[RejectedRow]) -> BlockRows:
        here = [row.row for row in rejected if row.cycle == part.cycle_index]
        return part.without(np.isin(self.row(part), here)) if here else part

    def row(self, part: BlockRows) -> NDArray[np.int64]:
        """Return (m,) rows of MEASUREMENTS."""
        return np.flatnonzero(self.campaign.cycles[part.cycle_index].valid)[part.rows]

    def group(self, block: int, part: BlockRows) -> NDArray[np.int64]:
        """Return (m,) which of the groups, as they come."""
        return np.arange(len(self._number))[self._blocks[block]][part.at]

    def number(self, block: int, part: BlockRows) -> NDArray[np.int64]:
        """Return (m,) the number of rows in the groups of some rows."""
        return self._number[self._blocks[block]][part.at]

    def deviations(self, block: int, part: BlockRows) -> Array:
        """Return (m, n) deviations of rows from the others of their groups, at weight 1 [N].

        The mean holds the row itself: seen from the others it lies further out, so that these have
        the variance of a reading of weight 1. 0 for a row without others.
        """
        mean = self._mean[self._coming[self._blocks[block]]]
        further = np.sqrt(self._further(block, part.weight))
        return np.asarray((part.force - mean[part.at]) * further[part.at][:, None])

    def _further(self, block: int, weight: float) -> Array:
        """Return, for each group, how much larger the square of a deviation is for the others."""
        total = self._weight[self._blocks[block]]
        return np.asarray(weight * total / np.where(total > weight, total - weight, np.inf))

    def leave_out(self, block: int, read: list[BlockRows], rejected: list[RejectedRow]) -> None:
        """Leave some rows out of what was read of a block, and sum the rest anew."""
        self._lost += rejected
        self._moments = None
        rest = [self._without(part, rejected) for part in read]
        number, weight = self._number[self._blocks[block]], self._weight[self._blocks[block]]
        number[:], weight[:] = 0, 0.0
        for part in rest:
            number[part.at] += 1
            weight[part.at] += part.weight
        displaced = any(is_displaced(self.campaign.cycles[row.cycle]) for row in rejected)
        self.stale |= displaced or not number.all()
        if not self.stale:
            mean = self._mean[self._coming[self._blocks[block]]]
            for part in read:
                self._differ(part, part.force - mean[part.at], mean, -1.0)
            self._sum(block, rest)
            self._scatter = self._scatter_of.sum(axis=0)

    def _differ(self, part: BlockRows, apart: Array, mean: Array, times: float) -> None:
        """Add, so many times, how rows of a cycle are (m, n) apart from the means of their groups.

        ``mean`` is (groups, n) of the block [N].
        """
        hour, weight = self._hours[part.cycle_index][part.rows], times * part.weight
        for sums, values in ((self._zero, apart), (self._gain, apart * mean[part.at])):
            sums[part.cycle_index] += weight * (np.ones(len(hour)) @ values)
            sums[-1] += weight * (hour @ values)  # products of two rows at once take longer

    def _sum(self, block: int, read: list[BlockRows]) -> None:
        """Sum over the rows that were read of a block of groups."""
        groups, n = self._blocks[block], len(self._scatter)
        weight, heaviest = self._weight[groups], max(layer.weight for layer in self._layers)
        centre, known = np.zeros((len(weight), n)), np.zeros((len(weight), 3))
        for part in read:
            self.prints.take(part.cycle_index, self.group(block, part), part.force)
            share = part.weight / heaviest
            centre[part.at] += part.force if share == 1.0 else share * part.force
            if part.known is not None:
                known[part.at] += part.weight * part.known
        centre *= (heaviest / weight)[:, None]
        self._mean[self._coming[groups]] = centre
        self._known[self._coming[groups]] = known / weight[:, None]
        self._scatter_of[block], self.furthest[block], sample = 0.0, 0.0, []
        for part in reversed(read):  # the last are in the cache still
            further = self._further(block, part.weight)
            apart = part.force - centre[part.at]
            chosen = (part.rows % self._stride == 0) & (self.number(block, part) > 1)
            sample.append(apart[chosen] * np.sqrt(further[part.at][chosen])[:, None])
            self._differ(part, apart, centre, 1.0)
            apart *= apart
            scatter = part.weight * (np.ones(len(apart)) @ apart)
            self._scatter += scatter
            self._scatter_of[block] += scatter
            if not (further == further[0]).all():
                apart *= further[part.at][:, None]
                further = np.ones(1)
            furthest = np.sqrt(apart.max(axis=0, initial=0.0) * further[0])
            np.maximum(self.furthest[block], furthest, out=self.furthest[block])
        self.samples[block] = np.concatenate(sample)
