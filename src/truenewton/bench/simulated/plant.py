"""The glass as the loop moves it: M z'' + C z' + K z = f, exact from sample to sample."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from truenewton.arrays import Array


def advance(stiffness: Array, mass: Array, damping: Array, period: float) -> Array:
    """Return S, (..., 2n, 3n), of the glass from one sample to the next: after = S [state; force].

    The state is (z, period z'), both in metres; the force is held for the period of a sample [s],
    over which the matrix exponential is exact. Of (..., n, n) K [N/m], M [kg], C [N s/m].
    """
    n = stiffness.shape[-1]
    joint = np.zeros((*stiffness.shape[:-2], 3 * n, 3 * n))
    joint[..., :n, n : 2 * n] = np.eye(n)
    joint[..., n : 2 * n, :n] = -(period**2) * np.linalg.solve(mass, stiffness)
    joint[..., n : 2 * n, n : 2 * n] = -period * np.linalg.solve(mass, damping)
    joint[..., n : 2 * n, 2 * n :] = period**2 * np.linalg.inv(mass)
    return np.asarray(expm(joint)[..., : 2 * n, :])
