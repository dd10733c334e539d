"""Shapes that do not balance with the rest, left out.

They are those whose squared Mahalanobis distance r rho' S^-1 rho (three degrees of freedom) is
larger than chance allows, from a start on the three quarters of the shapes that fit best, which
outliers in a tenth of them cannot drag; the very first of them agree with their opposites. The
threshold lets a sound campaign lose a shape once in a hundred campaigns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.moments import Moments, chosen_groups
from truenewton.estimation.multiple_tests import FALSE_ALARM
from truenewton.estimation.repeats import row_groups
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign

Fit = TypeVar("Fit")
MOST = 0.3  # of the rows; beyond this the campaign is refused
MEDIAN_CHI2 = scipy.stats.chi2.median(3)
CORE = 0.75  # of the shapes that make the robust start
STRANGE = 10.0  # median deviations, 6.7 sigma: for a start only
MOST_PASSES = 20  # until the groups that belong are settled


def without(campaign: Campaign, rows: list[RejectedRow]) -> Campaign:
    """Return the campaign with some rows marked as not valid.

    Raises
    ------
    TooManyOutliers
        A cycle would lose all its rows.
    """
    cycles = list(campaign.cycles)
    for k in {row.cycle for row in rows}:
        valid = cycles[k].valid.copy()
        valid[[row.row for row in rows if row.cycle == k]] = False
        if not valid.any():
            lost = int(cycles[k].valid.sum())
            raise _too_many(lost, lost, f" in {cycles[k]!r}")
        cycles[k] = replace(cycles[k], valid=valid)
    return Campaign(tuple(cycles))


def against_balance(
    moments: Moments,
    fit: Callable[[Moments], Fit],
    distances: Callable[[Fit], Array],
    *,
    noise_known: bool,
) -> tuple[NDArray[np.bool_], Array, Fit]:
    """Find the groups that balance with the rest.

    Parameters
    ----------
    moments
        All groups.
    fit
        Fits some of the groups.
    distances
        Returns the squared distances of all groups from a fit, (g,).
    noise_known
        Whether their size means something; if not, they are taken in terms of their median.

    Returns
    -------
    belongs, distance, fit
        (g,) true for groups that belong; (g,) squared distances from the fit to those; that fit.

    Raises
    ------
    RankDeficient, NotConverged, TooManyOutliers
    """
    limit = scipy.stats.chi2.isf(FALSE_ALARM / len(moments.rows), 3)
    belongs = np.ones(len(moments.rows), dtype=bool)
    try:
        fitted = fit(moments)
        distance = _scaled(distances(fitted), noise_known)
        if distance.max() <= limit:
            return belongs, distance, fitted
        del fitted  # an estimate holds matrices of all unknowns; the next one needs their room
        core = alike_opposites(moments)
    except (RankDeficient, NotConverged):
        core = alike_opposites(moments)
        if core.all():
            raise
    for _ in range(5):
        distance = _scaled(distances(fit(chosen_groups(moments, core))), noise_known)
        core = distance <= np.quantile(distance, CORE)
    belongs, passes = distance <= limit, 1
    while True:
        refuse_too_many(int(np.count_nonzero(~belongs)), len(belongs))
        fitted = fit(chosen_groups(moments, belongs))
        distance = _scaled(distances(fitted), noise_known)
        if passes == MOST_PASSES or np.array_equal(distance <= limit, belongs):
            return belongs, distance, fitted
        belongs, passes = distance <= limit, passes + 1
        del fitted


def alike_opposites(moments: Moments) -> NDArray[np.bool_]:
    """Tell which groups agree with their opposites, as those of most shapes do.

    A shape and its negative together leave the static forces, which are the same for all shapes of
    a load. No model enters, so a start from these groups is one that bad rows cannot drag.
    """
    labels, alike = moments.labels, np.ones(len(moments.labels), dtype=bool)
    first = np.flatnonzero((labels[1:, :2] == labels[:-1, :2]).all(axis=1))
    rounding = 1e-9 * max(moments.mean.max(), -moments.mean.min())
    for load_index in np.unique(labels[first, 0]):
        pair = first[labels[first, 0] == load_index]
        furthest = np.zeros(len(pair))
        for start in range(0, moments.mean.shape[1], ROWS_AT_ONCE):
            some = slice(start, start + ROWS_AT_ONCE)
            static = moments.mean[pair, some] + moments.mean[pair + 1, some]
            static -= np.median(static, axis=0)
            np.abs(static, out=static)
            typical = np.median(static, axis=0)
            static /= np.maximum(typical, rounding)
            np.maximum(furthest, static.max(axis=1), out=furthest)
        strange = pair[furthest > STRANGE]
        alike[strange] = alike[strange + 1] = False
    return alike


def _scaled(distance: Array, noise_known: bool) -> Array:
    """Return the distances in units of their own spread, where noise or model fall short.

    The median of chi^2 with three degrees of freedom is 2.37; a larger one is no outlier's doing.
    """
    spread = float(np.median(distance)) / MEDIAN_CHI2
    return distance / (max(1.0, spread) if noise_known else max(spread, 1e-300))


def rows_of(
    campaign: Campaign,
    lost: NDArray[np.bool_],
    distance: Array,
    actuator: NDArray[np.int64],
) -> list[RejectedRow]:
    """Return the rows of the groups that are lost, with the ID that stands out in each."""
    return [
        RejectedRow(k, int(row), int(actuator[g]), float(np.sqrt(distance[g])), "balance")
        for k, (cycle, group) in enumerate(
            zip(campaign.cycles, row_groups(campaign)[2], strict=True)
        )
        for row, g in zip(np.flatnonzero(cycle.valid), group, strict=True)
        if lost[g]
    ]


def refuse_too_many(rejected: int, rows: int) -> None:
    """Refuse a campaign that has lost more rows than can be explained by accidents."""
    if rejected > MOST * rows:
        raise _too_many(rejected, rows)


def _too_many(rejected: int, rows: int, where: str = "") -> TooManyOutliers:
    return TooManyOutliers(
        f"{rejected} of {rows} rows{where} do not fit their repeats or the balance",
        remedy="look at what happened during the run, or mark the bad rows as not VALID",
        got=rejected / rows,
        want=MOST,
    )
