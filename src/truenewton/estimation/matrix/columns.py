"""Likelihood of the columns of a stiffness matrix, each with the noise that its data show.

Column j, the commanded forces per displacement of sensor j, balances except for what the bias
magnets add to a rigid displacement, 9 numbers b, and for noise of variance V_ij in its elements:

    rho_j = A diag(alpha) k_j + b a_j,    S_j = A diag(alpha^2 V_.j) A'

Columns are independent, so the sum of rho_j' S_j^-1 rho_j is minimised, as in `likelihood` if each
column were a data set of its own. Noise proportional to an element is largest at the actuator of
the column; the moment of the column about that place is then known much better than its force.
Singular vectors mix columns and lose this information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import (
    likeliest_spread,
    on_logarithms,
    positive,
    pull,
    smooth_patterns,
)
from truenewton.estimation.matrix.facts import ElasticModes
from truenewton.linalg import inverse_of_positive

MIN_LOG_LIKELIHOOD_GAIN = 3.0  # in log likelihood: what a further parameter must bring
ROUNDING = 1e-13  # least standard deviation, relative to a typical element


@dataclass(frozen=True)
class ColumnNoise:
    """Noise of the elements of a stiffness matrix, all independent."""

    variance: float  # mean over all elements [(N/m)^2]
    proportional: float  # part of it that is proportional to the square of the element
    # of Student's t from sensor to sensor; infinite if all have the same noise
    freedom: float = np.inf

    def of_elements(self, k: Array) -> Array:
        """Return (n, m) variances of (n, m) elements [(N/m)^2], of a typical sensor."""
        square = k**2
        mean = float(square.mean())
        law, least = (
            (1.0 - self.proportional) + (self.proportional / mean) * square,
            ROUNDING**2 * mean,
        )
        return np.asarray(max(self.variance, least) * law + least)

    @property
    def lost(self) -> float:
        """Variance of a fit weighted by t, relative to that expected from its weights."""
        return 1.0 if np.isinf(self.freedom) else (self.freedom + 4.0) / (self.freedom + 2.0)

    def cost(self, distance: Array) -> float:
        """Return minus log likelihood of (m,) squared distances, with a cost of each parameter."""
        parameters = (0.0 < self.proportional < 1.0) + np.isfinite(self.freedom)
        return MIN_LOG_LIKELIHOOD_GAIN * float(parameters) + _cost(distance, self.freedom, 3.0)


def likeliest_noise(
    residual: Array, left: Array, laws: tuple[Array, Array]
) -> tuple[ColumnNoise, Array]:
    """Return the most likely noise and the (m,) weights of the columns.

    Noise is equal, proportional to the element, or both, and the same for all sensors or by sensor.
    A further parameter counts if it raises the log likelihood by `MIN_LOG_LIKELIHOOD_GAIN`.

    ``residual`` (m, 3) are combinations of the imbalance of each column, corrected for the fit.
    ``left`` (m, 3) is the part of each that the fit had left, descending: its degrees of freedom.
    ``laws`` are (m, 3, 3) covariances for equal and for proportional noise of variance 1.
    """
    freedoms = left.sum(axis=1)

    def at(share: float) -> tuple[float, Array]:
        s = (1.0 - share) * laws[0] + share * laws[1]
        # A column with one element alone is noisy in one direction, by proportion.
        s = s + ROUNDING * np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        factor = np.linalg.cholesky(s)
        solved = np.linalg.solve(factor, residual[:, :, None])[:, :, 0]
        size = np.log(np.diagonal(factor, axis1=1, axis2=2))
        return float(np.sum(left * size)), np.sum(left * solved**2, axis=1)

    def normal(share: float) -> tuple[float, ColumnNoise]:
        determinant, distance = at(share)
        variance = max(float(distance.sum() / freedoms.sum()), 1e-300)
        cost = determinant + 0.5 * float(freedoms.sum() * (np.log(variance) + 1.0))
        return cost, ColumnNoise(variance, share)

    def student(share: float) -> tuple[float, ColumnNoise]:
        determinant, distance = at(share)
        value, freedom, variance = _student(distance, freedoms)
        return determinant + value + MIN_LOG_LIKELIHOOD_GAIN, ColumnNoise(variance, share, freedom)

    found = []
    for law in (normal, student):
        found += [law(0.0), law(1.0)]
        share = scipy.optimize.minimize_scalar(
            lambda logit, law=law: law(float(scipy.special.expit(logit)))[0],
            bounds=(-7.0, 7.0),
            method="bounded",
            options={"xatol": 0.05},
        )
        value, noise = law(float(scipy.special.expit(share.x)))
        found.append((value + MIN_LOG_LIKELIHOOD_GAIN, noise))
    noise = min(found, key=lambda each: each[0])[1]
    if np.isinf(noise.freedom):
        return noise, np.ones(len(residual))
    distance = at(noise.proportional)[1] / noise.variance
    return noise, (noise.freedom + freedoms) / (noise.freedom + distance)


def _cost(distance: Array, freedom: float, dimensions: Array | float) -> float:
    """Return minus log likelihood of squared distances of t, without constant terms."""
    if np.isinf(freedom):
        return 0.5 * float(distance.sum())
    half, gamma = 0.5 * (freedom + dimensions), scipy.special.gammaln
    size = half - 0.5 * freedom
    each = size * np.log(0.5 * freedom) - (gamma(half) - gamma(0.5 * freedom))
    return float(np.sum(each + half * np.log1p(distance / freedom)))


def _cost_by_freedom(distance: Array, freedom: float, dimensions: Array) -> tuple[float, float]:
    """Return the derivatives of `_cost` with respect to freedom and log distance."""
    half, psi = 0.5 * (freedom + dimensions), scipy.special.psi
    pulled = half * distance / (freedom + distance)
    each = 0.5 * dimensions / freedom - 0.5 * (psi(half) - psi(0.5 * freedom))
    each += 0.5 * np.log1p(distance / freedom) - pulled / freedom
    return float(each.sum()), float(pulled.sum())


def _student(distance: Array, dimensions: Array) -> tuple[float, float, float]:
    """Return minus log likelihood, freedom and variance of (m,) squared distances."""
    scale, total = max(float(np.median(distance)), 1e-300), 0.5 * float(dimensions.sum())

    def cost(x: Array) -> tuple[float, Array]:
        freedom, variance = float(np.exp(x[0])), scale * float(np.exp(x[1]))
        scaled = distance / variance
        value = total * float(np.log(variance)) + _cost(scaled, freedom, dimensions)
        by_freedom, by_distance = _cost_by_freedom(scaled, freedom, dimensions)
        return value, np.array([freedom * by_freedom, total - by_distance])

    found = scipy.optimize.minimize(
        cost,
        [np.log(8.0), -1.0],
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, np.log(200.0)), (-20.0, 20.0)],
    )
    return float(found.fun), float(np.exp(found.x[0])), scale * float(np.exp(found.x[1]))


MIN_VARIANCE_SHARE = 0.01  # part of a variance that a fit leaves at least


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a stiffness matrix."""

    stiffness: Array  # (n, m) forces per displacement [N/m]
    a: Array  # (3, n) arms of forces and sensors, in comparable units
    disturbance: Array  # (m, 3, 3) covariance of what else disturbs the balance [N^2/m^2]
    start: Array  # (n,) first alpha
    size: Array  # (n, m) elements that scale proportional noise [N/m], of all modes
    modes: ElasticModes  # elastic modes of the columns


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms at one point; (n + 9) unknowns."""

    residual: Array  # (m, 3), of unit covariance
    root: Array  # (m, 3, 3) S^1/2
    design: Array  # (m, 3, n + 9)
    m: Array  # (n + 9, n + 9) M
    gradient: Array  # (n + 9,)


def terms_at(
    c: Columns, alpha: Array, b: Array, variance: Array, held: Array | None = None
) -> Terms:
    """Return the terms at (n,) alpha and (3, 3) b; with alpha ``held`` in S, of least squares."""
    n, m = c.stiffness.shape
    rho = ((c.a * alpha) @ c.stiffness + b @ c.a).T
    s = imbalance_covariances(c.a * (alpha if held is None else held), variance) + c.disturbance
    # A disturbance in one direction may be so large that noise in the others is its rounding.
    s = s + ROUNDING * np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    root = np.linalg.cholesky(s)
    inverse_root = np.linalg.inv(root)
    residual = np.einsum("mkl,ml->mk", inverse_root, rho)
    white = inverse_root @ c.a
    fitted = c.stiffness.T
    if held is None:
        fitted = fitted - (variance * alpha[:, None]).T * np.einsum("mki,mk->mi", white, residual)
    design = np.empty((m, 3, n + 9))
    np.multiply(white, fitted[:, None, :], out=design[:, :, :n])
    design[:, :, n:] = np.einsum("mkl,jm->mklj", inverse_root, c.a).reshape(m, 3, 9)
    flat = design.reshape(3 * m, n + 9)
    m_matrix = np.asarray(flat.T @ flat)
    return Terms(residual, np.asarray(root), design, m_matrix, flat.T @ residual.ravel())


def spurious_information(
    c: Columns, alpha: Array, root: Array, variance: Array, left: Array | None = None
) -> Array:
    """Return (n, n) D, the mean contribution of noise to M: all, or what the fit leaves of it.

    D = (A' S^-1/2 L S^-1/2 A) o (diag v - v alpha A' S^-1 A alpha v), summed over columns. With L =
    1 it is E[M] minus the information I. But the fit of all other unknowns removes part of the
    spurious information on a pattern, in M as in the gradient. To second order (M - D)^-1 has the
    mean I^-1, and errors of alpha the covariance I^-1 (I + D) I^-1, where L, (m, 3, 3), is what the
    fit leaves of the variance of each column.
    """
    n = len(alpha)
    white = np.linalg.inv(root) @ c.a
    noisy = white * (variance * alpha[:, None]).T[:, None, :]
    some = white if left is None else np.linalg.cholesky(left).transpose(0, 2, 1) @ white
    out = np.diag(np.einsum("mki,mki,mi->i", some, some, variance.T))
    for k in range(3):
        cross = some[:, k : k + 1] * noisy
        if left is None:  # symmetric in both equations
            cross = cross[:, k:]
            cross[:, 1:] *= np.sqrt(2.0)
        cross = cross.reshape(-1, n)
        out -= cross.T @ cross
    return np.asarray(out)


def left_of_columns(terms: Terms, inverse: Array, feigned: Array) -> Array:
    """Return the (m, 3, 3) part of each column's unit covariance that the fit leaves.

    1 - X H^-1 X' with the true design X. Noise in the measured design increases X H^-1 X', and the
    variance of alpha beyond H^-1, by the same amount: summed over columns, the trace of H^-1 D.
    """
    n, (m, _, u) = len(feigned), terms.design.shape
    inverse = inverse - 2.0 * inverse[:, :n] @ feigned @ inverse[:n]
    reached = (terms.design.reshape(3 * m, u) @ inverse).reshape(m, 3, u)
    values, vectors = np.linalg.eigh(np.eye(3) - reached @ terms.design.transpose(0, 2, 1))
    return np.asarray(
        (vectors * np.maximum(values, MIN_VARIANCE_SHARE)[:, None]) @ vectors.transpose(0, 2, 1)
    )


def imbalance_covariances(scaled_arms: Array, variance: Array) -> Array:
    """Return (m, 3, 3) covariances of the imbalance for (n, m) variances of the elements."""
    pairs = (scaled_arms[:, None] * scaled_arms[None]).reshape(9, -1)
    return np.asarray((pairs @ variance).T.reshape(-1, 3, 3))


def inverse_information(terms: Terms, prior: Array, feigned: Array) -> Array:
    """Return the (n + 9, n + 9) inverse of M - D and prior, with the common factor held."""
    n = len(prior)
    matrix = terms.m.copy()
    matrix[:n, :n] += prior - feigned + np.trace(terms.m[:n, :n]) / n**2
    try:
        return inverse_of_positive(matrix, overwrite=True)
    except np.linalg.LinAlgError:
        raise RankDeficient(
            "alpha is not unique: two patterns balance the columns almost equally well",
            remedy="check unit, X, Y and order of actuators; or measure a less noisy matrix",
        ) from None


SETTLED_STEP = 0.02  # rms step of alpha relative to its rms error, at which an iteration ends
MAX_DISTURBANCE_SHARE = 0.1  # part of a column's variance, if its noise is to be judged


@dataclass(frozen=True, eq=False)
class ElasticFit:
    """Relative alpha of elastic modes."""

    method: str  # as in the calibration file
    alpha: Array  # (n,) with mean 1
    covariance: Array  # (n, n) of alpha
    # (n,) of the balance of the modes, ascending; the first belongs to alpha
    singular_values: Array
    variance: float = float("nan")  # noise of one element of a mode; NaN if not needed
    warnings: tuple[Finding, ...] = ()  # which results are weak


@dataclass(frozen=True, eq=False)
class _Point:
    """Alpha, b, noise and spread that belong together; (m,) weights of columns, and their cost."""

    alpha: Array
    b: Array
    noise: ColumnNoise
    spread: float
    weight: Array | float = 1.0
    cost: float = np.inf


def fit_columns(columns: Columns, *, population: bool = False) -> tuple[ElasticFit, float]:
    """Return alpha with mean 1, fitted alternately with the law of the noise, and an inflation.

    The columns have at least as many equations as unknowns. ``population``: treat what is not
    smooth in alpha as samples of a normal population, whose spread is estimated. The inflation is
    the variance of alpha relative to that expected from the information alone.

    Raises
    ------
    NotConverged
        Alpha does not converge.
    RankDeficient
        Noise would determine some of alpha alone: the columns have another fault.
    """
    n, alpha = len(columns.start), columns.start / columns.start.mean()
    smooth, spread = smooth_patterns(columns.a), 0.1 if population else np.inf
    rough = _rough_noise(columns, alpha, 0.0)
    best = _alternate(
        columns, smooth, _Point(alpha, np.zeros((3, 3)), rough, spread), columns.start
    )
    # The law that weights the columns is judged too favourably by its residuals, so the other one
    # is tried as well; it is abandoned once it is clearly less likely.
    other = _rough_noise(columns, best.alpha, float(best.noise.proportional < 0.5))
    try:
        again = _alternate(columns, smooth, replace(best, noise=other), worst=best.cost + 30.0)
        best = min(best, again, key=lambda each: each.cost)
    except (NotConverged, RankDeficient):
        pass
    noise, prior = best.noise, on_logarithms(smooth, best.spread)
    variance = noise.of_elements(columns.size) / best.weight * noise.lost
    alpha, _, terms, inverse, feigned = _settle(columns, best.alpha, best.b, variance, prior)
    left = left_of_columns(terms, inverse, feigned)
    feigned = spurious_information(columns, alpha, terms.root, variance, left)
    inverse = inverse_information(terms, pull(prior, alpha)[1], feigned)
    held = np.eye(n) - np.outer(alpha, np.full(n, 1.0 / n))
    inverse = held @ inverse[:n, :n] @ held.T
    covariance = inverse + inverse @ feigned @ inverse
    share = float(np.trace(covariance) / np.trace(inverse))
    # Balance of the columns as they are, in patterns of alpha, relative to D.
    rows = (np.linalg.inv(terms.root) @ columns.a) * columns.stiffness.T[:, None, :]
    flat = rows.reshape(-1, n) / np.sqrt(np.diag(feigned))
    balance = np.sqrt(np.maximum(np.linalg.eigvalsh(flat.T @ flat), 0.0))
    method = f"ml, population {best.spread:.2g}" if population else "ml"
    return ElasticFit(method, alpha, covariance, balance), share


def _alternate(
    c: Columns,
    smooth: Array,
    at: _Point,
    held: Array | None = None,
    worst: float = np.inf,
) -> _Point:
    """Find alpha, noise and spread in turn until they agree.

    In the first step alpha is ``held`` in the covariances. The cost is minus log likelihood, alpha
    and b integrated out, plus that of the noise parameters; the iteration ends beyond the
    ``worst``.
    """
    n, weight = len(at.alpha), np.ones(c.size.shape[1])
    alpha, b, noise, spread = at.alpha, at.b, at.noise, at.spread
    for _ in range(8):
        variance, prior = noise.of_elements(c.size) / weight, on_logarithms(smooth, spread)
        alpha, b, terms, inverse, feigned = _settle(c, alpha, b, variance, prior, held)
        known = held is None
        held, before, before_spread = None, noise, spread
        distance = np.sum(terms.residual**2, axis=1) / weight
        roots = np.log(np.diagonal(terms.root, axis1=1, axis2=2)).sum() + 1.5 * np.log(weight).sum()
        cost = float(roots) + noise.cost(distance) - 0.5 * float(np.linalg.slogdet(inverse)[1])
        if np.isfinite(spread):
            log = np.log(positive(alpha))
            cost += 0.5 * float(log @ prior @ log) + (n - smooth.shape[1]) * float(np.log(spread))
            found = likeliest_spread(smooth, alpha, inverse[:n, :n], spread)
            spread = max(found, spread / 3.0)  # the noise is not known yet
        if cost > worst:
            break
        noise, weight = _noise(c, alpha, terms, left_of_columns(terms, inverse, feigned))
        if (
            known
            and _same(noise, before)
            and (np.isinf(spread) or abs(np.log(spread / before_spread)) < 0.06)
        ):
            break
    return _Point(alpha, b, noise, spread, weight, cost)


def _rough_noise(c: Columns, alpha: Array, proportional: float) -> ColumnNoise:
    """Return a first noise from the imbalance of the first alpha, rather too large.

    With too small a noise, alpha would scatter until its own variance explains the imbalance.
    """
    rho, law = ((c.a * alpha) @ c.stiffness).T, ColumnNoise(1.0, proportional)
    s = imbalance_covariances(c.a * alpha, law.of_elements(c.size))
    s += c.disturbance / (1e-12 * np.mean(c.size**2))  # large relative to any noise
    distance = np.einsum("mk,mk->m", rho, np.linalg.solve(s, rho[:, :, None])[:, :, 0])
    return ColumnNoise(float(np.median(distance)) / 2.37, proportional)  # median of chi^2 of 3


def _same(noise: ColumnNoise, before: ColumnNoise) -> bool:
    changes = (
        np.log(noise.variance / before.variance),
        noise.proportional - before.proportional,
        1.0 / noise.freedom - 1.0 / before.freedom,
    )
    return bool(np.abs(changes).max() < 0.03)


def _settle(
    c: Columns,
    alpha: Array,
    b: Array,
    variance: Array,
    prior: Array,
    held: Array | None = None,
) -> tuple[Array, Array, Terms, Array, Array]:
    """Return alpha of mean 1, b, the terms, the (n + 9, n + 9) inverse of H and prior, and D."""
    n, feigned = len(alpha), np.zeros((len(alpha), len(alpha)))
    for step_index in range(12):
        terms = terms_at(c, alpha, b, variance, held)
        if held is None and not step_index:  # alpha hardly moves it
            feigned = spurious_information(c, alpha, terms.root, variance)
        pulled, information = pull(prior, alpha)
        inverse = inverse_information(terms, information, feigned)
        gradient = terms.gradient.copy()
        gradient[:n] += pulled
        step = inverse @ gradient
        size = float(np.sqrt(np.mean(step[:n] ** 2) / np.mean(np.diag(inverse)[:n])))
        step *= min(1.0, 0.3 / float(np.abs(step[:n]).max(initial=1e-300)))
        alpha, b = alpha - step[:n], b - step[n:].reshape(3, 3)
        alpha, b = alpha / alpha.mean(), b / alpha.mean()
        if not np.isfinite(alpha).all() or np.abs(alpha).max() > 1e3:
            break
        if size < SETTLED_STEP:
            return alpha, b, terms, inverse, feigned
    raise NotConverged(
        "alpha of the stiffness matrix does not settle",
        remedy="check unit, X, Y, NZ and the order of rows and columns in STIFFNESS",
    )


def _noise(c: Columns, alpha: Array, terms: Terms, left: Array) -> tuple[ColumnNoise, Array]:
    """Return the most likely noise and (m,) weights, corrected for what the fit took away.

    Of most columns either nearly all or nearly nothing is left: the combination of the three
    equations that determines alpha of the column's own actuator.
    """
    disturbed = np.linalg.solve(terms.root, c.disturbance)
    disturbed = np.linalg.solve(terms.root, disturbed.transpose(0, 2, 1))
    shares, directions = np.linalg.eigh(disturbed)
    some = directions * (shares <= max(MAX_DISTURBANCE_SHARE, float(np.median(shares))))[:, None]
    clear = some @ some.transpose(0, 2, 1)
    values, vectors = (each[..., ::-1] for each in np.linalg.eigh(clear @ left @ clear))
    told = values >= 0.5 * MIN_VARIANCE_SHARE
    turn = (vectors * told[:, None]).transpose(0, 2, 1)
    residual = np.einsum("mkl,ml->mk", turn, terms.residual) / np.sqrt(
        np.maximum(values, MIN_VARIANCE_SHARE)
    )
    turn = turn @ np.linalg.inv(terms.root)
    scaled, square = c.a * alpha, c.size**2
    equal, proportional = (
        turn @ imbalance_covariances(scaled, law) @ turn.transpose(0, 2, 1)
        + np.eye(3) * ~told[:, None]
        for law in (np.ones_like(square), square / square.mean())
    )
    return likeliest_noise(residual, values * told, (equal, proportional))
