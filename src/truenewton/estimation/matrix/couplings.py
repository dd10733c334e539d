"""Couplings between the actuators of a matrix, and the positions that they imply.

Rigid motions cost a stiffness K no force: K (x, y) = 0. An error of one position costs that error
times its column. Rows give the same of the position of the force. A gain of sensor or coil costs as
much for piston as well, and a single wrong row or column shows on one side only.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from truenewton.arrays import Array
from truenewton.estimation.findings.code import LIMITS

MIN_JUDGED_ACTUATORS = 20  # actuators among which one can be recognised as an outlier
STRONG_COUPLING = 0.05  # relative to both diagonal elements: minimum of a pair that is used
# Pairs above this coupling have equal weight, so that one wrong element does not dominate.
EQUAL_WEIGHT_COUPLING = 0.1
NEAR_SPACINGS = 6.0  # spacings within which actuators are coupled noticeably
MIN_PLACE_DISTANCE = 0.3  # spacings from its X and Y, beyond which an actuator is misplaced
ELSEWHERE = "not at its X and Y"


def relative_couplings(k: Array) -> Array:
    """Return (n, n) elements relative to the diagonal elements of both actuators."""
    own = np.sqrt(np.abs(np.diag(k)))
    stiff = own > 0.0
    own = np.where(stiff, own, np.median(own[stiff]) if stiff.any() else 1.0)
    return np.asarray(k / np.outer(own, own))


def pair_ratios(k: Array, start: Array | None = None) -> tuple[Array, Array]:
    """Return (n,) log alpha from symmetry, with median 0, and the (n, n) misfit of strong pairs.

    Least absolute deviations of log(k_ij / k_ji) = log alpha_j - log alpha_i. Weights are the
    squared coupling, limited at `EQUAL_WEIGHT_COUPLING`. The misfit is NaN where a pair is weak,
    infinite where its elements differ in sign. From a (n,) log alpha nearby, ``start``, few steps
    are needed.
    """
    c, n = np.abs(relative_couplings(k)), len(k)
    linked = np.maximum(c, c.T) > STRONG_COUPLING
    np.fill_diagonal(linked, False)
    i, j = pairs = np.nonzero(np.triu(linked & (k * k.T > 0.0)))
    ratio = np.log(k[i, j] / k[j, i])
    weight = np.minimum(c[i, j] * c[j, i], EQUAL_WEIGHT_COUPLING**2)
    log_alpha, robust = np.zeros(n), weight
    if start is not None:
        log_alpha = start
        robust = weight / np.maximum(np.abs(ratio - (start[j] - start[i])), 1e-3)
    laplacian = np.empty((n, n))
    for _ in range(50 if start is None else 5):
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
    """Return the median distance to the nearest actuator, in the unit of (3, n) arms."""
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2])
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


def displaced(k: Array, arms: Array) -> Array:
    """Return the (3, n) errors of the positions by an (n, n) stiffness, 0 except for a few.

    All alpha are about equal, and the arms are those of the declared positions. The most expensive
    position is corrected first, as long as each explains most of the remaining cost.
    """
    given, arms, spacing = arms, arms.copy(), typical_spacing(arms)
    for _ in range(max(1, int(LIMITS.misfit_fraction * len(k)))):
        (i, shift, left), (j, other, other_left) = (_farthest(one, arms) for one in (k, k.T))
        far = float(np.linalg.norm(shift))
        # Force and sensor are found at about the same position, which explains most of the cost.
        alike = i == j and float(np.linalg.norm(shift - other)) < 0.3 * far
        if not (alike and far > MIN_PLACE_DISTANCE * spacing and max(left, other_left) < 0.5):
            break
        if not _is_free(arms[1:].T, i, arms[1:, i] + shift, typical_spacing(arms)):
            break
        arms[1:, i] += shift
    return arms - given


def _farthest(k: Array, arms: Array) -> tuple[int, Array, float]:
    """Return the most expensive position, its (2,) error, and the part of the cost that remains."""
    square, cost = np.sum(k**2, axis=0), k @ arms.T
    gain, *move = -(k.T @ cost / square[:, None]).T
    shift = np.array(move) - gain / arms[0] * arms[1:]
    i = int(np.argmax(square * np.sum(shift**2, axis=0)))
    left = np.sum((cost[:, 1:] + np.outer(k[:, i], shift[:, i])) ** 2)
    return i, shift[:, i], float(left / max(np.sum(cost[:, 1:] ** 2), 1e-300))


def _is_free(places: Array, i: int, there: Array, spacing: float) -> bool:
    """Return whether no other of (n, 2) positions is near (2,) ``there``."""
    others = np.linalg.norm(np.delete(places, i, axis=0) - there, axis=1)
    return bool(others.min() > 0.5 * spacing)
