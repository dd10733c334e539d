"""Maximum likelihood on a campaign, and the patterns of alpha that noise decides.

If noise alone makes as much imbalance as a pattern of alpha would, the data do not determine that
pattern (docs/likelihood.md). It is held at zero, so that alpha is uniform along it, with the rms
variation of alpha over the mirror as its rms error.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

from truenewton.arrays import Array
from truenewton.chance import chi2_ppf, normal_isf
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.checks import (
    campaign_warnings,
    check_inputs,
    refusal_naming,
    strange_alphas,
    unlike_declared,
)
from truenewton.estimation.effects.catalogue import CATALOGUE
from truenewton.estimation.effects.correction import (
    unseen_errors,
    with_magnets_unsure,
    with_positions_unsure,
)
from truenewton.estimation.effects.examination import (
    ExaminedFit,
    chi2_probability,
    examined,
    misfit_findings,
    warmer_loads,
)
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import (
    Diagnosis,
    Estimate,
    Goodness,
    NoiseSource,
    RejectedRow,
    Scale,
    UnseenError,
    errors_between_loads,
    scale_errors,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import (
    Minimum,
    Prior,
    chi2_at,
    gram_of_e,
    likeliest_spread,
    smooth_patterns,
    with_population,
)
from truenewton.estimation.paper.identifiability import (
    balance_patterns,
    centred_means,
    describe_pattern,
    diagnose,
    leverage,
    refuse,
    similar_loads,
    structural_faults,
    unseen_load,
)
from truenewton.estimation.problem import (
    Fitted,
    Problem,
    balancing_groups,
    balancing_moments,
    largest_distance,
    load_data,
    problem_of,
    with_noise_from_minimum,
    with_share_in_balance,
)
from truenewton.estimation.readings.moments import Moments, structure_of
from truenewton.estimation.readings.rows import WEIGHED_NOISE
from truenewton.estimation.screening.screen import (
    LONG_TAIL_RATIO,
    ScreenedCampaign,
    refuse_too_many,
)
from truenewton.linalg import largest_eigenvalue, mirrored, smallest_eigenvalue
from truenewton.records.campaign import Campaign
from truenewton.rounding import percent
from truenewton.statics.arms import arms_in_units_of_rms, enabled_arms

HELD_INFORMATION = 1e10  # on a pattern held at zero: 1e-5 until its error is added


def undetermined_patterns(problem: Problem, moments: Moments, count: int) -> Array:
    """Return (n, count) orthonormal patterns of alpha of mean 0 that the data determine least.

    One pattern more than ``count`` cannot be distinguished from alpha; those of their span without
    a mean leave alpha most uniform.
    """
    centred = centred_means(moments)
    _, patterns = balance_patterns(centred, problem.a, problem.noise.variance, count + 1)
    without_mean = scipy.linalg.null_space(patterns.mean(axis=0, keepdims=True))
    return np.asarray(np.linalg.qr(patterns @ without_mean)[0])


def with_patterns_held(problem: Problem, patterns: Array) -> Problem:
    """Return the problem with (n, k) orthonormal patterns of alpha held at zero."""
    return replace(problem, prior=problem.prior.with_more(HELD_INFORMATION * patterns @ patterns.T))


def with_undetermined_patterns(minimum: Minimum, patterns: Array) -> Minimum:
    """Return the minimum with the error of (n, k) patterns held at zero in its covariance."""
    n, t = len(patterns), len(minimum.reading_covariance)
    pulled = np.zeros((t, patterns.shape[1]))
    pulled[:n] = HELD_INFORMATION * patterns
    spread = float(minimum.values[:n].std())
    answer = scipy.linalg.solve(minimum.information[:t, :t], pulled, assume_a="pos")
    answer *= spread * np.sqrt(n)  # of length 1: RMS over actuators 1 / root n
    return replace(minimum, reading_covariance=minimum.reading_covariance + answer @ answer.T)


def tolerable(judged: Diagnosis, n: int) -> bool:
    """Return whether alpha is useful though some patterns are undetermined.

    Not if the shapes would be too few without noise, nor if it is a tenth of the patterns.
    """
    return 3 * judged.span >= n - 1 and 10 * judged.undetermined <= n


def fit_campaign(screened: ScreenedCampaign, population: bool = False) -> Estimate:
    """Return the likeliest alpha of a screened campaign, without outliers; no row is read.

    With ``population`` alpha is a sample of one normal population, whose spread is estimated.
    If the noise is declared, and everything fits with another, it is that one.
    Raises RankDeficient, TooManyOutliers or NotConverged.
    """
    other = with_noise_of_shapes(screened)
    if other is not None:
        try:
            estimate = _fit_campaign(other, population)
        except (RankDeficient, TooManyOutliers, NotConverged):
            return _fit_campaign(screened, population)
        goodness = estimate.goodness
        chance = min(goodness.probability, 1.0 - goodness.probability) if goodness else 0.0
        if chance > LIMITS.fit_probability and not estimate.effects:
            ratio = float(np.sqrt(np.mean(other.noise.variance / screened.noise.variance)))
            return estimate.with_warnings(unlike_declared(1e3 * estimate.noise, ratio))
    return _fit_campaign(screened, population)


def with_noise_of_shapes(screened: ScreenedCampaign) -> ScreenedCampaign | None:
    """Return a campaign without repeats with the noise by which shapes repeat over loads and signs.

    None if that agrees with FORCERR, repeats show the noise, or a few readings have most of it.
    """
    structure, noise = screened.structure, screened.noise
    if noise.source != NoiseSource.DECLARED or structure is None:
        return None
    if LIMITS.fit_probability < structure.probability < 1.0 - LIMITS.fit_probability:
        return None
    moments = replace(screened.moments, pooled=True)
    left = moments.mean - moments.pooling.groups(moments.pooling.rows(moments.mean))
    square = left**2 * moments.weight[:, None] / noise.variance
    if np.mean(square) > LONG_TAIL_RATIO**2 * np.median(square) / chi2_ppf(0.5, 1):
        return None
    noise = replace(noise, variance=np.maximum(structure.reduced * noise.variance, noise.least))
    structure = structure_of(moments, noise, screened.samples)
    return replace(screened, noise=noise, moments=moments, structure=structure)


def _fit_campaign(screened: ScreenedCampaign, population: bool) -> Estimate:
    """Return the likeliest alpha with the noise of a reading as it is."""
    sound, moments = screened.sound, screened.moments
    refuse(structural_faults(sound, moments))
    with refusal_naming(lambda: screened.suspects):
        rows = len(screened.rejected) + int(moments.rows.sum())
        refuse_too_many(len(screened.rejected), rows)
        force = moments.sums.force.sum(axis=1) / moments.sums.weight
        errors = {**weight_errors(sound), **errors_between_loads(sound, force)}
        free = problem_of(screened.campaign, screened.noise, errors)
        suspects = check_inputs(screened, free)
    with refusal_naming(lambda: suspects.where_nothing_balances(free, moments).named):
        belongs, distance, (problem, minimum), patterns = _fitted(free, sound, moments)
        free = with_share_in_balance(free, screened, minimum.values[: free.n])
        if free.dependent:
            belongs, distance, (problem, minimum), patterns = _fitted(free, sound, moments)
    balances = (
        bool(belongs.all())
        and problem.noise.source != NoiseSource.MINIMUM
        and ExaminedFit(problem, moments, minimum).probability > LIMITS.fit_probability
    )
    if not balances:
        suspects = suspects.where_nothing_balances(free, moments)
    wrong = not (balances or suspects.actuators) and bool(suspects.columns)
    with refusal_naming(lambda: suspects.named):
        left, lost = None, tuple[RejectedRow, ...]()
        if not (belongs.all() or patterns.size or wrong):
            left = _examined_whole(problem, minimum, screened)
        if left is None:
            moments, lost = balancing_moments(screened, belongs, distance, (problem, minimum))
            problem, minimum = with_noise_from_minimum(problem, moments, minimum)
            left = ExaminedFit(problem, moments, minimum)
            if not (patterns.size or wrong):
                left = examined(left, screened.structure, screened.samples)
        left, unseen = _with_all_errors(left, patterns, columns_are_wrong=wrong)
        method, doubts = "ml", misfit_findings(left)
        if population:
            left, method = _of_population(left, free.prior)
        else:
            doubts = chain(doubts, _no_better_than_uniform(left, free.prior))
        rejected, fitted = (*screened.rejected, *lost), (left.problem, left.moments, left.minimum)
        estimate = estimate_of(method, *fitted, rejected, patterns.shape[1], left.freedom)
        if estimate.diagnosis.undetermined:
            diagnosis = diagnose(sound, moments)
            if 3 * diagnosis.span < problem.n - 1:  # not even without noise
                refuse(diagnosis.faults)
    error = np.sqrt(np.diag(left.minimum.reading_covariance)[: problem.n])
    alpha = left.minimum.values[: problem.n]
    strange = () if suspects.columns else strange_alphas(screened.campaign, alpha, error)
    found = (_as_known(effect, left) for effect in left.effects)
    effects = (*suspects.named, *strange, *screened.frozen, *found)
    effects += tuple(warmer_loads(sound, estimate.scale_errors))
    return replace(estimate.with_warnings(doubts), effects=effects, unseen=unseen)


def _examined_whole(
    problem: Problem, minimum: Minimum, screened: ScreenedCampaign
) -> ExaminedFit | None:
    """Return the fit to all groups if only effects that were corrected unbalanced some; else None.

    Coils and magnets whose force depends on the gap, for example, unbalance the largest motions.
    """
    moments = screened.moments
    try:
        minimum = problem.fitted(moments, minimum.values)
    except (NotConverged, RankDeficient):
        return None
    plain = ExaminedFit(problem, moments, minimum)
    left = examined(plain, screened.structure, screened.samples)
    corrected = [effect.corrected for effect in left.effects]
    if not (corrected and all(corrected) and left.fits):
        return None
    distance = left.problem.distances(left.minimum.values, left.moments)
    return left if distance.max() <= largest_distance(moments) else None


def _with_all_errors(
    left: ExaminedFit, patterns: Array, *, columns_are_wrong: bool
) -> tuple[ExaminedFit, tuple[UnseenError, ...]]:
    """Return the fit with what else makes alpha unsure, and the undetectable errors."""
    if patterns.size:
        held = replace(left, minimum=with_undetermined_patterns(left.minimum, patterns))
        return held if held.fits else _inflated(held, held.excess), ()
    if columns_are_wrong:
        return _inflated(left, left.excess), ()
    unseen = unseen_errors(left.rows)
    for with_more in (with_magnets_unsure, with_positions_unsure):
        problem, minimum = with_more(left.rows, left.effects)
        left = replace(left, problem=problem, minimum=minimum)
    return left if left.fits or left.explained else _inflated(left, left.excess), unseen


def _as_known(effect: Finding, left: ExaminedFit) -> Finding:
    """Return an effect of the catalogue as unknown if the data do not fit with it, either.

    It is the likeliest of those that are tested, but the cause is probably another.
    """
    if effect.code == Code.UNKNOWN_FORCE:
        return replace(effect, remedy="")  # that of the catalogue
    tested = effect.code in {each.code for each in CATALOGUE}
    if effect.corrected or left.explained or not tested:
        return effect
    where = "" if effect.actuators else effect.where  # of a file or load
    if left.fits:
        where = "shapes balance, but do not repeat over loads and signs"
    unknown = replace(effect, code=Code.UNKNOWN_EFFECT, detail=effect.name, remedy="")
    return replace(unknown, where=where, actuators=())


def _inflated(left: ExaminedFit, excess: float) -> ExaminedFit:
    """Return a fit with errors inflated by the excess of the imbalance over its noise."""
    covariance = excess * left.minimum.reading_covariance
    return replace(left, minimum=replace(left.minimum, reading_covariance=covariance))


def _of_population(left: ExaminedFit, prior: Prior) -> tuple[ExaminedFit, str]:
    """Return the fit with alpha a sample of one population, and the name of that method."""
    n, problem, minimum = left.problem.n, left.problem, left.minimum
    alpha, smooth = minimum.values[:n], smooth_patterns(problem.a)
    spread = likeliest_spread(smooth, alpha, minimum.reading_covariance[:n, :n])
    for _ in range(3):  # until the pull of the population, linear in each, has settled
        problem = replace(problem, prior=with_population(prior, smooth, alpha, spread))
        minimum = problem.fitted(left.moments, minimum.values)
        alpha = minimum.values[:n]
        if np.median(alpha) <= 0.0:
            fault = "alpha as a sample of one population is not positive"
            raise NotConverged(fault, remedy="repeat more often, use larger forces, or add shapes")
    fitted = replace(left, problem=problem, minimum=minimum)
    method = f"ml, population {spread:.2g}"
    return fitted if left.fits or left.explained else _inflated(fitted, left.excess), method


def _no_better_than_uniform(left: ExaminedFit, prior: Prior) -> Iterator[Finding]:
    """Yield that relative alpha is known no better than if it were the same for all actuators.

    That is so if at least half of the variance of alpha over the actuators is error. Medians, so
    that a few actuators do not decide; errors that grew with a misfit have another cause.
    """
    alpha = left.minimum.values[: left.problem.n]
    typical = float(np.median(alpha))
    if not (left.fits or left.explained) or typical <= 0.0:
        return
    spread = float(np.median(np.abs(alpha - typical)) / normal_isf(0.25)) / typical
    error = _relative_error(left)
    if error**2 <= LIMITS.error_share * spread**2:
        return
    instead = ""
    with suppress(RankDeficient, NotConverged):
        pulled = _relative_error(_of_population(left, prior)[0])
        if pulled < error:
            instead = f"if you use --population, the typical error is {percent(pulled)}. "
    yield Finding.of(Code.WORSE_THAN_UNIFORM, error=error, spread=spread, instead=instead)


def _relative_error(left: ExaminedFit) -> float:
    """Return the median over actuators of the relative error of alpha, without the common scale.

    The scale is that of a mean by inverse variance, as alpha of a dead actuator is not known.
    """
    n = left.problem.n
    covariance, alpha = left.minimum.reading_covariance[:n, :n], left.minimum.values[:n]
    weight = 1.0 / np.diag(covariance)
    weight /= weight.sum()
    with_mean = covariance @ weight
    variance = np.diag(covariance) - 2.0 * with_mean + weight @ with_mean
    return float(np.sqrt(np.median(variance)) / abs(float(np.median(alpha))))


def _fitted(
    problem: Problem, campaign: Campaign, moments: Moments
) -> tuple[NDArray[np.bool_], Array, Fitted, Array]:
    """Fit the groups that belong; return these, distances, the fit, and the patterns held.

    None is held unless the data contain only noise along some.
    """
    nothing = np.empty((problem.n, 0))
    try:
        return *balancing_groups(problem, moments), nothing
    except (RankDeficient, NotConverged, TooManyOutliers):
        diagnosis = diagnose(campaign, moments)  # states better what is missing
        if not diagnosis.undetermined or not tolerable(diagnosis, problem.n):
            alike = similar_loads(campaign.effective_weights)
            unseen = unseen_load(problem.a[0], campaign.effective_weights, moments)
            refuse((unseen, *diagnosis.faults, alike))
            raise
    for count in range(diagnosis.undetermined, 2 * diagnosis.undetermined + 2):
        patterns = undetermined_patterns(problem, moments, count)
        try:
            return *balancing_groups(with_patterns_held(problem, patterns), moments), patterns
        except (RankDeficient, NotConverged):
            continue
    first = diagnosis.faults[0]
    raise RankDeficient(first.fault, remedy=first.remedy)


def estimate_of(
    method: str,
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    rejected: tuple[RejectedRow, ...],
    held: int,
    freedom: float | None = None,
) -> Estimate:
    """Return a minimum as an estimate; by default with the degrees of freedom of the problem."""
    campaign, n, unknowns = problem.campaign, problem.n, problem.unknowns
    freedom = problem.degrees_of_freedom(moments) if freedom is None else freedom
    probability = declared = float("nan")
    if problem.noise.source != NoiseSource.MINIMUM and freedom > 0:
        probability = chi2_probability(minimum.chi2, freedom, problem.noise)
    if all(c.force_error for c in campaign.cycles):
        same = np.full(n, WEIGHED_NOISE**2)
        at_declared = load_data(campaign, moments, same, problem.errors)
        declared = chi2_at(problem.a, [at_declared], minimum.values)
    diagnosis = _diagnosis(problem, moments, minimum, held)
    e_condition = condition(campaign, moments, minimum.reading_covariance)  # while there is room
    return Estimate(
        method=method,
        scale=Scale.WEIGHTS,
        values=minimum.values[: unknowns.count],
        reading_covariance=minimum.reading_covariance,
        systematic_covariance=minimum.changes @ minimum.changes.T,
        noise=float(np.sqrt(problem.noise.variance.mean() * moments.typical_variance)),
        condition=e_condition,
        rank=unknowns.count - diagnosis.undetermined,
        diagnosis=diagnosis,
        goodness=Goodness(minimum.chi2, round(freedom), problem.noise.source, probability),
        chi2=declared,
        scale_errors=scale_errors(
            minimum.values[:n],
            minimum.reading_covariance[:n, :n],
            minimum.changes[:n].T,
            problem.errors,
        ),
        rejected_rows=rejected,
    )


def _diagnosis(problem: Problem, moments: Moments, minimum: Minimum, held: int) -> Diagnosis:
    """Count patterns within the noise, including those ``held``, and name what is weak."""
    n, layout = problem.n, problem.campaign.layout
    covariance = minimum.reading_covariance[:n, :n]
    free = held + patterns_near_noise(minimum, moments.sums.shapes)
    value, vector = largest_eigenvalue(covariance)
    weakest = describe_pattern(vector, layout)
    warnings = []
    if free:
        warnings.append(Finding.of(Code.WEAK_PATTERNS, count=free, weakest=weakest))
    if held:
        error = float(np.sqrt(value / n))
        warnings.append(Finding.of(Code.CONSTRAINED_PATTERNS, count=held, error=error))
    warnings += campaign_warnings(problem, moments, minimum)
    return Diagnosis(
        undetermined=free,
        warnings=tuple(warnings),
        weakest=weakest,
        weakest_share=value / float(np.trace(covariance)),
        leverage=tuple(leverage(problem.a * minimum.values[:n], problem.noise.variance).tolist()),
    )


def patterns_near_noise(minimum: Minimum, shapes: int) -> int:
    """Count the patterns of alpha in which M is less than noise alone may make it.

    D, the spurious information, scatters by (1 +- root(n / 3 N))^2; so count the negative
    eigenvalues of M - reach D, B and the torques eliminated. There is none if all of D together is
    too small, as usual, or if there is a Cholesky factor.
    """
    n = len(minimum.noise_information.diagonal)
    reach = 1.1 * (1 + np.sqrt(n / (3 * shapes))) ** 2
    if (reach - 1.0) * minimum.noise_share < 0.9:
        return 0
    less = minimum.noise_information.taken_from(minimum.information, reach - 1.0)  # M = H + D
    if dpotrf(less, lower=True, clean=False)[1] == 0:
        return 0
    less = mirrored(less.T)
    schur = less[:n, :n] - less[:n, n:] @ np.linalg.pinv(less[n:, n:]) @ less[n:, :n]
    return int(np.count_nonzero(scipy.linalg.eigvalsh(schur) <= 0.0))


def condition(campaign: Campaign, moments: Moments, reading_covariance: Array) -> float:
    """Return the condition of E, each coordinate in units of its RMS, from E' E.

    Its inverse is, except for a factor, nearly the covariance from the readings, torques in the
    same units.
    """
    a = arms_in_units_of_rms(campaign.layout)
    gram = gram_of_e(a, load_data(campaign, moments, np.ones(a.shape[1]), {}))
    unit = np.ones(len(gram))
    for axis in (1, 2):
        unit[a.shape[1] + axis :: 2] = np.sqrt(np.mean(enabled_arms(campaign.layout)[axis] ** 2))
    smallest, _ = smallest_eigenvalue(gram, reading_covariance, unit)
    return float(np.sqrt(largest_eigenvalue(gram)[0] / max(smallest, 1e-300)))
