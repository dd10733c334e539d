"""The rows of a campaign as they balance, in blocks of groups that repeat one shape.

Displacements count from one reading of each sensor for all cycles of a campaign: the mean of its
cycles at rest. So alpha is that of the mean position of the mirror under all loads. Electronics may
set their zero anew with each file. If the mean of a sensor over a cycle differs from the common one
by more than its rms displacement, this sensor counts from the mean of each cycle instead; if this
holds for most sensors, all of them do.

Rows with the same load, SHAPE and SIGN are a group. A block of groups lists its rows and reads them
itself, and its sums contain no row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import BLOCK_BYTES, Array
from truenewton.estimation.findings.estimate import RejectedRow
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle, common_rest
from truenewton.statics.arms import enabled_arms

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]

Selection = slice | NDArray[np.int64]
"""Some rows of a cycle."""


# -- displacements --------------------------------------------------------------------------------


def common_reference(campaign: Campaign) -> Array:
    """Return (n,) the readings from which the displacements of a campaign count [m].

    NaN for a sensor that counts from the mean of each cycle; all are NaN if no cycle has both
    POSITION and a gradient.
    """
    displaced = [cycle for cycle in campaign.cycles if is_displaced(cycle)]
    if not displaced:
        return np.full(int(campaign.layout.enabled.sum()), np.nan)
    return common_rest(displaced)


def rest_positions(campaign: Campaign) -> tuple[Array, ...] | None:
    """Return for each cycle (n,) readings from which its displacements count [m].

    They do not depend on gradients; None if a cycle has no POSITION.
    """
    if any(cycle.position is None for cycle in campaign.cycles):
        return None
    reference = common_rest(campaign.cycles)
    return tuple(_from_own_mean(reference, cycle) for cycle in campaign.cycles)


def _from_own_mean(reference: Array, cycle: Cycle) -> Array:
    """Return (n,) a reference [m], the mean of the cycle itself where it is NaN."""
    anew = np.isnan(reference)
    return np.where(anew, cycle.rest_position, reference) if anew.any() else reference


def is_displaced(cycle: Cycle) -> bool:
    """Return whether POSITION changes the balance of a cycle."""
    return cycle.position is not None and bool(cycle.coil_gradient or cycle.bias_gradient)


# -- rows as they balance -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BalancedRows:
    """The rows of a cycle, corrected for POSITION."""

    # (N, all) commanded forces [N] and readings [m]; position is None if it does not change the
    # balance
    force: Array
    position: Array | None
    enabled: NDArray[np.bool_]  # (all,) which of the actuators take part, n of them
    a: Array  # (3, n) arms of these
    # (n,) readings from which displacements relative to the coils count [m]; of coils that have
    # shifted by COILZ, without POSITION, the shift itself
    zero: Array
    # COILGRAD [1/m] and BIASGRAD [N/m], 0 without
    coil: float
    bias: float
    shifted: bool = False  # whether the coils have moved along z

    def read(self, rows: Selection) -> tuple[Array, Array | None]:
        """Read (m, n) forces [N] and readings [m] of some rows."""
        position = None if self.position is None else self.used(self.position, rows)
        return self.used(self.force, rows), position

    def of(self, force: Array, position: Array | None) -> tuple[Array, Array | None]:
        """Return (m, n) c (1 + COILGRAD z) [N] and (m, 3) A (BIASGRAD z) of what was read.

        The latter is None if nothing is displaced relative to the coils.
        """
        if position is None:
            if not self.shifted:
                return force, None
            position = np.zeros_like(force)
        z = position - self.zero
        return force * (1.0 + self.coil * z), self.bias * z @ self.a.T

    def used(self, values: Array, rows: Selection) -> Array:
        """Return FORCE [N] or POSITION [m] of some rows, (m, n)."""
        chosen = values[rows]
        return chosen if self.enabled.all() else chosen[:, self.enabled]


def balanced_rows(cycle: Cycle, a: Array, reference: Array) -> BalancedRows:
    """Return the rows of a cycle as they balance, by (3, n) arms and the (n,) reference [m]."""
    displaced, shift = is_displaced(cycle), cycle.load.coil_shift or 0.0
    zero = _from_own_mean(reference, cycle) if displaced else np.zeros(a.shape[1])
    return BalancedRows(
        cycle.force,
        cycle.position if displaced else None,
        cycle.layout.enabled,
        a,
        zero + shift,
        cycle.coil_gradient or 0.0,
        cycle.bias_gradient or 0.0,
        shifted=shift != 0.0,
    )


# -- groups ---------------------------------------------------------------------------------------


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`; 1 for all if one of the files declares no noise, since it could be
    anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def row_hours(campaign: Campaign) -> tuple[Array, ...]:
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

    (g, 3) index of the load, SHAPE, SIGN, sorted; (g,) their first row, of all that count; and for
    each cycle (N,) the group of its rows that count.
    """
    names = [
        np.column_stack([np.full(np.count_nonzero(c.valid), k), c.shape[c.valid], c.sign[c.valid]])
        for c, k in zip(campaign.cycles, campaign.load_index, strict=True)
    ]
    whole, ends = np.concatenate(names), np.cumsum([len(name) for name in names])[:-1]
    span = int(whole[:, 1].max()) + 1
    # Shapes may be numbered at will; a code of load, SHAPE and SIGN has to fit into 64 bits.
    if span > 2**40:
        _, first, group = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    else:
        codes = 2 * (span * whole[:, 0] + whole[:, 1]) + (whole[:, 2] > 0)
        _, first, group = np.unique(codes, return_index=True, return_inverse=True)
    return whole[first], first, np.split(group.ravel(), ends)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of the (N,) rows, each with at most one row of a group; mostly one of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]


