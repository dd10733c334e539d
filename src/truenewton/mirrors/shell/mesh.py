"""A glass of any outline: polygons around it, and a mesh over it with a vertex at every actuator.

Polygons are refused if no mesh can follow them; their geometry is shapely's. The mesh is a
hexagonal lattice, relaxed between the boundary and the actuators (optimal Delaunay triangulation:
L. Chen, Proc. 13th Int. Meshing Roundtable, 2004, p. 109), then refined until no angle is small
(J. Ruppert, J. Algorithms 18, 1995, p. 548): sides that another vertex crowds are halved, and bad
triangles get a vertex at the centre of their circle. Delaunay's triangulation is scipy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, cKDTree

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell, check_shell, polygon_of
from truenewton.rounding import counted

if TYPE_CHECKING:
    from shapely import Polygon, STRtree

Indices = NDArray[np.int64]
MIN_ANGLE = 25.0  # of a triangle [deg]
MAX_CIRCLE = 0.8  # around a triangle, radius in mesh sizes; 0.58 in the lattice
RELAXATIONS = 12
MESH_SIZE = 1 / 3  # mesh size, in spacings
MAX_MESH_SIZE = 1 / 4  # in outer radii
MAX_ROUNDS = 300  # of refinement; some ten are usual
MIN_CORNER = 45.0  # [deg]; refinement of a sharper corner does not end
MAX_TRIANGLES = 100_000  # 22 000 of a curved glass take 1.5 GB, and more than in proportion
MAX_VERTICES = 2000  # of all polygons: elements are no longer than sides
MIN_MESH_SIZE = 1e-6  # [m]
MIN_DISTANCE = 0.02  # between actuators, and to an edge, in mesh sizes


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
    triangles = polygon_of(loops).area / (np.sqrt(3 / 16) * mesh_size**2)
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
    for i in np.flatnonzero(~(depth >= closest)):
        raise GeometryError(
            f"actuator {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m is off the glass or on an edge",
            remedy=f"bring it {closest:.2g} m within the outline, or take a smaller mesh size",
        )
    for one, other in cKDTree(places).query_pairs(closest) if len(places) else ():
        raise GeometryError(
            f"actuators {one} and {other} are at the same place, or nearly so",
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
            f"points {i + 1} and {(i + 1) % len(loop) + 1} of {name} are at the same place",
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


# -- the mesh ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a glass."""

    points: Array  # (n_points, 2) vertices [m]; the actuators come first, in their order
    triangles: Indices  # (n_triangles, 3) vertices of each triangle, counter-clockwise

    @cached_property
    def edges(self) -> Indices:
        """(n_edges, 2) vertices of each edge, the lower number first."""
        return self._edges_and_indices[0]

    @cached_property
    def edge_of(self) -> Indices:
        """(n_triangles, 3) the edges from vertex 0 to 1, 1 to 2 and 2 to 0."""
        return self._edges_and_indices[1]

    @cached_property
    def _edges_and_indices(self) -> tuple[Indices, Indices]:
        sides = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        edges, edge_index = np.unique(sides, axis=0, return_inverse=True)
        return edges, edge_index.reshape(-1, 3)

    @cached_property
    def size(self) -> float:
        """Median length of the edges [m]."""
        return float(np.median(np.linalg.norm(np.diff(self.points[self.edges], axis=1), axis=2)))

    @property
    def corners(self) -> Array:
        """(n_triangles, 3, 2) the vertices of each triangle [m]."""
        return np.asarray(self.points[self.triangles])

    @property
    def areas(self) -> Array:
        """(n_triangles,) [m2]."""
        return np.asarray(0.5 * np.linalg.det(self.corners[:, 1:] - self.corners[:, :1]))

    def triangle_at(self, places: Array) -> Indices:
        """Return (n,) the triangle around each of (n, 2) places, or the nearest at a round edge."""
        import shapely

        points, triangle = shapely.points(places), np.full(len(places), -1)
        found, around = self._tree.query(points, predicate="intersects")
        triangle[found] = around
        off = np.flatnonzero(triangle < 0)
        triangle[off] = self._tree.nearest(points[off])
        gaps = shapely.distance(self._tree.geometries[triangle[off]], points[off])
        for i in off[~(gaps < 0.05 * self.size)]:
            x, y = places[i]
            raise GeometryError(
                f"point {i} at x = {x:.6g} m, y = {y:.6g} m is off the glass",
                remedy="bring it within the edges",
            )
        return triangle

    @cached_property
    def _tree(self) -> STRtree:
        import shapely

        return shapely.STRtree(shapely.polygons(self.corners))


