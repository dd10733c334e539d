"""Effects: how readings, the load or the arms change with them, and their score and information.

With theta the parameters of an effect and g = dc/dtheta its change of the readings at fixed true
forces, the balance of pooled rows (`moments.Pooling`) and the residual of the means change by

    J = -A diag(alpha) U' r g,        g_R = g - U U' r g.

An effect on the load or on the arms gives J alone. With rho and S of the fit, s^2 the noise of a
reading, e the unknowns of the fit and H, D as in `likelihood`:

    score          U_t = sum J' S^-1 rho - sum r g_R (c - U y) / s^2
    information    M_tt = sum J' S^-1 J + sum r g_R^2 / s^2,      M_te = sum J' S^-1 J_e
    at the fit     B = (M_te - D_te) H^-1,      V = M_tt - M_te B' - B M_et + B M B'

V is the covariance of U_t, and alpha and the other unknowns move by -B' theta.

Several effects are one theta, and these sums contain every pair of them. If the fit contains
effects already, with the inverse C of their information and prior, a further one has

    V_t - I_ta C I_at,      I = M - D - M_te H^-1 M_et of both,

so that it is tested with all else free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dpotrf, dtrtri

from truenewton.arrays import Array
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.paper.equations import imbalance_covariance
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments

NEGLIGIBLE_NOISE_SHARE = 1e-3  # share of D in terms of H, below which it is not worth its products

Some = slice | NDArray[np.intp]
"""Some of the actuators."""
Removal = Callable[[Problem, Moments, Array], tuple[Problem, Moments]]


@dataclass(frozen=True, eq=False)
class FittedRows:
    """The rows of a campaign at a fit to them (docs/effects.md)."""

    # What was fitted
    problem: Problem
    moments: Moments
    minimum: Minimum
    # Whether readings are independent of each other, so that the residual of the means also
    # contains information on effects
    independent: bool
    # (g, n) contribution to the readings of an effect that is being taken out [N]
    removed: Array | float = 0.0
    # Indices of the actuators that this effect concerns, if only some
    affected: NDArray[np.intp] | None = None
    # Sums over readings that several effects share, by the name of their field
    found: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def alpha(self) -> Array:
        """(n,) alpha."""
        return self.minimum.values[: self.problem.n]

    @property
    def bias(self) -> float:
        """B [N]."""
        return float(self.minimum.values[self.problem.unknowns.bias])

    @cached_property
    def scaled_arms(self) -> Array:
        """(3, n) A diag(alpha)."""
        return self.problem.a * self.alpha

    @cached_property
    def root(self) -> Array:
        """(3, 3) S^-1/2."""
        s = imbalance_covariance(self.scaled_arms, self.problem.noise.in_balance)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(s + self.problem.disturbance)))

    @cached_property
    def white_arms(self) -> Array:
        """(3, n) S^-1/2 A."""
        return np.asarray(self.root @ self.problem.a)

    @cached_property
    def share(self) -> Array:
        """(R, L) how much of each load a row carries."""
        return self.moments.pooling.rows(self.moments.of_load)

    # -- rows at the fit

    @cached_property
    def rho(self) -> Array:
        """(R, 3) imbalance [N, N m, N m]."""
        of_loads = self.problem.data(self.moments)[0]
        known = self.moments.pooling.rows(self.moments.known)
        k = of_loads.external(self.minimum.values[self.problem.n :])
        pooled = self.moments.pooling.rows(self.moments.mean @ self.scaled_arms.T)
        return pooled + known + self.share @ k

    @cached_property
    def white_rho(self) -> Array:
        """(3 R,) S^-1/2 rho."""
        return (self.rho @ self.root.T).ravel()

    @cached_property
    def _p(self) -> Array:
        """(3, n) P'."""
        return np.asarray(
            self.root.T @ self.root @ (self.scaled_arms * self.problem.noise.in_balance)
        )

    @cached_property
    def fitted_rows(self) -> Array:
        """(R, n) c^ = y - P rho, the likeliest noiseless rows [N]."""
        rows = self.moments.pooling.rows(self.moments.mean)
        rows -= self.rho @ self._p
        return rows

    def fitted(self, some: Some = slice(None)) -> Array:
        """Return (g, b) c^ of every group, of some actuators [N]."""
        return self.moments.pooling.groups(self.fitted_rows[:, some])

    def recorded(self, some: Some) -> Array:
        """Return (g, b) c^ as recorded, with what is being taken out: coils bend by that [N]."""
        fitted = self.fitted(some)
        return fitted if isinstance(self.removed, float) else fitted + self.removed[:, some]

    @cached_property
    def _group_rho(self) -> Array:
        """(g, 3) U rho."""
        return self.moments.pooling.groups(self.rho)

    def recorded_and_apart(self, some: slice) -> tuple[Array, Array | None]:
        """Return `recorded`, and (g, b) the residual of the means, c - U y [N], y = c^ + P rho.

        The residual is None if readings are not independent.
        """
        fitted, apart = self.fitted(some), None
        if self.independent:
            apart = self.moments.mean[:, some] - fitted - self._group_rho @ self._p[:, some]
        recorded = fitted if isinstance(self.removed, float) else fitted + self.removed[:, some]
        return recorded, apart

    # -- noise that fitted readings still contain

    @cached_property
    def taken(self) -> Array:
        """(3, n) what S takes from Sigma: V = Sigma - taken' taken."""
        noise = self.problem.noise
        return np.asarray(np.sqrt(noise.share) * (self.root @ (self.scaled_arms * noise.variance)))

    def noise_covariance(self, some: Some) -> Array:
        """Return (b, n) V of the noise in fitted rows, of some actuators [N^2]."""
        rows = np.arange(self.problem.n)[some]
        covariance = np.asarray(-self.taken[:, some].T @ self.taken)
        covariance[np.arange(len(rows)), rows] += self.problem.noise.variance[some]
        return covariance

    def spurious_by_each(self, some: Some) -> Array:
        """Return (b, n) alpha_i (A' S^-1 A)_ij V_ij of some actuators i."""
        gram = self.white_arms[:, some].T @ self.white_arms
        return np.asarray(self.alpha[some, None] * gram * self.noise_covariance(some))

    @cached_property
    def spurious_by_all(self) -> Array:
        """(n,) the same summed over i: products of matrices of rank 3, and a diagonal."""
        white, taken = self.white_arms, self.taken
        both = (self.alpha * white) @ taken.T
        each = self.alpha * np.sum(white**2, axis=0) * self.problem.noise.variance
        return np.asarray(each - np.sum(white * (both @ taken), axis=0))

    # -- the unknowns of the fit

    @cached_property
    def free(self) -> int:
        """Number of free unknowns."""
        prior = self.problem.prior
        return len(self.minimum.values) - (prior.measured if prior.held else 0)

    @cached_property
    def _white_beside(self) -> Array:
        """(L, 3, free - n) S^-1/2 dk/dpsi of each load."""
        nuisance = self.problem.data(self.moments)[0].nuisance
        return np.asarray(self.root @ nuisance[:, :, : self.free - self.problem.n])

    @cached_property
    def white_jacobian(self) -> Array:
        """(3 R, free) S^-1/2 J of alpha and the unknowns beside it."""
        n = self.problem.n
        jacobian = np.empty((len(self.fitted_rows), 3, self.free))
        np.multiply(self.white_arms[None], self.fitted_rows[:, None], out=jacobian[:, :, :n])
        jacobian[:, :, n:] = np.tensordot(self.share, self._white_beside, axes=1)
        return jacobian.reshape(-1, self.free)

    def white_change(self, values: Array) -> Array:
        """Return (R, 3) S^-1/2 J of (free,) changes of the unknowns."""
        n = self.problem.n
        by_alpha = self.fitted_rows @ (self.white_arms * values[:n]).T
        return np.asarray(by_alpha + self.share @ (self._white_beside @ values[n:]))

    def cross(self, white: Array) -> Array:
        """Return (k, free) sum of J' S^-1 J_e of (R, 3, k) S^-1/2 J."""
        count, _, k = white.shape
        n = self.problem.n
        cross = np.empty((k, self.free))
        on_rows = (white.reshape(count, 3 * k).T @ self.fitted_rows).reshape(3, k, n)
        np.einsum("akn,an->kn", on_rows, self.white_arms, out=cross[:, :n])
        on_loads = (white.reshape(count, 3 * k).T @ self.share).reshape(3, k, -1)
        cross[:, n:] = np.einsum("akl,lau->ku", on_loads, self._white_beside)
        return cross

    def cross_of_each(self, of_each: OfEach, rows: Array, pulled: Array) -> Array:
        """Return (k, free) the same of parameters of each actuator, S^-1/2 times their arms."""
        n, times = self.problem.n, pulled.shape[1] // rows.shape[1]
        cross = np.empty((len(of_each.score), self.free))
        fitted = np.tile(rows.T @ self.fitted_rows, (times, 1))
        np.multiply(pulled.T @ self.white_arms, fitted, out=cross[:, :n])
        share = np.tile(rows.T @ self.share, (times, 1))
        cross[:, n:] = np.einsum("kl,ak,lau->ku", share, pulled, self._white_beside, optimize=True)
        return cross

    @cached_property
    def _inverse_factor(self) -> Array:
        """(free, free) L^-1, L the lower Cholesky factor of H; undefined above its diagonal."""
        information = self.minimum.information[: self.free, : self.free]
        # The upper triangle is the lower one in the order of Fortran, so no second copy is made.
        factor, failed = dpotrf(information.T, lower=True, clean=False)
        if failed:
            raise np.linalg.LinAlgError("the information is not positive definite")
        # Products take half as long as solutions of triangular equations.
        return np.asarray(dtrtri(factor, lower=True, overwrite_c=True)[0])

    def half_solved(self, cross: Array, *, overwrite: bool = False) -> Array:
        """Return (free, k) L^-1 cross' of (k, free)."""
        factor = self._inverse_factor
        return np.asarray(dtrmm(1.0, factor, cross.T, lower=True, overwrite_b=overwrite))

    def solved(self, half: Array) -> Array:
        """Return (free, k) L^-1' of (free, k), which is H^-1 cross' of `half_solved` cross'."""
        return np.asarray(dtrmm(1.0, self._inverse_factor, half, lower=True, trans_a=1))

    def left_by_fit(self, white: Array) -> Array:
        """Return (R, 3) what the unknowns of the fit, moved by it, leave of (R, 3) S^-1/2 J."""
        moved = self.solved(self.half_solved(self.cross(white[:, :, None])))[:, 0]
        return white - self.white_change(moved)


