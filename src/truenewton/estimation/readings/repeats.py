"""Rows by the group that they repeat, a block of groups after the other.

Rows with the same load, SHAPE and SIGN are a group. Groups are worked through in the order in which
they come, so that rows are read where they stand; a block after the other (`block_sums`), so that
all rows of a group are in the cache, and of those on disk no more in memory, while their mean and
then their deviations from it are taken. Where rows are left out, their blocks alone are read again.
Blocks know nothing of each other: a cluster's workers take some of them each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.cluster import Client, divided, each
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.readings.block_sums import (
    BlockSums,
    FileSums,
    GroupBlock,
    WithoutWorst,
    added,
    mean_displacement,
    sums_of,
    without_worst,
)
from truenewton.estimation.readings.moments import Moments, WithinGroups
from truenewton.estimation.readings.rounding_steps import rounding_steps
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.estimation.readings.rows import (
    BlockRows,
    DistinctRows,
    balanced_rows,
    common_reference,
    distinct,
    is_displaced,
    rest_positions,
)
from truenewton.files.stored_rows import BLOCK_BYTES
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]
MAX_DISPLACED_MEANS = 2**24  # means of displacements that are taken
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

    Parameters
    ----------
    campaign
        The campaign.
    reference
        (n,) readings from which displacements count [m]; its `common_reference` unless given.
    client
        A dask cluster that does the sums; done here without.

    Attributes
    ----------
    campaign
        The campaign.
    furthest
        (blocks, n) largest distance of a row from its group's mean, see `BlockSums`.
    samples
        (m, n) deviations of some repeated rows of each block; together they stand evenly among all
        rows.
    prints
        Of some rows: copies, readings that freeze, and rounding are known by them.
    stale
        Whether what was left out has emptied a group or moved the reference: the sums must be made
        of the rest anew.
    """

    def __init__(
        self, campaign: Campaign, reference: Array | None = None, client: Client | None = None
    ) -> None:
        self.campaign, self.client, self.stale = campaign, client, False
        self._moments: Moments | None = None
        self._reference = common_reference(campaign) if reference is None else reference
        self._labels, first, groups_of_rows = row_groups(campaign)
        self._coming = np.argsort(first)  # groups, as they come
        codes = np.prod(self._labels[:, 1:], axis=1)
        self.prints = RowPrints(codes)
        printed = np.where(np.isin(codes, self.prints.labels), codes, 0)
        self._layers = list(self._distinct(groups_of_rows, printed))
        groups, n = len(first), int(campaign.layout.enabled.sum())
        self._groups = self._cut(groups, n)
        self._left = dict[int, GroupBlock]()  # blocks without some of their rows
        count = len(self._groups)
        self._mean, self._known = np.empty((groups, n)), np.zeros((groups, 3))
        self._scatter_of, self.furthest = np.zeros((2, count, n))
        self.samples = [np.empty((0, n))] * count

        def take(several: list[BlockSums]) -> None:
            for sums in several:
                self._keep(sums)

        self._by_file: FileSums = divided(sums_of, self._runs(n), take, added, client)

    def _distinct(
        self, groups: Sequence[NDArray[np.int64]], printed: NDArray[np.int64]
    ) -> Iterator[DistinctRows]:
        """Yield rows of each file that are in no group twice, in the order of the groups.

        ``groups`` holds (N,) that of each row that counts, ``printed`` (g,) labels of those of
        which prints are taken.
        """
        campaign, turn = self.campaign, np.argsort(self._coming)
        a, weights, hour = enabled_arms(campaign.layout), row_weights(campaign), hours(campaign)
        stride = max(1, sum(map(len, groups)) // SAMPLE_ROWS)
        for k, (cycle, group) in enumerate(zip(campaign.cycles, groups, strict=True)):
            balanced = balanced_rows(cycle, a, self._reference)
            balanced = replace(balanced, enabled=campaign.layout.enabled)  # one array for all files
            counting = np.flatnonzero(cycle.valid)
            for rows in distinct(turn[group]):
                every = BlockRows(
                    k,
                    counting[rows],
                    slice(None),
                    hour[k][rows],
                    rows % stride == 0,
                    printed[group[rows]],
                    weights[k],
                    balanced,
                )
                yield DistinctRows(every, turn[group[rows]])

    def _cut(self, groups: int, n: int) -> list[slice]:
        """Cut the groups into blocks, as they come."""
        number = np.zeros(groups, dtype=np.int64)
        for layer in self._layers:
            number[layer.group] += 1
        most = int(np.clip(BLOCK_BYTES // (8 * n * number.max()), 1, ROWS_AT_ONCE))
        return [slice(at, min(at + most, groups)) for at in range(0, groups, most)]

    def _block(self, index: int) -> GroupBlock:
        """Return a block, with the rows that are not left out."""
        if index in self._left:
            return self._left[index]
        some = self._groups[index]
        parts = (layer.within(some) for layer in self._layers)
        here = tuple(part for part in parts if part is not None)
        heaviest = max(layer.rows.weight for layer in self._layers)
        return GroupBlock(index, some.stop - some.start, here, heaviest)

    def _every_block(self) -> Iterator[GroupBlock]:
        return map(self._block, range(len(self._groups)))

    def _runs(self, n: int) -> Iterator[list[GroupBlock]]:
        """Yield the blocks, some after each other at a time, as one task reads them."""
        run, size = list[GroupBlock](), 0
        for block in self._every_block():
            run.append(block)
            size += 8 * n * int(block.number.sum())
            if size > 4 * BLOCK_BYTES:  # some tenths of a second
                yield run
                run, size = [], 0
        if run:
            yield run

    def _keep(self, sums: BlockSums) -> None:
        """Put the sums of a block to the others."""
        block, groups = sums.block, self._coming[self._groups[sums.block]]
        self._mean[groups], self._known[groups] = sums.mean, sums.known
        self._scatter_of[block], self.furthest[block] = sums.scatter, sums.furthest
        self.samples[block] = sums.sample
        for file, codes, force in sums.printed:
            self.prints.take(file, codes, force)

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
            rows=np.concatenate([block.number for block in self._every_block()])[turn],
            weight=np.concatenate([block.weight for block in self._every_block()])[turn],
            mean=self._mean,
            known=self._known,
            scatter=self._scatter_of.sum(axis=0),
            reference=self._reference,
            within=self._within(turn),
            step=self.step,
        )

    def _within(self, turn: NDArray[np.int64]) -> WithinGroups:
        """Return how rows of one group differ; (g,) groups in order, among those as they come."""
        files, n = len(self.campaign.cycles), self._mean.shape[1]
        weight, hours = np.zeros((2, files, len(turn)))
        square = np.zeros(len(turn))
        for block, groups in zip(self._every_block(), self._groups, strict=True):
            for part in block.parts:
                k, at = part.cycle_index, np.arange(groups.start, groups.stop)[part.at]
                weight[k, at] += part.weight
                hours[k, at] += part.weight * part.hour
                square[at] += part.weight * part.hour**2
        zero, gain = np.zeros((2, files + 1, n))
        for k, sums in self._by_file.items():
            zero[k], gain[k] = sums  # those by hour stand last, as `HOURS` says
        weight, hours, square = weight[:, turn], hours[:, turn], square[turn]
        return WithinGroups(weight, hours, square, self._mean, zero, gain)

    def displacement(self) -> Array | None:
        """Return (g, n) mean displacements of the groups in their order [m]; None without POSITION.

        Nor beyond `MAX_DISPLACED_MEANS` values: their reading would take as long as that of FORCE.
        """
        if self._mean.size > MAX_DISPLACED_MEANS:
            return None
        zeros = rest_positions(self.campaign)
        if zeros is None:
            return None
        of_file = {
            rows.cycle_index: replace(rows.balanced, zero=zeros[rows.cycle_index])
            for rows in (layer.rows for layer in self._layers)
        }
        blocks = (
            replace(
                block,
                parts=tuple(replace(p, balanced=of_file[p.cycle_index]) for p in block.parts),
            )
            for block in self._every_block()
        )
        mean = np.empty_like(self._mean)
        for block, values in each(mean_displacement, blocks, self.client):
            mean[self._coming[self._groups[block]]] = values
        return mean

    def leave_out_worst(
        self, blocks: Sequence[int], noise: Array, limit: float
    ) -> list[RejectedRow]:
        """Leave out the worst row of each group of some blocks that has one too far out.

        Of two rows both. The rest is summed anew, unless all of it has to be.

        Parameters
        ----------
        blocks
            Which of them.
        noise, limit
            (n,) noise of a reading of weight 1 [N], and how many times that is too far.
        """
        rejected = list[RejectedRow]()

        def take(left: WithoutWorst | None) -> None:
            if left is None:
                return
            rejected.extend(left.rejected)
            self._left[left.block.index] = left.block
            displaced = any(is_displaced(self.campaign.cycles[r.cycle]) for r in left.rejected)
            self.stale |= displaced or left.sums is None
            if left.sums is not None and not self.stale:
                self._keep(left.sums)

        ids = self.campaign.layout.id[self.campaign.layout.enabled]
        function = partial(without_worst, noise=noise, limit=limit, ids=ids)
        if blocks:
            some = map(self._block, blocks)
            change = divided(function, some, take, added, self.client)
            self._by_file, self._moments = added(self._by_file, change), None
        return rejected
