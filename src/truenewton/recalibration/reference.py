"""Replaced actuators by an earlier stiffness: their rows and sensors are free, no weight is moved.

With K the earlier stiffness (commanded force per reading) and every reading z and force c relative
to its mean under a load,

    c = diag(exp a) K diag(exp b) z + e,

a = -log(alpha / earlier alpha), and b the same ratio of sensor gains. Only differences of a are
determined, so alpha is relative to the mean of the actuators that did not change, whose scale is
that of the earlier calibration. Neither balance nor weights are needed.

The residual u = c - y has covariance (1 + s Z M Z') x N: of shapes and of actuators. N is the noise
of the forces of a row; s Z M Z' that of K, with M = (X'X)^-1 of the earlier shapes X, or 1 for a
matrix; s is the likeliest. With shapes whitened, x = exp(b) z, T = diag(exp a) K, S = sum x x'
and W = N^-1 the score is T o (W sum u x'), summed over rows for a and over columns for b, and the
information

    W o (T S T'),      (W T) o (T S),      S o (T' W T)

(o: elementwise). The elements of a matrix have independent noise of variance A + B T^2 instead. The
factors stay as they are, and their covariance is that of such noise (`_by_elements`).

Actuators that were not replaced have a prior: a and b are normal about their means, with the
scatter that a fit without it shows. Those that deviate from it are free, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chance_of_any, t_sf
from truenewton.errors import CampaignMismatch, RankDeficient
from truenewton.estimation.readings.moments import Moments, reading_noise
from truenewton.estimation.reciprocity.regression import noise_of_rows, regressed, variance_shares
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign
from truenewton.linalg import inverse_of_positive
from truenewton.progress import report_progress
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.tracking.law import Outlier

LAW_PASSES = 4  # of A and B, and of what the factors absorb, each given the other
MIN_FREE = 0.1  # share of the variance of a residual that factors leave; others show no noise
MIN_SHAPES = 4  # beside one for each load
STEPS = 8  # of noise and factors, each given the other
MIN_SCATTER = 1e-5  # of actuators that did not change, relative
MEAN_INFORMATION = 1e8  # on the mean of b, as much as data have on the sum of both means
MAX_PASSES = 20
MAX_RESIDUAL = 0.1  # of the forces: with another mirror, order or sign of K it is about 1
LOG_SHARE = (-12.0, 12.0)  # of s, relative to the largest variance by K


@dataclass(frozen=True, eq=False)
class Reference:
    """An earlier (n, n) stiffness [N/m], and (n, n) M of its noise by shapes."""

    stiffness: Array
    shape_noise: Array
    measured: bool  # by a campaign, so that the noise is known


@dataclass(frozen=True, eq=False)
class Ratios:
    """Alpha of n actuators relative to the earlier one, and to the mean of those that stayed."""

    alpha: Array  # (n,) ratio
    covariance: Array  # (n, n) of its logarithm
    moved: tuple[Outlier, ...]  # actuators that deviate, besides those that were named
    scatter: float  # standard deviation of the others
    chi2: float  # of the others against no change
    degrees_of_freedom: int


def reference_from(earlier: Campaign | StiffnessMatrix) -> Reference:
    """Return the reference of a campaign with POSITION, or of a matrix.

    Raises RankDeficient without POSITION, or if no shape contains some motion of the mirror.
    """
    if isinstance(earlier, StiffnessMatrix):
        k = earlier.used_stiffness
        return Reference(k, np.eye(len(k)), measured=False)
    screened = screen_campaign(earlier)
    moments = _positioned(screened.moments, "the earlier campaign")
    found = regressed(moments, reading_noise(screened.sound, moments).variance)
    return Reference(found.stiffness, inverse_of_positive(found.square), measured=True)


def _positioned(moments: Moments, what: str) -> Moments:
    if moments.displacement is None:
        raise RankDeficient(
            f"{what} lacks POSITION in a cycle file",
            remedy="record what the sensors read, or leave the reference out",
        )
    return moments


@dataclass(frozen=True, eq=False)
class _Rows:
    """Independent rows of a run: (R, n) forces [N] and readings [m], and the variance of each.

    ``spread`` is (R,) the variance by K, the largest of them 1; ``by_elements`` whether K is a
    matrix whose elements have independent noise.
    """

    force: Array
    readings: Array
    spread: Array
    by_elements: bool


def _rows_of(moments: Moments, reference: Reference) -> _Rows:
    """Return the rows of a run, without the mean under each load."""
    root = np.sqrt(moments.weight[moments.rows > 0])[:, None]
    on = moments.rows > 0
    apart = scipy.linalg.null_space((root * moments.of_load[on]).T)
    if apart.shape[1] < MIN_SHAPES:
        raise RankDeficient(
            f"there are too few shapes: {len(root)}", remedy="apply more shapes, both signs"
        )
    z = apart.T @ (root * np.asarray(moments.displacement)[on])
    values, vectors = np.linalg.eigh(z @ reference.shape_noise @ z.T)
    force = vectors.T @ (apart.T @ (root * moments.mean[on]))
    spread = np.maximum(values, 0.0) / values.max()
    return _Rows(force, vectors.T @ z, spread, by_elements=not reference.measured)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Factors a and b, (2n,) together, and their covariance."""

    values: Array
    covariance: Array
    share: float = 1.0  # s
    used: float = 2.0  # parameters for each actuator that the data determine


