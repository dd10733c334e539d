"""Rings or segments, by which people see the actuators of a mirror."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.statics.layout import Layout


def ring_centre(layout: Layout) -> tuple[float, float]:
    """Return x and y about which actuators stand on rings [m]: the origin, or their own middle.

    The latter of a segment beside the axis, where it makes fewer rings of them.
    """
    own = float(layout.x.mean()), float(layout.y.mean())
    return min(((0.0, 0.0), own), key=lambda centre: int(_radius_number(layout, centre).max()))


def ring_of(layout: Layout) -> NDArray[np.int64]:
    """Return (n,) the ring of each actuator, 0 the innermost, by radius to a tenth of a millimetre.

    About `ring_centre`. All zeros where the actuators stand on no rings (as many radii as half the
    actuators).
    """
    ring = _radius_number(layout, ring_centre(layout))
    return ring if ring.max() < layout.n // 2 else np.zeros(layout.n, dtype=np.int64)


def _radius_number(layout: Layout, centre: tuple[float, float]) -> NDArray[np.int64]:
    """Return (n,) which of the radii that differ is that of each actuator, 0 the smallest."""
    radius = np.hypot(layout.x - centre[0], layout.y - centre[1])
    order = np.argsort(radius, kind="stable")
    steps = np.diff(radius[order], prepend=radius[order[0]]) > 1e-4
    number = np.empty(layout.n, dtype=np.int64)
    number[order] = np.cumsum(steps)
    return number


def group_of(layout: Layout) -> NDArray[np.int64]:
    """Return (n,) to which group of its kind, see `group_name`, each actuator belongs, from 0."""
    if layout.segments:
        return np.searchsorted(layout.segments, np.asarray(layout.segment))
    return ring_of(layout)


def group_name(layout: Layout) -> str:
    """Return by what actuators are grouped for people: 'segment', or 'ring' of a single body."""
    return "segment" if layout.segments else "ring"
