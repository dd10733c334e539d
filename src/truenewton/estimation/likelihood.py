"""Maximum likelihood: the noise where it is, in the readings (docs/likelihood.md).

For one shape with mean reading c (of r readings, each with covariance Sigma), external load k and a
part q of the balance that is known beforehand, the imbalance and its covariance are

    rho = A diag(alpha) c + q + k,        S / r,    S = A diag(alpha) Sigma diag(alpha) A'

and half the sum of r rho' S^-1 rho is minimised. The likeliest noiseless reading is c^ = c - P rho
with P = Sigma diag(alpha) A' S^-1; with J = [A diag(c^) | dk/dpsi] the gradient is the sum of
r J' S^-1 rho. M, the sum of r J' S^-1 J, is not the information: c^ still carries the noise
V = Sigma - Sigma diag(alpha) A' S^-1 A diag(alpha) Sigma, which adds to M, for each distinct shape,

    D = (A' S^-1 A) o V        on alpha                                   (o: elementwise)

H = M - D is the information, and H^-1 M H^-1 the covariance. Noise need not be independent: motion
of the mirror itself balances, so that less of Sigma reaches rho and P; V has all of it. Everything
is written in sums over shapes (`moments.ShapeSums`), so that an iteration costs O(n^3) whatever
the number of shapes.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.readings.moments import ShapeSums
from truenewton.linalg import ROWS_AT_ONCE, inverse_of_factor, mirrored


@dataclass(frozen=True, eq=False)
class DataSet:
    """Shapes under L loads that share one noise."""

    sums: ShapeSums  # sums over the shapes
    # (n,) of one reading of weight 1, the diagonal of Sigma, as the balance feels it.
    variance: Array
    load: Array  # (L, 3) the part of k that is known beforehand: (W, 0, 0)
    nuisance: Array  # (L, 3, p) derivative of k with respect to the unknowns beside alpha
    # Total variance of a reading in units of ``variance``: more than 1 if part of the noise
    # is motion of the mirror itself, which balances.
    excess: float = 1.0
    # (3, 3) covariance of a further disturbance of the balance of one row of weight 1, such
    # as an unknown force at an actuator; or 0.
    disturbance: Array | float = 0.0

    def external(self, psi: Array) -> Array:
        """Return (L, 3) k of every load."""
        return np.asarray(self.load + self.nuisance @ psi)

    def covariance(self, scaled_arms: Array) -> Array:
        """Return (3, 3) S, from (3, n) A diag(alpha)."""
        return np.asarray((scaled_arms * self.variance) @ scaled_arms.T + self.disturbance)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the unknowns besides the data, all of it normal."""

    mean: Array  # (u,) of all unknowns
    # (k, k) on the first k of them; may be singular, and is 0 by 0 if there is none.
    information: Array
    measured: int = 0  # how many of the last unknowns are errors of the weights: measured as 0 +- 1
    # Whether they stay 0: under two loads they are degenerate with B and the common scale.
    held: bool = False

    def added_to(self, matrix: Array) -> Array:
        """Add the information to a (k, k) matrix of the first k unknowns, in place; return it."""
        k, last = len(self.information), np.arange(len(self.mean) - self.measured, len(matrix))
        matrix[:k, :k] += self.information
        matrix[last, last] += 1.0
        return matrix

    def pull(self, values: Array) -> Array:
        """Return the (u,) gradient of the prior at (u,) values."""
        k, t, apart = len(self.information), len(self.mean) - self.measured, values - self.mean
        return np.concatenate([self.information @ apart[:k], np.zeros(t - k), apart[t:]])

    def with_more(self, information: Array) -> Prior:
        """Return the prior with additional (n, n) information on alpha."""
        before = self.information if self.information.size else 0.0
        return replace(self, information=before + information)