def _fitted(rows: _Rows, k: Array, prior: Array, start: _Fit, variance: Array) -> _Fit:
    """Return the likeliest factors with a (2n, 2n) information of the prior about a zero."""
    fit, n = start, len(k)
    for _ in range(STEPS):
        scale = 1.0 / np.sqrt(1.0 + fit.share * rows.spread)[:, None]
        a, gains = np.exp(fit.values[:n]), np.exp(fit.values[n:])
        true = a[:, None] * k
        z = scale * rows.readings * gains
        u = scale * rows.force - z @ true.T
        noise = noise_of_rows(u, true * gains, variance, len(u) - fit.used)
        weights = inverse_of_positive(noise)
        score, information = factor_equations(true, weights, z.T @ z, weights @ u.T @ z)
        covariance = inverse_of_positive(information + prior)
        values = fit.values + covariance @ (score - prior @ fit.values)
        used = float(np.sum(information * covariance)) / n
        shown = _Residuals(true, z, u, noise, weights, scale)
        fit = _Fit(values, covariance, _share(rows, u, weights, fit.share), used)
    if rows.by_elements:
        fit = replace(fit, covariance=_by_elements(shown, fit.covariance, prior))
    return fit


@dataclass(frozen=True, eq=False)
class _Residuals:
    """(R, n) whitened readings z and residuals u of T, N and its inverse, (R, 1) whitening."""

    t: Array
    z: Array
    u: Array
    noise: Array
    weights: Array
    scale: Array


