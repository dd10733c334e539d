"""Couplings between the actuators of a matrix, and the positions that they imply.

Where actuators are seen to stand, by forces or displacements that balance.

Of three vectors that span T A diag(alpha), A the arms, any (3, 3) T and alpha, T follows from the
places as they are given, by least squares that leave out what lies far (direct linear
transformation); its inverse shows each actuator where it stands, whatever its alpha.

Of a stiffness K, which rigid motions cost nothing, K (x, y) = 0: what one place is wrong by costs
that times its column. Rows say the same of where its force acts. A gain of sensor or coil costs as
much for piston as well, and one wrong row or column is seen from one side only.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from truenewton.arrays import Array

STRONG_COUPLING = 0.05  # coupling in terms of both own stiffnesses, from which a pair counts
# Coupling from which pairs count alike: one wrong element is not to outweigh the rest.
EQUAL_WEIGHT_COUPLING = 0.1
NEAR_SPACINGS = 6.0  # spacings


def relative_couplings(k: Array) -> Array:
    """Return (n, n) elements in terms of the own stiffness of both actuators."""
    own = np.sqrt(np.abs(np.diag(k)))
    stiff = own > 0.0
    own = np.where(stiff, own, np.median(own[stiff]) if stiff.any() else 1.0)
    return np.asarray(k / np.outer(own, own))


def pair_ratios(k: Array, start: Array | None = None) -> tuple[Array, Array]:
    """Return (n,) log alpha from symmetry, with median 0, and the (n, n) misfit of strong pairs.

    Least absolute deviations of log(k_ij / k_ji) = log alpha_j - log alpha_i, weights the squared
    coupling up to `EQUAL_WEIGHT_COUPLING`. The misfit is NaN where a pair is weak, infinite where
    its elements differ in sign. From an (n,) log alpha nearby to ``start`` with, few steps
    are taken.
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
    """Return the median distance to the nearest actuator, in the units of (3, n) arms."""
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2])
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


ELSEWHERE = "stands elsewhere than at its X and Y"
MIN_PLACED_ACTUATORS = 20  # actuators among which one can be told to stand elsewhere
MIN_PLACE_DISTANCE = 0.3  # of the spacing: so far from its place one is seen elsewhere
FREE_DISTANCE = 0.5  # of the spacing: nobody else stands where it is seen
HOME_SPACINGS = 0.1  # of the spacing, in the median: so near their places all are seen
MIN_PLACE_RATIO = 10.0  # times what is typical
MAX_MISPLACED_FRACTION = 0.1  # of the actuators, and one at least
MIN_EXPLAINED_COST = 0.5  # of what rigid motions cost: more than this it explains
MAX_FORCE_SENSOR_DISTANCE = 0.3  # of how far it is: so near each other force and sensor are seen


def projected(seen: Array, arms: Array) -> Array:
    """Return (n, 2) where the forces of each actuator act, were most of them at (3, n) arms."""
    n = arms.shape[1]
    a = arms / np.linalg.norm(arms, axis=0)
    b = seen / np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    nothing = np.zeros(n)
    cross = np.array([[nothing, -b[2], b[1]], [b[2], nothing, -b[0]], [-b[1], b[0], nothing]])
    equations = np.einsum("uvi,wi->iuvw", cross, a).reshape(n, 3, 9)
    weight, place = np.ones(n), np.zeros((n, 2))
    for _ in range(30):  # each with what lies far left out
        gram = np.einsum("i,iup,iuq->pq", weight, equations, equations, optimize=True)
        projection = np.linalg.eigh(gram)[1][:, 0].reshape(3, 3)
        found = np.linalg.pinv(projection) @ seen
        size = np.where(np.abs(found[0]) > 1e-9 * np.abs(found).max(), found[0], np.inf)
        place = (found[1:] / size).T
        far = np.linalg.norm(place - (arms[1:] / arms[0]).T, axis=1)
        weight = 1.0 / (1.0 + (far / max(float(np.median(far)), 1e-12)) ** 2) ** 2
    return np.asarray(place)


def misplaced(seen: Array, arms: Array) -> dict[int, tuple[float, float]]:
    """Return who is seen at a place of nobody, with x and y there; none if most are not at home.

    Parameters
    ----------
    seen
        (3, n) T A diag(alpha).
    arms
        (3, n) A, by the places as they are given.
    """
    places = (arms[1:] / arms[0]).T
    size = np.sqrt(np.mean(places**2))
    found = size * projected(seen, arms / np.array([[1.0], [size], [size]]))
    own, spacing = np.linalg.norm(found - places, axis=1), typical_spacing(arms / arms[0])
    usual = float(np.median(own))
    away = np.flatnonzero(own > max(MIN_PLACE_DISTANCE * spacing, MIN_PLACE_RATIO * usual)).tolist()
    if usual > HOME_SPACINGS * spacing or len(away) > max(1, MAX_MISPLACED_FRACTION * len(own)):
        return {}
    x, y = arms[0] * found.T
    return {i: (float(x[i]), float(y[i])) for i in away if _is_free(places, i, found[i], spacing)}


def displaced(k: Array, arms: Array) -> Array:
    """Return (3, n) how far each stands from its place by an (n, n) stiffness, 0 but of a few.

    All alpha are alike, arms by the places as they are given. The one that costs most first, while
    each explains most of what is left.
    """
    given, arms, spacing = arms, arms.copy(), typical_spacing(arms)
    for _ in range(max(1, int(MAX_MISPLACED_FRACTION * len(k)))):
        (i, shift, left), (j, other, other_left) = (_farthest(one, arms) for one in (k, k.T))
        far = float(np.linalg.norm(shift))
        alike = i == j and float(np.linalg.norm(shift - other)) < MAX_FORCE_SENSOR_DISTANCE * far
        if not (
            alike
            and far > MIN_PLACE_DISTANCE * spacing
            and max(left, other_left) < MIN_EXPLAINED_COST
        ):
            break
        if not _is_free(arms[1:].T, i, arms[1:, i] + shift, typical_spacing(arms)):
            break
        arms[1:, i] += shift
    return arms - given


def _farthest(k: Array, arms: Array) -> tuple[int, Array, float]:
    """Return who costs most by its place, (2,) by how much, and which part of all is left then."""
    square, cost = np.sum(k**2, axis=0), k @ arms.T
    gain, *move = -(k.T @ cost / square[:, None]).T
    shift = np.array(move) - gain / arms[0] * arms[1:]
    i = int(np.argmax(square * np.sum(shift**2, axis=0)))
    left = np.sum((cost[:, 1:] + np.outer(k[:, i], shift[:, i])) ** 2)
    return i, shift[:, i], float(left / max(np.sum(cost[:, 1:] ** 2), 1e-300))


def _is_free(places: Array, i: int, there: Array, spacing: float) -> bool:
    """Tell whether none of (n, 2) places but that of i is at (2,) ``there``."""
    others = np.linalg.norm(np.delete(places, i, axis=0) - there, axis=1)
    return bool(others.min() > FREE_DISTANCE * spacing)