@dataclass(frozen=True, eq=False)
class NoiseInformation:
    """D, the spurious information on alpha that noise alone produces: diag(d) - R' R.

    A' S^-1 A and what S takes from V have rank 3 each, so their elementwise product has rank 9.
    """

    # (n,) d and (9, n) R, nine more rows for each further noise.
    diagonal: Array
    root: Array

    def __matmul__(self, vectors: Array) -> Array:
        """Return D v of (n, m) vectors."""
        return np.asarray(self.diagonal[:, None] * vectors - self.root.T @ (self.root @ vectors))

    def taken_from(self, matrix: Array, times: float) -> Array:
        """Return a (u, u) symmetric matrix less D times a factor: its upper triangle.

        In Fortran order, so it is in the lower triangle.
        """
        n, left = len(self.diagonal), np.array(matrix.T, order="F")
        at = np.arange(n)
        left[at, at] -= times * self.diagonal
        left[:n, :n] += times * (self.root.T @ self.root)
        return left


@dataclass(frozen=True, eq=False)
class Minimum:
    """The minimum and its covariance; t unknowns without the errors of the weights."""

    values: Array  # (u,) alpha, then the unknowns beside it
    chi2: float  # sum of r rho' S^-1 rho over the data, without the prior
    information: Array  # (u, u) H with that of the prior: its upper triangle
    # D, by which M exceeds H; the sum of its eigenvalues in units of H, B and the torques
    # eliminated.
    noise_information: NoiseInformation
    noise_share: float
    reading_covariance: Array  # (t, t) covariance from the readings (and from a population)
    # (t, measured) change of the values by one standard uncertainty of each error of the
    # weights.
    changes: Array
    iterations: int  # number of steps


@dataclass(frozen=True, eq=False)
class _Terms:
    """The sums at one point: twice the objective, gradient, H without the prior, and D.

    H has its upper triangle only; LAPACK, in Fortran order, takes it for the lower one.
    """

    chi2: float
    gradient: Array
    h: Array
    noise_information: NoiseInformation

    @property
    def m(self) -> Array:
        """(u, u) M."""
        return mirrored(self.noise_information.taken_from(self.h, -1.0).T)


def chi2_at(a: Array, data: Sequence[DataSet], values: Array) -> float:
    """Return the sum of r rho' S^-1 rho, for (3, n) arms and (u,) values of the unknowns."""
    n = a.shape[1]
    total = 0.0
    for part in data:
        scaled_arms = a * values[:n]
        _, _, rho_rho = _imbalance(part.sums, scaled_arms, part.external(values[n:]))
        total += float(np.trace(np.linalg.solve(part.covariance(scaled_arms), rho_rho)))
    return max(total, 0.0)


def _imbalance(sums: ShapeSums, scaled_arms: Array, k: Array) -> tuple[Array, Array, Array]:
    """Return the sums of r rho by load (L, 3), and of r rho c' (3, n) and r rho rho' (3, 3)."""
    product = scaled_arms @ sums.square
    cross = scaled_arms @ sums.known_force.T
    mean = sums.force @ scaled_arms.T + sums.known
    rho_c = product + sums.known_force + k.T @ sums.force
    rho_rho = (
        product @ scaled_arms.T + cross + cross.T + sums.known_square
        + mean.T @ k + k.T @ mean + (k.T * sums.weight) @ k
    )  # fmt: skip
    return mean + sums.weight[:, None] * k, rho_c, rho_rho