def _by_elements(at: _Residuals, inverse: Array, prior: Array) -> Array:
    """Return the (2n, 2n) covariance of factors if the elements of K have independent noise.

    The variance of u_ri is c D_r N_ii + sum_j z_rj^2 (A + B t_ij^2), with D of the whitening and
    the likeliest c, A and B. With the (2n, 2n) ``inverse`` H^-1 of information and prior, the
    factors are H^-1 J'W u with the covariance H^-1 (J'W V W J + prior) H^-1 for V of u. A fit takes
    up 2 H^-1 J'W V - H^-1 (J'W V W J + prior) H^-1 of the variance of each u.
    """
    n, t, z, u, d = len(at.t), at.t, at.z, at.u, at.scale[:, 0] ** 2
    if len(z) > n:  # noise of K and factors act on n combinations of the rows, the first
        turn, z = np.linalg.qr(z, mode="complete")
        u, d = turn.T @ u, (turn**2).T @ d
    equal = np.broadcast_to((z**2).sum(axis=1)[:, None], u.shape)
    terms = np.stack([d[:, None] * np.diag(at.noise), equal, z**2 @ (t**2).T], axis=2)
    z = z[:n]
    forces, by_gains, square = z @ t.T, at.weights @ t, z.T @ z
    scaled, both = at.scale * at.z, np.hstack([at.weights, by_gains])
    _, by_rows = factor_equations(t, at.weights, scaled.T @ scaled, at.weights)
    seen = np.hstack([square @ t.T, square])
    proportional, taken = np.zeros_like(inverse), np.empty((len(z), n, 3))
    for i in range(n):
        report_progress("errors by the noise of the matrix", i / n)
        pull = np.hstack([forces * at.weights[i], z * by_gains[i]])  # (R, 2n) of J'W
        proportional += pull.T @ (((z * t[i] ** 2) @ z.T) @ pull)
        by_gain = z * t[i]
        left = by_gain @ inverse[n:] + by_gain.sum(axis=1)[:, None] * inverse[i]  # J_i H^-1
        met = z * (left @ (seen * both[i]).T)
        own = d[: len(z)] * _own(by_gain, i, inverse)
        taken[:, i] = np.stack([own, met.sum(axis=1), met @ t[i] ** 2], axis=1)
    middles = np.stack([by_rows, (both.T @ both) * (seen.T @ seen), proportional])
    free = np.ones_like(u)
    for _ in range(LAW_PASSES):
        shows = free > MIN_FREE
        shares = variance_shares(terms[shows], u[shows] ** 2 / free[shows])
        covariance = np.asarray(inverse @ (np.tensordot(shares, middles, 1) + prior) @ inverse)
        absorbed = 2.0 * taken @ shares
        for i in range(n):
            absorbed[:, i] -= _own(z * t[i], i, covariance)
        free[: len(z)] = 1.0 - absorbed / (terms[: len(z)] @ shares)
    return covariance


def _own(by_gain: Array, i: int, middle: Array) -> Array:
    """Return (R,) the diagonal of J_i M J_i' for a (2n, 2n) M.

    J_i are the derivatives of the force of actuator i by all factors, ``by_gain`` (R, n) those by
    b; the sum of these is that by a_i.
    """
    n, by_alpha = by_gain.shape[1], by_gain.sum(axis=1)
    cross = 2.0 * by_gain @ middle[n:, i] + by_alpha * middle[i, i]
    return np.asarray(((by_gain @ middle[n:, n:]) * by_gain).sum(axis=1) + by_alpha * cross)


def factor_equations(t: Array, left: Array, right: Array, pull: Array) -> tuple[Array, Array]:
    """Return the (2n,) score and (2n, 2n) information of logarithms of row and column factors of T.

    ``left`` and ``right`` are (n, n) inverse covariances of the columns and of the rows of the
    residual, ``pull`` the residual between them.
    """
    left_t, t_right = left @ t, t @ right
    score, cross = t * pull, left_t * t_right
    information = np.block([[left * (t_right @ t.T), cross], [cross.T, right * (t.T @ left_t)]])
    return np.concatenate([score.sum(axis=1), score.sum(axis=0)]), information


def _share(rows: _Rows, white: Array, weights: Array, before: float) -> float:
    """Return the likeliest s, from (R, n) residuals whitened with the one before."""
    n = white.shape[1]
    square = np.einsum("ri,ij,rj->r", white, weights, white) * (1.0 + before * rows.spread) / n

    def cost(log_share: float) -> float:
        variance = 1.0 + np.exp(log_share) * rows.spread
        scale = float(np.mean(square / variance))
        return float(np.log(variance).sum() + len(square) * np.log(scale))

    return float(np.exp(scipy.optimize.minimize_scalar(cost, bounds=LOG_SHARE, method="bounded").x))


