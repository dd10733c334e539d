"""Couplings of a stiffness matrix: how large, how far they reach, and what pairs say of alpha."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from truenewton.arrays import Array

STRONG = 0.05  # coupling in terms of both own stiffnesses, from which a pair counts
EVEN = 0.1  # coupling from which pairs count alike: one wrong element is not to outweigh the rest
NEAR = 6.0  # spacings
STEPS, FEW_STEPS = 50, 5


def relative_couplings(k: Array) -> Array:
    """Return (n, n) elements in terms of the own stiffness of both actuators."""
    own = np.sqrt(np.abs(np.diag(k)))
    stiff = own > 0.0
    own = np.where(stiff, own, np.median(own[stiff]) if stiff.any() else 1.0)
    return np.asarray(k / np.outer(own, own))


def pair_ratios(k: Array, start: Array | None = None) -> tuple[Array, Array]:
    """Return (n,) log alpha from symmetry, with median 0, and the (n, n) misfit of strong pairs.

    Least absolute deviations of log(k_ij / k_ji) = log alpha_j - log alpha_i, weights the squared
    coupling up to `EVEN`. The misfit is NaN where a pair is weak, infinite where its elements
    differ in sign. From an (n,) log alpha nearby to ``start`` with, few steps are taken.
    """
    c, n = np.abs(relative_couplings(k)), len(k)
    linked = np.maximum(c, c.T) > STRONG
    np.fill_diagonal(linked, False)
    i, j = pairs = np.nonzero(np.triu(linked & (k * k.T > 0.0)))
    ratio = np.log(k[i, j] / k[j, i])
    weight = np.minimum(c[i, j] * c[j, i], EVEN**2)
    log_alpha, robust = np.zeros(n), weight
    if start is not None:
        log_alpha = start
        robust = weight / np.maximum(np.abs(ratio - (start[j] - start[i])), 1e-3)
    laplacian = np.empty((n, n))
    for _ in range(STEPS if start is None else FEW_STEPS):
        own = np.bincount(i, robust, n) + np.bincount(j, robust, n)
        held = float(np.median(own[own > 0.0])) if own.any() else 1.0
        laplacian[:] = held / n
        laplacian[i, j] -= robust
        laplacian[np.diag_indices(n)] += own + 1e-9 * held
        pull = np.bincount(j, robust * ratio, n) - np.bincount(i, robust * ratio, n)
        before = log_alpha
        log_alpha = dposv(laplacian, pull)[1]
        log_alpha -= np.median(log_alpha)
        misfit = np.abs(ratio - (log_alpha[j] - log_alpha[i]))
        robust = weight / np.maximum(misfit, 1e-3)
        if np.abs(log_alpha - before).max() < 1e-4:
            break
    left = np.where(linked, np.inf, np.nan)
    left[pairs] = left[pairs[::-1]] = misfit
    return log_alpha, left


def typical_spacing(a: Array) -> float:
    """Return the median distance to the nearest actuator, in the units of (3, n) arms."""
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2])
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))