@dataclass(frozen=True, eq=False)
class OfEach:
    """J of k parameters that belong to one actuator each: products of arms and rows."""

    arms: Array  # (3, k)
    # Makes (R, k), or (R, k / 2) if x and y have the same: only when needed, as it is as large as
    # the readings
    rows: Callable[[], Array]
    # (k,) sum of J' S^-1 rho, and the diagonal of the sum of J' S^-1 J
    score: Array
    whole: Array
    # Makes the derivatives of the parameters of a few actuators at a time
    parts: Callable[[], Iterator[Derivative]] | None = None


@dataclass(frozen=True, eq=False)
class Columns:
    """Sums over the rows of a fit, of K columns of readings of k different means over groups."""

    slices: dict[str, slice]  # the columns of each field
    kind: NDArray[np.intp]  # (K,) which of the k means a column has
    # (K, n) and (K, K, n) of what pooled rows leave, of each actuator; 0 if readings are dependent
    score: Array
    gram: Array
    own: Array  # (K, K, n) sums of products within groups, where columns differ from their means
    square: Array  # (k, k, n) sums over the R rows of products of U' r h e
    jacobian: Array  # (R, 3, k) J of sizes that all actuators share
    pull: Array  # (3, k, n) sums over the R rows of S^-1/2 rho times U' r h e
    noise: Array  # (n,) s^2


