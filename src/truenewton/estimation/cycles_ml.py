"""`ml`: a campaign through the likelihood, its outliers left out, the result judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.column_order import misordered_columns
from truenewton.estimation.diagnosis import (
    Diagnosis,
    FoundEffect,
    Goodness,
    NoiseSource,
    RejectedRow,
)
from truenewton.estimation.effects.examination import examined
from truenewton.estimation.effects.examined import Examined, chi2_probability
from truenewton.estimation.effects.exchanges import exchanged_columns
from truenewton.estimation.effects.unsure_positions import (
    positions_are_unsure,
    with_positions_unsure,
)
from truenewton.estimation.effects.words import effect_warnings, misfit_warnings, warmer_loads
from truenewton.estimation.estimate import Estimate, Scale
from truenewton.estimation.fit_warnings import campaign_warnings, noise_warnings
from truenewton.estimation.identifiability import (
    diagnose,
    in_words,
    leverage,
    refuse,
    structural_faults,
)
from truenewton.estimation.likelihood import chi2_at, gram_of_e
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments, chosen_groups
from truenewton.estimation.noise import reading_noise
from truenewton.estimation.odd_actuators import (
    constant_actuators,
    readings_change,
    strange_alphas,
    stuck_faults,
)
from truenewton.estimation.outliers import Fitted, balancing_groups, rows_of
from truenewton.estimation.population import (
    likeliest_spread,
    smooth_patterns,
    with_population,
)
from truenewton.estimation.problem import (
    Problem,
    load_data,
    problem_of,
    with_noise_from_minimum,
    with_share_in_balance,
)
from truenewton.estimation.repeats import WEIGHED_NOISE
from truenewton.estimation.sifted import Sifted, naming, refuse_too_many
from truenewton.estimation.structure import FITS
from truenewton.estimation.undetermined import (
    tolerable,
    undetermined_patterns,
    with_patterns_held,
    with_undetermined_patterns,
)
from truenewton.estimation.weights import scale_errors, temperature_errors, weight_errors
from truenewton.linalg import largest_eigenvalue, mirrored, smallest_eigenvalue
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import arms_in_units_of_rms, enabled_arms

LINEAR = 3  # steps after which a population's pull, linear in each, has settled


def find(sifted: Sifted, population: bool = False) -> Estimate:
    """Find the likeliest alpha of a campaign, outliers left out; no row is read.

    Parameters
    ----------
    sifted
        Cycles under two loads at least, and a stiffness matrix if there is one.
    population
        Whether alpha is taken for a sample of one normal population, whose spread the data give.

    Raises
    ------
    RankDeficient, TooManyOutliers, NotConverged
    """
    suspects = list(sifted.suspects)
    try:
        return _found(sifted, population, suspects)
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        raise naming(error, suspects) from None


def _found(sifted: Sifted, population: bool, suspects: list[FoundEffect]) -> Estimate:
    """Find it, and add what is suspected besides."""
    campaign, sound, moments = sifted.campaign, sifted.sound, sifted.moments
    rejected = sifted.rejected
    rows = sum(int(c.valid.sum()) for c in campaign.cycles)
    refuse(structural_faults(sound, moments))
    refuse_too_many(len(rejected), rows)
    force = moments.sums.force.sum(axis=1) / moments.sums.weight
    errors = {**weight_errors(sound), **temperature_errors(sound, force)}
    free = problem_of(campaign, reading_noise(sound, moments), errors)
    change = readings_change(moments, free.noise)
    refuse(stuck_faults(campaign, change))
    constant = constant_actuators(campaign, change)
    suspects += constant
    order = misordered_columns(campaign, moments)
    suspects += order
    try:
        belongs, distance, (problem, minimum), patterns = _fitted(free, sound, moments)
    except (RankDeficient, TooManyOutliers, NotConverged):
        suspects += () if constant else exchanged_columns(free, moments)
        raise
    free = with_share_in_balance(free, sifted, minimum.values[: free.n])
    if free.dependent:
        belongs, distance, (problem, minimum), patterns = _fitted(free, sound, moments)
    wrong = False
    if not constant and not (belongs.all() and _balances(problem, moments, minimum)):
        exchanged = exchanged_columns(free, moments)
        wrong = bool(order or exchanged)
        suspects[:] = [effect for effect in suspects if not exchanged or effect not in order]
        suspects += exchanged
    if not belongs.all():
        actuator = problem.standing_out(minimum.values, moments)
        rejected += tuple(rows_of(sound, ~belongs, distance, actuator))
        refuse_too_many(len(rejected), rows)
        moments = chosen_groups(moments, belongs)
    problem, minimum = with_noise_from_minimum(problem, moments, minimum)
    left = Examined(problem, moments, minimum)
    if patterns.size:
        minimum = with_undetermined_patterns(minimum, patterns)
    elif wrong:
        minimum = replace(minimum, reading_covariance=left.excess * minimum.reading_covariance)
    else:
        left = examined(problem, moments, minimum, sifted.structure, sifted.samples)
        problem, moments, minimum = left.problem, left.moments, left.minimum
        if positions_are_unsure(sound.layout):
            minimum = with_positions_unsure(left)
        if not left.fits:
            minimum = replace(minimum, reading_covariance=left.excess * minimum.reading_covariance)
    method = "ml"
    if population:
        alpha, smooth = minimum.values[: problem.n], smooth_patterns(problem.a)
        covariance = minimum.reading_covariance[: problem.n, : problem.n]
        spread = likeliest_spread(smooth, alpha, covariance)
        for _ in range(LINEAR):
            prior = with_population(free.prior, smooth, alpha, spread)
            problem = replace(problem, prior=prior)
            minimum = problem.fitted(moments, minimum.values)
            alpha = minimum.values[: problem.n]
        if wrong or not left.fits:
            minimum = replace(minimum, reading_covariance=left.excess * minimum.reading_covariance)
        method = f"ml, population {spread:.2g}"
    freedom = problem.degrees_of_freedom(moments) - left.told
    estimate = estimate_of(method, problem, moments, minimum, rejected, patterns.shape[1], freedom)
    error = np.sqrt(np.diag(minimum.reading_covariance)[: problem.n])
    if not (wrong or order):
        suspects += strange_alphas(campaign, minimum.values[: problem.n], error)
    effects = (*suspects, *left.effects, *warmer_loads(sound, estimate.scale_errors))
    warnings = (*estimate.diagnosis.warnings, *effect_warnings(effects), *misfit_warnings(left))
    estimate = replace(
        estimate, effects=effects, diagnosis=replace(estimate.diagnosis, warnings=warnings)
    )
    if estimate.diagnosis.undetermined:
        diagnosis = diagnose(sound, moments)
        if 3 * diagnosis.span < problem.n - 1:  # not even without noise
            refuse(diagnosis.faults, diagnosis.undetermined)
    return estimate


def _balances(problem: Problem, moments: Moments, minimum: Minimum) -> bool:
    """Tell whether the balance of a fit is as good as the noise lets expect."""
    if problem.noise.source == NoiseSource.MINIMUM:
        return False
    freedom = problem.degrees_of_freedom(moments)
    return chi2_probability(minimum.chi2, freedom, problem.noise) > FITS


def _fitted(
    problem: Problem, campaign: Campaign, moments: Moments
) -> tuple[NDArray[np.bool_], Array, Fitted, Array]:
    """Fit the groups that belong; return these, distances, the fit, and patterns held even.

    None is held unless the data hold no more than noise along some.
    """
    nothing = np.empty((problem.n, 0))
    try:
        return *balancing_groups(problem, moments), nothing
    except (RankDeficient, NotConverged, TooManyOutliers):
        diagnosis = diagnose(campaign, moments)  # which knows better what is missing
        if not diagnosis.undetermined or not tolerable(diagnosis, problem.n):
            refuse(diagnosis.faults, diagnosis.undetermined)
            raise
    for count in range(diagnosis.undetermined, 2 * diagnosis.undetermined + 2):
        patterns = undetermined_patterns(problem, moments, count)
        try:
            return *balancing_groups(with_patterns_held(problem, patterns), moments), patterns
        except (RankDeficient, NotConverged):
            continue
    fault, remedy = diagnosis.faults[0]
    raise RankDeficient(fault, remedy=remedy, got=diagnosis.undetermined, want=0)


def estimate_of(
    method: str,
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    rejected: tuple[RejectedRow, ...],
    held: int,
    freedom: float | None = None,
) -> Estimate:
    """Put the minimum into the form that all methods share.

    Degrees of freedom are those of the problem unless given.
    """
    campaign, n, unknowns = problem.campaign, problem.n, problem.unknowns
    chi2 = minimum.chi2
    freedom = problem.degrees_of_freedom(moments) if freedom is None else freedom
    tested = problem.noise.source != NoiseSource.MINIMUM and freedom > 0
    probability = chi2_probability(chi2, freedom, problem.noise) if tested else float("nan")
    declared = float("nan")
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
        goodness=Goodness(chi2, round(freedom), problem.noise.source, probability),
        declared_chi2=declared,
        scale_errors=scale_errors(
            minimum.values[:n],
            minimum.reading_covariance[:n, :n],
            minimum.changes[:n].T,
            problem.errors,
        ),
        rejected=rejected,
    )


def _diagnosis(problem: Problem, moments: Moments, minimum: Minimum, held: int) -> Diagnosis:
    """Judge alpha by what its information stands above what noise feigns, and name what is weak.

    So many patterns as are held even drown for sure.
    """
    n, layout = problem.n, problem.campaign.layout
    covariance = minimum.reading_covariance[:n, :n]
    free = held + patterns_near_noise(minimum, moments.sums.shapes)
    value, vector = largest_eigenvalue(covariance)
    weakest = in_words(vector, layout)
    warnings = (
        *noise_warnings(free, weakest, held, float(np.sqrt(value / n))),
        *campaign_warnings(problem, moments, minimum),
    )
    return Diagnosis(
        undetermined=free,
        warnings=warnings,
        weakest=weakest,
        weakest_share=value / float(np.trace(covariance)),
        leverage=tuple(leverage(problem.a * minimum.values[:n], problem.noise.variance).tolist()),
    )


def patterns_near_noise(minimum: Minimum, shapes: int) -> int:
    """Count the patterns of alpha in which M reaches less than what noise alone may.

    What noise alone feigns, D, spreads by (1 +- root(n / 3 N))^2; so count the negative eigenvalues
    of M - reach D, B and the torques eliminated. There is none if all of D together is too small,
    as mostly, or if there is a Cholesky factor.
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

    Its inverse is, but for a factor, nearly the covariance from the readings, torques in the same
    units.
    """
    a = arms_in_units_of_rms(campaign.layout)
    gram = gram_of_e(a, load_data(campaign, moments, np.ones(a.shape[1]), {}))
    unit = np.ones(len(gram))
    for axis in (1, 2):
        unit[a.shape[1] + axis :: 2] = np.sqrt(np.mean(enabled_arms(campaign.layout)[axis] ** 2))
    smallest, _ = smallest_eigenvalue(
        lambda x: gram @ x, len(gram), lambda x: reading_covariance @ (x / unit) / unit
    )
    return float(np.sqrt(largest_eigenvalue(gram)[0] / max(smallest, 1e-300)))
