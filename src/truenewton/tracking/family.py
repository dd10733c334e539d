"""One physics, each actuator its own deviation: a normal population of the effects.

The effects y of single actuators (temperature coefficients k, relative drifts r) have the known
covariance C of their measurement and scatter by spreads s about common means m:

    y ~ N(X m, V),    V = C + diag(X s^2),

X telling the effects apart. The spreads come from restricted maximum likelihood (Patterson and
Thompson, Biometrika 58, 1971), by Fisher scoring; with

    P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1

the best linear prediction of the effects is y - C P y, of covariance C - C P C, the means being
unknown (Henderson). (P y)_i / P_ii is what an actuator differs by from what all others let expect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import chi2_isf, normal_isf, normal_sf, t_isf
from truenewton.tracking.scatter import largest_likelihood

TWO_SIDED = 0.95
GRID = 25  # spreads over which a chance is averaged


@dataclass(frozen=True)
class Family:
    """The population of one effect.

    Attributes
    ----------
    effect
        'temperature' or 'drift'.
    mean, mean_error, mean_interval
        Over actuators [1/K or 1/yr], its standard uncertainty, and a 95 % interval.
    spread, spread_interval
        Standard deviation over actuators, and a 95 % interval.
    members
        How many actuators it was taken from.
    """

    effect: str
    mean: float
    mean_error: float
    mean_interval: tuple[float, float]
    spread: float
    spread_interval: tuple[float, float]
    members: int


@dataclass(frozen=True, eq=False)
class Population:
    """The likeliest population.

    Attributes
    ----------
    variance
        (q,) s^2 of each effect.
    variance_covariance
        (q, q) of their estimates, from the expected information.
    mean, mean_covariance
        (q,) and (q, q).
    projection
        (N, N) P.
    """

    variance: Array
    variance_covariance: Array
    mean: Array
    mean_covariance: Array
    projection: Array


def fitted_population(
    y: Array, covariance: Array, which: NDArray[np.int64], start: Array | None = None
) -> Population:
    """Find the population by restricted maximum likelihood.

    Parameters
    ----------
    y, covariance
        (N,) effects and (N, N) covariance of their measurement.
    which
        (N,) index of each one's effect, 0 .. q - 1.
    start
        (q,) variances to begin with.

    Raises
    ------
    NotConverged
    """
    x = (which[:, None] == np.arange(which.max() + 1)).astype(float)
    noise = (np.diag(covariance) @ x) / x.sum(axis=0)
    scatter = ((y - x @ ((y @ x) / x.sum(axis=0))) ** 2 @ x) / np.maximum(x.sum(axis=0) - 1, 1)
    variance = np.maximum(scatter - noise, 0.1 * noise) if start is None else start

    def likelihood(variance: Array) -> tuple[float, Array, Array]:
        value, _, score, information = _likelihood(variance, y, covariance, x)
        return value, score, information

    variance, information = largest_likelihood(likelihood, variance, noise)
    weighed = np.linalg.solve(covariance + np.diag(x @ variance), x)
    mean_covariance = np.linalg.inv(x.T @ weighed)
    return Population(
        variance=variance,
        variance_covariance=np.asarray(np.linalg.inv(information), dtype=np.float64),
        mean=mean_covariance @ (weighed.T @ y),
        mean_covariance=mean_covariance,
        projection=_likelihood(variance, y, covariance, x)[1],
    )


def _likelihood(
    variance: Array, y: Array, covariance: Array, x: Array
) -> tuple[float, Array, Array, Array]:
    """Return the restricted log-likelihood, P, the score and the expected information."""
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
    return value, p, score, information


def families_from(
    names: tuple[str, ...], population: Population, members: Array
) -> tuple[Family, ...]:
    """Return each effect's population with its intervals; ``members``, (q,), are their numbers.

    The spread: (n - 1) t' / t is taken for chi-squared with n - 1 degrees of freedom, t the total
    variance that a single actuator scatters by, noise included, of which the estimate's variance
    2 t^2 / (n - 1) tells the size. The mean: Student's t, its degrees after Satterthwaite.
    """
    families = []
    tail = (1 - TWO_SIDED) / 2
    for k, name in enumerate(names):
        n, variance = int(members[k]), float(population.variance[k])
        of_variance = float(population.variance_covariance[k, k])
        total = np.sqrt(of_variance * (n - 1) / 2)
        ends = total * (n - 1) / chi2_isf([tail, 1 - tail], n - 1)
        low, high = np.sqrt(np.maximum(ends - (total - variance), 0.0))
        error = float(np.sqrt(population.mean_covariance[k, k]))
        # d mean_error^2 / d variance is about 1 / n.
        degrees = max(2 * error**4 * n**2 / of_variance, 1.0)
        reach = float(t_isf(tail, degrees)) * error
        mean = float(population.mean[k])
        families.append(
            Family(
                effect=name,
                mean=mean,
                mean_error=error,
                mean_interval=(mean - reach, mean + reach),
                spread=float(np.sqrt(variance)),
                spread_interval=(float(low), float(high)),
                members=n,
            )
        )
    return tuple(families)


def most_outlying(
    y: Array, covariance: Array, which: NDArray[np.int64], population: Population
) -> tuple[int, float, float]:
    """Return which of (n,) effects differs most from all others, sigmas and two-sided chance.

    Neither may it hide behind the spread that it makes itself, nor is the spread of the others
    known: the chance is a mean over all variances, each weighed by its likelihood from the others.
    The restricted likelihood of all is that of the others times the normal density of the
    deviation, so that both come from one P.

    Parameters
    ----------
    y, covariance, which
        As in `fitted_population`.
    population
        Of all effects.
    """
    z = (population.projection @ y) / np.sqrt(np.diag(population.projection))
    index = int(np.abs(z).argmax())
    others, effect = np.arange(len(y)) != index, which[index]
    rest = fitted_population(
        y[others], covariance[np.ix_(others, others)], which[others], population.variance
    )
    x = (which[:, None] == np.arange(which.max() + 1)).astype(float)
    middle = rest.variance[effect]
    reach = np.sqrt(rest.variance_covariance[effect, effect])
    ends = np.sqrt([max(middle - 5 * reach, 0.0), middle + 8 * reach])
    likelihood, deviation = np.empty(GRID), np.empty(GRID)
    spreads = np.linspace(ends[0], ends[1], GRID)
    for k, spread in enumerate(spreads):
        variance = rest.variance.copy()
        variance[effect] = spread**2
        value, p, _, _ = _likelihood(variance, y, covariance, x)
        precision = p[index, index]
        deviation[k] = (p @ y)[index] / np.sqrt(precision)
        likelihood[k] = value - 0.5 * np.log(precision) + 0.5 * deviation[k] ** 2
    weight = spreads * np.exp(likelihood - likelihood.max())  # even in the variance
    chance = float(weight @ (2 * normal_sf(np.abs(deviation))) / weight.sum())
    sigmas = float(np.sign(deviation[0]) * normal_isf(max(chance, 1e-300) / 2))
    return index, sigmas, chance