def mixed(mix: Array, values: Array, other: Array) -> Array:
    """Return (k, l, n) mix' v other of values v (K, L, n) of each actuator."""
    return np.asarray(np.einsum("kl,kmn,mo->lon", mix, values, other, optimize=True))


@dataclass(frozen=True, eq=False)
class Derivative:
    """The derivative of a fit with respect to k parameters of an effect."""

    count: int  # k
    jacobian: Array | None = None  # (R, 3, k) J; None if each actuator has parameters of its own
    of_each: OfEach | None = None  # J of these
    # The columns of an effect on readings, and (K, m) their sizes by the m parameters that all
    # actuators share, or that each has
    columns: Columns | None = None
    weights: Array | None = None
    remove: Removal | None = None  # takes (k,) parameters out of the balance, or of the arms
    # Makes (k, n) D_te on alpha and (k, k) D_tt; None if noise of fitted readings does not bias the
    # score
    spurious: Callable[[], tuple[Array, Array | float]] | None = None
    # Indices of the actuators that have parameters; None if all, or if parameters are shared
    actuators: NDArray[np.intp] | None = None
    # (n,) of (K, n) parameters of each actuator, along which they have a spread of their own
    direction: Array | None = None

    @cached_property
    def some(self) -> Some:
        """The actuators that have parameters."""
        return slice(None) if self.actuators is None else self.actuators

    def sizes(self, theta: Array) -> Array | float:
        """Return (K, n) sizes of the columns of each actuator, from (k,) parameters."""
        if self.weights is None or self.columns is None:
            return 0.0
        if self.of_each is None:
            return (self.weights @ theta)[:, None]
        sizes = np.zeros(self.columns.score.shape)
        sizes[:, self.some] = self.weights @ theta.reshape(self.weights.shape[1], -1)
        return sizes

    @cached_property
    def score(self) -> Array:
        """(k,) score by the residual of the means; 0 if it does not depend on the effect."""
        if self.columns is None or self.weights is None:
            return np.zeros(self.count)
        each = self.weights.T @ self.columns.score
        return np.asarray(each.sum(axis=1) if self.of_each is None else each[:, self.some].ravel())

    @cached_property
    def information(self) -> Array | None:
        """(m, m, n) information of each actuator by the residual of the means; None without."""
        if self.columns is None or self.weights is None or not self.columns.gram.any():
            return None
        each = mixed(self.weights, self.columns.gram, self.weights)
        return np.asarray(each if self.of_each is None else each[:, :, self.some])


