"""`ml` on a stiffness matrix: the balance of its columns, each with the noise that it shows.

Column j, the commanded forces per displacement of sensor j, balances but for what the bias magnets
add to a rigid displacement, 9 numbers b, and for noise of variance V_ij in its elements:

    rho_j = A diag(alpha) k_j + b a_j,    S_j = A diag(alpha^2 V_.j) A'

Columns are independent, so the sum of rho_j' S_j^-1 rho_j is least, as in `likelihood`, of which
every column would be a data set of its own. Noise in proportion to an element sits where the
actuator of the column stands; its moment about that place is then known far better than its force.
Singular vectors mix columns and lose that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.column_noise import ColumnNoise, likeliest_noise
from truenewton.estimation.population import (
    likeliest_spread,
    on_logarithms,
    pull,
    smooth_patterns,
)

STEPS = 12
ROUNDS = 8  # of alpha and noise in turn
SMALL = 0.02  # rms step in terms of the rms error at which alpha has settled
SAME = 0.03  # change of the noise at which it has
WIDE = 0.1  # spread of a population to begin with
CLEAR = 0.1  # part of a column's variance that may be a disturbance where its noise is judged


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a stiffness matrix.

    Attributes
    ----------
    stiffness
        (n, m) forces per displacement [N/m].
    a, sensor_arms
        (3, n) arms of the forces and (3, m) of the sensors, in comparable units.
    disturbance
        (m, 3, 3) covariance of what else disturbs the balance [N^2/m^2].
    start
        (n,) alpha to begin with.
    size
        (n, m) elements with which noise may go in proportion [N/m]; all of the columns unless only
        some of their modes are looked at.
    """

    stiffness: Array
    a: Array
    sensor_arms: Array
    disturbance: Array
    start: Array
    size: Array


@dataclass(frozen=True, eq=False)
class ColumnFit:
    """Alpha from columns.

    Attributes
    ----------
    alpha, covariance
        (n,) with mean 1, and its (n, n) covariance.
    noise
        What the noise follows.
    spread
        Of the population; infinite for none.
    eigenvalues
        (n,) squared imbalance that the columns leave in patterns of alpha, in terms of its noise.
    feigned
        Variance of alpha in terms of what the information alone lets expect.
    """

    alpha: Array
    covariance: Array
    noise: ColumnNoise
    spread: float
    eigenvalues: Array
    feigned: float


@dataclass(frozen=True, eq=False)
class _Terms:
    """At one point: residuals of unit covariance, S^1/2, the design, M and gradient, and D.

    (m, 3), (m, 3, 3), (m, 3, n + 9), (n + 9, n + 9), (n + 9,) and (n, n).
    """

    residual: Array
    root: Array
    design: Array
    m: Array
    gradient: Array
    feigned: Array


def fit_columns(columns: Columns, *, population: bool = False) -> ColumnFit:
    """Fit alpha and what the noise follows, in turn.

    Parameters
    ----------
    columns
        At least as many equations as unknowns.
    population
        Take what is not smooth in alpha for samples of a normal population, whose spread the
        columns give.

    Raises
    ------
    NotConverged
        Alpha does not settle.
    RankDeficient
        What is taken for noise would hold some of alpha alone: the columns have another fault.
    """
    k, start = columns.size, columns.start
    n, m = k.shape
    alpha, b, spread = start / start.mean(), np.zeros((3, 3)), WIDE if population else np.inf
    noise, weight = _rough_noise(columns), np.ones(m)
    smooth = smooth_patterns(columns.a)
    for round_index in range(ROUNDS):
        variance = noise.of_elements(k) / weight
        prior = on_logarithms(smooth, spread)
        if round_index == 0:
            alpha, b, terms, inverse = _settle(columns, alpha, b, variance, prior, start)
        else:
            alpha, b, terms, inverse = _settle(columns, alpha, b, variance, prior)
        before, before_spread = noise, spread
        noise, weight = _noise(columns, alpha, terms, inverse, variance * weight)
        if population:
            found = likeliest_spread(smooth, alpha, inverse[:n, :n], spread)
            spread = max(found, spread / 3.0)  # the noise is not known yet
        if (
            round_index
            and _same(noise, before)
            and abs(np.log(spread / before_spread)) < SAME * (2.0)
        ):
            break
    variance = noise.of_elements(k) / weight * noise.lost
    prior = on_logarithms(smooth, spread)
    alpha, b, terms, inverse = _settle(columns, alpha, b, variance, prior)
    held = np.eye(n) - np.outer(alpha, np.full(n, 1.0 / n))
    inverse = held @ inverse[:n, :n] @ held.T
    covariance = inverse + inverse @ terms.feigned @ inverse
    share = float(np.trace(covariance) / np.trace(inverse))
    return ColumnFit(alpha, covariance, noise, spread, _eigenvalues(columns, terms), share)


