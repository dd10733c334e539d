"""Sums over the rows of a block of groups: pure, wherever they are done.

A block knows where its rows stand and reads them itself; what comes back holds no row. So blocks
may be summed in any order, here or by the workers of a cluster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.estimation.readings.rows import BlockRows

HOURS = -1  # among the sums by file


@dataclass(frozen=True, eq=False)
class GroupBlock:
    """A block of groups, and where the rows stand that are not left out.

    Attributes
    ----------
    index, groups
        Which of the blocks; the number of its groups.
    parts
        Rows of a file that are in none of the groups twice.
    heaviest
        Largest weight of a row of the campaign.
    """

    index: int
    groups: int
    parts: tuple[BlockRows, ...]
    heaviest: float

    @cached_property
    def number(self) -> NDArray[np.int64]:
        """(groups,) number of rows."""
        number = np.zeros(self.groups, dtype=np.int64)
        for part in self.parts:
            number[part.at] += 1
        return number

    @cached_property
    def weight(self) -> Array:
        """(groups,) sum of the weights of the rows."""
        weight = np.zeros(self.groups)
        for part in self.parts:
            weight[part.at] += part.weight
        return weight

    def read(self) -> list[ReadRows]:
        """Read the rows."""
        return [ReadRows(part, *part.read()) for part in self.parts]

    def without(self, rejected: Sequence[RejectedRow]) -> GroupBlock:
        """Return the block with some rows left out."""
        masks = (_lost(part, rejected) for part in self.parts)
        parts = [
            part.without(lost) if lost.any() else part
            for part, lost in zip(self.parts, masks, strict=True)
            if not lost.all()
        ]
        return replace(self, parts=tuple(parts))


class ReadRows(NamedTuple):
    """Rows of a file that were read.

    Where they stand, (m, n) forces [N], (m, 3) known balance, commanded forces of those of which
    prints are taken.
    """

    of: BlockRows
    force: Array
    known: Array | None
    printed: Array

    def without(self, lost: NDArray[np.bool_]) -> ReadRows:
        """Return those that are not (m,) lost."""
        if not lost.any():
            return self
        part, force, known, printed = self
        left = ~lost[part.printed != 0]
        known = None if known is None else known[~lost]
        return ReadRows(part.without(lost), force[~lost], known, printed[left])


FileSums = dict[int, Array]
"""By file and under `HOURS` (2, n) sums over rows, weighted, of (c - c_mean) [N] and the same times
c_mean; under `HOURS` times the hour."""


@dataclass(frozen=True, eq=False)
class BlockSums:
    """What the rows of a block sum up to.

    Attributes
    ----------
    block
        Which of the blocks.
    mean, known
        (groups, n) and (groups, 3) means over the rows of a group [N].
    scatter
        (n,) weighted sum of squared deviations from these [N^2].
    furthest
        (n,) largest distance of a row from its group's mean, as seen from the rest of the group and
        divided by its noise over that of a row of weight 1 [N].
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


