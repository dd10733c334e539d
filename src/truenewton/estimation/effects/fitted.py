"""A fit, and what the score of an effect needs of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.imbalance import imbalance_covariance
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem
from truenewton.linalg import mirrored


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
        What several effects need of it, by name, once found.
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
    def rows(self) -> Array:
        """(R, n) y = U' r c [N]."""
        return self.moments.pooling.rows(self.moments.mean)

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
        return self.rows @ self.scaled_arms.T + known + self.share @ k

    @cached_property
    def white_rho(self) -> Array:
        """(3 R,) S^-1/2 rho."""
        return (self.rho @ self.root.T).ravel()

    @cached_property
    def fitted_rows(self) -> Array:
        """(R, n) c^ = y - P rho, the likeliest noiseless rows [N]."""
        p = (self.scaled_arms * self.problem.noise.in_balance).T @ self.root.T @ self.root
        return self.rows - self.rho @ p.T

    @cached_property
    def fitted(self) -> Array:
        """(g, n) the same of every group [N]."""
        return self.moments.pooling.groups(self.fitted_rows)

    @property
    def recorded(self) -> Array:
        """(g, n) the same as recorded, with what is being taken out: coils bend by that [N]."""
        return self.fitted + self.removed

    @cached_property
    def apart(self) -> Array:
        """(g, n) what pooled rows leave of the means, c - U y [N]."""
        return self.moments.mean - self.moments.pooling.groups(self.rows)

    @cached_property
    def noise_covariance(self) -> Array:
        """(n, n) V of the noise that fitted rows carry still [N^2]."""
        taken = self.root @ (self.scaled_arms * self.problem.noise.variance)
        return np.diag(self.problem.noise.variance) - self.problem.noise.share * taken.T @ taken

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
        jacobian = np.empty((len(self.rows), 3, self.free))
        np.multiply(self.white_arms[None], self.fitted_rows[:, None], out=jacobian[:, :, :n])
        jacobian[:, :, n:] = np.tensordot(self.share, self.white_beside, axes=1)
        return jacobian.reshape(-1, self.free)

    @cached_property
    def information_factor(self) -> Array:
        """(free, free) lower Cholesky factor of H."""
        information = mirrored(self.minimum.information[: self.free, : self.free])
        return np.asarray(scipy.linalg.cholesky(information, lower=True, check_finite=False))

    def half_solved(self, cross: Array) -> Array:
        """Return (free, k) L^-1 cross' of (k, free), L the Cholesky factor of H."""
        solve = scipy.linalg.solve_triangular
        return np.asarray(solve(self.information_factor, cross.T, lower=True, check_finite=False))

    def solved_half(self, half: Array) -> Array:
        """Return (k, free) cross H^-1 from the half of it."""
        factor, solve = self.information_factor, scipy.linalg.solve_triangular
        return np.asarray(solve(factor, half, lower=True, trans=1, check_finite=False).T)
