"""What an effect is: how readings, the load or the arms change with it, and what follows of that.

With theta the parameters of an effect and g = dc/dtheta what it does to readings at fixed true
forces, the balance of pooled rows (`pooling`) and what they leave of the means change by

    J = -A diag(alpha) U' r g,        g_R = g - U U' r g,

an effect on the load or on the arms gives J alone. With rho and S of the fit, s^2 the noise of a
reading, e the unknowns of the fit and H, D as in `likelihood`:

    score          U_t = sum J' S^-1 rho - sum r g_R (c - U y) / s^2
    information    M_tt = sum J' S^-1 J + sum r g_R^2 / s^2,      M_te = sum J' S^-1 J_e
    at the fit     B = (M_te - D_te) H^-1,      V = M_tt - M_te B' - B M_et + B M B'

V is the covariance of U_t, and alpha and the rest move by -B' theta.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
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


@dataclass(frozen=True, eq=False)
class FittedRows:
    """The rows of a campaign at a fit to them (docs/effects.md).

    Attributes
    ----------
    problem, moments, minimum
        What was fitted.
    independent
        Whether readings are independent of each other, so that what pooled rows leave of the means
        tells of effects as well.
    removed
        (g, n) what an effect that is being taken out added to the readings [N].
    affected
        Indices of the actuators whose effect that is, where it is that of single ones.
    found
        What several effects do to readings, by their field, once found.
    """

    problem: Problem
    moments: Moments
    minimum: Minimum
    independent: bool
    removed: Array | float = 0.0
    affected: NDArray[np.intp] | None = None
    found: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def alpha(self) -> Array:
        """(n,) alpha."""
        return self.minimum.values[: self.problem.n]

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
    def share(self) -> Array:
        """(R, L) how much of each load a row carries."""
        return self.moments.pooling.rows(self.moments.of_load)

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

    def fitted(self, some: slice | NDArray[np.intp] = slice(None)) -> Array:
        """Return (g, b) the same of every group, of some actuators [N]."""
        return self.moments.pooling.groups(self.fitted_rows[:, some])

    @cached_property
    def _group_rho(self) -> Array:
        """(g, 3) U rho."""
        return self.moments.pooling.groups(self.rho)

    def apart(self, some: slice, fitted: Array) -> Array:
        """Return (g, b) what pooled rows leave of the means, c - U y [N], y = c^ + P rho."""
        return np.asarray(self.moments.mean[:, some] - fitted - self._group_rho @ self._p[:, some])

    @cached_property
    def taken(self) -> Array:
        """(3, n) what S takes from Sigma: V = Sigma - taken' taken."""
        noise = self.problem.noise
        return np.asarray(np.sqrt(noise.share) * (self.root @ (self.scaled_arms * noise.variance)))

    def recorded(self, some: slice | NDArray[np.intp], fitted: Array | None = None) -> Array:
        """Return (g, b) c^ as recorded, with what is being taken out: coils bend by that [N]."""
        fitted = self.fitted(some) if fitted is None else fitted
        return fitted if isinstance(self.removed, float) else fitted + self.removed[:, some]

    def noise_covariance(self, some: slice | NDArray[np.intp]) -> Array:
        """Return (b, n) V of the noise that fitted rows carry still, of some actuators [N^2]."""
        rows = np.arange(self.problem.n)[some]
        covariance = np.asarray(-self.taken[:, some].T @ self.taken)
        covariance[np.arange(len(rows)), rows] += self.problem.noise.variance[some]
        return covariance

    def feigned_by_each(self, some: slice | NDArray[np.intp]) -> Array:
        """Return (b, n) alpha_i (A' S^-1 A)_ij V_ij of some actuators i."""
        gram = self.white_arms[:, some].T @ self.white_arms
        return np.asarray(self.alpha[some, None] * gram * self.noise_covariance(some))

    @cached_property
    def feigned_by_all(self) -> Array:
        """(n,) the same summed over i: of matrices of rank 3, but for a diagonal."""
        white, taken = self.white_arms, self.taken
        both = (self.alpha * white) @ taken.T
        each = self.alpha * np.sum(white**2, axis=0) * self.problem.noise.variance
        return np.asarray(each - np.sum(white * (both @ taken), axis=0))

    @cached_property
    def free(self) -> int:
        """How many unknowns are free."""
        prior = self.problem.prior
        return len(self.minimum.values) - (prior.measured if prior.held else 0)

    @cached_property
    def white_arms(self) -> Array:
        """(3, n) S^-1/2 A."""
        return np.asarray(self.root @ self.problem.a)

    @cached_property
    def white_beside(self) -> Array:
        """(L, 3, free - n) S^-1/2 dk/dpsi of each load."""
        nuisance = self.problem.data(self.moments)[0].nuisance
        return np.asarray(self.root @ nuisance[:, :, : self.free - self.problem.n])

    @cached_property
    def white_jacobian(self) -> Array:
        """(3 R, free) S^-1/2 J of alpha and the unknowns beside it."""
        n = self.problem.n
        jacobian = np.empty((len(self.fitted_rows), 3, self.free))
        np.multiply(self.white_arms[None], self.fitted_rows[:, None], out=jacobian[:, :, :n])
        jacobian[:, :, n:] = np.tensordot(self.share, self.white_beside, axes=1)
        return jacobian.reshape(-1, self.free)

    def cross(self, white: Array) -> Array:
        """Return (k, free) sum of J' S^-1 J_e of (R, 3, k) S^-1/2 J."""
        count, _, k = white.shape
        n = self.problem.n
        cross = np.empty((k, self.free))
        on_rows = (white.reshape(count, 3 * k).T @ self.fitted_rows).reshape(3, k, n)
        np.einsum("akn,an->kn", on_rows, self.white_arms, out=cross[:, :n])
        on_loads = (white.reshape(count, 3 * k).T @ self.share).reshape(3, k, -1)
        cross[:, n:] = np.einsum("akl,lau->ku", on_loads, self.white_beside)
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

    def half_solved(self, cross: Array) -> Array:
        """Return (free, k) L^-1 cross' of (k, free)."""
        return np.asarray(dtrmm(1.0, self._inverse_factor, cross.T, lower=True))

    def solved(self, half: Array) -> Array:
        """Return (free, k) L^-1' of (free, k), which is H^-1 cross' of `half_solved` cross'."""
        return np.asarray(dtrmm(1.0, self._inverse_factor, half, lower=True, trans_a=1))


