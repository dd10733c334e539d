"""Rows of a cycle as they balance, and the groups of rows that repeat one shape.

Displacements count from one reading of each sensor for all cycles of a campaign: the mean of its
cycles at rest. So alpha is that of the mean position of the mirror under all loads. Electronics may
set their zero anew with each file. If the mean of a sensor over a cycle differs from the common one
by more than its rms displacement, this sensor counts from the mean of each cycle instead; if this
holds for most sensors, all of them do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.files.stored_rows import Rows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle

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
    return _reference(displaced)


def rest_positions(campaign: Campaign) -> tuple[Array, ...] | None:
    """Return for each cycle (n,) readings from which its displacements count [m].

    They do not depend on gradients; None if a cycle has no POSITION.
    """
    if any(cycle.position is None for cycle in campaign.cycles):
        return None
    reference = _reference(list(campaign.cycles))
    return tuple(_from_own_mean(reference, cycle) for cycle in campaign.cycles)


def _reference(displaced: list[Cycle]) -> Array:
    whole = [cycle for cycle in displaced if cycle.has_opposites] or displaced
    reference = np.array([cycle.rest_position for cycle in whole])
    stroke = np.sqrt(np.mean([cycle.stroke**2 for cycle in whole], axis=0))
    common = reference[0] + (reference - reference[0]).mean(axis=0)  # equal ones to the last digit
    anew = (np.abs(reference - common) > stroke).any(axis=0)
    return np.where(anew | (anew.mean() > 0.5), np.nan, common)


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
    """The rows of a cycle, corrected for POSITION.

    Attributes
    ----------
    force, position
        (N, all) commanded forces [N] and readings [m], in memory or in their file; position is None
        if it does not change the balance.
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

    def read(self, rows: Selection) -> tuple[Array, Array | None]:
        """Read (m, n) forces [N] and readings [m] of some rows."""
        position = None if self.position is None else self.used(self.position, rows)
        return self.used(self.force, rows), position

    def of(self, force: Array, position: Array | None) -> tuple[Array, Array | None]:
        """Return (m, n) c (1 + COILGRAD z) [N] and (m, 3) A (BIASGRAD z) of what was read.

        The latter is None without position.
        """
        if position is None:
            return force, None
        z = position - self.zero
        return force * (1.0 + self.coil * z), self.bias * z @ self.a.T

    def used(self, values: Rows, rows: Selection) -> Array:
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
        (n,) of `common_reference` [m].
    """
    displaced = is_displaced(cycle)
    return BalancedRows(
        cycle.force,
        cycle.position if displaced else None,
        cycle.layout.enabled,
        a,
        _from_own_mean(reference, cycle) if displaced else reference,
        cycle.coil_gradient or 0.0,
        cycle.bias_gradient or 0.0,
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