def _terms(a: Array, data: Sequence[DataSet], values: Array) -> _Terms:
    """Evaluate objective, gradient, H and D at a point."""
    n, u = a.shape[1], len(values)
    alpha, psi = values[:n], values[n:]
    scaled_arms = a * alpha
    chi2, gradient, h = 0.0, np.zeros(u), np.zeros((u, u))
    diagonal, roots = np.zeros(n), []
    for part in data:
        sums = part.sums
        rho, rho_c, rho_rho = _imbalance(sums, scaled_arms, part.external(psi))
        noisy = scaled_arms * part.variance  # A diag(alpha) Sigma
        s_inverse = np.asarray(np.linalg.inv(part.covariance(scaled_arms)))
        root = np.linalg.cholesky(s_inverse).T  # S^-1 = root' root
        # A' S^-1 A = white' white; V = Sigma - taken' taken
        white, taken = root @ a, np.sqrt(part.excess) * (root @ noisy)
        p = noisy.T @ s_inverse
        # c^ = c - P rho, summed: rho c^' and c^ c^' = c c' - P half - half' P'.
        rho_fitted = rho_c - rho_rho @ p.T
        half = rho_c - 0.5 * rho_rho @ p.T
        fitted = sums.force - rho @ p.T
        chi2 += float(np.sum(s_inverse * rho_rho))
        gradient[:n] += np.sum((s_inverse @ a) * rho_fitted, axis=0)
        # H: c^ c^' less, for each shape, V.
        left = np.concatenate([p, half.T, -sums.shapes * taken.T], axis=1)
        _add_product(h, white, sums.square, left, np.concatenate([half, p.T, taken]))
        once = sums.shapes * part.excess * np.sum(white**2, axis=0) * part.variance
        h[np.arange(n), np.arange(n)] -= once
        diagonal += once
        roots.append(np.sqrt(sums.shapes) * (white[:, None] * taken).reshape(9, n))
        gradient[n:] += _add_nuisance(h, part, s_inverse, a, fitted, rho)
    # In perfect balance rounding may leave less than nothing.
    return _Terms(max(chi2, 0.0), gradient, h, NoiseInformation(diagonal, np.concatenate(roots)))


def _add_product(matrix: Array, white: Array, square: Array, left: Array, right: Array) -> None:
    """Add the upper triangle of (white' white) o (square - left right), some rows at a time."""
    n = white.shape[1]
    for start in range(0, n, ROWS_AT_ONCE):
        end = min(start + ROWS_AT_ONCE, n)
        rows, columns = slice(start, end), slice(start, n)
        block = left[rows] @ right[:, columns]
        np.subtract(square[rows, columns], block, out=block)
        block *= white[:, rows].T @ white[:, columns]
        matrix[rows, columns] += block


def _add_nuisance(
    matrix: Array, part: DataSet, s_inverse: Array, a: Array, force: Array, rho: Array
) -> Array:
    """Add the information of (L, n) forces on the unknowns beside alpha; return its gradient."""
    n, gradient = a.shape[1], np.zeros(len(matrix) - a.shape[1])
    for f, r, weight, nuisance in zip(force, rho, part.sums.weight, part.nuisance, strict=True):
        pull = nuisance.T @ s_inverse
        matrix[:n, n:] += f[:, None] * (pull @ a).T
        matrix[n:, n:] += weight * pull @ nuisance
        gradient += pull @ r
    return gradient


def minimise(a: Array, data: Sequence[DataSet], prior: Prior, start: Array) -> Minimum:
    """Return the likeliest alpha and nuisance, from (3, n) arms and a (u,) start.

    Raises NotConverged or RankDeficient.
    """
    values, before = start.copy(), np.inf
    converged, unshortened = 1e-10, 1e-3  # squared step in standard errors
    for iteration in range(1, 61):
        try:
            terms = _terms(a, data, values)
        except np.linalg.LinAlgError:  # alpha ran away along a pattern that nothing holds
            raise _no_more_than_noise(prior, a.shape[1]) from None
        pull = prior.pull(values)
        step, decrement, factor = _step(terms, prior, terms.gradient + pull)
        # Near the minimum the gradient is trusted, and when it no longer falls rounding is reached.
        if decrement < converged or (decrement < unshortened and decrement > 0.25 * before):
            return _minimum(terms, prior, values, factor, iteration)
        before = decrement
        if decrement >= unshortened:
            objective = float(terms.chi2 + (values - prior.mean) @ pull)
            step = step * _shortening(a, data, prior, values, step, objective)
        values = values - step
        del terms, factor  # the next ones need their room
    raise NotConverged(
        f"the likelihood has not settled after {iteration} steps",
        remedy="look at `truenewton info`: outliers, or forces below the noise",
    )


