"""Sums over the rows that repeat one shape, one block of groups after the other.

Groups are summed in the order in which they come in the files, so that rows are read in the order
in which they are stored. All rows of a block of groups fit into the cache; their means and then
their deviations from these are taken before the next block is read. If rows are left out, only
their blocks are read again.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import BLOCK_BYTES, Array
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.readings.moments import Moments, WithinGroups, rounding_steps
from truenewton.estimation.readings.rows import (
    BlockSums,
    FileSums,
    GroupBlock,
    GroupBlocks,
    added,
    common_reference,
    file_rows,
    is_displaced,
    mean_displacement,
    rest_positions,
    row_groups,
    sums_of,
    without_worst,
)
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


class RepeatSums:
    """Sums over the rows of each group of a campaign, which are read a block of groups at a time.

    Displacements count from the (n,) reference [m], the `common_reference` of the campaign unless
    given.
    """

    def __init__(self, campaign: Campaign, reference: Array | None = None) -> None:
        self.campaign = campaign
        # Whether leaving rows out has emptied a group or moved the reference: then all sums must be
        # made again.
        self.stale = False
        self._reference = common_reference(campaign) if reference is None else reference
        self._labels, first, groups_of_rows = row_groups(campaign)
        self._coming = np.argsort(first)  # groups, as they come
        codes = np.prod(self._labels[:, 1:], axis=1)
        self.prints = RowPrints(codes)  # they show copies, frozen readings and rounding
        printed = np.where(np.isin(codes, self.prints.labels), codes, 0)[self._coming]
        turn = np.argsort(self._coming)
        coming = [turn[group] for group in groups_of_rows]
        groups, n = len(first), int(campaign.layout.enabled.sum())
        rows = file_rows(campaign, self._reference, coming, printed)
        self._blocks = GroupBlocks(rows, groups, n)  # of the rows that are not left out
        count = len(self._blocks.spans)
        self._mean, self._known = np.empty((groups, n)), np.zeros((groups, 3))
        self._scatter_of, self.furthest = np.zeros((2, count, n))  # of each block, see `BlockSums`
        self.samples = [np.empty((0, n))] * count
        self._by_file = FileSums()
        for several in self._runs(n):
            sums_of_blocks, by_file = sums_of(several)
            for sums in sums_of_blocks:
                self._keep(sums)
            self._by_file = added(self._by_file, by_file)

    def _runs(self, n: int) -> Iterator[list[GroupBlock]]:
        """Yield successive blocks in lists whose sums by file are added."""
        run, size = list[GroupBlock](), 0
        for block in self._blocks:
            run.append(block)
            size += 8 * n * int(block.number.sum())
            if size > 4 * BLOCK_BYTES:
                yield run
                run, size = [], 0
        if run:
            yield run

    def _keep(self, sums: BlockSums) -> None:
        """Put the sums of a block to the others."""
        block = sums.block
        groups = self._coming[self._blocks.spans[block]]
        self._mean[groups], self._known[groups] = sums.mean, sums.known
        self._scatter_of[block], self.furthest[block] = sums.scatter, sums.furthest
        self.samples[block] = sums.sample
        for file, codes, force in sums.printed:
            self.prints.take(file, codes, force)

    @cached_property
    def step(self) -> Array:
        """(n,) step of which the readings are multiples [N], or 0."""
        return rounding_steps(self.prints.of_first)

    @cached_property
    def moments(self) -> Moments:
        """Moments of the rows that are not left out."""
        turn = np.argsort(self._coming)
        sizes = [(block.number, block.weight) for block in self._blocks]
        number, weight = map(np.concatenate, zip(*sizes, strict=True))
        return Moments(
            loads=self.campaign.loads,
            labels=self._labels,
            rows=number[turn],
            weight=weight[turn],
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
        for block in self._blocks:
            for part in block.parts:
                k, at = part.file, np.arange(block.span.start, block.span.stop)[part.group]
                weight[k, at] += part.weight
                hours[k, at] += part.weight * part.hour
                square[at] += part.weight * part.hour**2
        zero, gain = np.zeros((2, files + 1, n))
        for k, sums in self._by_file.items():
            zero[k], gain[k] = sums  # those by hour are the last
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
        mean = np.empty_like(self._mean)
        for block, values in (mean_displacement(b, positions, zeros) for b in self._blocks):
            mean[self._coming[self._blocks.spans[block]]] = values
        return mean

    def leave_out_worst(
        self, blocks: Sequence[int], noise: Array, limit: float
    ) -> list[RejectedRow]:
        """Leave out the worst row of each group of some blocks that has one too far from its mean.

        Too far is ``limit`` times the (n,) noise of a reading of weight 1 [N]. Of a group of two
        both go. The rest is summed again, unless all sums must be made again.
        """
        rejected, ids = list[RejectedRow](), self.campaign.layout.id[self.campaign.layout.enabled]
        for block in map(self._blocks.__getitem__, blocks):
            left, change = without_worst(block, noise=noise, limit=limit, ids=ids)
            if left is None:
                continue
            rejected += left.rejected
            self._blocks.left[left.block.index] = left.block
            displaced = any(is_displaced(self.campaign.cycles[r.cycle]) for r in left.rejected)
            self.stale |= displaced or left.sums is None
            if left.sums is not None and not self.stale:
                self._keep(left.sums)
            self._by_file = added(self._by_file, change)
        vars(self).pop("moments", None)  # of the rows before
        return rejected


# -- fingerprints of some rows ---------------------------------------------------------------------


def common_labels(codes: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return (m,) some of the labels that all files have, given (N,) those of the rows of each."""
    return _some(reduce(np.intersect1d, codes))


