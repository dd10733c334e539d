"""Triangles over a glass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """

    points: Array
    triangles: Indices

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
        return np.asarray(0.5 * np.linalg.det(self.corners[:, 1:] - self.corners[:, :1]))

    def triangle_at(self, places: Array) -> Indices:
        """Return (n,) the triangle around each of (n, 2) places, beside it past a round edge.

        Raises
        ------
        GeometryError
            A place further off the triangles than a circle is from its polygon.
        """
        triangle = np.asarray(self._finder(*places.T), dtype=np.int64)
        along = np.roll(self.corners, -1, axis=1) - self.corners
        for i in np.flatnonzero(triangle < 0):
            areas = np.linalg.det(np.stack([along, places[i] - self.corners], axis=2))
            depth = (areas / np.linalg.norm(along, axis=2)).min(axis=1)  # inward from all sides
            triangle[i] = depth.argmax()
            if not depth.max() > -0.05 * self.size:
                x, y = places[i]
                raise GeometryError(
                    f"point {i} at x = {x:.6g} m, y = {y:.6g} m is off the glass",
                    remedy="bring it within the edges",
                )
        return triangle

    @cached_property
    def _finder(self) -> Any:
        from matplotlib.tri import Triangulation  # half a second that rings do not wait for

        return Triangulation(self.points[:, 0], self.points[:, 1], self.triangles).get_trifinder()
