"""`ml` on a stiffness matrix: alone by its columns, beside cycles its modes as shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import (
    DataSet,
    Prior,
    likeliest_spread,
    minimise,
    on_logarithms,
    pull,
    smooth_patterns,
    with_population,
)
from truenewton.estimation.matrix.columns import Columns, fit_columns
from truenewton.estimation.matrix.modes import (
    ElasticFit,
    balance_modes,
    mode_covariance,
    refuse_few_modes,
)
from truenewton.estimation.paper.equations import balance_rows
from truenewton.estimation.readings.moments import shape_sums

# Variance in terms of the information's, above which noise feigns what holds alpha.
SPURIOUS_FACTOR = 1.27
MAX_CONDITION = 1e12  # of sum_i alpha_i^2 A_i A_i': beyond it fewer than three actuators have alpha


def mode_data(modes: Array, variance: float) -> DataSet:
    """Return (m, n) elastic modes as shapes without any external load, for the likelihood."""
    m, n = modes.shape
    sums = shape_sums(modes, np.ones(m), np.zeros((m, 3)), np.ones((1, m)))
    return DataSet(sums, np.full(n, variance), np.zeros((1, 3)), np.zeros((1, 3, 0)))


def column_fit(columns: Columns, *, population: bool = False) -> ElasticFit:
    """Find the likeliest relative alpha from columns alone, their noise as it shows.

    Where what the columns leave is no noise of independent elements, alpha is that of the modes,
    all with one noise, and its errors from what each mode leaves.

    Raises
    ------
    RankDeficient, NotConverged
    """
    n = columns.a.shape[1]
    refuse_few_modes(len(columns.modes.values), n)
    try:
        fit = fit_columns(columns, population=population)
    except (RankDeficient, NotConverged):
        fit_of_modes = likeliest(columns.modes.forces.T, columns.a, population=population)
        return replace(fit_of_modes, warnings=(Finding.of(Code.COLUMN_NOISE_NOT_INDEPENDENT),))
    if fit.feigned > SPURIOUS_FACTOR:
        raise RankDeficient(
            "noise decides some patterns of alpha: the matrix is too noisy for so many actuators",
            remedy="use --population, or measure a less noisy matrix",
            got=fit.feigned,
            want=SPURIOUS_FACTOR,
        )
    if (fit.alpha <= 0.0).any():
        raise RankDeficient(
            "the alpha that balances the columns is not positive for every actuator",
            remedy="check X, Y, NZ and the order of rows and columns in STIFFNESS",
        )
    method = f"ml, population {fit.spread:.2g}" if population else "ml"
    return ElasticFit(method, fit.alpha, fit.covariance, np.sqrt(fit.eigenvalues))


def likeliest(modes: Array, a: Array, *, population: bool = False) -> ElasticFit:
    """Find the likeliest relative alpha, equal noise in all elements of the modes.

    Parameters
    ----------
    modes, a
        (m, n) force patterns of unit length; (3, n) arms.
    population
        Take what is not smooth in alpha for samples of a normal population, whose spread the modes
        give.

    Raises
    ------
    RankDeficient, NotConverged
    """
    start, singular_values = balance_modes(modes, a)
    fit = _at_spread(modes, a, np.inf, start, singular_values)
    if not population:
        return fit
    spread = likeliest_spread(smooth_patterns(a), fit.alpha, fit.covariance)
    fit = _at_spread(modes, a, spread, start, singular_values)
    return replace(fit, method=f"ml, population {spread:.2g}")


def _at_spread(
    modes: Array, a: Array, spread: float, start: Array, singular_values: Array
) -> ElasticFit:
    n, freedom = a.shape[1], 3 * len(modes) - a.shape[1] + 1
    s, smooth = (a * start**2) @ a.T, smooth_patterns(a)
    if np.linalg.cond(s) > MAX_CONDITION:
        raise RankDeficient(
            "the alpha that balances STIFFNESS is that of a few actuators alone",
            remedy="look for rows that are not like the others",
        )
    white = np.linalg.inv(np.linalg.cholesky(s)) @ a
    rows = balance_rows(modes, white) @ start
    least = 1e-18 / n  # rounding of a mode's element
    variance, values = max(float(rows @ rows) / freedom, least), start
    for _ in range(20):
        # Elastic forces leave the scale free, so nothing but this holds the mean at 1.
        scale = float(np.sum(singular_values**2)) / variance
        prior = Prior(np.ones(n), np.full((n, n), scale / n))
        prior = with_population(prior, smooth, values, spread)
        minimum = minimise(a, [mode_data(modes, variance)], prior, values)
        size, values = minimum.chi2 / freedom, minimum.values / minimum.values.mean()
        if abs(size - 1.0) < 1e-6 or variance * size < least:
            break
        variance *= size
    s = (a * values**2) @ a.T
    pulled = pull(on_logarithms(smooth, spread), values)[1] * variance
    covariance = mode_covariance(modes, a, values, s, pulled)
    if np.isfinite(spread):
        covariance = covariance + _shrinkage(modes, a, s, pulled) * variance
    return ElasticFit("ml", values, covariance, singular_values, variance)


def _shrinkage(modes: Array, a: Array, s: Array, pulled: Array) -> Array:
    """Return the (n, n) covariance of what a population's pull takes from alpha, over variance."""
    rows = balance_rows(modes, np.linalg.inv(np.linalg.cholesky(s)) @ a)
    information = rows.T @ rows + pulled
    information += np.trace(information) / len(pulled) ** 2
    inverse = np.linalg.inv(information)
    return np.asarray(inverse @ pulled @ inverse)
