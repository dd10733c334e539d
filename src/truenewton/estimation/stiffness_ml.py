"""`ml` on a stiffness matrix: the modes as shapes without weight, and a population if asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.optimize

from truenewton.arrays import Array
from truenewton.estimation.likelihood import minimise
from truenewton.estimation.minimum import DataSet, Prior
from truenewton.estimation.shape_sums import shape_sums
from truenewton.estimation.stiffness_svd import (
    ElasticFit,
    balance_modes,
    mode_covariance,
)
from truenewton.estimation.systems import balance_rows


def mode_data(modes: Array, variance: float) -> DataSet:
    """Return (m, n) elastic modes as shapes without any external load, for the likelihood."""
    m, n = modes.shape
    sums = shape_sums(modes, np.ones(m), np.zeros((m, 3)), np.ones((1, m)))
    return DataSet(sums, np.full(n, variance), np.zeros((1, 3)), np.zeros((1, 3, 0)))


def likeliest(modes: Array, a: Array, *, population: bool = False) -> ElasticFit:
    """Find the likeliest relative alpha, equal noise in all elements of the modes.

    Parameters
    ----------
    modes, a
        (m, n) force patterns of unit length; (3, n) arms.
    population
        Take alpha for samples of a normal population, whose spread the modes give.

    Raises
    ------
    RankDeficient, NotConverged
    """
    start, singular_values = balance_modes(modes, a)
    fit = _at_spread(modes, a, np.inf, start, singular_values)
    if not population:
        return fit
    spread = population_spread(fit.alpha, fit.covariance)
    fit = _at_spread(modes, a, spread, start, singular_values)
    return replace(fit, method=f"ml, population {spread:.2g}")


def _at_spread(
    modes: Array, a: Array, spread: float, start: Array, singular_values: Array
) -> ElasticFit:
    n, freedom = a.shape[1], 3 * len(modes) - a.shape[1] + 1
    s = (a * start**2) @ a.T
    rows = balance_rows(modes, np.linalg.inv(np.linalg.cholesky(s)) @ a) @ start
    least = 1e-18 / n  # rounding of a mode's element
    variance, values = max(float(rows @ rows) / freedom, least), start
    for _ in range(20):
        # Elastic forces leave the scale free, so nothing but this holds the mean at 1.
        scale = float(np.sum(singular_values**2)) / variance
        prior = population_prior(n, spread, scale)
        minimum = minimise(a, [mode_data(modes, variance)], prior, values)
        size, values = minimum.chi2 / freedom, minimum.values / minimum.values.mean()
        if abs(size - 1.0) < 1e-6 or variance * size < least:
            break
        variance *= size
    s = (a * values**2) @ a.T
    pull = population_prior(n, spread).information * variance
    covariance = mode_covariance(modes, a, values, s, pull)
    return ElasticFit("ml", values, covariance, singular_values, variance)


def population_prior(n: int, spread: float, scale: float = 0.0) -> Prior:
    """Return a normal prior of (n,) alpha about their common mean, and of the mean about 1.

    Parameters
    ----------
    n
        Number of alphas.
    spread
        Standard deviation about the mean; infinite for no prior.
    scale
        Information on the mean; 0 leaves it free.
    """
    mean = np.full((n, n), 1.0 / n)
    return Prior(np.ones(n), (np.eye(n) - mean) / spread**2 + scale * mean)


def population_spread(alpha: Array, covariance: Array) -> float:
    """Return the likeliest spread of a normal population of which alpha are noisy samples.

    (n,) alpha about its mean ~ N(0, spread^2 I + covariance), (n, n), maximised over the spread.
    """
    values, vectors = np.linalg.eigh(covariance)
    projected = (vectors.T @ (alpha - alpha.mean())) ** 2

    def minus_log_likelihood(log_spread: float) -> float:
        total = np.exp(2 * log_spread) + np.maximum(values, 0.0)
        return float(0.5 * np.sum(np.log(total) + projected / total))

    likeliest_log = scipy.optimize.minimize_scalar(
        minus_log_likelihood, bounds=(np.log(1e-5), np.log(1.0)), method="bounded"
    ).x
    return float(np.exp(likeliest_log))
