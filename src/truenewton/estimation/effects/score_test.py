"""The score test of an effect at a fit without it, with all else free.

For few parameters U' V^-1 U over the directions that the data constrain is chi^2 of as many degrees
of freedom, with score U and its covariance V as in `derivative`. For many, in units that make the
diagonal of V 1, U' U is compared with tr V chi^2(nu) / nu, nu = (tr V)^2 / tr V^2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.special
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND
from truenewton.estimation.effects.derivative import (
    Derivative,
    FittedRows,
    Scored,
    residual_information,
    scored,
    variance_at_least,
)

MAX_EXACT_PARAMETERS = 30  # whose V is inverted
MAX_PARAMETERS_PER_ACTUATOR = 2  # beyond which only the residual of the means is used

Chi2 = tuple[float, float, float]
"""chi^2, its degrees of freedom, and the logarithm of the probability of a larger one."""


Given = tuple[Scored, Array]
"""Effects that a fit contains already, and the (k, k) covariance of their parameters."""


def chi2_of(
    fit: FittedRows,
    derivatives: Sequence[Derivative],
    given: Given | None = None,
    *,
    bounded: bool = False,
) -> list[Chi2 | None]:
    """Return the score tests of some effects at a fit without them, ``given`` those with it.

    For few parameters U' V^-1 U over the directions that the data constrain is chi^2 of as many
    degrees of freedom. For many, in units that make the diagonal of V 1, U' U is compared with
    tr V chi^2(nu) / nu, nu = (tr V)^2 / tr V^2. None if the data contain no information.
    ``bounded``: tr V^2 is computed only if tr V is not sufficient; otherwise chi^2 is stated as 0.
    """
    # A direction is tested if the data contain so much information on it, relative to all else
    # known. More if readings share noise: c^ is uncorrelated with rho only if rho contains no noise
    # of the readings, and the correlation biases scores with little information.
    least = 1e-2 if np.any(fit.problem.disturbance) else 1e-6
    found = list[Chi2 | None]()
    for derivative in derivatives:
        if bounded and surely_sound(fit, derivative, least):
            found.append((0.0, 1.0, 0.0))
            continue
        if derivative.count > MAX_PARAMETERS_PER_ACTUATOR * fit.problem.n:
            chi2 = _chi2_by_structure(derivative, given)
        else:
            chi2 = _chi2_by_score(scored(fit, derivative), given, least)
        found.append(chi2 and (*chi2, float(log_chance(*chi2))))
    return found


def surely_sound(fit: FittedRows, derivative: Derivative, least: float) -> bool:
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
    if not (variance > least * whole).all():
        return False
    f = float(np.sum(score**2 / whole) / np.sum(variance / whole))
    nu = np.array([1.0, k])
    return bool(log_chance(f * nu, nu).min() > np.log(OF_EACH_KIND))


def _chi2_by_score(result: Scored, given: Given | None, least: float) -> tuple[float, float] | None:
    """Return chi^2 and degrees of freedom by score and variance; None without information."""
    whole, variance = result.whole, result.variance
    if given is not None:
        others, covariance = given
        shared = result.with_others(others)
        variance = variance - shared @ covariance @ shared.T
    seen = np.diag(variance) > least * whole
    if not seen.any():
        return None
    unit = 1.0 / np.sqrt(whole[seen])
    u = result.score[seen] * unit
    v = variance[np.ix_(seen, seen)] * unit[:, None] * unit
    if len(u) > MAX_EXACT_PARAMETERS:
        scale = float(np.sum(v**2) / np.trace(v))
        return float(u @ u) / scale, float(np.trace(v)) / scale
    values, vectors = np.linalg.eigh(v)
    held = values > max(1e-4 * values[-1], least)
    if not held.any():
        return None
    chi2 = float(np.sum((vectors[:, held].T @ u) ** 2 / values[held]))
    return chi2, float(np.count_nonzero(held))


def _chi2_by_structure(derivative: Derivative, given: Given | None) -> tuple[float, float] | None:
    """Return the same of several parameters of each actuator, by the residual of the means."""
    information, score = derivative.information, derivative.score
    if information is None:
        return None
    m, _, n = information.shape
    if given is not None:
        others, covariance = given
        shared = np.hstack(
            [
                np.broadcast_to(residual_information(derivative, other), (m * n, other.count))
                for other in others.derivatives
            ]
        )
        each, half = (values.reshape(m, n, -1) for values in (shared, shared @ covariance))
        information = information - np.einsum("anj,bnj->abn", half, each)
    chi2, held = chi2_of_each(score.reshape(m, n), information)
    return float(chi2.sum()), float(held.sum())


def chi2_of_each(score: Array, information: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return (n,) chi^2 of (K, n) scores of (K, K, n) information, and their freedom."""
    values, vectors = np.linalg.eigh(np.moveaxis(information, 2, 0))
    held = values > 1e-4 * values.max()  # directions that the data constrain
    along = np.einsum("nab,an->nb", vectors, score)
    each = np.where(held, along**2 / np.where(held, values, 1.0), 0.0)
    return np.sum(each, axis=1), np.count_nonzero(held, axis=1)


def log_chance(chi2: Array | float, freedom: Array | float) -> Array:
    """Return the logarithm of the probability of a larger chi^2, however small it is, (...,)."""
    chance, half = scipy.special.chdtrc(freedom, chi2), 0.5 * np.asarray(freedom)
    # Where that is 0, the first term of the incomplete Gamma function's expansion.
    far = np.maximum(0.5 * np.asarray(chi2), 1e-300)
    small = (half - 1.0) * np.log(far) - far - scipy.special.gammaln(half)
    return np.where(chance > 0.0, np.log(np.where(chance > 0.0, chance, 1.0)), small)
