"""Pressures in the film of air under a glass of any outline: linear elements on its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from truenewton.arrays import Array
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh
from truenewton.mirrors.shell.places import Points


@dataclass(frozen=True, eq=False)
class MeshedFilm:
    """Linear between the vertices of a mesh, zero at its edges.

    Attributes
    ----------
    mesh
        Whose first vertices are the actuators.
    """

    mesh: Mesh

    @cached_property
    def _energy(self) -> csc_array:
        """(vertices, vertices) integral of grad s . grad s' of the linear functions."""
        corners = self.mesh.corners
        opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        local = opposite @ np.swapaxes(opposite, 1, 2) / (4 * self.mesh.areas[:, None, None])
        rows, columns = np.broadcast_arrays(
            self.mesh.triangles[:, :, None], self.mesh.triangles[:, None, :]
        )
        return csc_array((local.ravel(), (rows.ravel(), columns.ravel())))

    @cached_property
    def _inner_and_edge(self) -> tuple[Indices, Indices]:
        """Vertices within the film, and those on an edge of it."""
        sides = np.bincount(self.mesh.edge_of.ravel())
        edge = np.unique(self.mesh.edges[sides == 1])
        return np.setdiff1d(np.arange(len(self.mesh.points)), edge), edge

    def values(self, at: Points) -> Array:
        """Return (points, functions), a function for each vertex within."""
        return np.asarray(self._values(at).toarray())

    def _values(self, at: Points) -> csr_array:
        places = np.stack(at, axis=1)
        triangle = self.mesh.triangle_at(places)
        corners = self.mesh.corners[triangle]
        ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
        sides = np.stack([ahead - places[:, None], behind - places[:, None]], axis=2)
        shares = np.linalg.det(sides) / (2 * self.mesh.areas[triangle, None])
        rows = np.repeat(np.arange(len(places)), 3)
        columns = self.mesh.triangles[triangle].ravel()
        shape = (len(places), len(self.mesh.points))
        return csr_array((shares.ravel(), (rows, columns)), shape=shape)[:, self._inner_and_edge[0]]

    def work(self, at: Points, shapes: Array) -> Array:
        """Return (functions, k) sums of each over places, times (places, k) area times shape."""
        return np.asarray(self._values(at).T @ shapes)

    def solve(self, work: Array) -> Array:
        """Return (functions, k) of pressure."""
        inner, _ = self._inner_and_edge
        return np.asarray(splu(csc_array(self._energy[inner][:, inner])).solve(np.asarray(work)))

    def smooth_green(self, at: Points) -> Array:
        """Return (n, n) Green's function between actuators plus ln(distance) / 2 pi.

        It has no sources and is ln(distance) / 2 pi at the edges.
        """
        inner, edge = self._inner_and_edge
        places = self.mesh.points[edge, None] - np.stack(at, axis=1)
        at_edge = np.log(np.linalg.norm(places, axis=2)) / (2 * np.pi)
        within = np.zeros((len(self.mesh.points), at[0].size))
        within[inner] = self.solve(-(self._energy[inner][:, edge] @ at_edge))
        return within[: at[0].size]
