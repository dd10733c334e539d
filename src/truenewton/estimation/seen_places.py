"""Where actuators are seen to stand, by forces or displacements that balance.

Of three vectors that span T A diag(alpha), A the arms, any (3, 3) T and alpha, T follows from the
places as they are given, by least squares that leave out what lies far (direct linear
transformation); its inverse shows each actuator where it stands, whatever its alpha.

Of a stiffness K, which rigid motions cost nothing, K (x, y) = 0: what one place is wrong by costs
that times its column. Rows say the same of where its force acts. A gain of sensor or coil costs as
much for piston as well, and one wrong row or column is seen from one side only.
"""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.couplings import typical_spacing

PASSES = 30  # of the projection, each with what lies far left out
ELSEWHERE = "stands elsewhere than at its X and Y"
FEWEST = 20  # actuators among which one can be told to stand elsewhere
FAR = 0.3  # of the spacing: so far from its place one is seen elsewhere
FREE = 0.5  # of the spacing: nobody else stands where it is seen
HOME = 0.1  # of the spacing, in the median: so near their places all are seen
CLEARLY = 10.0  # times what is typical
FEW = 0.1  # of the actuators, and one at least
LEFT = 0.5  # of what rigid motions cost: more than this it explains
ALIKE = 0.3  # of how far it is: so near each other force and sensor are seen


def projected(seen: Array, arms: Array) -> Array:
    """Return (n, 2) where the forces of each actuator act, were most of them at (3, n) arms."""
    n = arms.shape[1]
    a = arms / np.linalg.norm(arms, axis=0)
    b = seen / np.maximum(np.linalg.norm(seen, axis=0), 1e-300)
    nothing = np.zeros(n)
    cross = np.array([[nothing, -b[2], b[1]], [b[2], nothing, -b[0]], [-b[1], b[0], nothing]])
    equations = np.einsum("uvi,wi->iuvw", cross, a).reshape(n, 3, 9)
    weight, place = np.ones(n), np.zeros((n, 2))
    for _ in range(PASSES):
        gram = np.einsum("i,iup,iuq->pq", weight, equations, equations, optimize=True)
        projection = np.linalg.eigh(gram)[1][:, 0].reshape(3, 3)
        found = np.linalg.pinv(projection) @ seen
        size = np.where(np.abs(found[0]) > 1e-9 * np.abs(found).max(), found[0], np.inf)
        place = (found[1:] / size).T
        far = np.linalg.norm(place - (arms[1:] / arms[0]).T, axis=1)
        weight = 1.0 / (1.0 + (far / max(float(np.median(far)), 1e-12)) ** 2) ** 2
    return np.asarray(place)


def out_of_place(seen: Array, arms: Array) -> dict[int, tuple[float, float]]:
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
    away = np.flatnonzero(own > max(FAR * spacing, CLEARLY * usual)).tolist()
    if usual > HOME * spacing or len(away) > max(1, FEW * len(own)):
        return {}
    x, y = arms[0] * found.T
    return {i: (float(x[i]), float(y[i])) for i in away if _is_free(places, i, found[i], spacing)}


def displaced(k: Array, arms: Array) -> Array:
    """Return (3, n) how far each stands from its place by an (n, n) stiffness, 0 but of a few.

    All alpha are alike, arms by the places as they are given. The one that costs most first, while
    each explains most of what is left.
    """
    given, arms, spacing = arms, arms.copy(), typical_spacing(arms)
    for _ in range(max(1, int(FEW * len(k)))):
        (i, shift, left), (j, other, other_left) = (_farthest(one, arms) for one in (k, k.T))
        far = float(np.linalg.norm(shift))
        alike = i == j and float(np.linalg.norm(shift - other)) < ALIKE * far
        if not (alike and far > FAR * spacing and max(left, other_left) < LEFT):
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
    return bool(others.min() > FREE * spacing)