def ratios(screened: ScreenedCampaign, reference: Reference, new: NDArray[np.bool_]) -> Ratios:
    """Return what changed of each actuator; the (n,) ``new`` ones are free.

    Raises
    ------
    RankDeficient
        No POSITION, or too few shapes.
    CampaignMismatch
        The forces are not those of the reference.
    """
    moments = _positioned(screened.moments, "the run")
    variance = reading_noise(screened.sound, moments).variance
    rows = _rows_of(moments, reference)
    expected = rows.readings @ reference.stiffness.T
    slope = np.sum(expected * rows.force, axis=0) / np.sum(expected**2, axis=0)
    left = rows.force - slope * expected
    if np.sum(left**2) > MAX_RESIDUAL**2 * np.sum(rows.force**2):
        raise CampaignMismatch(
            "the forces of the run do not follow from the earlier stiffness",
            remedy="give the stiffness of the same mirror, before the change",
        )
    signs = np.sign(slope) * np.sign(np.median(slope))
    k, n = signs[:, None] * reference.stiffness, len(slope)
    start = np.log(np.maximum(np.abs(slope), np.finfo(float).tiny))
    first = _Fit(np.concatenate([start, np.zeros(n)]), np.empty(0))
    # Data determine only the sum of the means of a and b.
    common = np.zeros((2 * n, 2 * n))
    common[n:, n:] = MEAN_INFORMATION / n**2
    free = _fitted(rows, k, common, first, variance)
    alphas, sensors = (
        _population(free.values[part], free.covariance[part, part], ~new & (signs > 0))
        for part in (slice(0, n), slice(n, 2 * n))
    )
    prior = common + scipy.linalg.block_diag(alphas.information, sensors.information)
    fit = _fitted(rows, k, prior, free, variance)
    stays = alphas.stays
    about = np.eye(n) - stays / np.count_nonzero(stays)
    contrasts = scipy.linalg.null_space(np.ones((1, np.count_nonzero(stays)))).T
    apart = contrasts @ free.values[:n][stays]
    spread = contrasts @ free.covariance[:n, :n][np.ix_(stays, stays)] @ contrasts.T
    covariance = about @ fit.covariance[:n, :n] @ about.T
    if not reference.measured:
        # If factors absorb nearly all noise of the matrix, only the scatter of the others shows it.
        covariance += np.diag(np.where(stays, 0.0, alphas.scatter**2))
    ids = screened.sound.layout.id[screened.sound.layout.enabled]
    moved = (
        Outlier(int(ids[i]), "moved", float(-alphas.sigmas[i]), float(alphas.chances[i]))
        for i in np.flatnonzero(~stays & ~new)
    )
    return Ratios(
        alpha=signs * np.exp(-about @ fit.values[:n]),
        covariance=covariance,
        moved=tuple(sorted(moved, key=lambda one: one.probability)),
        scatter=alphas.scatter,
        chi2=float(apart @ np.linalg.solve(spread, apart)),
        degrees_of_freedom=len(apart),
    )


@dataclass(frozen=True, eq=False)
class _Population:
    """Which of (n,) values belong together, with what scatter beyond their errors.

    ``sigmas`` and ``chances`` are (n,) the deviations of all, and the chances of any as large.
    """

    stays: NDArray[np.bool_]
    scatter: float
    sigmas: Array
    chances: Array

    @property
    def information(self) -> Array:
        """(n, n) of the prior: those that stay are normal about their mean."""
        stays = self.stays.astype(float)
        about = np.diag(stays) - np.outer(stays, stays) / stays.sum()
        return np.asarray(about / max(self.scatter, MIN_SCATTER) ** 2)


def _population(values: Array, covariance: Array, old: NDArray[np.bool_]) -> _Population:
    """Return which of the (n,) ``old`` actuators stay, by their (n,) values and covariance."""
    far = np.abs(values - np.median(values[old]))
    stays = old & (far <= 5.0 * np.median(far[old]))
    for _ in range(MAX_PASSES):
        count = int(stays.sum())
        about = np.eye(len(values)) - stays / count
        variance = np.einsum("ij,jk,ik->i", about, covariance, about)
        apart = about @ values
        excess = float(apart[stays] @ apart[stays] / (count - 1) - variance[stays].mean())
        sigmas = apart / np.sqrt(variance + max(excess, 0.0))
        chances = np.array([chance_of_any(2 * t_sf(abs(x), count - 1), count) for x in sigmas])
        now = old & (chances >= FALSE_ALARM / 2)  # half for rows, half for sensors
        if (now == stays).all():
            break
        stays = now
    return _Population(stays, float(np.sqrt(max(excess, 0.0))), sigmas, chances)
