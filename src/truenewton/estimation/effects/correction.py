"""An effect taken out of the data, its size estimated together with alpha.

The parameters theta of an effect are unknowns with a normal prior about 0 of spread tau. At every
theta the data without it are fitted as ever (`Derivative.remove`), and theta steps by Newton with
what the data say of it, all else being free. tau is the data's own (MacKay 1992, Neural Computation
4, 415): with C the covariance of theta,

    tau^2 <- sum theta^2 / nu,        nu = sum (1 - C_ii / tau^2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import Effect
from truenewton.estimation.effects.derivative import FittedRows, scored
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import reading_noise

MAX_CORRECTED_PARAMETERS = 10_000  # a matrix of which takes 0.8 GB, and there are some of them
SETTLED_SQUARED_STEP = 1e-4  # squared step in standard errors at which theta has settled


@dataclass(frozen=True, eq=False)
class Correction:
    """Data without an effect, and the fit to them.

    Attributes
    ----------
    theta, covariance, effective_parameters
        (k,) its parameters, their (k, k) covariance, and how many the data tell: nu.
    problem, moments, minimum
        The data without it and their fit, whose covariance has what the effect's error adds.
    """

    theta: Array
    covariance: Array
    effective_parameters: float
    problem: Problem
    moments: Moments
    minimum: Minimum


def correction(fit: FittedRows, effect: Effect) -> Correction | None:
    """Estimate an effect together with alpha; None where that does not settle, or is too large."""
    first = effect.derivative(fit)
    if first is None or first.count > MAX_CORRECTED_PARAMETERS:
        return None
    result, theta = scored(fit, first), np.zeros(first.count)
    # A first spread from the score itself: U U' = V of the effect, on the average.
    size = np.trace(result.variance) / np.sum(result.variance**2)
    tau2 = float(max(np.sum(result.score**2) * size - 1.0, 1e-3)) * float(size)
    at, derivative, settled = fit, first, False
    for _ in range(30):
        information = result.information + np.eye(len(theta)) / tau2
        try:  # in the units of theta: an effect of no size at all is none that settles
            factor = scipy.linalg.cho_factor(0.5 * (information + information.T))
        except np.linalg.LinAlgError:
            return None
        inverse = scipy.linalg.cho_solve(factor, np.eye(len(theta)))
        uphill = result.score + theta / tau2
        effective_parameters = float(np.sum(1.0 - np.diag(inverse) / tau2))
        if settled and float(uphill @ inverse @ uphill) < SETTLED_SQUARED_STEP:
            minimum = with_error(at.minimum, result.moves, inverse)
            return Correction(theta, inverse, effective_parameters, at.problem, at.moments, minimum)
        theta = theta - inverse @ uphill
        before, tau2 = tau2, max(float(theta @ theta) / max(effective_parameters, 1e-3), 1e-300)
        settled = abs(np.log(before / tau2)) < 1e-2
        problem, moments = derivative.remove(fit.problem, fit.moments, theta)
        problem = _with_noise_anew(problem, moments)
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


def _with_noise_anew(problem: Problem, moments: Moments) -> Problem:
    """Return the problem with the noise of the repeats that an effect was taken out of."""
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    noise = reading_noise(problem.campaign, moments)
    share, freedom = problem.noise.share, problem.noise.share_freedom
    return replace(problem, noise=replace(noise, share=share, share_freedom=freedom))


def with_error(minimum: Minimum, moves: Array, covariance: Array) -> Minimum:
    """Return a minimum with what (k, k) C and (k, free) B add to its covariance, B' C B."""
    added = minimum.reading_covariance.copy()
    t = min(len(added), moves.shape[1])
    added[:t, :t] += moves[:, :t].T @ covariance @ moves[:, :t]
    return replace(minimum, reading_covariance=added)
