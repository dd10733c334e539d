"""Actuators and sensors that do not obey reciprocity: found before any fit, and left free.

A stiffness in which set B pushes nothing knows neither the alpha nor the sensors of B, whatever
linear nonsense these read:

    K <- K_GG - K_GB K_BB^-1 K_BG
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.matrix_faults import condensed
from truenewton.estimation.reciprocity.known_noise import Regressed
from truenewton.estimation.reciprocity.sight import Places

NEIGHBOURS = 12  # whose forces an actuator's displacement tells best
FAR = 4.0  # times the median asymmetry of a row: beyond it an actuator is left free
MOST = 0.03  # of the actuators, and two at least, may be left free
CANDIDATES = 8  # that are tried: neighbours of a bad actuator stand out as well
ROUNDS = 50  # of medians, each of which reaches one neighbour further


def odd_actuators(stiffness: Array) -> NDArray[np.int64]:
    """Return which actuators of an (n, n) K_c are apart from the others; one more than may be left.

    Rows and columns are made alike, robustly, as far as one factor for each actuator can. While the
    asymmetry of a row stands out, that actuator among the worst goes whose absence leaves least.
    """
    n, rest = len(stiffness), stiffness
    at, found = np.arange(n), list[int]()
    while len(found) <= max(2, int(MOST * n)):
        size = _asymmetry(rest)
        if not size.max() > FAR * np.median(size):
            break
        worst = np.argsort(-size)[:CANDIDATES]
        without = [_without(rest, int(k)) for k in worst]
        best = int(np.argmin([np.sum(_asymmetry(each) ** 2) for each in without]))
        found.append(int(at[worst[best]]))
        at, rest = np.delete(at, worst[best]), without[best]
    return np.sort(np.array(found, dtype=np.int64))


def kept(stiffness: Array) -> tuple[NDArray[np.bool_], tuple[int, ...]]:
    """Return (n,) which actuators of K_c to keep; and, where too many are odd, all, with these."""
    odd = odd_actuators(stiffness)
    keep = np.ones(len(stiffness), dtype=bool)
    if len(odd) > max(2, int(MOST * len(stiffness))):
        return keep, tuple(odd.tolist())
    keep[odd] = False
    return keep, ()


def _asymmetry(stiffness: Array) -> Array:
    """Return (n,) rms asymmetry of each row over the root of its own stiffness."""
    alike = np.exp(_factors(stiffness))[:, None] * stiffness
    own = np.median(np.abs(alike), axis=1)  # that of a bad one may be anything
    typical = np.median(own) or np.inf  # 0 where most do not feel each other
    return np.asarray(np.sqrt(np.mean((alike - alike.T) ** 2, axis=1)) / typical)


def _without(stiffness: Array, k: int) -> Array:
    """Return (n - 1, n - 1) stiffness with actuator k free."""
    keep = np.arange(len(stiffness)) != k
    taken = np.outer(stiffness[keep, k], stiffness[k, keep]) / stiffness[k, k]
    return np.asarray(stiffness[np.ix_(keep, keep)] - taken)


def _factors(stiffness: Array) -> Array:
    """Return (n,) log u such that diag(u) K_c is nearly symmetric: medians over neighbours."""
    n = len(stiffness)
    with np.errstate(all="ignore"):
        ratio = np.log(stiffness / stiffness.T)  # NaN where the signs differ
    near = _nearest(np.where(np.isfinite(ratio), stiffness, 0.0))
    step = np.nan_to_num(np.take_along_axis(ratio, near, axis=1), posinf=0.0, neginf=0.0)
    factors = np.zeros(n)
    for _ in range(ROUNDS):
        factors = 0.5 * (factors + np.median(factors[near] - step, axis=1))
        factors -= np.median(factors)
    return factors


def _nearest(stiffness: Array) -> NDArray[np.int64]:
    """Return (n, k) the actuators on whose forces each one's displacement tells most, both ways."""
    strength = np.abs(stiffness * stiffness.T)
    np.fill_diagonal(strength, 0.0)
    return np.asarray(np.argsort(-strength, axis=1)[:, : min(NEIGHBOURS, len(stiffness) - 1)])


def condensed_regression(regressed: Regressed, keep: NDArray[np.bool_]) -> Regressed:
    """Return a regressed stiffness in which some of (n,) actuators are left free."""
    if keep.all():
        return regressed
    stiffness, left, right = condensed(regressed.stiffness, keep)
    return replace(
        regressed,
        stiffness=stiffness,
        square=np.linalg.inv(right.T @ np.linalg.solve(regressed.square, right)),
        noise=left @ regressed.noise @ left.T,
        coil_force=np.broadcast_to(regressed.coil_force, keep.shape)[keep],
    )


def kept_places(places: Places, keep: NDArray[np.bool_], stiffness: Array) -> Places:
    """Return the places of actuators that are kept of (n,), as (n, n) K_c lets the others move."""
    if keep.all():
        return places
    motion, changes = places.motion, places.changes
    if motion is not None:
        moved = condensed(stiffness, keep)[2]
        motion = motion[keep] @ moved
        changes = None if changes is None else changes[:, keep] @ moved
    return Places(places.x[keep], places.y[keep], places.nz[keep], motion, changes)
