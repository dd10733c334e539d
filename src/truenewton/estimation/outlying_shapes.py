"""Shapes that do not balance with the rest, left out.

They are those whose squared Mahalanobis distance r rho' S^-1 rho (three degrees of freedom) is
larger than chance allows, from a start on the three quarters of the shapes that fit best, which
outliers in a tenth of them cannot drag; the very first of them agree with their opposites. A
sound campaign loses a shape once in four hundred.

They are accidents only if few go and the others balance without them. Where the rest does not, the
model falls short, and soft shapes, of small forces, would go for it (docs/effects.md): then only
those go that stand out of what the others are out of balance by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_isf, chi2_ppf, chi2_sf
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.findings.estimate import NoiseSource, RejectedRow
from truenewton.estimation.likelihood.minimum import Minimum
from truenewton.estimation.paper.equations import MEDIAN_CHI2
from truenewton.estimation.problem import Problem, roughly_scaled
from truenewton.estimation.readings.moments import Moments, chosen_groups
from truenewton.estimation.readings.repeats import row_groups
from truenewton.estimation.screening.noise import MIN_FIT_PROBABILITY
from truenewton.estimation.screening.screen import FAR_OUT_FACTOR, ScreenedCampaign, refuse_too_many
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign

CORE_FRACTION = 0.75  # of the shapes that make the robust start
START_DEVIATIONS = 10.0  # median deviations, 6.7 sigma: for a start only
MAX_OUTLYING_FRACTION = 0.12  # of the groups may be accidents


Fitted = tuple[Problem, Minimum]


def balancing_groups(problem: Problem, moments: Moments) -> tuple[NDArray[np.bool_], Array, Fitted]:
    """Fit the groups that balance with the rest.

    Returns
    -------
    belongs, distance, fitted
        (g,) true for groups that belong; (g,) squared distances of all from the fit to those; that
        fit, and the problem with a noise that was given its first size.

    Raises
    ------
    RankDeficient, NotConverged, TooManyOutliers
    """
    limit = float(chi2_isf(OF_EACH_KIND / len(moments.rows), 3))
    try:
        belongs, distance, fitted = _within(limit, problem, moments)
        if belongs.all() or _accidents(belongs, moments, fitted):
            return belongs, distance, fitted
    except (RankDeficient, NotConverged, TooManyOutliers):
        fitted, distance = _fitted(problem, moments, moments)
    usual = (np.quantile(distance, [0.5, 0.75]) / chi2_ppf([0.5, 0.75], 3)).max()
    try:
        return _within(FAR_OUT_FACTOR * max(float(usual), 1 / 3) * limit, problem, moments)
    except (RankDeficient, NotConverged, TooManyOutliers):
        fitted, distance = _fitted(problem, moments, moments)
        return np.ones(len(moments.rows), dtype=bool), distance, fitted


def _accidents(belongs: NDArray[np.bool_], moments: Moments, fitted: Fitted) -> bool:
    """Tell whether few groups do not belong, and the others balance without them.

    Where they do not, the model falls short, and what lies far is as good as the rest.
    """
    problem, minimum = fitted
    few = np.count_nonzero(~belongs) <= MAX_OUTLYING_FRACTION * len(belongs)
    if problem.noise.source == NoiseSource.MINIMUM:
        return bool(few)
    freedom = problem.degrees_of_freedom(chosen_groups(moments, belongs))
    return bool(few) and float(chi2_sf(minimum.chi2, max(freedom, 1))) > MIN_FIT_PROBABILITY


def _within(
    limit: float, problem: Problem, moments: Moments
) -> tuple[NDArray[np.bool_], Array, Fitted]:
    """Fit the groups whose squared distance from the fit is within a limit."""
    whole = 0.0  # alpha of all groups: should others make it negative, too few are left
    try:
        fitted, distance = _fitted(problem, moments, moments)
        whole = float(np.median(fitted[1].values[: problem.n]))
        if distance.max() <= limit:
            return np.ones(len(moments.rows), dtype=bool), distance, fitted
        del fitted  # an estimate holds matrices of all unknowns; the next one needs their room
        core = alike_opposites(moments)
    except (RankDeficient, NotConverged):
        core = alike_opposites(moments)
        if core.all():
            raise
    for _ in range(5):
        distance = _fitted(problem, chosen_groups(moments, core), moments)[1]
        core = distance <= np.quantile(distance, CORE_FRACTION)
    belongs, passes = distance <= limit, 1
    while True:
        refuse_too_many(int(np.count_nonzero(~belongs)), len(belongs))
        fitted, distance = _fitted(problem, chosen_groups(moments, belongs), moments)
        if np.median(fitted[1].values[: problem.n]) <= 0.0 < whole:
            raise NotConverged("too few shapes agree", remedy="look at `truenewton info`")
        if passes == 20 or np.array_equal(distance <= limit, belongs):
            return belongs, distance, fitted
        belongs, passes = distance <= limit, passes + 1
        del fitted


def _fitted(problem: Problem, groups: Moments, moments: Moments) -> tuple[Fitted, Array]:
    """Fit some groups; return also the squared distances of all.

    These are in units of their own spread, where noise or model fall short: the median of chi^2
    with three degrees of freedom is 2.37; a larger one is no outlier's doing.
    """
    scaled = roughly_scaled(problem, groups)
    minimum = scaled.fitted(groups)
    distance = scaled.distances(minimum.values, moments)
    spread = float(np.median(distance)) / MEDIAN_CHI2
    least = 1e-300 if problem.noise.source == NoiseSource.MINIMUM else 1.0
    return (scaled, minimum), distance / max(spread, least)


def alike_opposites(moments: Moments) -> NDArray[np.bool_]:
    """Tell which of the (g,) groups agree with their opposites, as those of most shapes do.

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
        strange = pair[furthest > START_DEVIATIONS]
        alike[strange] = alike[strange + 1] = False
    return alike


def balancing_moments(
    screened: ScreenedCampaign, belongs: NDArray[np.bool_], distance: Array, fitted: Fitted
) -> tuple[Moments, tuple[RejectedRow, ...]]:
    """Return the moments of the groups that belong, and the rows of the others.

    ``belongs`` (g,), ``distance`` (g,) and ``fitted`` are those of `balancing_groups`.

    Raises
    ------
    TooManyOutliers
        With the rows left out before, more than accidents take.
    """
    moments = screened.moments
    if belongs.all():
        return moments, ()
    problem, minimum = fitted
    actuator = problem.standing_out(minimum.values, moments)
    lost = rows_of(screened.sound, ~belongs, distance, actuator)
    before = len(screened.rejected)
    refuse_too_many(before + len(lost), before + int(moments.rows.sum()))
    return chosen_groups(moments, belongs), tuple(lost)


def rows_of(
    campaign: Campaign,
    lost: NDArray[np.bool_],
    distance: Array,
    actuator: NDArray[np.int64],
) -> list[RejectedRow]:
    """Return the rows of the (g,) groups that are lost, with the ID that stands out in each."""
    return [
        RejectedRow(k, int(row), int(actuator[g]), float(np.sqrt(distance[g])), "balance")
        for k, (cycle, group) in enumerate(
            zip(campaign.cycles, row_groups(campaign)[2], strict=True)
        )
        for row, g in zip(np.flatnonzero(cycle.valid), group, strict=True)
        if lost[g]
    ]
