"""Rows of a cycle as they balance, displacements and gradients put to use.

Displacements count from one reading of each sensor for all cycles of a campaign, the mean of its
cycles at rest: so alpha is that of the mean place of the glass, wherever a load holds it. But
somebody's electronics may set their zero anew with each file. Where a sensor's mean over a cycle
lies further from the common one than its shapes move it, rms, that is what happened: this sensor
counts from the mean of each cycle instead; and where most sensors do, all do.
"""

from __future__ import annotations

from collections.abc import Callable
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
    return _reference(displaced)


def displacements(
    campaign: Campaign,
) -> tuple[Callable[[NDArray[np.int64]], Array], ...] | None:
    """Return for each cycle what reads displacements of some rows that count, (m, n) [m].

    Whether gradients are declared or not; None where a cycle has no POSITION.
    """
    if any(cycle.position is None for cycle in campaign.cycles):
        return None
    reference = _reference(list(campaign.cycles))

    def reader(cycle: Cycle) -> Callable[[NDArray[np.int64]], Array]:
        zero = np.where(np.isnan(reference), cycle.rest_position, reference)
        return lambda rows: cycle.used(cycle.position, rows) - zero  # type: ignore[arg-type]

    return tuple(map(reader, campaign.cycles))


def _reference(displaced: list[Cycle]) -> Array:
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
        """Read some rows; return c (1 + COILGRAD z), (m, n), and A (BIASGRAD z), (m, 3)."""
        cycle = self.cycle
        position = None
        if cycle.position is not None and is_displaced(cycle):
            position = cycle.used(cycle.position, rows)
        return self.of(cycle.used(cycle.force, rows), position)

    def of(self, force: Array, position: Array | None) -> tuple[Array, Array | None]:
        """Return the same of (m, n) forces [N] and readings [m], None where they do not count."""
        if position is None:
            return force, None
        z = position - self.cycle_reference
        cycle = self.cycle
        coil, bias = cycle.coil_gradient or 0.0, cycle.bias_gradient or 0.0
        return force * (1.0 + coil * z), bias * z @ self.a.T

    @cached_property
    def cycle_reference(self) -> Array:
        """(n,) ``reference``, that of the cycle itself where it is NaN [m]."""
        anew = np.isnan(self.reference)
        if not anew.any():
            return self.reference
        return np.where(anew, self.cycle.rest_position, self.reference)
