"""Maximum likelihood: the noise where it is, in the readings (docs/likelihood.md).

For one shape with mean reading c (of r readings, each with covariance Sigma), the imbalance and its
covariance are

    rho = A diag(alpha) c + q + k,        S / r,    S = A diag(alpha) Sigma diag(alpha) A'

and half the sum of r rho' S^-1 rho is minimised. The likeliest noiseless reading is c^ = c - P rho
with P = Sigma diag(alpha) A' S^-1; with J = [A diag(c^) | dk/dpsi] the gradient is the sum of
r J' S^-1 rho. M, the sum of r J' S^-1 J, is not the information: c^ still carries the noise
V = Sigma - Sigma diag(alpha) A' S^-1 A diag(alpha) Sigma, which feigns, for each distinct shape,

    D = (A' S^-1 A) o V        on alpha                                   (o: elementwise)

H = M - D is the information, and H^-1 M H^-1 the covariance. Everything is written in sums over
shapes (`moments.LoadSums`), so that an iteration costs O(n^3) whatever the number of shapes.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.actuators import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.moments import LoadSums

STEPS = 60
SMALL = 1e-10  # squared step in standard errors at which the iteration ends
NEAR = 1e-3  # below which no step is shortened


@dataclass(frozen=True, eq=False)
class DataSet:
    """Shapes that share one external load and one noise.

    Attributes
    ----------
    sums
        The shapes.
    variance
        (n,) of one reading of weight 1, the diagonal of Sigma.
    load
        (3,) the part of k known beforehand: (W, 0, 0).
    nuisance
        (3, p) derivative of k with respect to the unknowns beside alpha.
    """

    sums: LoadSums
    variance: Array
    load: Array
    nuisance: Array


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the unknowns besides the data.

    Attributes
    ----------
    mean, information
        (u,) and (u, u) of all unknowns, normal; information may be singular.
    measured
        How many of the last unknowns are errors of the weights: measured as 0 +- 1.
    held
        Whether they stay 0: under two loads B and the common scale take up whatever they are, and
        the data say nothing of them.
    """

    mean: Array
    information: Array
    measured: int = 0
    held: bool = False


@dataclass(frozen=True, eq=False)
class Estimate:
    """The minimum and what it is worth; t unknowns without the errors of the weights.

    Attributes
    ----------
    values
        (u,) alpha, then the unknowns beside it.
    chi2
        Sum of r rho' S^-1 rho over the data, prior left out.
    m
        (u, u) M, the data's part of the information, noise included.
    feigned
        (n, n) D, the part of M on alpha that noise alone would feign.
    statistical
        (t, t) covariance from the readings (and from a population).
    changes
        (t, measured) change of the values by one standard uncertainty of each error of the weights.
    iterations
        Steps taken.
    """

    values: Array
    chi2: float
    m: Array
    feigned: Array
    statistical: Array
    changes: Array
    iterations: int


@dataclass(frozen=True, eq=False)
class _Terms:
    """The sums at one point: twice the objective, gradient, M, and D on alpha."""

    chi2: float
    gradient: Array
    m: Array
    d: Array


def chi2_at(a: Array, data: Sequence[DataSet], values: Array) -> float:
    """Return the sum of r rho' S^-1 rho."""
    n = a.shape[1]
    total = 0.0
    for part in data:
        k = part.load + part.nuisance @ values[n:]
        arms = a * values[:n]
        _, _, rho_rho = _imbalance(part.sums, arms, k)
        total += float(np.trace(np.linalg.solve((arms * part.variance) @ arms.T, rho_rho)))
    return max(total, 0.0)


def _imbalance(sums: LoadSums, arms: Array, k: Array) -> tuple[Array, Array, Array]:
    """Return the sums of r rho (3,), r rho c' (3, n) and r rho rho' (3, 3)."""
    product = arms @ sums.square
    cross = arms @ sums.known_force.T
    mean = arms @ sums.force + sums.known
    rho_c = product + sums.known_force + np.outer(k, sums.force)
    rho_rho = (
        product @ arms.T + cross + cross.T + sums.known_square
        + np.outer(mean, k) + np.outer(k, mean) + sums.weight * np.outer(k, k)
    )  # fmt: skip
    return mean + sums.weight * k, rho_c, rho_rho


