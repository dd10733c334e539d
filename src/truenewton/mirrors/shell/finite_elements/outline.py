"""Polygons around a glass, refused where no mesh could follow them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import areas_and_moments
from truenewton.rounding import counted

SHARPEST_CORNER = 45.0  # [deg]; below, halving one side of a corner crowds the other for ever
MOST_TRIANGLES = 100_000  # 22 000 of a curved glass take 1.5 GB, and more than in proportion
MOST_VERTICES = 2000  # of all polygons: elements are no longer than sides
FINEST = 1e-6  # [m]
CLOSEST = 0.02  # actuators to one another and to an edge, in mesh sizes


def inside(loops: Sequence[Array], places: Array) -> NDArray[np.bool_]:
    """Tell (n,) whether (n, 2) places lie within the first polygon and none of the others."""
    from matplotlib.path import Path  # half a second that rings do not wait for

    outer, *holes = (Path(loop).contains_points(places) for loop in loops)
    return np.asarray(outer & ~np.any(holes, axis=0))


def checked_sides(polygons: Sequence[ArrayLike], mesh_size: float) -> list[Array]:
    """Return the outline and its holes as (n_vertices, 2) arrays [m], once a mesh can follow them.

    Raises
    ------
    GeometryError
        What `checked_polygons` and `check_mesh_size` refuse.
    """
    loops = checked_polygons(polygons)
    check_mesh_size(loops, mesh_size)
    return loops


def checked_polygons(polygons: Sequence[ArrayLike]) -> list[Array]:
    """Return the outline and its holes as (n_vertices, 2) arrays [m], once they can be.

    Raises
    ------
    GeometryError
        A polygon without three finite vertices, with corners too sharp, crossing itself or another;
        holes off the glass; far too many vertices. Points and holes are counted from 1.
    """
    loops = [np.asarray(polygon, dtype=float) for polygon in polygons]
    vertices = sum(map(len, loops))
    if vertices > MOST_VERTICES:
        raise GeometryError(
            f"an outline of {vertices} vertices",
            remedy=f"thin it to {MOST_VERTICES} at most; one in each element will do",
            got=vertices,
        )
    for k, loop in enumerate(loops):
        _check_points(loop, _named(k))
    _check_crossings(loops)
    for k, loop in enumerate(loops):
        _check_corners(loop, _named(k))
    for k, hole in enumerate(loops[1:], 1):
        if not inside(loops[:k] + loops[k + 1 :], hole[:1]).all():
            raise GeometryError(
                f"hole {k} does not lie in the glass", remedy="give holes within the edge, apart"
            )
    return loops


def check_mesh_size(loops: Sequence[Array], mesh_size: float) -> None:
    """Refuse a size of elements [m] that is not positive or far too fine for (n, 2) polygons [m].

    Raises
    ------
    GeometryError
    """
    if not FINEST <= mesh_size < np.inf:
        raise GeometryError(
            f"mesh size {mesh_size:.6g} m",
            remedy=f"give a positive length, {FINEST:g} m at least",
            got=mesh_size,
        )
    triangles = areas_and_moments(loops)[0] / (np.sqrt(3 / 16) * mesh_size**2)
    if triangles > MOST_TRIANGLES:
        coarser = mesh_size * np.sqrt(triangles / MOST_TRIANGLES)
        raise GeometryError(
            f"a mesh size of {mesh_size:.6g} m makes some {triangles:.1e} triangles",
            remedy=f"give {coarser:.2g} m or more",
            got=mesh_size,
        )


def sides_of(loops: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return starts and ends of the sides of all polygons, as their vertices: [m] or numbers."""
    return np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])


def checked_places(loops: Sequence[Array], x: Array, y: Array, mesh_size: float) -> Array:
    """Return (n, 2) positions of actuators [m], once known to be on the glass and apart.

    Raises
    ------
    GeometryError
        Actuators off the glass, all but on an edge, or all but at one place.
    """
    places = np.stack([x, y], axis=1)
    closest, depth = CLOSEST * mesh_size, depth_inside(loops, places)
    for i in np.flatnonzero(~(depth >= 0)):
        raise GeometryError(
            f"actuator {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m is off the glass",
            remedy="bring it within the outline",
        )
    for i in np.flatnonzero(depth < closest):
        raise GeometryError(
            f"actuator {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m is all but on an edge",
            remedy=f"keep actuators {closest:.2g} m away from edges, or take a smaller mesh size",
        )
    for one, other in cKDTree(places).query_pairs(closest) if len(places) else ():
        raise GeometryError(
            f"actuators {one} and {other} stand at one place, or all but",
            remedy="correct the positions, drop one, or take a smaller mesh size",
        )
    return places


