"""A fit, and what the score of an effect needs of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

from truenewton.arrays import Array
from truenewton.estimation.imbalance import imbalance_covariance
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem


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
    struck
        Indices of the actuators whose effect that is, where it is that of single ones.
    found
        What several effects do to readings, by their field, once found.
    """

    problem: Problem
    moments: Moments
    minimum: Minimum
    independent: bool
    removed: Array | float = 0.0
    struck: NDArray[np.intp] | None = None
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

    def fitted(self, some: slice = slice(None)) -> Array:
        """Return (g, b) the same of every group, of some actuators [N]."""
        return self.moments.pooling.groups(self.fitted_rows[:, some])

    def apart(self, some: slice = slice(None)) -> Array:
        """Return (g, b) what pooled rows leave of the means of some actuators, c - U y [N]."""
        rows = self.fitted_rows[:, some] + self.rho @ self._p[:, some]
        return np.asarray(self.moments.mean[:, some] - self.moments.pooling.groups(rows))

    @cached_property
    def taken(self) -> Array:
        """(3, n) what S takes from Sigma: V = Sigma - taken' taken."""
        noise = self.problem.noise
        return np.asarray(np.sqrt(noise.share) * (self.root @ (self.scaled_arms * noise.variance)))

    def recorded(self, some: slice = slice(None)) -> Array:
        """Return (g, b) c^ as recorded, with what is being taken out: coils bend by that [N]."""
        removed = self.removed if isinstance(self.removed, float) else self.removed[:, some]
        return self.fitted(some) + removed

    def noise_covariance(self, some: slice | NDArray[np.intp] = slice(None)) -> Array:
        """Return (b, n) V of the noise that fitted rows carry still, of some actuators [N^2]."""
        rows = np.arange(self.problem.n)[some]
        covariance = np.asarray(-self.taken[:, some].T @ self.taken)
        covariance[np.arange(len(rows)), rows] += self.problem.noise.variance[some]
        return covariance

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
    def information_factor(self) -> Array:
        """(free, free) lower Cholesky factor of H; above its diagonal stands anything."""
        information = self.minimum.information[: self.free, : self.free]
        # The upper triangle is the lower one in the order of Fortran, so no second copy is made.
        factor, failed = dpotrf(information.T, lower=True, clean=False)
        if failed:
            raise np.linalg.LinAlgError("the information is not positive definite")
        return np.asarray(factor)

    def half_solved(self, cross: Array) -> Array:
        """Return (free, k) L^-1 cross' of (k, free), L the Cholesky factor of H."""
        solve = scipy.linalg.solve_triangular
        return np.asarray(solve(self.information_factor, cross.T, lower=True, check_finite=False))

    def solved_half(self, half: Array) -> Array:
        """Return (k, free) cross H^-1 from the half of it."""
        factor, solve = self.information_factor, scipy.linalg.solve_triangular
        return np.asarray(solve(factor, half, lower=True, trans=1, check_finite=False).T)
