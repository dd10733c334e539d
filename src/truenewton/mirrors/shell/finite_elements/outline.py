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
        A mesh size that is not positive or far too fine; a polygon without three finite vertices,
        with corners too sharp, crossing itself or another; holes off the glass.
    """
    if not FINEST <= mesh_size < np.inf:
        raise GeometryError(
            f"mesh size {mesh_size:.6g} m",
            remedy=f"give a positive length, {FINEST:g} m at least",
            got=mesh_size,
        )
    loops = [np.asarray(polygon, dtype=float) for polygon in polygons]
    vertices = sum(map(len, loops))
    if vertices > MOST_VERTICES:
        raise GeometryError(
            f"an outline of {vertices} vertices",
            remedy=f"thin it to {MOST_VERTICES} at most; one every {mesh_size:.2g} m will do",
            got=vertices,
        )
    for loop in loops:
        _check_loop(loop)
    area = areas_and_moments(loops)[0]
    triangles = area / (np.sqrt(3 / 16) * mesh_size**2)
    if triangles > MOST_TRIANGLES:
        coarser = mesh_size * np.sqrt(triangles / MOST_TRIANGLES)
        raise GeometryError(
            f"a mesh size of {mesh_size:.6g} m makes some {triangles:.1e} triangles",
            remedy=f"give {coarser:.2g} m or more",
            got=mesh_size,
        )
    start, end = sides_of(loops)
    for i in range(len(start)):
        if _meets(start[i], end[i], start, end).any():
            raise GeometryError(
                f"two sides of the outline meet near x = {start[i, 0]:.6g} m, "
                f"y = {start[i, 1]:.6g} m",
                remedy="give polygons that cross neither themselves nor one another",
            )
    for i, hole in enumerate(loops[1:]):
        if not inside(loops[: i + 1] + loops[i + 2 :], hole[:1]).all():
            raise GeometryError(
                f"hole {i} does not lie in the glass", remedy="give holes within the outline, apart"
            )
    return loops


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


def _check_loop(loop: Array) -> None:
    if loop.ndim != 2 or loop.shape[0] < 3 or loop.shape[1] != 2 or not np.isfinite(loop).all():
        raise GeometryError(
            f"an outline of shape {loop.shape}",
            remedy="give three or more vertices, x and y of each, all finite",
            got=loop.shape,
        )
    ahead, back = np.roll(loop, -1, axis=0) - loop, np.roll(loop, 1, axis=0) - loop
    length = np.linalg.norm(ahead, axis=1)
    if length.min() <= 1e-9 * length.max():
        i = int(length.argmin())
        raise GeometryError(
            f"vertices {i} and {(i + 1) % len(loop)} of the outline stand at one place",
            remedy="give every vertex once; the polygon closes itself",
        )
    cosine = (ahead * back).sum(axis=1) / (length * np.roll(length, 1))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    if angle.min() < SHARPEST_CORNER:
        i = int(angle.argmin())
        raise GeometryError(
            f"the outline turns back to {angle[i]:.3g} degrees at its vertex {i}",
            remedy=f"blunt corners below {SHARPEST_CORNER:g} degrees",
            got=float(angle[i]),
        )


def _meets(p: Array, q: Array, start: Array, end: Array) -> NDArray[np.bool_]:
    """Tell which sides start-end touch the side p-q without sharing a vertex with it."""

    def turn(a: Array, b: Array, c: Array) -> Array:
        (u, v), (s, t) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
        return np.asarray(np.sign(u * t - v * s))

    def ends_at(r: Array) -> NDArray[np.bool_]:
        return np.asarray((start == r).all(axis=1) | (end == r).all(axis=1))

    crossing = (turn(p, q, start) * turn(p, q, end) <= 0) & (
        turn(start, end, p) * turn(start, end, q) <= 0
    )
    overlap = (np.minimum(start, end) <= np.maximum(p, q)) & (
        np.maximum(start, end) >= np.minimum(p, q)
    )
    return np.asarray(crossing & overlap.all(axis=1) & ~ends_at(p) & ~ends_at(q))


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