def mesh_size_of(shell: Shell, x: Array, y: Array) -> float:
    """Return the length of the elements' sides [m]: that of the outline, or by (n,) actuators.

    It is a third of their spacing, at most a fourth of the outer radius.
    """
    if shell.outline is not None and shell.outline.mesh_size is not None:
        return shell.outline.mesh_size
    coarsest = MAX_MESH_SIZE * shell.outer_radius
    if np.size(x) < 2:
        return coarsest
    places = np.stack([x, y], axis=1)
    gaps = np.asarray(cKDTree(places).query(places, k=2)[0])
    spacing = float(np.median(gaps[:, 1]))
    return min(MESH_SIZE * spacing, coarsest)


def shell_mesh(shell: Shell, x: Array, y: Array, *, mesh_size: float) -> Mesh:
    """Mesh a ring, a disc (inner radius 0) or an outline, with vertices at (n,) x and y on it [m].

    Triangles have sides of ``mesh_size`` [m], shorter where actuators crowd. The edges of a ring
    are polygons of the circles' areas.
    """
    check_shell(shell)
    polygons = shell.polygons()
    if shell.outline is None:
        radii = shell.outer_radius, shell.inner_radius
        polygons = [_circle(radius, mesh_size) for radius in radii if radius > 0]
    loops = checked_polygons(polygons)
    check_mesh_size(loops, mesh_size)
    places = checked_places(loops, x, y, mesh_size)
    rims = [_divided(loop, mesh_size) for loop in loops]
    fixed = np.concatenate([places, *rims])
    numbers = np.split(np.arange(len(fixed)), np.cumsum([len(places), *map(len, rims)]))
    sides = np.stack(sides_of(numbers[1:-1]), axis=1)
    glass = polygon_of(loops)
    points = _relaxed(fixed, _lattice(loops[0], mesh_size), glass, mesh_size)
    return _refined(points, sides, glass, mesh_size)


