"""The imbalance rho = A diag(alpha) c + k of readings c, in terms of its noise.

What noise of covariance Sigma in the readings makes of it is S = A diag(alpha) Sigma diag(alpha) A'
(docs/likelihood.md). Its three numbers are in N, N m and N m; A diag(alpha) are the scaled arms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import chi2_ppf

MEDIAN_CHI2 = chi2_ppf(0.5, 3)  # of the squared distance of an imbalance


def imbalance_covariance(scaled_arms: Array, variance: Array) -> Array:
    """Return (3, 3) S, from (3, n) scaled arms and the (n,) variance of one reading [N^2]."""
    return np.asarray((scaled_arms * variance) @ scaled_arms.T)


def squared_distances(rho: Array, weight: Array, s: Array) -> Array:
    """Return (g,) r rho' S^-1 rho of (g, 3) imbalances with (g,) weights r."""
    return np.asarray(weight * np.einsum("gk,gk->g", rho, np.linalg.solve(s, rho.T).T))


def standing_out(rho: Array, scaled_arms: Array, s: Array) -> NDArray[np.int64]:
    """Return (g,) whose reading, of the n actuators, would best explain each imbalance alone."""
    weighed = np.linalg.solve(s, scaled_arms)
    pull = (rho @ weighed) ** 2 / np.einsum("kn,kn->n", scaled_arms, weighed)
    return np.asarray(pull.argmax(axis=1))