def residual_information(one: Derivative, other: Derivative) -> Array | float:
    """Return (k, l) information of two effects by the residual of the means."""
    if one.columns is None or one.weights is None or other.weights is None:
        return 0.0
    each = mixed(one.weights, one.columns.gram, other.weights)
    m, o, n = each.shape
    if one.of_each is None and other.of_each is None:
        return np.asarray(each.sum(axis=2))
    if one.of_each is None:
        return np.asarray(each[:, :, other.some].reshape(m, -1))
    if other.of_each is None:
        return np.asarray(np.moveaxis(each[:, :, one.some], 2, 1)).reshape(-1, o)
    whole, at = np.zeros((m, n, o, n)), np.arange(n)
    whole[:, at, :, at] = np.moveaxis(each, 2, 0)
    return whole[:, at[one.some]][:, :, :, at[other.some]].reshape(one.count, other.count)


@dataclass(frozen=True, eq=False)
class _White:
    """S^-1/2 J of k parameters: (R, 3, k), or (3, k) of each actuator times its (R, k) rows."""

    rows: Array
    pulled: Array | None

    @classmethod
    def of(cls, fit: FittedRows, derivative: Derivative) -> _White:
        of_each = derivative.of_each
        if of_each is not None:
            return cls(of_each.rows(), fit.root @ of_each.arms)
        jacobian = np.asarray(derivative.jacobian)
        return cls(np.einsum("ab,rbk->rak", fit.root, jacobian, optimize=True), None)

    def dot(self, other: _White) -> Array:
        """Return (k, l) sum of J' S^-1 J."""
        k, o = self.rows.shape[-1], other.rows.shape[-1]
        if self.pulled is None and other.pulled is None:
            return np.asarray(self.rows.reshape(-1, k).T @ other.rows.reshape(-1, o))
        if self.pulled is not None and other.pulled is None:
            return other.dot(self).T
        assert other.pulled is not None
        times = other.pulled.shape[1] // o
        if self.pulled is None:
            each = np.tensordot(self.rows, other.rows, axes=(0, 0))  # (3, k, l)
            return np.asarray(np.einsum("akl,al->kl", np.tile(each, times), other.pulled))
        square = np.tile(self.rows.T @ other.rows, (self.pulled.shape[1] // k, times))
        return np.asarray((self.pulled.T @ other.pulled) * square)


@dataclass(frozen=True, eq=False)
class Scored:
    """Score and information of effects at a fit; k parameters, `free` unknowns of the fit."""

    fit: FittedRows  # the fit
    derivatives: tuple[Derivative, ...]
    score: Array  # (k,) U_t
    balance: Array  # (k, k) the part of M_tt by the balance
    residual: Array  # (k, k) and by the residual of the means
    half: Array  # (free, k) L^-1 (M_te - D_te)', L the Cholesky factor of H
    # (k, n) D_te on alpha, None if there is none, and (k, k) D_tt
    spurious: Array | None
    spurious_information: Array | float
    white: tuple[_White, ...] = ()

    @cached_property
    def joint(self) -> Array:
        """(k, k) M_tt."""
        return np.asarray(self.balance + self.residual)

    @cached_property
    def whole(self) -> Array:
        """(k,) diagonal of M_tt: the information if all else were known."""
        return np.diag(self.joint).copy()

    @cached_property
    def moves(self) -> Array:
        """(k, free) B."""
        return self.fit.solved(self.half).T

    @cached_property
    def by_balance(self) -> Array:
        """(k, k) information on the effects by the balance, if the fit is free."""
        return np.asarray(self.balance - self.spurious_information - self.half.T @ self.half)

    @cached_property
    def information(self) -> Array:
        """(k, k) H_tt - H_te H^-1 H_et: information on the effects if all else is free."""
        return np.asarray(self.by_balance + self.residual)

    def with_others(self, others: Scored) -> Array:
        """Return (k, l) the same of these effects and others."""
        blocks = [
            [a.dot(b) + residual_information(one, other)
             for other, b in zip(others.derivatives, others.white, strict=True)]
            for one, a in zip(self.derivatives, self.white, strict=True)
        ]  # fmt: skip
        return np.asarray(np.block(blocks) - self.half.T @ others.half)

    @cached_property
    def variance(self) -> Array:
        """(k, k) V."""
        variance, n = self.joint - self.half.T @ self.half, self.fit.problem.n
        minimum = self.fit.minimum
        # B M B' = (M_te - D_te) B' + B D B', as M = H + D at the fit.
        if minimum.noise_share > NEGLIGIBLE_NOISE_SHARE:
            on_alpha, noise = self.moves[:, :n], minimum.noise_information
            less = on_alpha @ noise.root.T
            variance += (on_alpha * noise.diagonal) @ on_alpha.T - less @ less.T
        if self.spurious is not None:
            both = self.spurious @ self.moves[:, :n].T
            variance -= both + both.T
        return np.asarray(variance)


def scored(fit: FittedRows, *derivatives: Derivative) -> Scored:
    """Return score and information of some effects."""
    n, white = fit.problem.n, tuple(_White.of(fit, each) for each in derivatives)
    ends = np.cumsum([each.count for each in derivatives])
    at = [slice(end - each.count, end) for end, each in zip(ends, derivatives, strict=True)]
    score, cross = np.empty(ends[-1]), np.empty((ends[-1], fit.free))
    balance, residual = np.empty((2, ends[-1], ends[-1]))
    spurious, spurious_information = np.zeros((ends[-1], n)), np.zeros((ends[-1],) * 2)
    biased = False
    for first, (one, of_one, k) in enumerate(zip(derivatives, white, at, strict=True)):
        if one.of_each is None:
            score[k] = of_one.rows.reshape(-1, one.count).T @ fit.white_rho
            cross[k] = fit.cross(of_one.rows)
        else:
            assert of_one.pulled is not None
            score[k] = one.of_each.score
            cross[k] = fit.cross_of_each(one.of_each, of_one.rows, of_one.pulled)
        score[k] += one.score
        if one.spurious is not None:
            biased = True
            spurious[k], spurious_information[k, k] = one.spurious()
            cross[k, :n] -= spurious[k]  # M_te - D_te
        for other, of_other, j in list(zip(derivatives, white, at, strict=True))[first:]:
            balance[k, j] = of_one.dot(of_other)
            residual[k, j] = residual_information(one, other)
            balance[j, k], residual[j, k] = balance[k, j].T, residual[k, j].T
    half = fit.half_solved(cross, overwrite=True)
    return Scored(
        fit, derivatives, score, balance, residual, half,
        spurious if biased else None, spurious_information, white,
    )  # fmt: skip


def variance_at_least(fit: FittedRows, derivative: Derivative) -> tuple[Array, Array, Array] | None:
    """Return U_t, the diagonal of M_tt, and a lower bound of the diagonal of V, (k,) each.

    For many parameters, at a cost of O(n) each. V is the information in the residual of the means
    plus a covariance by the balance, whose diagonal is not negative except for D, which is left
    out. If the residual contains no information, that of V itself, a few actuators at a time. None
    if neither can be computed.
    """
    of_each = derivative.of_each
    if of_each is None:
        return None
    if of_each.parts is not None:
        blocks = []  # x, then y, of some actuators
        for part in of_each.parts():
            result = scored(fit, part)
            if fit.minimum.noise_share > NEGLIGIBLE_NOISE_SHARE:
                least = np.diag(result.variance)
            else:
                least = (1 - 2 * NEGLIGIBLE_NOISE_SHARE) * result.whole
                least -= np.sum(result.half**2, axis=0)
            blocks.append(least.reshape(2, -1))
        return of_each.score, of_each.whole, np.hstack(blocks).ravel()
    information = derivative.information
    if information is None:
        return None
    of_means = np.einsum("kkn->kn", information).ravel()
    least = of_means - 2 * NEGLIGIBLE_NOISE_SHARE * of_each.whole
    return of_each.score + derivative.score, of_each.whole + of_means, least