def _named(k: int) -> str:
    return f"hole {k}" if k else "the edge"


def _check_points(loop: Array, name: str) -> None:
    if loop.ndim != 2 or loop.shape[1] != 2 or not np.isfinite(loop).all():
        raise GeometryError(
            f"{name} is an array of shape {loop.shape}",
            remedy="give x and y of each point, all finite",
            got=loop.shape,
        )
    if len(loop) < 3:
        raise GeometryError(
            f"{name} has {counted(loop, 'point')}", remedy="give three or more", got=len(loop)
        )
    length = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    if length.min() <= 1e-9 * length.max():
        i = int(length.argmin())
        raise GeometryError(
            f"points {i + 1} and {(i + 1) % len(loop) + 1} of {name} stand at one place",
            remedy="give every point once; the polygon closes itself",
        )


def _check_corners(loop: Array, name: str) -> None:
    ahead, back = np.roll(loop, -1, axis=0) - loop, np.roll(loop, 1, axis=0) - loop
    cosine = (ahead * back).sum(axis=1) / np.hypot(*ahead.T) / np.hypot(*back.T)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    if angle.min() < SHARPEST_CORNER:
        i = int(angle.argmin())
        raise GeometryError(
            f"{name} turns back to {angle[i]:.3g} degrees at its point {i + 1}, {_at(loop[i])}",
            remedy=f"blunt corners below {SHARPEST_CORNER:g} degrees",
            got=float(angle[i]),
        )


def _check_crossings(loops: Sequence[Array]) -> None:
    """Refuse sides that meet, but for the ends of neighbours."""
    start, end = sides_of(loops)
    sizes = [len(loop) for loop in loops]
    loop_of = np.repeat(np.arange(len(loops)), sizes)
    first = np.repeat(np.cumsum([0, *sizes[:-1]]), sizes)
    place = np.arange(len(start)) - first  # within its own polygon
    before = first + (place - 1) % np.repeat(sizes, sizes)
    after = first + (place + 1) % np.repeat(sizes, sizes)
    for i in range(len(start)):
        met = _meets(start[i], end[i], start, end)
        met[[before[i], i, after[i]]] = False
        if not met.any():
            continue
        j = int(met.argmax())
        at = _at(_meeting_point(start[i], end[i], start[j], end[j]))
        one, other = loop_of[[i, j]].tolist()
        if one == other:
            raise GeometryError(
                f"{_named(one)} crosses itself at {at}, with its sides after points"
                f" {place[i] + 1} and {place[j] + 1}",
                remedy="give its points in their order along it, each once",
            )
        raise GeometryError(
            f"{_named(one)} and {_named(other)} meet at {at}",
            remedy="keep holes within the edge, and apart",
        )


def _at(point: Array) -> str:
    return "x = {:.5g} m, y = {:.5g} m".format(*(np.round(point, 9) + 0.0))


def _meets(p: Array, q: Array, start: Array, end: Array) -> NDArray[np.bool_]:
    """Tell which sides start-end touch the side p-q."""

    def turn(a: Array, b: Array, c: Array) -> Array:
        (u, v), (s, t) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
        return np.asarray(np.sign(u * t - v * s))

    crossing = (turn(p, q, start) * turn(p, q, end) <= 0) & (
        turn(start, end, p) * turn(start, end, q) <= 0
    )
    overlap = (np.minimum(start, end) <= np.maximum(p, q)) & (
        np.maximum(start, end) >= np.minimum(p, q)
    )
    return np.asarray(crossing & overlap.all(axis=1))


def _meeting_point(p: Array, q: Array, start: Array, end: Array) -> Array:
    """Return a point that two sides share: where they cross, or an end that lies on the other."""
    across = np.stack([q - p, start - end], axis=1)
    if abs(np.linalg.det(across)) > 1e-12 * np.prod(np.linalg.norm(across, axis=0)):
        return np.asarray(p + np.linalg.solve(across, start - p)[0] * (q - p))
    longest = int(np.abs(q - p).argmax())
    return np.asarray(sorted([p, q, start, end], key=lambda point: float(point[longest]))[1])


def depth_inside(loops: Sequence[Array], places: Array) -> Array:
    """Return (n,) distance from each of (n, 2) places to the nearest side, negative off the glass.

    Lengths as those of the places.
    """
    nearest = np.full(len(places), np.inf)
    for start, end in zip(*sides_of(loops), strict=True):
        along = end - start
        part = np.clip((places - start) @ along / (along @ along), 0, 1)
        gap = places - start - part[:, None] * along
        nearest = np.minimum(nearest, np.hypot(*gap.T))
    return np.where(inside(loops, places), nearest, -nearest)
