"""The population of the coefficients of all actuators: one mean and one spread for each effect.

The effects y of single actuators (temperature coefficients k, relative drifts r) are measured with
the covariance C. They scatter by spreads s about common means m:

    y ~ N(X m, V),    V = C + diag(X s^2),

where X assigns each y to its effect. The spreads maximise the restricted likelihood (Patterson and
Thompson, Biometrika 58, 1971; Fisher scoring). With

    P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1

the best linear prediction of the effects is y - C P y, with covariance C - C P C, unknown means
included (Henderson). (P y)_i / P_ii is the deviation of y_i from its prediction by all others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import chi2_isf, normal_isf, normal_sf, t_isf
from truenewton.tracking.lines import maximise_likelihood

TAIL = 0.025  # probability beyond each end of a 95 % interval
SPREAD_GRID = 25  # number of spreads over which a probability is averaged


@dataclass(frozen=True)
class Population:
    """The distribution of one effect over the actuators.

    Attributes
    ----------
    effect
        'temperature' or 'drift'.
    mean, mean_error, mean_interval
        Mean [1/K or 1/yr], its standard uncertainty, and its 95 % interval.
    spread, spread_interval
        Standard deviation over actuators, and its 95 % interval.
    members
        Number of actuators that it was estimated from.
    """

    effect: str
    mean: float
    mean_error: float
    mean_interval: tuple[float, float]
    spread: float
    spread_interval: tuple[float, float]
    members: int


@dataclass(frozen=True, eq=False)
class PopulationFit:
    """The fit of the population."""

    variance: Array  # (q,) s^2 of each effect
    variance_covariance: Array  # (q, q), from the expected information
    mean: Array  # (q,)
    mean_covariance: Array  # (q, q)
    projection: Array  # (N, N) P


def fit_population(
    y: Array, covariance: Array, which: NDArray[np.int64], start: Array | None = None
) -> PopulationFit:
    """Fit the population by restricted maximum likelihood.

    ``y`` and ``covariance`` are N measured effects; ``which`` is the index 0 .. q - 1 of the effect
    of each; ``start`` the (q,) first variances.
    """
    x = (which[:, None] == np.arange(which.max() + 1)).astype(float)
    noise = (np.diag(covariance) @ x) / x.sum(axis=0)
    scatter = ((y - x @ ((y @ x) / x.sum(axis=0))) ** 2 @ x) / np.maximum(x.sum(axis=0) - 1, 1)
    variance = np.maximum(scatter - noise, 0.1 * noise) if start is None else start

    variance, information = maximise_likelihood(
        lambda tried: _likelihood(tried, y, covariance, x)[:3], variance, noise
    )
    weighed = np.linalg.solve(covariance + np.diag(x @ variance), x)
    mean_covariance = np.linalg.inv(x.T @ weighed)
    return PopulationFit(
        variance=variance,
        variance_covariance=np.asarray(np.linalg.inv(information), dtype=np.float64),
        mean=mean_covariance @ (weighed.T @ y),
        mean_covariance=mean_covariance,
        projection=_likelihood(variance, y, covariance, x)[3],
    )


def _likelihood(
    variance: Array, y: Array, covariance: Array, x: Array
) -> tuple[float, Array, Array, Array]:
    """Return the restricted log-likelihood, the score, the expected information and P."""
    v = covariance + np.diag(x @ variance)
    factor = scipy.linalg.cho_factor(v, lower=True)
    inverse = scipy.linalg.cho_solve(factor, np.eye(len(y)))
    weighed = inverse @ x
    gram = x.T @ weighed
    p = inverse - weighed @ np.linalg.solve(gram, weighed.T)
    py = p @ y
    value = -0.5 * float(2 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(gram)[1] + y @ py)
    score = 0.5 * ((py**2 - np.diag(p)) @ x)
    information = 0.5 * x.T @ (p**2) @ x
    return value, score, information, p


def populations_from(
    names: tuple[str, ...], population: PopulationFit, members: Array
) -> tuple[Population, ...]:
    """Return the population of each effect with intervals; ``members``: (q,) numbers of actuators.

    Spread: with the total variance t of one actuator, noise included, (n - 1) t' / t is taken as
    chi-squared with n - 1 degrees of freedom; the variance 2 t^2 / (n - 1) of the estimate gives t.
    Mean: Student's t with Satterthwaite's degrees of freedom.
    """
    populations = []
    for k, name in enumerate(names):
        n, variance = int(members[k]), float(population.variance[k])
        of_variance = float(population.variance_covariance[k, k])
        total = np.sqrt(of_variance * (n - 1) / 2)
        ends = total * (n - 1) / chi2_isf([TAIL, 1 - TAIL], n - 1)
        low, high = np.sqrt(np.maximum(ends - (total - variance), 0.0))
        error = float(np.sqrt(population.mean_covariance[k, k]))
        # d mean_error^2 / d variance is about 1 / n.
        degrees = max(2 * error**4 * n**2 / of_variance, 1.0)
        reach = float(t_isf(TAIL, degrees)) * error
        mean = float(population.mean[k])
        populations.append(
            Population(
                effect=name,
                mean=mean,
                mean_error=error,
                mean_interval=(mean - reach, mean + reach),
                spread=float(np.sqrt(variance)),
                spread_interval=(float(low), float(high)),
                members=n,
            )
        )
    return tuple(populations)


def most_outlying(
    y: Array, covariance: Array, which: NDArray[np.int64], population: PopulationFit
) -> tuple[int, float, float]:
    """Return which of (N,) effects differs most from the others, sigmas and probability.

    The spread is that of the others, so that an outlier is not hidden by the spread that it causes.
    This spread is uncertain: the probability is a mean over variances, weighted by their likelihood
    from the others. The restricted likelihood of all is that of the others times the normal density
    of the deviation, so that both come from one P.
    """
    z = (population.projection @ y) / np.sqrt(np.diag(population.projection))
    index = int(np.abs(z).argmax())
    others, effect = np.arange(len(y)) != index, which[index]
    rest = fit_population(
        y[others], covariance[np.ix_(others, others)], which[others], population.variance
    )
    x = (which[:, None] == np.arange(which.max() + 1)).astype(float)
    middle = rest.variance[effect]
    reach = np.sqrt(rest.variance_covariance[effect, effect])
    ends = np.sqrt([max(middle - 5 * reach, 0.0), middle + 8 * reach])
    likelihood, deviation = np.empty(SPREAD_GRID), np.empty(SPREAD_GRID)
    spreads = np.linspace(ends[0], ends[1], SPREAD_GRID)
    for k, spread in enumerate(spreads):
        variance = rest.variance.copy()
        variance[effect] = spread**2
        value, _, _, p = _likelihood(variance, y, covariance, x)
        precision = p[index, index]
        deviation[k] = (p @ y)[index] / np.sqrt(precision)
        likelihood[k] = value - 0.5 * np.log(precision) + 0.5 * deviation[k] ** 2
    weight = spreads * np.exp(likelihood - likelihood.max())  # even in the variance
    chance = float(weight @ (2 * normal_sf(np.abs(deviation))) / weight.sum())
    sigmas = float(np.sign(deviation[0]) * normal_isf(max(chance, 1e-300) / 2))
    return index, sigmas, chance
