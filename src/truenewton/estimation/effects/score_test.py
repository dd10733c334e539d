"""Score tests of the effects of the catalogue.

With U_t and its covariance V of an effect at a fit without it (`derivative`): for few parameters
U' V^-1 U over the directions that the data constrain is chi^2 of as many degrees of freedom. For
many parameters, in units that make the diagonal of V 1, U' U is compared with tr V chi^2(nu) / nu,
nu = (tr V)^2 / tr V^2.

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
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chance_of_any, f_logsf
from truenewton.estimation.effects.catalogue import CATALOGUE, FIELDS, Effect, sum_fields
from truenewton.estimation.effects.derivative import (
    Derivative,
    FittedRows,
    scored,
    variance_at_least,
)
from truenewton.estimation.effects.fields import chi2_of_each
from truenewton.estimation.findings.code import Code
from truenewton.estimation.problem import Problem
from truenewton.estimation.screening.noise import independent_readings

MAX_EXACT_PARAMETERS = 30  # whose V is inverted
MAX_PARAMETERS_PER_ACTUATOR = 2  # beyond which only the residual of the means is used


@dataclass(frozen=True, eq=False)
class EffectTest:
    """The test of one effect: a chi^2, and the logarithm of the probability of a larger one."""

    effect: Effect
    derivative: Derivative
    statistic: float
    degrees_of_freedom: float
    log_probability: float


def tests(fit: FittedRows) -> list[EffectTest]:
    """Return the tests of the catalogue at a fit, the likeliest effect first."""
    found = [_tested(fit, *pair) for pair in _derivatives(fit)]
    return sorted((test for test in found if test), key=lambda test: test.log_probability)


def named(fit: FittedRows) -> list[EffectTest]:
    """Return the significant effects, the likeliest first; 1 of 400 sound campaigns has one.

    Of effects with a parameter of each actuator, tr V^2 is computed only if tr V is not sufficient.
    """
    found, sound = [], 0
    for effect, derivative in _derivatives(fit):
        if surely_sound(fit, derivative):
            sound += 1
        elif test := _tested(fit, effect, derivative):
            found.append(test)
    return significant(found, sound)


def significant(found: Sequence[EffectTest], sound: int = 0) -> list[EffectTest]:
    """Return the significant tests, among a number of insignificant ones, the likeliest first."""
    limit = np.log(-np.expm1(np.log1p(-OF_EACH_KIND) / max(len(found) + sound, 1)))
    chosen = [test for test in found if test.log_probability < limit]
    return sorted(chosen, key=lambda test: test.log_probability)


def _derivatives(fit: FittedRows) -> Iterator[tuple[Effect, Derivative]]:
    """Yield the effects on which the data may contain information, and their derivatives."""
    displaced = fit.moments.displacement is not None
    sum_fields(fit, [name for name in FIELDS if displaced or name != "displacement"])
    for effect in CATALOGUE:
        derivative = effect.derivative(fit)
        if derivative is not None and derivative.count:
            yield effect, derivative


def _least_share(fit: FittedRows) -> float:
    """Return the least information of a direction that is tested, relative to all else known.

    More if readings share noise: c^ is uncorrelated with rho only if rho contains no noise of the
    readings, and the correlation biases scores in directions on which there is little information.
    """
    return 1e-2 if np.any(fit.problem.disturbance) else 1e-6


def surely_sound(fit: FittedRows, derivative: Derivative) -> bool:
    """Return whether an effect of many parameters is insignificant even as the only one tested.

    With f = U' U / tr V the probability is that of chi^2(nu) > f nu, and tr V is at least what is
    used here. nu lies between 1 and the number of parameters; as nu grows the probability first
    grows, then falls, so that it is smallest at one of the ends.
    """
    k = derivative.count
    if not MAX_EXACT_PARAMETERS < k <= MAX_PARAMETERS_PER_ACTUATOR * fit.problem.n:
        return False
    at_least = variance_at_least(fit, derivative)
    if at_least is None:
        return False
    score, whole, variance = at_least
    if not (variance > _least_share(fit) * whole).all():
        return False
    f = float(np.sum(score**2 / whole) / np.sum(variance / whole))
    lowest = min(log_chance(f * nu, nu) for nu in (1.0, float(k)))
    return lowest > float(np.log(OF_EACH_KIND))


def _tested(fit: FittedRows, effect: Effect, derivative: Derivative) -> EffectTest | None:
    """Return the test of one effect; None if the data contain no information on it."""
    if derivative.count > MAX_PARAMETERS_PER_ACTUATOR * fit.problem.n:
        return _tested_by_structure(effect, derivative)
    result = scored(fit, derivative)
    least = _least_share(fit)
    seen = np.diag(result.variance) > least * result.whole
    if not seen.any():
        return None
    unit = 1.0 / np.sqrt(result.whole[seen])
    u = result.score[seen] * unit
    v = result.variance[np.ix_(seen, seen)] * unit[:, None] * unit
    if len(u) <= MAX_EXACT_PARAMETERS:
        values, vectors = np.linalg.eigh(v)
        held = values > max(1e-4 * values[-1], least)
        if not held.any():
            return None
        statistic = float(np.sum((vectors[:, held].T @ u) ** 2 / values[held]))
        freedom = float(np.count_nonzero(held))
    else:
        scale = float(np.sum(v**2) / np.trace(v))
        statistic, freedom = float(u @ u) / scale, float(np.trace(v)) / scale
    return EffectTest(effect, derivative, statistic, freedom, log_chance(statistic, freedom))


def _tested_by_structure(effect: Effect, derivative: Derivative) -> EffectTest | None:
    """Return the test of several parameters of each actuator, by the residual of the means."""
    information, score = derivative.information, derivative.score
    if isinstance(information, float) or isinstance(score, float) or not information.any():
        return None
    chi2, held = chi2_of_each(score.reshape(information.shape[1:]), information)
    statistic, freedom = float(chi2.sum()), float(held.sum())
    return EffectTest(effect, derivative, statistic, freedom, log_chance(statistic, freedom))


def log_chance(chi2: float, freedom: float) -> float:
    """Return the logarithm of the probability of a larger chi^2, however small it is."""
    chance = float(scipy.special.chdtrc(freedom, chi2))
    if chance > 0.0:
        return float(np.log(chance))
    half = 0.5 * freedom  # the first term of the incomplete Gamma function's expansion
    return float((half - 1.0) * np.log(0.5 * chi2) - 0.5 * chi2 - scipy.special.gammaln(half))


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
        chance = log_chance(share * statistic, share * freedom)
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
    chances = np.array([log_chance(*pair) for pair in zip(statistic, freedom, strict=True)])
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