@dataclass(frozen=True, eq=False)
class WithoutWorst:
    """A block, the worst rows of its groups left out.

    Attributes
    ----------
    block
        The block without them.
    rejected
        The rows.
    sums
        Of the rest; None where a group is empty.
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
        of_block, of_files = _summed(block, block.read())
        sums.append(of_block)
        by_file = added(by_file, of_files)
    return sums, by_file


def without_worst(
    block: GroupBlock, *, noise: Array, limit: float, ids: NDArray[np.int64]
) -> tuple[WithoutWorst | None, FileSums]:
    """Read a block, and leave out the worst row of each group that has one too far out; or a pair.

    Parameters
    ----------
    block
        The block.
    noise, limit
        (n,) noise of a reading of weight 1 [N], and how many times that is too far.
    ids
        (n,) of the actuators.

    Returns
    -------
    left, by_file
        None where no row is too far out; by how much the sums by file change.
    """
    read = block.read()
    worst = _worst_rows(block, read, noise, limit, ids)
    if not worst:
        return None, {}
    rest = block.without(worst)
    if not rest.number.all():
        return WithoutWorst(rest, worst, None), {}
    before = _summed(block, read)[1]
    kept = [
        rows.without(lost) for rows in read for lost in [_lost(rows.of, worst)] if not lost.all()
    ]
    sums, after = _summed(rest, kept)
    change = added(after, {k: -of_file for k, of_file in before.items()})
    return WithoutWorst(rest, worst, sums), change


def _lost(part: BlockRows, rejected: Sequence[RejectedRow]) -> NDArray[np.bool_]:
    """Return (m,) which of some rows are left out."""
    rows = [row.row for row in rejected if row.cycle == part.cycle_index]
    return np.asarray(np.isin(part.row, rows))


def _worst_rows(
    block: GroupBlock, read: list[ReadRows], noise: Array, limit: float, ids: NDArray[np.int64]
) -> list[RejectedRow]:
    """Return the worst row of each group that has one too far out; or both of a pair."""
    worst: dict[int, RejectedRow] = {}
    pairs: list[RejectedRow] = []
    mean, every = _means(block, read)[0], np.arange(block.groups)
    for part, force, _, _ in read:
        further = np.sqrt(_further(block, part.weight))[part.at][:, None]
        sigmas = np.abs((force - mean[part.at]) * further) / noise
        group, number = every[part.at], block.number[part.at]
        for at in np.flatnonzero(sigmas.max(axis=1, initial=0.0) > limit).tolist():
            i, g = int(sigmas[at].argmax()), int(group[at])
            far = float(sigmas[at, i])
            row = RejectedRow(part.cycle_index, int(part.row[at]), int(ids[i]), far, "repeats")
            if number[at] == 2:
                pairs.append(row)
            elif g not in worst or worst[g].sigmas < far:
                worst[g] = row
    return [*worst.values(), *pairs]


def _further(block: GroupBlock, weight: float) -> Array:
    """Return, for each group, how much larger the square of a deviation is for the others.

    The mean holds the row itself: seen from the others it lies further out, so that deviations
    times the root of this have the variance of a reading of weight 1. 0 for a row without others.
    """
    total = block.weight
    return np.asarray(weight * total / np.where(total > weight, total - weight, np.inf))


def _means(block: GroupBlock, read: list[ReadRows]) -> tuple[Array, Array]:
    """Return (groups, n) and (groups, 3) means over the rows of each group [N]."""
    n = read[0].force.shape[1]
    mean, known = np.zeros((block.groups, n)), np.zeros((block.groups, 3))
    for part, force, of_balance, _ in read:
        share = part.weight / block.heaviest
        mean[part.at] += force if share == 1.0 else share * force
        if of_balance is not None:
            known[part.at] += part.weight * of_balance
    mean *= (block.heaviest / block.weight)[:, None]
    return mean, known / block.weight[:, None]


def _summed(block: GroupBlock, read: list[ReadRows]) -> tuple[BlockSums, FileSums]:
    """Sum over the rows that were read of a block."""
    mean, known = _means(block, read)
    n = mean.shape[1]
    scatter, furthest, sample = np.zeros(n), np.zeros(n), []
    by_file = {HOURS: np.zeros((2, n))}
    for part, force, _, _ in reversed(read):  # the last are in the cache still
        further = _further(block, part.weight)
        apart = force - mean[part.at]
        chosen = part.sampled & (block.number[part.at] > 1)
        sample.append(apart[chosen] * np.sqrt(further[part.at][chosen])[:, None])
        of_file = by_file.setdefault(part.cycle_index, np.zeros((2, n)))
        ones = np.ones(len(apart))
        for k, values in enumerate((apart, apart * mean[part.at])):
            of_file[k] += part.weight * (ones @ values)
            by_file[HOURS][k] += part.weight * (part.hour @ values)  # both at once take longer
        apart *= apart
        scatter += part.weight * (ones @ apart)
        if not (further == further[0]).all():
            apart *= further[part.at][:, None]
            further = np.ones(1)
        here = np.sqrt(apart.max(axis=0, initial=0.0) * further[0])
        np.maximum(furthest, here, out=furthest)
    sums = BlockSums(
        block.index, mean, known, scatter, furthest, np.concatenate(sample), _printed(read)
    )
    return sums, by_file


def _printed(read: list[ReadRows]) -> list[tuple[int, NDArray[np.int64], Array]]:
    """Return the rows of which prints are taken, with their labels, by part of a file."""
    return [
        (rows.of.cycle_index, rows.of.printed[rows.of.printed != 0], rows.printed)
        for rows in read
        if rows.printed.size
    ]


def mean_displacement(block: GroupBlock) -> tuple[int, Array]:
    """Read POSITION of a block; return which it is, and (groups, n) mean displacements [m]."""
    total = np.zeros((block.groups, block.parts[0].balanced.a.shape[1]))
    for part in block.parts:
        total[part.at] += part.weight * part.balanced.displacement(part.where)
    return block.index, total / block.weight[:, None]