def _terms(a: Array, data: Sequence[DataSet], values: Array) -> _Terms:
    """Evaluate objective, gradient, M and D at a point."""
    n, u = a.shape[1], len(values)
    alpha, psi = values[:n], values[n:]
    arms = a * alpha
    chi2, gradient, m, d = 0.0, np.zeros(u), np.zeros((u, u)), np.zeros((n, n))
    for part in data:
        sums = part.sums
        rho, rho_c, rho_rho = _imbalance(sums, arms, part.load + part.nuisance @ psi)
        noisy = arms * part.variance  # A diag(alpha) Sigma
        s_inverse = np.linalg.inv(noisy @ arms.T)
        weighed = s_inverse @ a  # S^-1 A
        p = noisy.T @ s_inverse
        # c^ = c - P rho, summed: rho c^' and c^ c^'.
        rho_fitted = rho_c - rho_rho @ p.T
        half = p @ (rho_c - 0.5 * rho_rho @ p.T)
        fitted_square = sums.square - half - half.T
        fitted = sums.force - p @ rho
        gram = a.T @ weighed  # A' S^-1 A
        chi2 += float(np.sum(s_inverse * rho_rho))
        gradient[:n] += np.sum(weighed * rho_fitted, axis=0)
        gradient[n:] += part.nuisance.T @ (s_inverse @ rho)
        m[:n, :n] += fitted_square * gram
        m[:n, n:] += fitted[:, None] * (weighed.T @ part.nuisance)
        m[n:, n:] += sums.weight * part.nuisance.T @ s_inverse @ part.nuisance
        v = -p @ noisy
        v[np.diag_indices(n)] += part.variance
        d += sums.shapes * gram * v
    m[n:, :n] = m[:n, n:].T
    return _Terms(max(chi2, 0.0), gradient, m, d)  # in perfect balance rounding may leave less


def minimise(a: Array, data: Sequence[DataSet], prior: Prior, start: Array) -> Estimate:
    """Find the likeliest alpha and nuisance.

    Parameters
    ----------
    a
        (3, n) arms of the enabled actuators.
    data
        The sets of shapes.
    prior
        What is known besides.
    start
        (u,) where to begin.

    Raises
    ------
    NotConverged
        The iteration does not settle.
    """
    n = a.shape[1]
    values, before = start.copy(), np.inf
    for iteration in range(1, STEPS + 1):
        terms = _terms(a, data, values)
        apart = values - prior.mean
        gradient = terms.gradient + prior.information @ apart
        step, decrement = _step(terms, prior, gradient, n)
        # Near the minimum the gradient is trusted, and when it no longer falls rounding is reached.
        if decrement < SMALL or (decrement < NEAR and decrement > 0.25 * before):
            return _estimate(terms, prior, values, n, iteration)
        before = decrement
        if decrement >= NEAR:
            objective = terms.chi2 + apart @ prior.information @ apart
            step = step * _shortening(a, data, prior, values, step, float(objective))
        values = values - step
    raise NotConverged(
        f"the likelihood has not settled after {STEPS} steps",
        remedy="look at `truenewton info`: outliers, or shapes that drown in noise",
        got=float(decrement),
        want=SMALL,
    )


def _shortening(
    a: Array, data: Sequence[DataSet], prior: Prior, values: Array, step: Array, objective: float
) -> float:
    """Return the largest power of 1/2 of the step that lowers the objective."""
    for halving in range(12):
        trial = values - step * 0.5**halving
        far = trial - prior.mean
        if chi2_at(a, data, trial) + far @ prior.information @ far <= objective:
            break
    return 0.5**halving


def _step(terms: _Terms, prior: Prior, gradient: Array, n: int) -> tuple[Array, float]:
    """Return the step of Newton and its squared length in standard errors.

    H where it is positive definite, as it is near the minimum; M while far.
    """
    free = len(gradient) - (prior.measured if prior.held else 0)
    m = (terms.m + prior.information)[:free, :free]
    h = m.copy()
    h[:n, :n] -= terms.d
    for matrix in (h, m):
        try:
            factor = scipy.linalg.cho_factor(matrix, check_finite=False)
            break
        except np.linalg.LinAlgError:
            continue
    else:
        raise _no_more_than_noise()
    step = np.zeros_like(gradient)
    step[:free] = scipy.linalg.cho_solve(factor, gradient[:free], check_finite=False)
    return step, float(gradient @ step)


