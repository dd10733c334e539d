"""Rows that do not belong: found against their repeats, then against the balance.

Against repeats: a row whose reading of one actuator lies far from the mean of the others of its
group. The worst row of each group goes first, the scatter is taken anew, until none is left; where
only two rows disagree neither can be trusted and both go.

Against the balance: shapes whose squared Mahalanobis distance r rho' S^-1 rho (three degrees of
freedom) is larger than chance allows, from a start on the three quarters of the shapes that fit
best, which outliers in a tenth of them cannot drag; the very first of them agree with their
opposites.

Both thresholds let a sound campaign lose a row once in a hundred campaigns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.displaced_rows import BalancedRows
from truenewton.estimation.moments import (
    Moments,
    campaign_moments,
    chosen_groups,
    groups_of,
    row_weights,
)
from truenewton.estimation.multiple_tests import FALSE_ALARM
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms

Fit = TypeVar("Fit")
MOST = 0.3  # of the rows; beyond this the campaign is refused
MEDIAN_ROWS = 200
QUARTILE = scipy.stats.norm.isf(0.25)  # median of |z|
MEDIAN_CHI2 = scipy.stats.chi2.median(3)
CORE = 0.75  # of the shapes that make the robust start
STRANGE = 10.0  # median deviations, 6.7 sigma: for a start only
MOST_PASSES = 20  # until the groups that belong are settled


def against_repeats(campaign: Campaign) -> tuple[Moments, Campaign, tuple[RejectedRow, ...]]:
    """Leave out rows that lie far from their repeats; return moments, campaign and those rows."""
    rejected: list[RejectedRow] = []
    while True:
        moments = campaign_moments(campaign)
        found = _worst_rows(campaign, moments) if moments.repeats >= 2 else []
        if not found:
            return moments, campaign, tuple(rejected)
        rejected += found
        campaign = without(campaign, found)
        del moments  # there is no room for two where the mirror is large


@dataclass(frozen=True, eq=False)
class _Part:
    """The rows that count of one cycle, beside the groups that they repeat.

    Attributes
    ----------
    place
        Of the cycle in the campaign.
    row, group
        (N,) row of MEASUREMENTS and group of each.
    weight
        Of a row.
    rows
        As they balance.
    """

    place: int
    row: NDArray[np.int64]
    group: NDArray[np.int64]
    weight: float
    rows: BalancedRows

    def deviations(self, moments: Moments, some: slice | NDArray[np.int64]) -> Array:
        """Return (m, n) deviations of some rows from the others of their groups, at weight 1 [N].

        The mean holds the row itself: seen from the others it lies further out, so that these have
        the variance of a reading of weight 1. 0 for a row without others.
        """
        group = self.group[some]
        alone, total = moments.rows[group] < 2, moments.weight[group]
        further = np.sqrt(total * self.weight / np.where(alone, np.inf, total - self.weight))
        apart = moments.mean[group]
        np.subtract(self.rows.at(some)[0], apart, out=apart)
        apart *= further[:, None]
        return apart


def _parts(campaign: Campaign, moments: Moments) -> Iterator[_Part]:
    """Walk through the cycles."""
    a, weights = enabled_arms(campaign.layout), row_weights(campaign)
    for k, (cycle, place) in enumerate(zip(campaign.cycles, campaign.load_index, strict=True)):
        row, group = np.flatnonzero(cycle.valid), groups_of(cycle, place, moments)
        yield _Part(k, row, group, weights[k], BalancedRows(cycle, a, moments.reference))


def _worst_rows(campaign: Campaign, moments: Moments) -> list[RejectedRow]:
    """Return the worst row of each group that has one too far out; both rows of a pair."""
    ids = campaign.layout.id[campaign.layout.enabled]
    noise, robust = np.sqrt(moments.scatter / moments.repeats), _robust(campaign, moments)
    # The median is less sure than the scatter: it counts where spikes have swollen that.
    noise = np.where(noise > 1.5 * robust, robust, noise)
    tests = moments.rows.sum() * len(ids)
    limit = scipy.stats.t.isf(FALSE_ALARM / 2 / tests, max(moments.repeats - 1, 1))
    if (moments.furthest <= limit * noise).all():
        return []
    noise = np.maximum(noise, 1e-12 * max(moments.mean.max(), -moments.mean.min()))  # of rounding
    worst: dict[int, RejectedRow] = {}
    pairs: list[RejectedRow] = []
    for part in _parts(campaign, moments):
        for some in part.rows.cycle.used_blocks():
            sigmas = part.deviations(moments, some)
            np.abs(sigmas, out=sigmas)
            sigmas /= noise
            for at in np.flatnonzero(sigmas.max(axis=1) > limit).tolist():
                row, i = some.start + at, int(sigmas[at].argmax())
                g, far = int(part.group[row]), float(sigmas[at, i])
                found = RejectedRow(part.place, int(part.row[row]), int(ids[i]), far, "repeats")
                if moments.rows[g] == 2:
                    pairs.append(found)
                elif g not in worst or worst[g].sigmas < far:
                    worst[g] = found
    return [*worst.values(), *pairs]


def _robust(campaign: Campaign, moments: Moments) -> Array:
    """Return (n,) noise of a reading that an actuator's spikes cannot swell: from the median.

    Of some 200 repeated rows, which tells it to 8 per cent.
    """
    by_row = np.concatenate(list(repeat_deviations(campaign, moments, MEDIAN_ROWS)))
    ordered = np.sort(np.abs(by_row).T)  # faster than np.median
    middle = slice((len(by_row) - 1) // 2, len(by_row) // 2 + 1)
    return np.asarray(ordered[:, middle].mean(axis=1) / QUARTILE)


def repeat_deviations(campaign: Campaign, moments: Moments, count: int) -> Iterator[Array]:
    """Yield (m, n) deviations of repeated rows of each cycle from their groups, at weight 1 [N].

    Of some ``count`` in all, which stand evenly among all repeated rows.
    """
    stride = max(1, moments.rows.sum() // count)
    for part in _parts(campaign, moments):
        yield part.deviations(moments, np.flatnonzero(moments.rows[part.group] > 1)[::stride])


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
    kept, distance, fit
        (g,) true for groups that belong; (g,) squared distances from the fit to those; that fit.

    Raises
    ------
    RankDeficient, NotConverged, TooManyOutliers
    """
    limit = scipy.stats.chi2.isf(FALSE_ALARM / len(moments.rows), 3)
    kept = np.ones(len(moments.rows), dtype=bool)
    try:
        found = fit(moments)
        distance = _scaled(distances(found), noise_known)
        if distance.max() <= limit:
            return kept, distance, found
        del found  # an estimate holds matrices of all unknowns; the next one needs their room
        core = alike_opposites(moments)
    except (RankDeficient, NotConverged):
        core = alike_opposites(moments)
        if core.all():
            raise
    for _ in range(5):
        distance = _scaled(distances(fit(chosen_groups(moments, core))), noise_known)
        core = distance <= np.quantile(distance, CORE)
    kept, passes = distance <= limit, 1
    while True:
        refuse_too_many(int(np.count_nonzero(~kept)), len(kept))
        found = fit(chosen_groups(moments, kept))
        distance = _scaled(distances(found), noise_known)
        if passes == MOST_PASSES or np.array_equal(distance <= limit, kept):
            return kept, distance, found
        kept, passes = distance <= limit, passes + 1
        del found


def alike_opposites(moments: Moments) -> NDArray[np.bool_]:
    """Tell which groups agree with their opposites, as those of most shapes do.

    A shape and its negative together leave the static forces, which are the same for all shapes of
    a load. No model enters, so a start from these groups is one that bad rows cannot drag.
    """
    labels, alike = moments.labels, np.ones(len(moments.labels), dtype=bool)
    first = np.flatnonzero((labels[1:, :2] == labels[:-1, :2]).all(axis=1))
    rounding = 1e-9 * max(moments.mean.max(), -moments.mean.min())
    for place in np.unique(labels[first, 0]):
        pair = first[labels[first, 0] == place]
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
    moments: Moments,
    lost: NDArray[np.bool_],
    distance: Array,
    actuator: NDArray[np.int64],
) -> list[RejectedRow]:
    """Return the rows of the groups that are lost, with the ID that stands out in each."""
    return [
        RejectedRow(
            part.place, int(part.row[at]), int(actuator[g]), float(np.sqrt(distance[g])), "balance"
        )
        for part in _parts(campaign, moments)
        for at in np.flatnonzero(lost[part.group])
        for g in [part.group[at]]
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