# -- what a block reads ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FileRows:
    """Rows of one file, at most one of each group, not yet read."""

    # Index of the cycle, and (m,) rows of its MEASUREMENTS
    file: int
    row: NDArray[np.int64]
    group: Selection  # (m,) their groups in ascending order; in a block, counted from its first
    hour: Array  # (m,) hours since the mean of all cycles
    sampled: NDArray[np.bool_]  # (m,) whether their deviations are kept
    # (m,) their labels, SHAPE times SIGN, if prints are taken of them; otherwise 0
    printed: NDArray[np.int64]
    weight: float  # of a row
    balanced: BalancedRows  # reads them

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
    """A block of groups, with the rows that are not left out."""

    # Which of the blocks, and which groups are in it, in the order in which they come
    index: int
    span: slice
    parts: tuple[FileRows, ...]  # rows of a file, at most one of each group
    heaviest: float  # largest weight of a row of the campaign

    @property
    def groups(self) -> int:
        """Number of groups."""
        return int(self.span.stop - self.span.start)

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


def file_rows(
    campaign: Campaign,
    reference: Array,
    groups: Sequence[NDArray[np.int64]],
    printed: NDArray[np.int64],
) -> list[FileRows]:
    """Return rows of each file, of each group at most one, in the order of the groups.

    ``reference`` is (n,) that of `common_reference` [m], ``groups`` of each cycle (N,) the group of
    each row that counts, ``printed`` (g,) labels if prints are taken of a group, otherwise 0.
    """
    found, a, weights = list[FileRows](), enabled_arms(campaign.layout), row_weights(campaign)
    # Deviations of 1000 rows are kept: they give a variance of three degrees to 3 %.
    stride = max(1, sum(map(len, groups)) // 1000)
    files = zip(campaign.cycles, groups, row_hours(campaign), weights, strict=True)
    for k, (cycle, group, hour, weight) in enumerate(files):
        balanced = balanced_rows(cycle, a, reference)
        balanced = replace(balanced, enabled=campaign.layout.enabled)  # one array for all files
        counting = np.flatnonzero(cycle.valid)
        for some in distinct(group):
            at, sampled = group[some], some % stride == 0
            found.append(
                FileRows(k, counting[some], at, hour[some], sampled, printed[at], weight, balanced)
            )
    return found


class GroupBlocks:
    """The blocks of groups of a campaign, each made when it is read: their rows take memory.

    ``spans`` are the groups of each block, as they come, ``left`` the blocks without some rows.
    """

    def __init__(self, layers: Sequence[FileRows], groups: int, n: int) -> None:
        """Cut so many groups into blocks, with the rows of n readings of each."""
        number = np.zeros(groups, dtype=np.int64)
        for layer in layers:
            number[layer.group] += 1
        most = int(np.clip(BLOCK_BYTES // (8 * n * number.max()), 1, ROWS_AT_ONCE))
        self.spans = [slice(at, min(at + most, groups)) for at in range(0, groups, most)]
        self.left = dict[int, GroupBlock]()
        self._layers, self._heaviest = layers, max(layer.weight for layer in layers)

    def __iter__(self) -> Iterator[GroupBlock]:
        return map(self.__getitem__, range(len(self.spans)))

    def __getitem__(self, index: int) -> GroupBlock:
        if index in self.left:
            return self.left[index]
        span = self.spans[index]
        parts = (layer.within(span) for layer in self._layers)
        here = tuple(part for part in parts if part is not None)
        return GroupBlock(index, span, here, self._heaviest)


# -- sums of a block ------------------------------------------------------------------------------


FileSums = dict[int, Array]
"""By file (2, n) sums over rows, weighted, of (c - c_mean) [N] and the same times c_mean; under -1,
the last, of all files and times the hour."""


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums over the rows of a block."""

    block: int  # which of the blocks
    # (groups, n) and (groups, 3) means over the rows of a group [N]
    mean: Array
    known: Array
    scatter: Array  # (n,) weighted sum of squared deviations from these [N^2]
    # (n,) largest distance of a row from the mean of the others of its group, divided by its noise
    # over that of a row of weight 1 [N]
    furthest: Array
    sample: Array  # (m, n) deviations of some rows from the others of their groups, at weight 1 [N]
    # Rows of which prints are taken: of some files the index, labels and (m, n) readings [N]
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
    by_file = {-1: np.zeros((2, n))}
    for part, force, _, _ in reversed(read):  # the last are in the cache still
        factor = block.distance_factor(part.weight)
        apart = force - mean[part.group]
        chosen = part.sampled & (block.number[part.group] > 1)
        sample.append(apart[chosen] * np.sqrt(factor[part.group][chosen])[:, None])
        of_file = by_file.setdefault(part.file, np.zeros((2, n)))
        ones = np.ones(len(apart))
        for k, values in enumerate((apart, apart * mean[part.group])):
            of_file[k] += part.weight * (ones @ values)
            by_file[-1][k] += part.weight * (part.hour @ values)  # both at once take longer
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
    block: GroupBlock, positions: Sequence[Array], zeros: Sequence[Array]
) -> tuple[int, Array]:
    """Read POSITION of a block; return its index, and (groups, n) mean displacements [m].

    Of each file POSITION, and (n,) readings from which its displacements count [m].
    """
    total = np.zeros((block.groups, len(zeros[0])))
    for part in block.parts:
        read = part.balanced.used(positions[part.file], part.where)
        total[part.group] += part.weight * (read - zeros[part.file])
    return block.index, total / block.weight[:, None]