def _eigenvalues(c: Columns, terms: _Terms) -> Array:
    """Return (n,) ascending eigenvalues of the balance of the columns as they are, D being 1."""
    n, m = c.stiffness.shape
    rows = (np.linalg.inv(terms.root) @ c.a) * c.stiffness.T[:, None, :]
    flat = rows.reshape(3 * m, n) / np.sqrt(np.diag(terms.feigned))
    return np.asarray(np.maximum(np.linalg.eigvalsh(flat.T @ flat), 0.0))


def _rough_noise(c: Columns) -> ColumnNoise:
    """Return a first noise, from what alpha to begin with leaves out of balance: rather too large.

    Too small a noise would have alpha scatter until its own variance explains the imbalance.
    """
    rho = ((c.a * c.start) @ c.stiffness).T
    square = c.size**2
    s = _covariances(c.a * c.start, np.ones_like(square))
    distance = np.einsum("mk,mk->m", rho, np.linalg.solve(s, rho[:, :, None])[:, :, 0])
    return ColumnNoise(float(np.median(distance)) / 2.37, 0.0)  # the median of chi^2 of 3


def _same(noise: ColumnNoise, before: ColumnNoise) -> bool:
    return (
        abs(np.log(noise.variance / before.variance)) < SAME
        and abs(noise.proportional - before.proportional) < SAME
        and abs(1.0 / noise.freedom - 1.0 / before.freedom) < SAME
    )


def _terms(
    c: Columns, alpha: Array, b: Array, variance: Array, held: Array | None = None
) -> _Terms:
    """Return the terms; with alpha held in S, those of weighted least squares, nothing feigned."""
    n, m = c.stiffness.shape
    rho = ((c.a * alpha) @ c.stiffness + b @ c.sensor_arms).T
    s = _covariances(c.a * (alpha if held is None else held), variance) + c.disturbance
    root = np.linalg.cholesky(s)
    inverse_root = np.linalg.inv(root)
    residual = np.einsum("mkl,ml->mk", inverse_root, rho)
    white = inverse_root @ c.a
    noisy = (variance * alpha[:, None]).T  # (m, n)
    fitted = c.stiffness.T
    if held is None:
        fitted = fitted - noisy * np.einsum("mki,mk->mi", white, residual)
    design = np.empty((m, 3, n + 9))
    np.multiply(white, fitted[:, None, :], out=design[:, :, :n])
    design[:, :, n:] = np.einsum("mkl,jm->mklj", inverse_root, c.sensor_arms).reshape(m, 3, 9)
    flat = design.reshape(3 * m, n + 9)
    # D = (A' S^-1 A) o (diag v - v alpha A' S^-1 A alpha v), summed over columns.
    feigned = np.diag(np.einsum("mki,mki,mi->i", white, white, variance.T))
    for k in range(3):
        cross = (white[:, k : k + 1] * white * noisy[:, None, :]).reshape(3 * m, n)
        feigned -= cross.T @ cross
    m_matrix = np.asarray(flat.T @ flat)
    return _Terms(residual, np.asarray(root), design, m_matrix, flat.T @ residual.ravel(), feigned)