def expected(a: Array, data: Sequence[DataSet], prior: Prior, values: Array) -> Minimum:
    """Return what `minimise` will state on the average, from sums over noiseless readings.

    At the true (u,) values M is the information itself; noise will add D to M alone. So H of noisy
    readings is M of noiseless ones, and their covariance is H^-1 (H + D) H^-1. Raises RankDeficient
    if the shapes leave a pattern of alpha free.
    """
    terms = _terms(a, data, values)
    terms = replace(terms, h=terms.m)
    factor = _step(terms, prior, terms.gradient)[2]
    return _minimum(terms, prior, values, factor, 0)


def _shortening(
    a: Array, data: Sequence[DataSet], prior: Prior, values: Array, step: Array, objective: float
) -> float:
    """Return the largest power of 1/2 of the step that lowers the objective."""
    for halving in range(12):
        trial = values - step * 0.5**halving
        from_prior = float((trial - prior.mean) @ prior.pull(trial))
        if chi2_at(a, data, trial) + from_prior <= objective:
            break
    return 0.5**halving


def _step(terms: _Terms, prior: Prior, gradient: Array) -> tuple[Array, float, Array | None]:
    """Return the step of Newton, its squared length in standard errors, and the factor of H.

    H where it is positive definite, as it is near the minimum; M while far, and no factor.
    """
    free = len(gradient) - (prior.measured if prior.held else 0)
    h = prior.added_to(terms.h[:free, :free].copy())
    factor, failed = dpotrf(h.T, lower=True, clean=False, overwrite_a=True)
    used = factor
    if failed:
        m = terms.noise_information.taken_from(prior.added_to(terms.h[:free, :free].copy()), -1.0)
        used, failed_too = dpotrf(m, lower=True, clean=False, overwrite_a=True)
        if failed_too:
            raise _no_more_than_noise(prior, len(terms.noise_information.diagonal))
    step = np.zeros_like(gradient)
    step[:free] = scipy.linalg.cho_solve((used, True), gradient[:free], check_finite=False)
    return step, float(gradient @ step), None if failed else factor


def _minimum(
    terms: _Terms, prior: Prior, values: Array, factor: Array | None, iterations: int
) -> Minimum:
    """Return the minimum with its covariance, H^-1 M H^-1, from readings and weights apart.

    The errors of the weights are eliminated: against quiet readings they are almost degenerate with
    the common scale, and in H^-1 of all unknowns rounding would exceed the information of the
    readings. With theta the other unknowns, which come first in the factor, and T = H_tt^-1 M_tu,
    the scores g move theta by H_tt^-1 g_t - T C (g_u - T' g_t), C = (1 + M_uu - M_ut T)^-1.
    """
    n, t = len(terms.noise_information.diagonal), len(values) - prior.measured
    if factor is None or np.abs(values[:n]).max() > 1e6:  # where weights count for nothing
        raise _no_more_than_noise(prior, n)
    inverse = inverse_of_factor(factor[:t, :t])
    # Those of H equal those of M, because D is on alpha alone.
    m_tu, m_uu = terms.h[:t, t:], terms.h[t:, t:]
    turn = inverse @ m_tu
    left = _not_negative(m_uu - m_tu.T @ turn)
    measured = np.linalg.inv(np.eye(prior.measured) + left)
    changes = -turn @ measured
    # M = H + D, so H^-1 M H^-1 = H^-1 + H^-1 D H^-1; likewise in what follows.
    noise_turn = terms.noise_information @ turn[:n]
    by_turn = _not_negative(turn[:n].T @ noise_turn)
    rest = left + by_turn
    cross = -(inverse[:, :n] @ noise_turn)
    wide = np.sqrt(terms.noise_information.diagonal)[:, None] * inverse[:n]
    less = terms.noise_information.root @ inverse[:n]
    share = float(
        terms.noise_information.diagonal @ np.diagonal(inverse)[:n]
        - np.sum(less[:, :n] * terms.noise_information.root)
        + np.sum(measured * by_turn)
    )
    whole = dsyrk(1.0, wide.T, beta=1.0, c=inverse.T, lower=True, overwrite_c=True)
    del wide  # as large as all of H
    whole = dsyrk(-1.0, less.T, beta=1.0, c=whole, lower=True, overwrite_c=True)
    if prior.held:
        changes = -turn
    else:
        whole += cross @ changes.T + changes @ cross.T + changes @ rest @ changes.T
    information, whole = prior.added_to(terms.h), mirrored(whole.T)
    return Minimum(
        values, terms.chi2, information, terms.noise_information, share, whole, changes, iterations
    )