def _circle(radius: float, mesh_size: float) -> Array:
    """Return a polygon with the area of a circle."""
    finest = radius / 150  # sides are divided later, and sizes too small refused
    count = max(16, int(np.ceil(2 * np.pi * radius / max(finest, mesh_size))))
    step = 2 * np.pi / count
    angle = step * np.arange(count)
    corner = radius * np.sqrt(step / np.sin(step))
    return np.asarray(corner * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _divided(loop: Array, mesh_size: float) -> Array:
    """Return the vertices of a polygon with its sides divided evenly."""
    starts, ends = sides_of([loop])
    parts = np.ceil(np.linalg.norm(ends - starts, axis=1) / mesh_size - 1e-9).astype(int)
    return np.concatenate([
        np.linspace(start, end, part, endpoint=False)
        for start, end, part in zip(starts, ends, parts, strict=True)
    ])  # fmt: skip


def _lattice(outline: Array, mesh_size: float) -> Array:
    """Return hexagonal lattice points over the box of the outline."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    row = mesh_size * np.sqrt(0.75)
    columns, rows = np.ceil((high - low) / [mesh_size, row]).astype(int) + 1
    across, up = np.meshgrid(np.arange(columns), np.arange(rows))
    lattice = np.stack([mesh_size * (across + 0.5 * (up % 2)), row * up], axis=-1)
    return np.asarray(low + lattice.reshape(-1, 2))


def _relaxed(fixed: Array, free: Array, glass: Polygon, mesh_size: float) -> Array:
    """Return fixed points and free ones moved to the mean circumcentre of their triangles."""
    tree = cKDTree(fixed)

    def apart(places: Array, least: float) -> Array:
        gap, _ = tree.query(places)
        roomy = places[gap > least * mesh_size]
        return roomy[inside(glass, roomy)]

    free = apart(free, 0.7)
    for _ in range(RELAXATIONS):
        points = np.concatenate([fixed, free])
        triangles = _triangles(points, glass, mesh_size)
        centre, _, area = _circles(points[triangles])
        # Near the boundary the centre of the circle may lie outside: that of the triangle then.
        out = ~inside(glass, centre)
        centre[out] = points[triangles[out]].mean(axis=1)
        total, moment = np.zeros(len(points)), np.zeros((len(points), 2))
        np.add.at(total, triangles, area[:, None])
        np.add.at(moment, triangles, (area[:, None] * centre)[:, None])
        moved = points.copy()
        moved[total > 0] = moment[total > 0] / total[total > 0, None]
        free = apart(moved[len(fixed) :], 0.6)
    return np.concatenate([fixed, free])


def _refined(points: Array, sides: Indices, glass: Polygon, mesh_size: float) -> Mesh:
    """Add vertices until all triangles are good (Ruppert's algorithm, many vertices a round)."""
    for _ in range(MAX_ROUNDS):
        middle = points[sides].mean(axis=1)
        half = 0.5 * np.linalg.norm(np.diff(points[sides], axis=1)[:, 0], axis=1)
        within = cKDTree(points).query_ball_point(middle, half * (1 - 1e-9), return_length=True)
        crowded = np.asarray(within) > 0
        new = np.zeros((0, 2))
        if not crowded.any():
            triangles = _triangles(points, glass, mesh_size)
            centre, radius, _ = _circles(points[triangles])
            side = np.linalg.norm(np.diff(points[triangles][:, [0, 1, 2, 0]], axis=1), axis=2)
            slender = side.min(axis=1) < 2 * radius * np.sin(np.radians(MIN_ANGLE))
            bad = slender | (radius > MAX_CIRCLE * mesh_size)
            if not bad.any():
                return Mesh(points, triangles)
            new = _scattered(centre[bad], radius[bad])
            to_middle, near = cKDTree(new).query(middle)
            crowded = np.asarray(to_middle) < half
            new = np.delete(new, np.asarray(near)[crowded], axis=0)
        count = len(points)
        points = np.concatenate([points, middle[crowded], new])
        added = count + np.arange(np.count_nonzero(crowded))
        first, second = sides[crowded].T
        sides = np.concatenate([
            sides[~crowded], np.stack([first, added], axis=1), np.stack([added, second], axis=1)
        ])  # fmt: skip
    raise GeometryError(
        f"no mesh of {mesh_size:.6g} m with sound angles was found for this outline",
        remedy="take a smaller mesh size, or blunt the outline's sharpest corners",
    )


def _triangles(points: Array, glass: Polygon, mesh_size: float) -> Indices:
    """Return Delaunay's triangles on the glass, counter-clockwise, without slivers."""
    triangles = Delaunay(points).simplices.astype(np.int64)
    corners = points[triangles]
    twice = np.linalg.det(corners[:, 1:] - corners[:, :1])
    triangles[twice < 0] = triangles[twice < 0][:, ::-1]
    sound = np.abs(twice) > 1e-9 * mesh_size**2
    return np.asarray(triangles[sound & inside(glass, corners.mean(axis=1))])


def _circles(corners: Array) -> tuple[Array, Array, Array]:
    """Return centre and radius of the circle around each triangle, and its area."""
    sides = corners[:, 1:] - corners[:, :1]
    arm = np.linalg.solve(2 * sides, (sides**2).sum(axis=2, keepdims=True))[:, :, 0]
    area = 0.5 * np.abs(np.linalg.det(sides))
    return corners[:, 0] + arm, np.linalg.norm(arm, axis=1), area


def _scattered(centre: Array, radius: Array) -> Array:
    """Return centres, in the order of radius, that lie in no circle already taken."""
    order = np.argsort(-radius)
    taken: list[int] = []
    for i in order:
        gap = np.linalg.norm(centre[taken] - centre[i], axis=1)
        if not taken or (gap > radius[taken]).all():
            taken.append(int(i))
    return centre[taken]
