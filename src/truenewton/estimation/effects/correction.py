"""Which effects of the catalogue are significant, and how an effect is taken out.

Noise that the readings of a row share pushes the rows of a file in one direction and looks like
zeros by file. Effects by which rows of one group differ are therefore compared with it. Along the
direction d of an effect that all actuators share, 1 for zeros, the forces at rest for gains,
repeats scatter kappa times as much as independent readings; without what the effect itself explains

    T / k against F(k, M - k),        T -> T (M - k) / max(M kappa - T, M - k),

M the rows less the groups. Parameters of each actuator are as many as are independent,
(tr C)^2 / tr C^2 instead of n, C the correlations of the readings (`noise.structure_of`).

A force that comes and goes at one actuator (friction, dust in its gap, a cable that pulls) adds
a_i f_r to the imbalance of every row, a_i the arms of the actuator and f_r unknown. With
u_i = S^-1/2 a_i / |S^-1/2 a_i| the rows S^-1/2 rho have along u_i

    T_i = sum (u_i' S^-1/2 rho)^2,      R - u_i' (sum J H^-1 J') u_i  degrees of freedom,

J in terms of S^-1/2. If one stands out, S + tau^2 a_i a_i' replaces S, with tau^2 such that T_i is
as expected; so the other actuators are judged without this disturbance.

The parameters theta of an effect are unknowns with a normal prior about 0 of spread tau. At every
theta the data without the effect are fitted as usual (`Derivative.remove`), and theta takes a
Newton step with its score and information, all else being free. The data determine tau (MacKay
1992, Neural Computation 4, 415): with C the covariance of theta,

    tau^2 <- sum theta^2 / nu,        nu = sum (1 - C_ii / tau^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chance_of_any, f_logsf
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import Effect, derivatives
from truenewton.estimation.effects.derivative import (
    Derivative,
    FittedRows,
    chi2_of,
    log_chance,
    scored,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import independent_readings, reading_noise
from truenewton.linalg import inverse_of_positive


@dataclass(frozen=True, eq=False)
class EffectTest:
    """The test of one effect: a chi^2, and the logarithm of the probability of a larger one."""

    effect: Effect
    derivative: Derivative
    statistic: float
    degrees_of_freedom: float
    log_probability: float


def effect_tests(fit: FittedRows, *, bounded: bool = False) -> list[EffectTest]:
    """Return the tests of the catalogue at a fit, the likeliest effect first.

    ``bounded``: as in `chi2_of`.
    """
    effects = derivatives(fit)
    found = chi2_of(fit, [derivative for _, derivative in effects], bounded=bounded)
    each = [EffectTest(*pair, *one) for pair, one in zip(effects, found, strict=True) if one]
    return sorted(each, key=lambda test: test.log_probability)


def significant(found: Sequence[EffectTest]) -> list[EffectTest]:
    """Return the significant tests, the likeliest first; 1 of 400 sound campaigns has one."""
    limit = np.log(-np.expm1(np.log1p(-OF_EACH_KIND) / max(len(found), 1)))
    chosen = [test for test in found if test.log_probability < limit]
    return sorted(chosen, key=lambda test: test.log_probability)


def beside_shared_noise(
    found: Sequence[EffectTest], fit: FittedRows, samples: Sequence[Array]
) -> list[EffectTest]:
    """Return effects by which rows of one group differ, if significant despite shared noise.

    Their order stays that of independent noise; ``samples`` as in `noise.structure_of`, (m, n) [N].
    """
    some = [test for test in found if test.effect.within]
    judged = [_judged(test, fit, np.concatenate(samples)) for test in some]
    codes = {test.effect.code for test in significant(judged)}
    return [test for test in some if test.effect.code in codes]


def _judged(test: EffectTest, fit: FittedRows, samples: Array) -> EffectTest:
    n, variance = fit.problem.n, fit.problem.noise.variance
    statistic, freedom = test.statistic, test.degrees_of_freedom
    if test.derivative.count >= n or test.derivative.actuators is not None:
        share = independent_readings([samples], n) / n
        chance = float(log_chance(share * statistic, share * freedom))
        return replace(test, log_probability=chance)
    gain = test.effect.code in (Code.GAIN_BY_HOUR, Code.GAIN_BY_FILE)
    weights = (fit.fitted().mean(axis=0) if gain else np.ones(n)) / variance
    kappa = float(np.mean((samples @ weights) ** 2) / np.sum(weights**2 * variance))
    left = fit.moments.repeats - freedom
    rest = max(kappa * fit.moments.repeats - statistic, left)
    ratio = statistic / freedom * left / rest
    return replace(test, log_probability=float(f_logsf(ratio, freedom, left)))


@dataclass(frozen=True)
class UnknownForce:
    """An unknown force at one actuator.

    Attributes
    ----------
    index, actuator
        Index among the enabled, and ID.
    log_probability
        Logarithm of the probability that any actuator stands out so far.
    size
        tau, rms force at one row of weight 1 [N].
    """

    index: int
    actuator: int
    log_probability: float
    size: float


def unknown_force(fit: FittedRows) -> UnknownForce | None:
    """Return the most significant unknown force; None if there is none."""
    pulled = fit.root @ fit.problem.a
    square = np.sum(pulled**2, axis=0)
    towards = pulled / np.sqrt(square)
    rows = fit.white_rho.reshape(-1, 3)
    statistic = np.sum((rows @ towards) ** 2, axis=0)
    solved = fit.half_solved(fit.white_jacobian)
    by_row = solved.T.reshape(len(rows), 3, -1)
    taken = np.einsum("rak,rbk->ab", by_row, by_row, optimize=True)
    freedom = np.maximum(len(rows) - np.einsum("an,ab,bn->n", towards, taken, towards), 1.0)
    chances = log_chance(statistic, freedom)
    worst = int(chances.argmin())
    chance = float(chances[worst])
    if chance_of_any(float(np.exp(chance)), len(chances)) >= OF_EACH_KIND:
        return None
    excess = float(statistic[worst] / freedom[worst]) - 1.0
    ids = fit.problem.campaign.layout.id[fit.problem.campaign.layout.enabled]
    return UnknownForce(
        worst,
        int(ids[worst]),
        chance + float(np.log(len(chances))),
        float(np.sqrt(max(excess, 0.0) / square[worst])),
    )


def disturbed(problem: Problem, force: UnknownForce) -> Problem:
    """Return the problem with an unknown force at an actuator."""
    arm = problem.a[:, force.index]
    added = force.size**2 * np.outer(arm, arm)
    return replace(problem, disturbance=problem.disturbance + added)


# -- an effect taken out ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Correction:
    """Data without an effect, and the fit to them.

    Attributes
    ----------
    theta, covariance, effective_parameters
        (k,) its parameters, their (k, k) covariance, and nu.
    problem, moments, minimum
        The data without it and their fit, whose covariance includes the error of the effect.
    """

    theta: Array
    covariance: Array
    effective_parameters: float
    problem: Problem
    moments: Moments
    minimum: Minimum


def correction(fit: FittedRows, effect: Effect) -> Correction | None:
    """Estimate an effect together with alpha; None if it does not converge, or is too large."""
    first = effect.derivative(fit)
    # A matrix of 10,000 parameters takes 0.8 GB, and several are needed.
    if first is None or first.count > 10_000:
        return None
    result, theta = scored(fit, first), np.zeros(first.count)
    # A first spread from the score itself: U U' = V of the effect, on the average.
    size = np.trace(result.variance) / np.sum(result.variance**2)
    tau2 = float(max(np.sum(result.score**2) * size - 1.0, 1e-3)) * float(size)
    at, derivative, settled = fit, first, False
    for _ in range(30):
        information = result.information + np.eye(len(theta)) / tau2
        try:  # an effect without any size does not converge
            inverse = inverse_of_positive(0.5 * (information + information.T), overwrite=True)
        except np.linalg.LinAlgError:
            return None
        uphill = result.score + theta / tau2
        effective_parameters = float(np.sum(1.0 - np.diag(inverse) / tau2))
        # Theta has converged if its step is below 0.01 standard errors.
        if settled and float(uphill @ inverse @ uphill) < 1e-4:
            minimum = with_error(at.minimum, result.moves, inverse)
            return Correction(theta, inverse, effective_parameters, at.problem, at.moments, minimum)
        theta = theta - inverse @ uphill
        before, tau2 = tau2, max(float(theta @ theta) / max(effective_parameters, 1e-3), 1e-300)
        settled = abs(np.log(before / tau2)) < 1e-2
        problem, moments = derivative.remove(fit.problem, fit.moments, theta)
        problem = _with_new_noise(problem, moments)
        try:
            minimum = problem.fitted(moments, at.minimum.values)
        except (NotConverged, RankDeficient):
            return None
        removed = fit.removed + fit.moments.mean - moments.mean
        at = FittedRows(problem, moments, minimum, fit.independent, removed, first.actuators)
        again = effect.derivative(at)
        if again is None:
            return None
        derivative, result = again, scored(at, again)
    return None


def _with_new_noise(problem: Problem, moments: Moments) -> Problem:
    """Return the problem with the noise of repeats without the effect."""
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    noise = reading_noise(problem.campaign, moments)
    share, freedom = problem.noise.share, problem.noise.share_freedom
    return replace(problem, noise=replace(noise, share=share, share_freedom=freedom))


def with_error(minimum: Minimum, moves: Array, covariance: Array) -> Minimum:
    """Return a minimum with B' C B added to its covariance, (k, k) C and (k, free) B."""
    added = minimum.reading_covariance.copy()
    t = min(len(added), moves.shape[1])
    added[:t, :t] += moves[:, :t].T @ covariance @ moves[:, :t]
    return replace(minimum, reading_covariance=added)