def _not_negative(matrix: Array) -> Array:
    """Return the nearest covariance to a small symmetric matrix with rounding errors."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def start_values(a: Array, data: Sequence[DataSet], prior: Prior) -> Array:
    """Return (u,) weighted least squares, noise removed: alpha = 1 in S, linear in the rest."""
    n = a.shape[1]
    u = len(prior.mean)
    matrix, right = prior.added_to(np.zeros((u, u))), -prior.pull(np.zeros(u))
    nothing = np.zeros((n, 0))
    for part in data:
        sums = part.sums
        s_inverse = np.asarray(np.linalg.inv(part.covariance(a)))
        white, weighed = np.linalg.cholesky(s_inverse).T @ a, s_inverse @ a
        _add_product(matrix, white, sums.square, nothing, nothing.T)
        at = np.arange(n)
        matrix[at, at] -= sums.shapes * part.excess * part.variance * np.sum(white**2, axis=0)
        rho = sums.weight[:, None] * part.load + sums.known
        right[n:] -= _add_nuisance(matrix, part, s_inverse, a, sums.force, rho)
        right[:n] -= np.sum(weighed * (part.load.T @ sums.force + sums.known_force), axis=0)
    # Errors of the weights stay 0 for a start: against little noise they are all but degenerate.
    values, free = prior.mean.copy(), len(right) - prior.measured
    inner, right = matrix[:free, :free], right[:free] - matrix[:free, free:] @ values[free:]
    factor, failed = dpotrf(inner.T, lower=True, clean=False)
    if not failed:
        values[:free] = scipy.linalg.cho_solve((factor, True), right, check_finite=False)
        return values
    with warnings.catch_warnings():
        warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
        try:
            values[:free] = scipy.linalg.solve(inner, right, assume_a="sym")
        except (scipy.linalg.LinAlgWarning, np.linalg.LinAlgError):
            raise _no_more_than_noise(prior, n) from None
    return values


def _no_more_than_noise(prior: Prior, n: int) -> RankDeficient:
    """Return the refusal of data of n actuators; a matrix has no unknowns beside alpha."""
    remedy = "apply more shapes, larger or more often, or add a stiffness matrix"
    return RankDeficient(
        "the data contain no more than noise along some pattern of alpha",
        remedy=remedy if len(prior.mean) > n else "measure a less noisy matrix",
    )


def gram_of_e(a: Array, part: DataSet) -> Array:
    """Return (u, u) E' E of the paper's eq. 4 from the sums, with (3, n) arms a."""
    n = a.shape[1]
    gram = np.zeros((n + part.nuisance.shape[2],) * 2)
    for start in range(0, n, ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        np.multiply(a[:, rows].T @ a, part.sums.square[rows], out=gram[:n, :n][rows])
    _add_nuisance(gram, part, np.eye(3), a, part.sums.force, np.zeros_like(part.load))
    gram[n:, :n] = gram[:n, n:].T
    return gram


# -- alpha as a sample of one population ---------------------------------------------------------

MIN_SMOOTH_ACTUATORS = 100  # enough to leave smooth patterns of the fourth degree free


def smooth_patterns(a: Array) -> Array:
    """Return (n, p) orthonormal polynomials of the coordinates in (3, n) arms.

    Of second degree; of fourth degree on mirrors of `MIN_SMOOTH_ACTUATORS` actuators.
    """
    degree = 4 if a.shape[1] >= MIN_SMOOTH_ACTUATORS else 2
    x, y = a[1:] / np.sqrt(np.mean(a[1:] ** 2, axis=1, keepdims=True))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.asarray(np.linalg.qr(np.stack([x**i * y**j for i, j in powers], 1))[0])


def on_logarithms(smooth: Array, spread: float) -> Array:
    """Return the (n, n) information on log alpha, none along the (n, p) smooth patterns."""
    return np.asarray((np.eye(len(smooth)) - smooth @ smooth.T) / spread**2)


def pull(information: Array, alpha: Array) -> tuple[Array, Array]:
    """Return the (n,) gradient and (n, n) information on alpha, given those on its logarithm."""
    per = 1.0 / positive(alpha)
    return -per * (information @ np.log(per)), information * np.outer(per, per)


def positive(alpha: Array) -> Array:
    """Return (n,) alpha with a positive lower limit, so that its logarithm exists."""
    return np.asarray(np.maximum(alpha, 0.1 * np.median(alpha)))


def with_population(prior: Prior, smooth: Array, alpha: Array, spread: float) -> Prior:
    """Return the prior with that of a population on log alpha, to first order at (n,) alpha.

    The logarithm is used because the balance determines ratios of neighbours far better than the
    mean of a region: a pull of the deviations themselves to 0 would shift whole regions, and the
    common scale.
    """
    n, at = len(alpha), positive(alpha)
    information = pull(on_logarithms(smooth, spread), alpha)[1]
    # The gradient is that of a normal prior about alpha (1 - log alpha), any multiple of alpha
    # added: so that the mean is that of before.
    about, mean = -at * np.log(at), prior.mean.copy()
    mean[:n] = about + at * ((mean[:n].mean() - about.mean()) / at.mean())
    return replace(prior, mean=mean).with_more(information)


def likeliest_spread(
    smooth: Array, alpha: Array, covariance: Array, spread: float = np.inf
) -> float:
    """Return the likeliest spread of log alpha about the (n, p) smooth patterns.

    The estimate from the data alone of a pattern that is not smooth, all else eliminated, is y with
    variance v; minus twice the log of its marginal likelihood is
    log (spread^2 + v) + y^2 / (spread^2 + v) (restricted maximum likelihood; Patterson and
    Thompson, Biometrika 58, 1971). ``alpha`` (n,) and its (n, n) ``covariance`` were found with a
    population of the given ``spread``; infinite for none.
    """
    now = spread**-2
    basis = np.linalg.qr(smooth, mode="complete")[0][:, smooth.shape[1] :]
    alpha = positive(alpha)
    relative = covariance / np.outer(alpha, alpha)
    values, vectors = np.linalg.eigh(basis.T @ relative @ basis)
    alone = np.maximum(1.0 - values * now, 1e-9)  # 0 where the data hold nothing
    y, variance = vectors.T @ (basis.T @ np.log(alpha)) / alone, np.maximum(values, 0.0) / alone

    def cost(log_spread: float) -> float:
        total = np.exp(2.0 * log_spread) + variance
        return float(np.sum(np.log(total) + y**2 / total))

    # Coils and magnets scatter by more than 0.1 %.
    found = scipy.optimize.minimize_scalar(cost, bounds=(np.log(1e-3), 0.0), method="bounded")
    return float(np.exp(found.x))
