"""The problem of a campaign: data, noise, unknowns and priors; and the shapes that do not balance.

A shape is left out if its squared Mahalanobis distance r rho' S^-1 rho (three degrees of freedom)
is larger than chance allows. The fit starts from the three quarters of the shapes that fit best, so
that outliers in a tenth of them have no influence; the first of them agree with their opposites. A
sound campaign loses a shape once in four hundred.

These shapes are accidents only if they are few and the others balance without them. Otherwise the
model is incomplete, and soft shapes, of small forces, would be left out for it (docs/effects.md):
then a shape is left out only if it exceeds the imbalance of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_isf, chi2_ppf, chi2_sf
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.findings.estimate import (
    NoiseSource,
    RejectedRow,
    WeightErrors,
    weight_errors,
)
from truenewton.estimation.likelihood import DataSet, Minimum, Prior, minimise, start_values
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.modes import likeliest, mode_data
from truenewton.estimation.paper.equations import (
    Unknowns,
    imbalance_covariance,
    squared_distances,
    standing_out,
)
from truenewton.estimation.readings.moments import Moments, Noise, chosen_groups
from truenewton.estimation.readings.rows import row_groups
from truenewton.estimation.screening.screen import FAR_OUT_FACTOR, ScreenedCampaign, refuse_too_many
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms, external_load


def load_data(
    campaign: Campaign, moments: Moments, variance: Array, errors: WeightErrors
) -> DataSet:
    """Return the shapes of all loads, whose readings have the (n,) variance [N^2], with weights."""
    return DataSet(moments.sums, variance, *_loads_of(campaign, len(variance), errors))


def _loads_of(campaign: Campaign, n: int, errors: WeightErrors) -> tuple[Array, Array]:
    """Return (L, 3) k by the weights, and its (L, 3, p) derivative by what is beside n alphas."""
    unknowns = Unknowns(n, len(campaign.loads), len(errors))
    nuisance = unknowns.external_load_derivative(tuple(errors.values()))
    return external_load(campaign.effective_weights, 0.0, 0.0, 0.0), nuisance


@dataclass(frozen=True, eq=False)
class Problem:
    """All that the likelihood needs besides the moments."""

    campaign: Campaign  # the campaign
    errors: WeightErrors  # errors of the weights; their sizes are the last of the unknowns
    noise: Noise  # of a reading
    prior: Prior  # of the errors of the weights, and of alpha as one population
    elastic: tuple[DataSet, ...] = ()  # shapes from a stiffness matrix
    # (3, n) difference of the arms from those of the layout; 0 unless positions were
    # corrected.
    moved: Array | float = 0.0
    disturbance: Array | float = 0.0  # (3, 3) of `DataSet`
    # (t, t) covariance of the unknowns from the effects that were taken out of the data, or that
    # only the errors contain; every fit has it.
    by_effects: Array | float = 0.0

    @cached_property
    def dependent(self) -> bool:
        """Whether the readings of a row are correlated, as far as the balance shows."""
        return bool(np.isfinite(self.noise.share_freedom))

    @cached_property
    def a(self) -> Array:
        """(3, n) arms of the enabled actuators."""
        return np.asarray(enabled_arms(self.campaign.layout) + self.moved)

    @cached_property
    def n(self) -> int:
        """Number of enabled actuators."""
        return int(self.a.shape[1])

    @cached_property
    def unknowns(self) -> Unknowns:
        """The order of the unknowns, including errors of the weights."""
        return Unknowns(self.n, len(self.campaign.loads), len(self.errors))

    @cached_property
    def _loads(self) -> tuple[Array, Array]:
        return _loads_of(self.campaign, self.n, self.errors)

    def degrees_of_freedom(self, moments: Moments) -> int:
        """Return equations less unknowns; errors of the weights are measured, so neither."""
        shapes = moments.sums.shapes + sum(part.sums.shapes for part in self.elastic)
        return 3 * shapes - self.unknowns.count

    def data(self, moments: Moments) -> list[DataSet]:
        """Return the shapes of each load, with its weight and unknowns, and the elastic ones."""
        of_loads = DataSet(
            moments.sums,
            self.noise.in_balance,
            *self._loads,
            excess=1.0 / self.noise.share,
            disturbance=self.disturbance,
        )
        return [of_loads, *self.elastic]

    def fitted(self, moments: Moments, start: Array | None = None) -> Minimum:
        """Return the likeliest values, from a (u,) start if there is a better one than usual."""
        data = self.data(moments)
        begin = start_values(self.a, data, self.prior) if start is None else start
        minimum = minimise(self.a, data, self.prior, begin)
        covariance = minimum.reading_covariance + self.by_effects
        return replace(minimum, reading_covariance=covariance)

    def with_error(self, minimum: Minimum, moves: Array, covariance: Array) -> Fitted:
        """Return problem and fit with B' C B, (k, k) C and (k, free) B, in their covariance."""
        t = min(len(minimum.reading_covariance), moves.shape[1])
        added = np.zeros_like(minimum.reading_covariance)
        added[:t, :t] = moves[:, :t].T @ covariance @ moves[:, :t]
        fitted = replace(minimum, reading_covariance=minimum.reading_covariance + added)
        return replace(self, by_effects=self.by_effects + added), fitted

    def imbalance(self, values: Array, moments: Moments) -> tuple[Array, Array]:
        """Return (g, 3) rho of the groups, and S."""
        scaled_arms = self.a * values[: self.n]
        known, nuisance = self._loads
        k = known + nuisance @ values[self.n :]
        rho = (scaled_arms @ moments.mean.T).T + moments.known + k[moments.labels[:, 0]]
        return rho, imbalance_covariance(scaled_arms, self.noise.in_balance) + self.disturbance

    def distances(self, values: Array, moments: Moments) -> Array:
        """Return (g,) squared Mahalanobis distances of the groups."""
        rho, s = self.imbalance(values, moments)
        return squared_distances(rho, moments.weight, s)