def _covariances(scaled_arms: Array, variance: Array) -> Array:
    """Return (m, 3, 3) covariances of the imbalance for (n, m) variances of the elements."""
    pairs = (scaled_arms[:, None] * scaled_arms[None]).reshape(9, -1)
    return np.asarray((pairs @ variance).T.reshape(-1, 3, 3))


def _settle(
    c: Columns,
    alpha: Array,
    b: Array,
    variance: Array,
    prior: Array,
    held: Array | None = None,
) -> tuple[Array, Array, _Terms, Array]:
    """Return alpha of mean 1, b, the terms there and the (n + 9, n + 9) inverse of H and prior."""
    n = len(alpha)
    for _ in range(STEPS):
        terms = _terms(c, alpha, b, variance, held)
        pulled, information = pull(prior, alpha)
        inverse = _inverse(terms, information, feigned=held is None)
        gradient = terms.gradient.copy()
        gradient[:n] += pulled
        step = inverse @ gradient
        size = float(np.sqrt(np.mean(step[:n] ** 2) / np.mean(np.diag(inverse)[:n])))
        step *= min(1.0, 0.3 / float(np.abs(step[:n]).max(initial=1e-300)))
        alpha, b = alpha - step[:n], b - step[n:].reshape(3, 3)
        alpha, b = alpha / alpha.mean(), b / alpha.mean()
        if not np.isfinite(alpha).all() or np.abs(alpha).max() > 1e3:
            break
        if size < SMALL:
            return alpha, b, terms, inverse
    raise NotConverged(
        "alpha of the stiffness matrix does not settle",
        remedy="check unit, X, Y, NZ and the order of rows and columns in STIFFNESS",
    )


def _inverse(terms: _Terms, prior: Array, *, feigned: bool) -> Array:
    """Return the inverse of H = M - D and prior; the factor common to all alpha is held.

    Raises
    ------
    RankDeficient
    """
    n = len(prior)
    matrix = terms.m.copy()
    matrix[:n, :n] += prior + np.trace(terms.m[:n, :n]) / n**2
    if feigned:
        matrix[:n, :n] -= terms.feigned
    try:
        factor = scipy.linalg.cho_factor(matrix, lower=True)
        return np.asarray(scipy.linalg.cho_solve(factor, np.eye(n + 9)))
    except np.linalg.LinAlgError:
        pass
    raise RankDeficient(
        "a second pattern of alpha balances the columns as well",
        remedy="check unit, X, Y and order of actuators; or measure a less noisy matrix",
    )


def _noise(
    c: Columns, alpha: Array, terms: _Terms, inverse: Array, variance: Array
) -> tuple[ColumnNoise, Array]:
    """Return the likeliest noise, and (m,) weights, after putting back what the fit took away."""
    m, _, u = terms.design.shape
    reached = (terms.design.reshape(3 * m, u) @ inverse).reshape(m, 3, u)
    taken = np.einsum("mku,mlu->mkl", reached, terms.design)
    left = np.eye(3) - taken
    values, vectors = np.linalg.eigh(left)
    values = np.maximum(values, 0.02)
    turned = np.einsum("mlk,ml->mk", vectors, terms.residual) / np.sqrt(values)
    residual = np.einsum("mkl,ml->mk", terms.root @ vectors, turned)
    expected = terms.residual[:, :, None] * terms.residual[:, None] + taken
    expected = terms.root @ expected @ terms.root.transpose(0, 2, 1)
    scaled, square = c.a * alpha, c.size**2
    laws = [_covariances(scaled, law) for law in (np.ones_like(square), square / square.mean())]
    clear = np.trace(c.disturbance, axis1=1, axis2=2) <= CLEAR * np.trace(
        _covariances(scaled, variance), axis1=1, axis2=2
    )
    if np.count_nonzero(clear) < 0.2 * m:
        clear = np.ones(m, dtype=bool)
    noise, some = likeliest_noise(
        residual[clear], expected[clear], (laws[0][clear], laws[1][clear])
    )
    weight = np.ones(m)
    weight[clear] = some
    return noise, weight
