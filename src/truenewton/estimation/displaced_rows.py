"""Rows of a cycle as they balance, in layers in which no shape stands twice.

Displacements count from one reading of each sensor for all cycles of a campaign, the mean of its
cycles at rest: so alpha is that of the mean place of the glass, wherever a load holds it. But
somebody's electronics may set their zero anew with each file. Where a sensor's mean over a cycle
lies further from the common one than its shapes move it, rms, that is what happened: this sensor
counts from the mean of each cycle instead; and where most sensors do, all do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
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
    whole = [cycle for cycle in displaced if cycle.knows_rest] or displaced
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
    """The valid rows of a cycle, what POSITION says of them taken into account.

    Attributes
    ----------
    cycle
        The cycle.
    a
        (3, n) arms of its enabled actuators.
    reference
        (n,) readings from which displacements count [m], of `common_reference`; NaN where they
        count from the mean of the cycle.
    """

    cycle: Cycle
    a: Array
    reference: Array

    def at(self, rows: slice | NDArray[np.int64]) -> tuple[Array, Array | None]:
        """Return c (1 + COILGRAD z), (m, n), and A (BIASGRAD z), (m, 3), of some rows."""
        cycle = self.cycle
        force = cycle.used(cycle.force, rows)
        if cycle.position is None or not is_displaced(cycle):
            return force, None
        z = cycle.used(cycle.position, rows) - self.cycle_reference
        coil, bias = cycle.coil_gradient or 0.0, cycle.bias_gradient or 0.0
        return force * (1.0 + coil * z), bias * z @ self.a.T

    @cached_property
    def cycle_reference(self) -> Array:
        """(n,) ``reference``, that of the cycle itself where it is NaN [m]."""
        anew = np.isnan(self.reference)
        if not anew.any():
            return self.reference
        return np.where(anew, self.cycle.rest_position, self.reference)


@dataclass(frozen=True, eq=False)
class DistinctRows:
    """Rows of a cycle in none of which a group stands twice, in the order of their groups."""

    rows: BalancedRows
    some: NDArray[np.int64]
    group: NDArray[np.int64]
    weight: float

    @cached_property
    def inorder(self) -> bool:
        """Whether the rows follow each other."""
        return bool((np.diff(self.some) == 1).all())

    def within(
        self, block: slice
    ) -> tuple[slice | NDArray[np.int64], Array, Array | None, float] | None:
        """Return where in a block of groups rows stand, and the rows; None where none does."""
        first, end = self.group.searchsorted((block.start, block.stop)).tolist()
        if first == end:
            return None
        whole = end - first == block.stop - block.start
        at = slice(None) if whole else self.group[first:end] - block.start
        some = self.some[first:end]
        force, balance = self.rows.at(slice(some[0], some[-1] + 1) if self.inorder else some)
        return at, force, balance, self.weight


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of rows in none of which a group stands twice; mostly one set of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
