"""The imbalance rho = A diag(alpha) c + k of readings c, in terms of its noise.

What noise of covariance Sigma in the readings makes of it is S = A diag(alpha) Sigma diag(alpha) A'
(docs/likelihood.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array


def imbalance_covariance(scaled_arms: Array, variance: Array) -> Array:
    """Return (3, 3) S [N^2, N^2 m, N^2 m^2].

    Parameters
    ----------
    scaled_arms
        (3, n) A diag(alpha).
    variance
        (n,) of one reading, the diagonal of Sigma [N^2].
    """
    return np.asarray((scaled_arms * variance) @ scaled_arms.T)


def squared_distances(rho: Array, weight: Array, s: Array) -> Array:
    """Return (g,) squared Mahalanobis distances r rho' S^-1 rho.

    Parameters
    ----------
    rho, weight
        (g, 3) imbalances [N, N m, N m] and (g,) weights r.
    s
        (3, 3) covariance of the imbalance of one reading.
    """
    return np.asarray(weight * np.einsum("gk,gk->g", rho, np.linalg.solve(s, rho.T).T))


def standing_out(rho: Array, scaled_arms: Array, s: Array) -> NDArray[np.int64]:
    """Return (g,) the index of the actuator whose reading alone would best explain each imbalance.

    Parameters
    ----------
    rho
        (g, 3) imbalances [N, N m, N m].
    scaled_arms
        (3, n) A diag(alpha).
    s
        (3, 3) covariance of the imbalance of one reading.
    """
    weighed = np.linalg.solve(s, scaled_arms)
    pull = (rho @ weighed) ** 2 / np.einsum("kn,kn->n", scaled_arms, weighed)
    return np.asarray(pull.argmax(axis=1))
