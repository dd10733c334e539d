"""Rows of a cycle as they balance, with displacements and gradients, and blocks of groups of rows.

Displacements count from one reading of each sensor for all cycles of a campaign, the mean of its
cycles at rest: so alpha is that of the mean place of the glass, wherever a load holds it. But
somebody's electronics may set their zero anew with each file. Where a sensor's mean over a cycle
lies further from the common one than its shapes move it, rms, that is what happened: this sensor
counts from the mean of each cycle instead; and where most sensors do, all do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.files.stored_rows import Rows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


def common_reference(campaign: Campaign) -> Array:
    """Return (n,) the readings from which the displacements of a campaign count [m].

    NaN for a sensor whose zero was set anew, so that it counts from the mean of each cycle; all
    are NaN where no cycle has POSITION and a gradient.
    """
    displaced = [cycle for cycle in campaign.cycles if is_displaced(cycle)]
    if not displaced:
        return np.full(int(campaign.layout.enabled.sum()), np.nan)
    return _reference(displaced)


def rest_positions(campaign: Campaign) -> tuple[Array, ...] | None:
    """Return for each cycle (n,) readings from which its displacements count [m].

    Whether gradients are declared or not; None where a cycle has no POSITION.
    """
    if any(cycle.position is None for cycle in campaign.cycles):
        return None
    reference = _reference(list(campaign.cycles))
    if not np.isnan(reference).any():
        return (reference,) * len(campaign.cycles)
    return tuple(_from_own_mean(reference, cycle) for cycle in campaign.cycles)


def _reference(displaced: list[Cycle]) -> Array:
    whole = [cycle for cycle in displaced if cycle.has_opposites] or displaced
    reference = np.array([cycle.rest_position for cycle in whole])
    stroke = np.sqrt(np.mean([cycle.stroke**2 for cycle in whole], axis=0))
    common = reference[0] + (reference - reference[0]).mean(axis=0)  # equal ones to the last digit
    anew = (np.abs(reference - common) > stroke).any(axis=0)
    return np.where(anew | (anew.mean() > 0.5), np.nan, common)


def is_displaced(cycle: Cycle) -> bool:
    """Tell whether POSITION has a say in the balance of a cycle."""
    return cycle.position is not None and bool(cycle.coil_gradient or cycle.bias_gradient)


@dataclass(frozen=True, eq=False)
class BalancedRows:
    """The rows of a cycle, what POSITION says of them taken into account.

    Attributes
    ----------
    force, position
        (N, all) commanded forces [N] and readings [m], or where they stay in their file; None
        without POSITION.
    enabled
        (all,) which of the actuators take part, n of them.
    a
        (3, n) arms of these.
    zero
        (n,) readings from which displacements count [m].
    coil, bias
        COILGRAD [1/m] and BIASGRAD [N/m], 0 without.
    """

    force: Rows
    position: Rows | None
    enabled: NDArray[np.bool_]
    a: Array
    zero: Array
    coil: float
    bias: float

    @property
    def displaced(self) -> bool:
        """Whether POSITION has a say in the balance."""
        return self.position is not None and bool(self.coil or self.bias)

    def read(self, rows: slice | NDArray[np.int64]) -> tuple[Array, Array | None]:
        """Read (m, n) forces [N] of some rows and readings [m], None where they do not count."""
        position = None
        if self.position is not None and self.displaced:
            position = self.used(self.position, rows)
        return self.used(self.force, rows), position

    def of(self, force: Array, position: Array | None) -> tuple[Array, Array | None]:
        """Return (m, n) c (1 + COILGRAD z) [N] and (m, 3) A (BIASGRAD z) of what was read.

        The latter is None where readings do not count.
        """
        if position is None:
            return force, None
        z = position - self.zero
        return force * (1.0 + self.coil * z), self.bias * z @ self.a.T

    def displacement(self, rows: slice | NDArray[np.int64]) -> Array:
        """Read (m, n) displacements of some rows [m]."""
        if self.position is None:
            raise ValueError("there is no POSITION")
        return self.used(self.position, rows) - self.zero

    def used(self, values: Rows, rows: slice | NDArray[np.int64]) -> Array:
        """Return FORCE [N] or POSITION [m] of some rows, (m, n)."""
        chosen = values[rows]
        return chosen if self.enabled.all() else chosen[:, self.enabled]


def balanced_rows(cycle: Cycle, a: Array, reference: Array) -> BalancedRows:
    """Return the rows of a cycle as they balance.

    Parameters
    ----------
    cycle, a
        The cycle, and (3, n) arms of its enabled actuators.
    reference
        (n,) readings from which displacements count [m], of `common_reference`; NaN where they
        count from the mean of the cycle.
    """
    return BalancedRows(
        cycle.force,
        cycle.position,
        cycle.layout.enabled,
        a,
        _from_own_mean(reference, cycle) if is_displaced(cycle) else reference,
        cycle.coil_gradient or 0.0,
        cycle.bias_gradient or 0.0,
    )


def _from_own_mean(reference: Array, cycle: Cycle) -> Array:
    """Return (n,) a reference [m], that of the cycle itself where it is NaN."""
    anew = np.isnan(reference)
    return np.where(anew, cycle.rest_position, reference) if anew.any() else reference


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
        return self.only(~lost, at[~lost])

    def only(self, some: slice | NDArray[np.bool_], at: slice | NDArray[np.int64]) -> BlockRows:
        """Return some of the rows, which have (m,) groups ``at``."""
        return replace(
            self,
            row=self.row[some],
            at=at,
            hour=self.hour[some],
            sampled=self.sampled[some],
            printed=self.printed[some],
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
        at = slice(None) if whole else self.group[first:end] - block.start  # a slice: no copy
        return self.rows.only(slice(first, end), at)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of the (N,) rows in none of which a group stands twice; mostly one of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
