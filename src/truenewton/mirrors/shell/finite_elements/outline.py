"""Polygons around a glass, refused if no mesh can follow them; their geometry is shapely's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import areas_and_moments
from truenewton.rounding import counted

if TYPE_CHECKING:
    from shapely import Polygon

MIN_CORNER = 45.0  # [deg]; refinement of a sharper corner does not end
MAX_TRIANGLES = 100_000  # 22 000 of a curved glass take 1.5 GB, and more than in proportion
MAX_VERTICES = 2000  # of all polygons: elements are no longer than sides
MIN_MESH_SIZE = 1e-6  # [m]
MIN_DISTANCE = 0.02  # between actuators, and to an edge, in mesh sizes


def polygon_of(loops: Sequence[Array]) -> Polygon:
    """Return the glass within the first of (n, 2) polygons and outside the others."""
    import shapely  # late: rings do without it

    polygon = shapely.Polygon(loops[0], loops[1:])
    shapely.prepare(polygon)
    return polygon


def inside(glass: Polygon, places: Array) -> NDArray[np.bool_]:
    """Return (n,) which of (n, 2) places lie on the glass."""
    import shapely

    return np.asarray(shapely.contains_xy(glass, *places.T))


def depth_inside(loops: Sequence[Array], places: Array) -> Array:
    """Return (n,) distance from each of (n, 2) places to the nearest side, negative off the glass.

    Lengths have the unit of the places.
    """
    import shapely

    glass = polygon_of(loops)
    distance = shapely.distance(glass.boundary, shapely.points(places))
    return np.asarray(np.where(inside(glass, places), distance, -distance))


def checked_polygons(polygons: Sequence[ArrayLike]) -> list[Array]:
    """Return the outline and its holes as (n_vertices, 2) arrays [m], once they are valid."""
    loops = [np.asarray(polygon, dtype=float) for polygon in polygons]
    vertices = sum(map(len, loops))
    if vertices > MAX_VERTICES:
        raise GeometryError(
            f"an outline of {vertices} vertices",
            remedy=f"thin it to {MAX_VERTICES} at most; one in each element will do",
        )
    for k, loop in enumerate(loops):
        _check_points(loop, _named(k))
    _check_crossings(loops)
    for k, loop in enumerate(loops):
        _check_corners(loop, _named(k))
    for k, hole in enumerate(loops[1:], 1):
        if not inside(polygon_of(loops[:k] + loops[k + 1 :]), hole[:1]).all():
            raise GeometryError(
                f"hole {k} does not lie in the glass", remedy="give holes within the edge, apart"
            )
    return loops


def check_mesh_size(loops: Sequence[Array], mesh_size: float) -> None:
    """Refuse a size of elements [m] that is not positive, or far too fine for (n, 2) polygons."""
    if not MIN_MESH_SIZE <= mesh_size < np.inf:
        raise GeometryError(
            f"mesh size {mesh_size:.6g} m",
            remedy=f"give a positive length, {MIN_MESH_SIZE:g} m at least",
        )
    triangles = areas_and_moments(loops)[0] / (np.sqrt(3 / 16) * mesh_size**2)
    if triangles > MAX_TRIANGLES:
        coarser = mesh_size * np.sqrt(triangles / MAX_TRIANGLES)
        raise GeometryError(
            f"a mesh size of {mesh_size:.6g} m makes some {triangles:.1e} triangles",
            remedy=f"give {coarser:.2g} m or more",
        )


def sides_of(loops: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return starts and ends of the sides of all polygons, as their vertices: [m] or numbers."""
    return np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])


def checked_places(loops: Sequence[Array], x: Array, y: Array, mesh_size: float) -> Array:
    """Return (n, 2) positions of actuators [m], once known to be on the glass and apart."""
    places = np.stack([x, y], axis=1)
    closest, depth = MIN_DISTANCE * mesh_size, depth_inside(loops, places)
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
        )
    if len(loop) < 3:
        raise GeometryError(f"{name} has {counted(loop, 'point')}", remedy="give three or more")
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
    if angle.min() < MIN_CORNER:
        i = int(angle.argmin())
        raise GeometryError(
            f"{name} turns back to {angle[i]:.3g} degrees at its point {i + 1}, {_at(loop[i])}",
            remedy=f"blunt corners below {MIN_CORNER:g} degrees",
        )


def _check_crossings(loops: Sequence[Array]) -> None:
    """Refuse a polygon that crosses or touches itself, and two that meet."""
    import shapely
    from shapely.validation import explain_validity

    rings = [shapely.LinearRing(loop) for loop in loops]
    for k, ring in enumerate(rings):
        reason, _, place = explain_validity(shapely.Polygon(ring)).partition("[")
        if place:
            at = _at(np.array(place.rstrip("]").split(), dtype=float))
            raise GeometryError(
                f"{_named(k)} crosses itself at {at} ({reason})",
                remedy="give its points in their order along it, each once",
            )
        for other in range(k):
            common = shapely.get_coordinates(ring.intersection(rings[other]))
            if len(common):
                raise GeometryError(
                    f"{_named(other)} and {_named(k)} meet at {_at(common[0])}",
                    remedy="keep holes within the edge, and apart",
                )


def _at(point: Array) -> str:
    return "x = {:.5g} m, y = {:.5g} m".format(*(np.round(point, 9) + 0.0))