def _some(labels: NDArray[np.int64], most: int = 16) -> NDArray[np.int64]:
    """Return at most so many of (m,) labels, evenly from the first to the last."""
    last = len(labels) - 1
    return labels[np.unique(np.linspace(0, last, most if last >= 0 else 0).astype(np.int64))]


class RowPrints:
    """Fingerprints of one row of each file under some of (g,) labels, SHAPE times SIGN."""

    def __init__(self, codes: NDArray[np.int64]) -> None:
        self.labels = _some(np.unique(codes), 48)  # of which prints are taken
        self._kept = {*_some(self.labels).tolist()}  # rows of each file that are kept
        self._before = dict[int, Array]()
        self.taken: dict[tuple[int, int], bytes] = {}  # digests by file and label
        self.rows = Counter[int]()  # their number by file
        self._run: dict[int, NDArray[np.int64]] = {}
        # By file (n,) how many rows after each other repeat the reading before, bit by bit.
        self.longest: dict[int, NDArray[np.int64]] = {}
        # By file (n,) the largest magnitude of a reading [N], and how many of the rows have it.
        self.limit: dict[int, Array] = {}
        self.at_limit: dict[int, NDArray[np.int64]] = {}
        self.of_first: list[Array] = []  # (n,) readings of the rows of one file [N]
        # (n,) those of some of the rows [N], by file and label.
        self.readings: dict[tuple[int, int], NDArray[np.float32]] = {}

    @property
    def common_rows(self) -> NDArray[np.float32]:
        """(files, m, n) readings under the labels that all files have [N]."""
        files = range(1 + max(file for file, _ in self.taken))
        codes = [np.array([code for of, code in self.readings if of == file]) for file in files]
        chosen = common_labels(codes).tolist()
        return np.array([[self.readings[file, code] for code in chosen] for file in files])

    def take(self, file: int, codes: NDArray[np.int64], force: Array) -> None:
        """Take the prints of (m, n) rows of a file [N], which have (m,) of the labels."""
        for code, readings in zip(codes.tolist(), force, strict=True):
            key = file, code
            if key in self.taken:
                continue
            self.rows[file] += 1
            if code in self._kept:
                self.readings[key] = readings.astype(np.float32)
            self.taken[key] = hashlib.sha1(readings.tobytes(), usedforsecurity=False).digest()
            if file not in self._before:
                self._run[file], self.longest[file] = np.zeros((2, len(readings)), np.int64)
                self.at_limit[file] = np.zeros(len(readings), np.int64)
                self.limit[file] = np.zeros(len(readings))
            else:
                run = np.where(readings == self._before[file], self._run[file] + 1, 0)
                self._run[file], self.longest[file] = run, np.maximum(self.longest[file], run)
            self._before[file], size, limit = readings.copy(), np.abs(readings), self.limit[file]
            at_limit = self.at_limit[file] + (size == limit)
            self.at_limit[file] = np.where(size > limit, 1, at_limit)
            self.limit[file] = np.maximum(size, limit)
            if file == next(iter(self._before)):
                self.of_first.append(self._before[file])


# -- the second reading, shared by all that need it -----------------------------------------------


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Some of the rows of a cycle that count, m of them, which follow each other."""

    # The cycle in its campaign
    cycle_index: int
    cycle: Cycle
    # Which of its rows that count; whether these are the last of them
    rows: slice
    last: bool
    force: Array  # (m, n) commanded forces of the enabled actuators [N]

    @cached_property
    def position(self) -> Array:
        """(m, n) readings of the sensors [m], read on first use."""
        if self.cycle.position is None:
            raise ValueError(f"{self.cycle!r} holds no POSITION")
        return self.cycle.used(self.cycle.position, self.rows)


RowReader = Callable[[RowBlock], None]


def read_rows(campaign: Campaign, readers: Sequence[RowReader]) -> None:
    """Read the rows that count once: cycle after cycle, some megabytes at a time."""
    for k, cycle in enumerate(campaign.cycles):
        count = int(cycle.valid.sum())
        for rows in cycle.used_blocks:
            block = RowBlock(k, cycle, rows, rows.stop == count, cycle.used(cycle.force, rows))
            for take in readers:
                take(block)
