"""Triangles over a glass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from truenewton.arrays import Array
from truenewton.errors import GeometryError

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a glass.

    Attributes
    ----------
    points
        (n_points, 2) vertices [m]; the actuators come first, in their order.
    triangles
        (n_triangles, 3) vertices of each triangle, counter-clockwise.
    actuators
        How many actuators there are.
    """

    points: Array
    triangles: Indices
    actuators: int

    @cached_property
    def edges(self) -> Indices:
        """(n_edges, 2) vertices of each edge, the lower number first."""
        return self._edges_and_indices[0]

    @cached_property
    def edge_of(self) -> Indices:
        """(n_triangles, 3) the edges from vertex 0 to 1, 1 to 2 and 2 to 0 of each triangle."""
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
        one, other = np.moveaxis(self.corners[:, 1:] - self.corners[:, :1], 1, 0)
        return np.asarray(0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]))

    def triangle_at(self, places: Array) -> Indices:
        """Return (n,) the triangle around each of (n, 2) places, beside it past a round edge.

        Raises
        ------
        GeometryError
            A place further off the triangles than a circle is from its polygon.
        """
        corners = self.corners
        centres = corners.mean(axis=1)
        reach = np.linalg.norm(corners - centres[:, None], axis=2).max()
        tree = cKDTree(centres)
        triangle = np.zeros(len(places), dtype=np.int64)
        depth = np.zeros(len(places))
        count, left = 8, np.arange(len(places))
        while left.size:  # until all centres within reach of a place have been looked at
            count = min(count, len(centres))
            nearest = tree.query(places[left], np.arange(1, count + 1))
            away, near = np.asarray(nearest[0]), np.asarray(nearest[1])
            inward = _depth(places[left, None], corners[near])
            pick = np.arange(left.size), inward.argmax(axis=1)
            triangle[left], depth[left] = near[pick], inward[pick]
            unsure = (inward[pick] < -1e-9 * self.size) & (away[:, -1] < reach)
            left = left[unsure] if count < len(centres) else left[:0]
            count *= 4
        for i in np.flatnonzero(depth < -0.05 * self.size):
            raise GeometryError(
                f"point {i} at x = {places[i, 0]:.6g} m, y = {places[i, 1]:.6g} m is off the glass",
                remedy="bring it within the edges",
            )
        return triangle


def _depth(places: Array, corners: Array) -> Array:
    """Return (...) the least distance [m] inward from the sides of triangles (..., 3, 2)."""
    along = np.roll(corners, -1, axis=-2) - corners
    arm = places[..., None, :] - corners
    inward = along[..., 0] * arm[..., 1] - along[..., 1] * arm[..., 0]
    return np.asarray((inward / np.linalg.norm(along, axis=-1)).min(axis=-1))
