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
from truenewton.estimation.matrix.couplings import pair_ratios
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.reciprocity.regression import Regressed
from truenewton.estimation.reciprocity.sensor_model import Places

MAX_ROW_ASYMMETRY = 4.0  # times the median asymmetry of a row: beyond it an actuator is left free
MIN_ASYMMETRY_RATIO = 2.0  # times less asymmetry that a typical row has with one of them free
MAX_FREED_FRACTION = 0.03  # of the actuators, and two at least, may be left free


def odd_actuators(stiffness: Array, start: Array | None = None) -> NDArray[np.int64]:
    """Return which actuators of an (n, n) K_c are apart from the others; one more than may be left.

    Rows and columns are made alike, robustly, as far as one factor for each actuator can. While the
    asymmetry of a row stands out, or all have less without one of the worst, that one goes whose
    absence leaves least. ``start`` is the (n,) log alpha from symmetry, if known.
    """
    at, rest = np.arange(len(stiffness)), stiffness
    ratios = pair_ratios(stiffness)[0] if start is None else start
    found, size = list[int](), _asymmetry(stiffness, ratios)
    while len(found) <= max(2, int(MAX_FREED_FRACTION * len(stiffness))):
        worst = np.argsort(-size)
        # Neighbours of a bad actuator stand out as well; one that yields can be free.
        tried = worst[rest.diagonal()[worst] != 0.0][:8]
        if not tried.size:
            break
        left, alike = list[Array](), list[Array]()
        for k in tried.tolist():
            alike.append(pair_ratios(_without(rest, k), np.delete(ratios, k))[0])
            left.append(_asymmetry(_without(rest, k), alike[-1]))
        best = int(np.argmin([np.sum(each**2) for each in left]))
        usual = np.median(size)
        if not (
            size.max() > MAX_ROW_ASYMMETRY * usual
            or usual > MIN_ASYMMETRY_RATIO * np.median(left[best])
        ):
            break
        found.append(int(at[tried[best]]))
        at, rest = np.delete(at, tried[best]), _without(rest, int(tried[best]))
        size, ratios = left[best], alike[best]
    return np.sort(np.array(found, dtype=np.int64))


def kept(stiffness: Array, start: Array | None = None) -> tuple[NDArray[np.bool_], tuple[int, ...]]:
    """Return (n,) which actuators of K_c to keep; and, where too many are odd, all, with these."""
    odd = odd_actuators(stiffness, start)
    keep = np.ones(len(stiffness), dtype=bool)
    if len(odd) > max(2, int(MAX_FREED_FRACTION * len(stiffness))):
        return keep, tuple(odd.tolist())
    keep[odd] = False
    return keep, ()


def _asymmetry(stiffness: Array, ratios: Array) -> Array:
    """Return (n,) rms asymmetry of each row, made alike, in terms of a typical element."""
    alike = np.exp(ratios)[:, None] * stiffness
    own = np.median(np.abs(alike), axis=1)  # that of a bad one may be anything
    typical = np.median(own) or np.inf  # 0 where most do not feel each other
    return np.asarray(np.sqrt(np.mean((alike - alike.T) ** 2, axis=1)) / typical)


def _without(stiffness: Array, k: int) -> Array:
    """Return (n - 1, n - 1) stiffness with actuator k free."""
    keep = np.arange(len(stiffness)) != k
    taken = np.outer(stiffness[keep, k], stiffness[k, keep]) / stiffness[k, k]
    return np.asarray(stiffness[np.ix_(keep, keep)] - taken)


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
