"""Couplings of a stiffness matrix: how large, how far they reach, and what pairs say of alpha."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array

STRONG = 0.05  # coupling in terms of both own stiffnesses, from which a pair counts
EVEN = 0.1  # coupling from which pairs count alike: one wrong element is not to outweigh the rest
NEAR = 6.0  # spacings


def relative_couplings(k: Array) -> Array:
    """Return (n, n) elements in terms of the own stiffness of both actuators."""
    own = np.sqrt(np.abs(np.diag(k)))
    stiff = own > 0.0
    own = np.where(stiff, own, np.median(own[stiff]) if stiff.any() else 1.0)
    return np.asarray(k / np.outer(own, own))


def pair_ratios(k: Array) -> tuple[Array, Array]:
    """Return (n,) log alpha from symmetry, with median 0, and the (n, n) misfit of strong pairs.

    Least absolute deviations of log(k_ij / k_ji) = log alpha_j - log alpha_i, weights the squared
    coupling up to `EVEN`. The misfit is NaN where a pair is weak, infinite where its elements
    differ in sign.
    """
    c, n = np.abs(relative_couplings(k)), len(k)
    linked = np.maximum(c, c.T) > STRONG
    np.fill_diagonal(linked, False)
    same = linked & (k * k.T > 0.0)
    ratio = np.zeros_like(k)
    ratio[same] = np.log(k[same] / k.T[same])
    weight = np.where(same, np.minimum(c * c.T, EVEN**2), 0.0)
    log_alpha, robust = np.zeros(n), weight
    for _ in range(50):
        laplacian = np.diag(robust.sum(axis=1)) - robust
        own = np.diag(laplacian)
        held = float(np.median(own[own > 0.0])) if own.any() else 1.0
        laplacian += held / n + 1e-9 * held * np.eye(n)
        before = log_alpha
        log_alpha = np.linalg.solve(laplacian, -(robust * ratio).sum(axis=1))
        log_alpha -= np.median(log_alpha)
        misfit = np.abs(ratio - (log_alpha - log_alpha[:, None]))
        robust = weight / np.maximum(misfit, 1e-3)
        if np.abs(log_alpha - before).max() < 1e-4:
            break
    return log_alpha, np.where(same, misfit, np.where(linked, np.inf, np.nan))


def typical_spacing(a: Array) -> float:
    """Return the median distance to the nearest actuator, in the units of (3, n) arms."""
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2])
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))