def problem_of(campaign: Campaign, noise: Noise, errors: WeightErrors | None = None) -> Problem:
    """Return the problem of a campaign; by default its weights have their declared errors."""
    errors = weight_errors(campaign) if errors is None else errors
    n = int(campaign.layout.enabled.sum())
    unknowns = Unknowns(n, len(campaign.loads), len(errors))
    elastic: tuple[DataSet, ...] = ()
    if campaign.stiffness is not None:
        facts = MatrixFacts.of(campaign.stiffness)
        modes = facts.elastic_modes.forces.T
        data = mode_data(modes, likeliest(modes, facts.arms).variance)
        elastic = (replace(data, nuisance=np.zeros((1, 3, unknowns.total - n))),)
    mean, nothing = np.zeros(unknowns.total), np.zeros((0, 0))
    prior = Prior(mean, nothing, len(errors), held=len(campaign.loads) < 3)
    return Problem(campaign, errors, noise, prior, elastic)


def roughly_scaled(problem: Problem, moments: Moments) -> Problem:
    """Give an unknown noise a first size, from the imbalance that least squares leave."""
    if problem.noise.source != NoiseSource.MINIMUM:
        return problem
    start = start_values(problem.a, problem.data(moments), problem.prior)
    # From the median, and rather too small: bad rows shall not swell it, lest D outgrow M.
    distance = problem.distances(start, moments)[moments.rows > 0]
    size = 0.25 * float(np.median(distance)) / chi2_ppf(0.5, 3)
    variance = problem.noise.variance * max(size, 1.0)
    return replace(problem, noise=replace(problem.noise, variance=variance))


def with_share_in_balance(problem: Problem, screened: ScreenedCampaign, alpha: Array) -> Problem:
    """Return the problem with the share of the repeats' scatter that reaches the balance.

    It is estimated from the imbalance of deviations from the mean, A diag(alpha) (c - c_mean), of
    some repeated rows, and differs from 1 only by more than four standard errors. If it exceeds 1,
    something pushes many actuators at once, mostly in one direction: then this is a disturbance of
    the balance, direction by direction.
    """
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    scaled_arms, moments = problem.a * alpha, screened.moments
    rho = screened.samples @ scaled_arms.T
    s = imbalance_covariance(scaled_arms, problem.noise.seen)
    share = float(squared_distances(rho, np.ones(len(rho)), s).mean() / 3)
    share = max(share, problem.noise.least / problem.noise.seen.mean())
    repeats = moments.rows[moments.rows > 1]
    freedom = 3 * len(rho) * float(1.0 - repeats.size / repeats.sum())  # their means are theirs
    if abs(share - 1.0) < 4 * np.sqrt(2 / freedom):
        return problem
    if share > 1.0:
        size, directions = scipy.linalg.eigh(rho.T @ rho / len(rho), s)
        pushed = (s @ directions) * np.sqrt(np.maximum(size - 1.0, 0.0))
        noise = replace(problem.noise, share_freedom=freedom)
        return replace(problem, disturbance=pushed @ pushed.T, noise=noise)
    return replace(problem, noise=replace(problem.noise, share=share, share_freedom=freedom))