def _estimate(terms: _Terms, prior: Prior, values: Array, n: int, iterations: int) -> Estimate:
    """Return the minimum with its covariance, H^-1 M H^-1, from readings and weights apart.

    The errors of the weights are eliminated: against quiet readings they are all but degenerate
    with the common scale, and H^-1 of all unknowns would drown in rounding what the readings say.
    With theta the other unknowns and T = H_tt^-1 M_tu, the scores g move theta by
    H_tt^-1 g_t - T C (g_u - T' g_t), C = (1 + M_uu - M_ut T)^-1.
    """
    t = len(values) - prior.measured
    known = prior.information[:t, :t]
    score = terms.m[:t, :t] + known  # covariance of g_t
    h = score.copy()
    h[:n, :n] -= terms.d
    try:
        factor = scipy.linalg.cho_factor(h, check_finite=False)
    except np.linalg.LinAlgError:
        raise _no_more_than_noise() from None
    inverse = scipy.linalg.cho_solve(factor, np.eye(t), check_finite=False)
    m_tu, m_uu = terms.m[:t, t:], terms.m[t:, t:]
    turn = inverse @ m_tu
    if prior.held:
        return Estimate(
            values, terms.chi2, terms.m, terms.d, inverse @ score @ inverse, -turn, iterations
        )
    c = np.linalg.inv(np.eye(prior.measured) + _not_negative(m_uu - m_tu.T @ turn))
    changes = -turn @ c
    with_rest = m_tu - score @ turn  # covariance of g_t with g_u - T' g_t
    rest = _not_negative(m_uu - turn.T @ m_tu - m_tu.T @ turn + turn.T @ score @ turn)
    cross = inverse @ with_rest @ changes.T
    statistical = inverse @ score @ inverse + cross + cross.T + changes @ rest @ changes.T
    return Estimate(values, terms.chi2, terms.m, terms.d, statistical, changes, iterations)


def _not_negative(matrix: Array) -> Array:
    """Return the nearest covariance to a small symmetric matrix that rounding may have spoiled."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def start_values(a: Array, data: Sequence[DataSet], prior: Prior) -> Array:
    """Return weighted least squares, the noise taken out: alpha = 1 in S, linear in the rest."""
    n = a.shape[1]
    matrix, right = prior.information.copy(), prior.information @ prior.mean
    for part in data:
        sums = part.sums
        s_inverse = np.linalg.inv((a * part.variance) @ a.T)
        weighed = s_inverse @ a
        gram = a.T @ weighed
        square = sums.square.copy()
        square[np.diag_indices(n)] -= sums.shapes * part.variance
        mixed = weighed.T @ part.nuisance
        matrix[:n, :n] += square * gram
        matrix[:n, n:] += sums.force[:, None] * mixed
        matrix[n:, :n] += (sums.force[:, None] * mixed).T
        matrix[n:, n:] += sums.weight * part.nuisance.T @ s_inverse @ part.nuisance
        given = np.outer(part.load, sums.force) + sums.known_force
        right[:n] -= np.sum(weighed * given, axis=0)
        right[n:] -= part.nuisance.T @ s_inverse @ (sums.weight * part.load + sums.known)
    # What is known beforehand stays so for a start: against little noise it is all but degenerate.
    known = np.diag(prior.information) > 0
    found = prior.mean.copy()
    right = right - matrix @ np.where(known, prior.mean, 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
        try:
            found[~known] = scipy.linalg.solve(
                matrix[np.ix_(~known, ~known)], right[~known], assume_a="sym"
            )
        except (scipy.linalg.LinAlgWarning, np.linalg.LinAlgError):
            raise _no_more_than_noise() from None
    return found


def _no_more_than_noise() -> RankDeficient:
    return RankDeficient(
        "the data hold no more than noise along some pattern of alpha",
        remedy="apply more shapes, larger or more often, or add a stiffness matrix",
    )