NEGLIGIBLE_NOISE_SHARE = 1e-3  # share of D in terms of H, below which it is not worth its products

Removal = Callable[[Problem, Moments, Array], tuple[Problem, Moments]]


@dataclass(frozen=True, eq=False)
class OfEach:
    """J of k parameters that belong to one actuator each: arms and rows multiplied by elements.

    Attributes
    ----------
    arms
        (3, k).
    rows
        Makes (R, k), or (R, k / 2) where x and y have the same: only where they are needed, as they
        are as large as the readings.
    score, whole
        (k,) sum of J' S^-1 rho, and the diagonal of the sum of J' S^-1 J.
    parts
        Makes the derivatives of the parameters of some actuators after the other.
    """

    arms: Array
    rows: Callable[[], Array]
    score: Array
    whole: Array
    parts: Callable[[], Iterator[Derivative]] | None = None


@dataclass(frozen=True, eq=False)
class Derivative:
    """What k parameters of an effect do at a fit.

    Attributes
    ----------
    count
        K.
    remove
        Takes an effect of (k,) parameters out of the data.
    jacobian
        (R, 3, k) J; None where each actuator has parameters of its own.
    of_each
        J of these.
    score, information
        (k,) and (k, k) of what pooled rows leave, structure, 0 where an effect says nothing of it;
        where each actuator has K parameters (K, K, n), as those of different ones share nothing.
    feigns
        Makes (k, n) D_te on alpha and (k, k) D_tt; None where noise of fitted readings feigns
        nothing.
    actuators
        Whose the parameters are, over and over; None where of all, or of none.
    direction
        (n,) of (K, n) parameters of each actuator, along which they do nothing; readings without a
        gain alone may have one.
    """

    count: int
    remove: Removal
    jacobian: Array | None = None
    of_each: OfEach | None = None
    score: Array | float = 0.0
    information: Array | float = 0.0
    feigns: Callable[[], tuple[Array, Array | float]] | None = None
    actuators: NDArray[np.intp] | None = None
    direction: Array | None = None


def without_direction(values: Array, direction: Array) -> Array:
    """Return (..., K n) values of parameters of each actuator without those along (n,) sizes."""
    unit = direction / np.linalg.norm(direction)
    each = values.reshape(*values.shape[:-1], -1, len(unit))
    return np.asarray((each - (each @ unit)[..., None] * unit).reshape(values.shape))