def with_noise_from_minimum(
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    freedom: Callable[[Problem, Moments, Minimum], float] = (
        lambda problem, moments, _: problem.degrees_of_freedom(moments)
    ),
) -> tuple[Problem, Minimum]:
    """Give an unknown noise its size from the minimum, and with it D.

    ``freedom`` gives the degrees of freedom of a minimum; by default those of the problem.
    """
    for _ in range(20):
        if problem.noise.source != NoiseSource.MINIMUM:
            break
        size = minimum.chi2 / max(freedom(problem, moments, minimum), 1.0)
        variance = np.maximum(problem.noise.variance * size, problem.noise.least)
        if np.allclose(variance, problem.noise.variance, rtol=1e-6, atol=0.0):
            break
        problem = replace(problem, noise=replace(problem.noise, variance=variance))
        minimum = problem.fitted(moments, minimum.values)
    return problem, minimum


MAX_OUTLYING_FRACTION = 0.12  # of the groups may be accidents


Fitted = tuple[Problem, Minimum]


def largest_distance(moments: Moments) -> float:
    """Return the squared distance that a group exceeds once in 400 sound campaigns."""
    return float(chi2_isf(OF_EACH_KIND / len(moments.rows), 3))


def balancing_groups(problem: Problem, moments: Moments) -> tuple[NDArray[np.bool_], Array, Fitted]:
    """Fit the groups that balance with the rest.

    Return (g,) which groups belong, (g,) squared distances of all from the fit to those, and that
    fit, with the problem in which an unknown noise has its first size. Raises RankDeficient,
    NotConverged or TooManyOutliers.
    """
    limit = largest_distance(moments)
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
    """Return whether few groups do not belong, and the others balance without them."""
    problem, minimum = fitted
    few = np.count_nonzero(~belongs) <= MAX_OUTLYING_FRACTION * len(belongs)
    if problem.noise.source == NoiseSource.MINIMUM:
        return bool(few)
    freedom = problem.degrees_of_freedom(chosen_groups(moments, belongs))
    return bool(few) and float(chi2_sf(minimum.chi2, max(freedom, 1))) > LIMITS.fit_probability


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
        core = distance <= np.quantile(distance, 0.75)
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

    These are relative to their own spread if noise or model are incomplete: the median of chi^2
    with three degrees of freedom is 2.37, and outliers do not make it larger.
    """
    scaled = roughly_scaled(problem, groups)
    minimum = scaled.fitted(groups)
    distance = scaled.distances(minimum.values, moments)
    spread = float(np.median(distance)) / chi2_ppf(0.5, 3)
    least = 1e-300 if problem.noise.source == NoiseSource.MINIMUM else 1.0
    return (scaled, minimum), distance / max(spread, least)


def alike_opposites(moments: Moments) -> NDArray[np.bool_]:
    """Return which of the (g,) groups agree with their opposites, as most do.

    The sum of a shape and its negative contains only the static forces, which are the same for all
    shapes of a load. This needs no model, so bad rows have no influence on a start from these
    groups.
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
        strange = pair[furthest > 10.0]  # median deviations, 6.7 sigma: for a start only
        alike[strange] = alike[strange + 1] = False
    return alike


def balancing_moments(
    screened: ScreenedCampaign, belongs: NDArray[np.bool_], distance: Array, fitted: Fitted
) -> tuple[Moments, tuple[RejectedRow, ...]]:
    """Return the moments of the groups that belong, and the rows of the others.

    ``belongs`` (g,), ``distance`` (g,) and ``fitted`` are those of `balancing_groups`. Raises
    TooManyOutliers if more rows are left out than accidents explain.
    """
    moments = screened.moments
    if belongs.all():
        return moments, ()
    problem, minimum = fitted
    rho, s = problem.imbalance(minimum.values, moments)
    worst = standing_out(rho, problem.a * minimum.values[: problem.n], s)
    actuator = screened.campaign.layout.id[screened.campaign.layout.enabled][worst]
    groups = zip(screened.sound.cycles, row_groups(screened.sound)[1], strict=True)
    lost = tuple(
        RejectedRow(k, int(row), int(actuator[g]), float(np.sqrt(distance[g])), "balance")
        for k, (cycle, group) in enumerate(groups)
        for row, g in zip(np.flatnonzero(cycle.valid), group, strict=True)
        if not belongs[g]
    )
    before = len(screened.rejected)
    refuse_too_many(before + len(lost), before + int(moments.rows.sum()))
    return chosen_groups(moments, belongs), lost
