"""Sums over the rows that repeat one shape, one block of groups after the other.

Rows with the same load, SHAPE and SIGN are a group. Groups are summed in the order in which they
come in the files, so that rows are read in the order in which they are stored. All rows of a block
of groups fit into the cache; their means and then their deviations from these are taken before the
next block is read. If rows are left out, only their blocks are read again.

A block lists its rows and reads them itself, and its sums contain no row. So blocks can be summed
in any order, here or by the workers of a cluster.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.cluster import Client, divided, each
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.readings.moments import Moments, WithinGroups
from truenewton.estimation.readings.rounding_steps import rounding_steps
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.estimation.readings.rows import (
    BalancedRows,
    Selection,
    balanced_rows,
    common_reference,
    distinct,
    is_displaced,
    rest_positions,
    row_groups,
    row_hours,
    row_weights,
)
from truenewton.files.stored_rows import BLOCK_BYTES, Rows
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms

HOURS = -1  # key of the sums by hour among those by file

FileSums = dict[int, Array]
"""By file and under `HOURS` (2, n) sums over rows, weighted, of (c - c_mean) [N] and the same times
c_mean; under `HOURS` times the hour."""


class RepeatSums:
    """Sums over the rows of each group of a campaign, which are read a block of groups at a time.

    Parameters
    ----------
    campaign
        The campaign.
    reference
        (n,) readings from which displacements count [m]; its `common_reference` unless given.
    client
        A dask cluster that makes the sums; without it they are made here.

    Attributes
    ----------
    campaign
        The campaign.
    furthest
        (blocks, n) largest distance of a row from its group's mean, see `BlockSums`.
    samples
        (m, n) deviations of some repeated rows of each block, evenly spaced among all rows.
    prints
        Of some rows: they show copies, frozen readings and rounding.
    stale
        Whether leaving rows out has emptied a group or moved the reference: then all sums must be
        made again.
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
        self._layers = list(self._file_rows(groups_of_rows, printed))
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

    def _file_rows(
        self, groups: Sequence[NDArray[np.int64]], printed: NDArray[np.int64]
    ) -> Iterator[FileRows]:
        """Yield rows of each file, of each group at most one, in the order of the groups.

        ``groups`` contains (N,) the group of each row that counts, ``printed`` (g,) labels of those
        of which prints are taken.
        """
        campaign, turn = self.campaign, np.argsort(self._coming)
        a, weights, hour = enabled_arms(campaign.layout), row_weights(campaign), row_hours(campaign)
        # Deviations of 1000 rows are kept: they give a variance of three degrees to 3 %.
        stride = max(1, sum(map(len, groups)) // 1000)
        for k, (cycle, group) in enumerate(zip(campaign.cycles, groups, strict=True)):
            balanced = balanced_rows(cycle, a, self._reference)
            balanced = replace(balanced, enabled=campaign.layout.enabled)  # one array for all files
            counting = np.flatnonzero(cycle.valid)
            for rows in distinct(turn[group]):
                yield FileRows(
                    k,
                    counting[rows],
                    turn[group[rows]],
                    hour[k][rows],
                    rows % stride == 0,
                    printed[group[rows]],
                    weights[k],
                    balanced,
                )

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
        heaviest = max(layer.weight for layer in self._layers)
        return GroupBlock(index, some.stop - some.start, here, heaviest)

    def _every_block(self) -> Iterator[GroupBlock]:
        return map(self._block, range(len(self._groups)))

    def _runs(self, n: int) -> Iterator[list[GroupBlock]]:
        """Yield successive blocks in lists, each of which is read by one task."""
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
        """Moments of the rows that are not left out."""
        if self._moments is None:
            turn = np.argsort(self._coming)
            self._moments = Moments(
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
        return self._moments

    def _within(self, turn: NDArray[np.int64]) -> WithinGroups:
        """Return how rows of one group differ; (g,) groups in order, among those as they come."""
        files, n = len(self.campaign.cycles), self._mean.shape[1]
        weight, hours = np.zeros((2, files, len(turn)))
        square = np.zeros(len(turn))
        for block, groups in zip(self._every_block(), self._groups, strict=True):
            for part in block.parts:
                k, at = part.file, np.arange(groups.start, groups.stop)[part.group]
                weight[k, at] += part.weight
                hours[k, at] += part.weight * part.hour
                square[at] += part.weight * part.hour**2
        zero, gain = np.zeros((2, files + 1, n))
        for k, sums in self._by_file.items():
            zero[k], gain[k] = sums  # those by hour are the last, as `HOURS` is
        weight, hours, square = weight[:, turn], hours[:, turn], square[turn]
        return WithinGroups(weight, hours, square, self._mean, zero, gain)

    def displacement(self) -> Array | None:
        """Return (g, n) mean displacements of the groups in their order [m]; None without POSITION.

        None also beyond 2^24 values: reading them takes as long as reading FORCE.
        """
        zeros = rest_positions(self.campaign) if self._mean.size <= 2**24 else None
        if zeros is None:
            return None
        positions = [cycle.position for cycle in self.campaign.cycles if cycle.position is not None]
        function = partial(mean_displacement, positions=positions, zeros=zeros)
        mean = np.empty_like(self._mean)
        for block, values in each(function, self._every_block(), self.client):
            mean[self._coming[self._groups[block]]] = values
        return mean

    def leave_out_worst(
        self, blocks: Sequence[int], noise: Array, limit: float
    ) -> list[RejectedRow]:
        """Leave out the worst row of each group of some blocks that has one too far from its mean.

        Of a group of two both go. The rest is summed again, unless all sums must be made again.

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


# -- what a block reads ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FileRows:
    """Rows of one file, at most one of each group, not yet read.

    Attributes
    ----------
    file, row
        Index of the cycle, and (m,) rows of its MEASUREMENTS.
    group
        (m,) their groups in ascending order; in a block, counted from its first.
    hour
        (m,) hours since the mean of all cycles.
    sampled
        (m,) whether their deviations are kept.
    printed
        (m,) their labels, SHAPE times SIGN, if prints are taken of them; otherwise 0.
    weight
        Of a row.
    balanced
        Reads them.
    """

    file: int
    row: NDArray[np.int64]
    group: Selection
    hour: Array
    sampled: NDArray[np.bool_]
    printed: NDArray[np.int64]
    weight: float
    balanced: BalancedRows

    def within(self, block: slice) -> FileRows | None:
        """Return the rows of a block of groups; None if there is none."""
        group = self.group
        assert not isinstance(group, slice)  # these are the rows of all groups
        first, end = group.searchsorted((block.start, block.stop)).tolist()
        if first == end:
            return None
        whole = end - first == block.stop - block.start
        at = slice(None) if whole else group[first:end] - block.start  # a slice: no copy
        return self.only(slice(first, end), at)

    def only(self, some: slice | NDArray[np.bool_], group: Selection) -> FileRows:
        """Return some of the rows, which have (m,) groups."""
        return replace(
            self,
            row=self.row[some],
            group=group,
            hour=self.hour[some],
            sampled=self.sampled[some],
            printed=self.printed[some],
        )

    @property
    def where(self) -> Selection:
        """The (m,) rows, as a slice if they are successive."""
        row = self.row
        follow = bool((np.diff(row) == 1).all())
        return slice(int(row[0]), int(row[-1]) + 1) if follow and row.size else row

    def read(self) -> ReadRows:
        """Read the rows.

        Prints are of what was read: corrected for displacements, no row repeats to the last bit.
        """
        raw, position = self.balanced.read(self.where)
        return ReadRows(self, *self.balanced.of(raw, position), raw[self.printed != 0])

    def rejected_in(self, rejected: Sequence[RejectedRow]) -> NDArray[np.bool_]:
        """Return (m,) which of the rows are left out."""
        return np.isin(self.row, [row.row for row in rejected if row.cycle == self.file])


class ReadRows(NamedTuple):
    """Rows of a file that were read.

    Their description, (m, n) c (1 + COILGRAD z) [N], (m, 3) A (BIASGRAD z) or None, and commanded
    forces of those of which prints are taken [N].
    """

    of: FileRows
    force: Array
    known: Array | None
    printed: Array

    def only(self, kept: NDArray[np.bool_]) -> ReadRows:
        """Return the (m,) rows that are kept."""
        of, force, known, printed = self
        if kept.all():
            return self
        group = np.arange(len(kept)) if isinstance(of.group, slice) else of.group
        known = None if known is None else known[kept]
        rows = of.only(kept, group[kept])
        return ReadRows(rows, force[kept], known, printed[kept[of.printed != 0]])


@dataclass(frozen=True, eq=False)
class GroupBlock:
    """A block of groups, with the rows that are not left out.

    Attributes
    ----------
    index, groups
        Which of the blocks; the number of its groups.
    parts
        Rows of a file, at most one of each group.
    heaviest
        Largest weight of a row of the campaign.
    """

    index: int
    groups: int
    parts: tuple[FileRows, ...]
    heaviest: float

    @cached_property
    def number(self) -> NDArray[np.int64]:
        """(groups,) number of rows."""
        number = np.zeros(self.groups, dtype=np.int64)
        for part in self.parts:
            number[part.group] += 1
        return number

    @cached_property
    def weight(self) -> Array:
        """(groups,) sum of the weights of the rows."""
        weight = np.zeros(self.groups)
        for part in self.parts:
            weight[part.group] += part.weight
        return weight

    def distance_factor(self, weight: float) -> Array:
        """Return (groups,) factor of the squared deviation of a row from the mean of the others.

        The mean includes the row itself. With this factor, deviations have the variance of a
        reading of weight 1; it is 0 for a row without others.
        """
        total = self.weight
        return np.asarray(weight * total / np.where(total > weight, total - weight, np.inf))


# -- sums of a block ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums over the rows of a block.

    Attributes
    ----------
    block
        Which of the blocks.
    mean, known
        (groups, n) and (groups, 3) means over the rows of a group [N].
    scatter
        (n,) weighted sum of squared deviations from these [N^2].
    furthest
        (n,) largest distance of a row from the mean of the others of its group, divided by its
        noise over that of a row of weight 1 [N].
    sample
        (m, n) deviations of some rows from the others of their groups, at weight 1 [N].
    printed
        Rows of which prints are taken: of some files the index, labels and (m, n) readings [N].
    """

    block: int
    mean: Array
    known: Array
    scatter: Array
    furthest: Array
    sample: Array
    printed: list[tuple[int, NDArray[np.int64], Array]]


class WithoutWorst(NamedTuple):
    """A block without the worst rows of its groups, these rows, and the sums of the rest.

    The sums are None if a group is empty.
    """

    block: GroupBlock
    rejected: list[RejectedRow]
    sums: BlockSums | None


def added(one: FileSums, other: FileSums) -> FileSums:
    """Add sums by file."""
    return one | {k: one[k] + sums if k in one else sums for k, sums in other.items()}


def sums_of(blocks: Sequence[GroupBlock]) -> tuple[list[BlockSums], FileSums]:
    """Read some blocks; return the sums of each, and those by file of all."""
    sums, by_file = list[BlockSums](), FileSums()
    for block in blocks:
        of_block, of_files = _summed(block, [part.read() for part in block.parts])
        sums.append(of_block)
        by_file = added(by_file, of_files)
    return sums, by_file


def without_worst(
    block: GroupBlock, *, noise: Array, limit: float, ids: NDArray[np.int64]
) -> tuple[WithoutWorst | None, FileSums]:
    """Read a block, and leave out the worst row of each group that has one too far out.

    Returns the block, None if no row is too far out, and by how much the sums by file change.
    Noise of a reading of weight 1 [N] and ids are (n,).
    """
    read = [part.read() for part in block.parts]
    worst = _worst_rows(block, read, noise, limit, ids)
    if not worst:
        return None, {}
    kept = [(rows, ~rows.of.rejected_in(worst)) for rows in read]
    left = [rows.only(some) for rows, some in kept if some.any()]
    rest = replace(block, parts=tuple(rows.of for rows in left))
    if not rest.number.all():
        return WithoutWorst(rest, worst, None), {}
    before = _summed(block, read)[1]
    sums, after = _summed(rest, left)
    change = added(after, {k: -of_file for k, of_file in before.items()})
    return WithoutWorst(rest, worst, sums), change


def _worst_rows(
    block: GroupBlock, read: list[ReadRows], noise: Array, limit: float, ids: NDArray[np.int64]
) -> list[RejectedRow]:
    """Return the worst row of each group that has one too far out; both of a group of two."""
    worst: dict[int, RejectedRow] = {}
    pairs: list[RejectedRow] = []
    mean, every = _means(block, read)[0], np.arange(block.groups)
    for part, force, _, _ in read:
        factor = np.sqrt(block.distance_factor(part.weight))[part.group][:, None]
        sigmas = np.abs((force - mean[part.group]) * factor) / noise
        group, number = every[part.group], block.number[part.group]
        for at in np.flatnonzero(sigmas.max(axis=1, initial=0.0) > limit).tolist():
            i, g = int(sigmas[at].argmax()), int(group[at])
            far = float(sigmas[at, i])
            row = RejectedRow(part.file, int(part.row[at]), int(ids[i]), far, "repeats")
            if number[at] == 2:
                pairs.append(row)
            elif g not in worst or worst[g].sigmas < far:
                worst[g] = row
    return [*worst.values(), *pairs]


def _means(block: GroupBlock, read: list[ReadRows]) -> tuple[Array, Array]:
    """Return (groups, n) and (groups, 3) means over the rows of each group [N]."""
    n = read[0].force.shape[1]
    mean, known = np.zeros((block.groups, n)), np.zeros((block.groups, 3))
    for part, force, of_balance, _ in read:
        share = part.weight / block.heaviest
        mean[part.group] += force if share == 1.0 else share * force
        if of_balance is not None:
            known[part.group] += part.weight * of_balance
    mean *= (block.heaviest / block.weight)[:, None]
    return mean, known / block.weight[:, None]


def _summed(block: GroupBlock, read: list[ReadRows]) -> tuple[BlockSums, FileSums]:
    """Return the sums over the rows that were read of a block, and those by file."""
    mean, known = _means(block, read)
    n = mean.shape[1]
    scatter, furthest, sample = np.zeros(n), np.zeros(n), []
    by_file = {HOURS: np.zeros((2, n))}
    for part, force, _, _ in reversed(read):  # the last are in the cache still
        factor = block.distance_factor(part.weight)
        apart = force - mean[part.group]
        chosen = part.sampled & (block.number[part.group] > 1)
        sample.append(apart[chosen] * np.sqrt(factor[part.group][chosen])[:, None])
        of_file = by_file.setdefault(part.file, np.zeros((2, n)))
        ones = np.ones(len(apart))
        for k, values in enumerate((apart, apart * mean[part.group])):
            of_file[k] += part.weight * (ones @ values)
            by_file[HOURS][k] += part.weight * (part.hour @ values)  # both at once take longer
        apart *= apart
        scatter += part.weight * (ones @ apart)
        if not (factor == factor[0]).all():
            apart *= factor[part.group][:, None]
            factor = np.ones(1)
        here = np.sqrt(apart.max(axis=0, initial=0.0) * factor[0])
        np.maximum(furthest, here, out=furthest)
    printed = [
        (rows.of.file, rows.of.printed[rows.of.printed != 0], rows.printed)
        for rows in read
        if rows.printed.size
    ]
    sums = BlockSums(block.index, mean, known, scatter, furthest, np.concatenate(sample), printed)
    return sums, by_file


def mean_displacement(
    block: GroupBlock, positions: Sequence[Rows], zeros: Sequence[Array]
) -> tuple[int, Array]:
    """Read POSITION of a block; return its index, and (groups, n) mean displacements [m].

    Of each file POSITION, and (n,) readings from which its displacements count [m].
    """
    total = np.zeros((block.groups, len(zeros[0])))
    for part in block.parts:
        read = part.balanced.used(positions[part.file], part.where)
        total[part.group] += part.weight * (read - zeros[part.file])
    return block.index, total / block.weight[:, None]