@dataclass(frozen=True, eq=False)
class Scored:
    """Score and information of an effect at a fit; k parameters, `free` unknowns of the fit.

    What is made of these is made when it is first asked for.

    Attributes
    ----------
    fit
        Where.
    score
        (k,) U_t.
    joint
        (k, k) M_tt.
    half
        (free, k) L^-1 (M_te - D_te)', L the Cholesky factor of H.
    feigned, feigned_information
        (k, n) D_te on alpha, None where there is none, and (k, k) D_tt.
    """

    fit: FittedRows
    score: Array
    joint: Array
    half: Array
    feigned: Array | None
    feigned_information: Array | float

    @property
    def whole(self) -> Array:
        """(k,) diagonal of M_tt: what the data would say, were all else known."""
        return np.diag(self.joint).copy()

    @cached_property
    def moves(self) -> Array:
        """(k, free) B."""
        return self.fit.solved(self.half).T

    def moves_along(self, direction: Array) -> Array:
        """Return (k,) B along one (n,) direction of alpha, without all of B."""
        whole = np.concatenate([direction, np.zeros(self.fit.free - len(direction))])
        return np.asarray((self.fit.half_solved(whole[None]).T @ self.half)[0])

    @cached_property
    def _by_fit(self) -> Array:
        return np.asarray(self.half.T @ self.half)

    @cached_property
    def information(self) -> Array:
        """(k, k) H_tt - H_te H^-1 H_et: what the data say of the effect, all else being free."""
        return np.asarray(self.joint - self.feigned_information - self._by_fit)

    @cached_property
    def variance(self) -> Array:
        """(k, k) V."""
        variance, n, minimum = self.joint - self._by_fit, self.fit.problem.n, self.fit.minimum
        # B M B' = (M_te - D_te) B' + B D B', as M = H + D at the fit.
        if minimum.noise_share > NEGLIGIBLE_NOISE_SHARE:
            on_alpha, noise = self.moves[:, :n], minimum.noise_information
            less = on_alpha @ noise.root.T
            variance += (on_alpha * noise.diagonal) @ on_alpha.T - less @ less.T
        if self.feigned is not None:
            both = self.feigned @ self.moves[:, :n].T
            variance -= both + both.T
        return np.asarray(variance)


def scored(fit: FittedRows, derivative: Derivative) -> Scored:
    """Return score and information of an effect."""
    score, joint, told = _from_balance(fit, derivative)
    joint += _of_all(derivative.information)
    feigned, feigned_information = derivative.feigns() if derivative.feigns else (None, 0.0)
    if feigned is not None:
        told[:, : fit.problem.n] -= feigned  # M_te - D_te
    score = score + derivative.score
    if derivative.direction is not None:
        left = partial(without_direction, direction=derivative.direction)
        score, joint, told = left(score), left(left(joint).T), left(told.T).T
    return Scored(fit, score, joint, fit.half_solved(told), feigned, feigned_information)


def _from_balance(fit: FittedRows, derivative: Derivative) -> tuple[Array, Array, Array]:
    """Return (k,) sum of J' S^-1 rho, (k, k) of J' S^-1 J, and (k, free) M_te."""
    if derivative.jacobian is not None:
        k = derivative.count
        white = np.einsum("ab,rbk->rak", fit.root, derivative.jacobian, optimize=True)
        flat = white.reshape(-1, k)
        return flat.T @ fit.white_rho, flat.T @ flat, fit.cross(white)
    of_each = derivative.of_each
    assert of_each is not None  # the one or the other
    rows, pulled = of_each.rows(), fit.root @ of_each.arms
    n, times = fit.problem.n, pulled.shape[1] // rows.shape[1]
    cross = np.empty((derivative.count, fit.free))
    fitted = np.tile(rows.T @ fit.fitted_rows, (times, 1))
    np.multiply(pulled.T @ fit.white_arms, fitted, out=cross[:, :n])
    share = np.tile(rows.T @ fit.share, (times, 1))
    cross[:, n:] = np.einsum("kl,ak,lau->ku", share, pulled, fit.white_beside, optimize=True)
    whole = (pulled.T @ pulled) * np.tile(rows.T @ rows, (times, times))
    return of_each.score, whole, cross


def _of_all(information: Array | float) -> Array | float:
    """Return (k, k) information, spread out where it is that of each actuator by itself."""
    if isinstance(information, float) or information.ndim == 2:
        return information
    k, _, n = information.shape
    whole = np.zeros((k, n, k, n))
    whole[:, np.arange(n), :, np.arange(n)] = np.moveaxis(information, 2, 0)
    return whole.reshape(k * n, k * n)


def variance_at_least(fit: FittedRows, derivative: Derivative) -> tuple[Array, Array, Array] | None:
    """Return U_t, the diagonal of M_tt, and what the diagonal of V is at least, (k,) each.

    Of many parameters at a cost of O(n) each. V is what the structure tells, and for the balance a
    covariance too: its diagonal cannot be less than 0, but for D where that is left out. Where the
    structure tells nothing V itself, a few actuators at a time. None where neither is to be had.
    """
    of_each = derivative.of_each
    if of_each is None or derivative.direction is not None:
        return None
    if of_each.parts is not None:
        diagonals = [np.diag(scored(fit, part).variance) for part in of_each.parts()]
        blocks = [diagonal.reshape(2, -1) for diagonal in diagonals]  # x, then y, of some actuators
        return of_each.score, of_each.whole, np.hstack(blocks).ravel()
    information = derivative.information
    if isinstance(information, float):
        return None
    told = np.einsum("kkn->kn", information).ravel()
    whole = of_each.whole + told
    return (
        of_each.score + derivative.score,
        whole,
        told - 2 * NEGLIGIBLE_NOISE_SHARE * of_each.whole,
    )
