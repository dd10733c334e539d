"""Thin free glass of any outline and spherical curvature, by finite elements.

For round glass it is the independent check of `truenewton.mirrors.shell.fourier`, with which it
shares nothing before `truenewton.mirrors.shell.condensation`. x and y are the shallow shell's own
coordinates: where the glass is deep, give arc lengths from the vertex as radii. Edges are free.

Elements that conform make a glass too stiff: by a part in the square of mesh size to spacing of
actuators in the stiffest modes under point forces, where the glass bends most under the forces
themselves; by far less in soft modes, and where annular sensors read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Shell, rim
from truenewton.mirrors.shell.finite_elements.argyris import Argyris, argyris, quadrature
from truenewton.mirrors.shell.finite_elements.energy import elastic_energy
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh
from truenewton.mirrors.shell.places import Points

AT_ONCE = 64  # forces, which bounds the memory of the solutions
POINTS_AT_ONCE = 4096  # read from them
AREA_DEGREE = 6  # of the quadrature over the glass


@dataclass(frozen=True, eq=False)
class MeshedShell:
    """A free glass on a mesh.

    Attributes
    ----------
    shell
        Thickness, material and curvature.
    mesh
        From `shell_mesh`.
    """

    shell: Shell
    mesh: Mesh

    @cached_property
    def element(self) -> Argyris:
        """The element on every triangle."""
        return argyris(self.mesh)

    @cached_property
    def _held(self) -> tuple[Indices, SuperLU]:
        """The unknowns left free where three vertices hold what is not balanced; the factors."""
        energy = elastic_energy(self.shell, self.mesh, self.element)
        held = _held_still(self.shell, self.mesh, self.element)
        free = np.setdiff1d(np.arange(energy.shape[0]), held)
        factor = splu(  # a positive matrix needs no pivoting
            csc_array(energy[free][:, free]),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return free, factor

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield some rows of the (n_at, n_of) displacement per unit force, as `RoundShell` [m/N].

        Raises
        ------
        GeometryError
            A point, a puck or a sensor off the glass.
        """
        solved = self._solved(self._means(of, rim(puck_radius)).T)
        for first in range(0, at[0].size, POINTS_AT_ONCE):
            some = slice(first, first + POINTS_AT_ONCE)
            yield self._means((at[0][some], at[1][some]), sensor) @ solved

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return (n_at,) displacement per unit force spread evenly over the glass [m/N]."""
        places, areas = self.quadrature(at[0].size)
        pushed = self._means(places, None).T @ (areas / areas.sum())
        return np.asarray(self._means(at, sensor) @ self._solved(csc_array(pushed[:, None])))[:, 0]

    def quadrature(self, actuators: int) -> tuple[Points, Array]:  # noqa: ARG002
        """Return x, y [m] and areas [m^2] of a rule on each triangle, however many actuators."""
        barycentric, weights = quadrature(AREA_DEGREE)
        x, y = (barycentric @ self.mesh.corners).reshape(-1, 2).T
        return (x, y), (self.mesh.areas[:, None] * weights).ravel()

    def _solved(self, pushed: csc_array) -> Array:
        """Return (unknowns of w, loads) for the work that (unknowns of w, loads) do."""
        free, factor = self._held
        bending = free[free < self.element.count]
        loads = csc_array(pushed)[bending]
        solved = np.zeros((self.element.count, loads.shape[1]))
        for first in range(0, loads.shape[1], AT_ONCE):
            some = slice(first, first + AT_ONCE)
            given = np.pad(loads[:, some].toarray(), ((0, free.size - bending.size), (0, 0)))
            solved[bending, some] = factor.solve(given)[: bending.size]
        return solved

    def _means(self, at: Points, over: Annulus | None) -> csr_array:
        """Return the matrix (n, unknowns of w) of w at points, or of its mean round each."""
        around, weights = _annulus(over) if over else (np.zeros((1, 2)), np.ones(1))
        places = np.stack(at, axis=1)[:, None] + around
        n, q = places.shape[:2]
        try:
            triangle = self.mesh.triangle_at(places.reshape(-1, 2))
        except GeometryError as off:
            if over is None:
                raise
            raise GeometryError(
                "a sensor reaches over an edge of the glass",
                remedy="give a smaller sensor or puck, or bring the actuators off the edges",
                got=over,
            ) from off
        shapes = self.element.shapes(triangle, places.reshape(-1, 1, 2), (0, 0)).reshape(n, q, 21)
        values = (weights[:, None] * shapes).ravel()
        rows, columns = np.repeat(np.arange(n), 21 * q), self.element.unknown[triangle].ravel()
        return csr_array((values, (rows, columns)), shape=(n, self.element.count))


def _annulus(sensor: Annulus) -> tuple[Array, Array]:
    """Return (q, 2) places and (q,) weights of the mean over an annulus around the origin."""
    inner, outer = sensor.inner_radius**2, sensor.outer_radius**2
    gauss, weight = np.polynomial.legendre.leggauss(3)
    radius = np.sqrt(inner + (outer - inner) * (gauss + 1) / 2)
    angle = 2 * np.pi * np.arange(16) / 16
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return (radius[:, None, None] * ring).reshape(-1, 2), np.repeat(weight / 32, 16)


def _held_still(shell: Shell, mesh: Mesh, element: Argyris) -> Indices:
    """Return the unknowns that, held, keep a glass from moving as a whole.

    That is w at three vertices, far apart and off one line; where the glass is curved, sliding and
    turning too.
    """
    points = mesh.points - mesh.points.mean(axis=0)
    first = np.linalg.norm(points, axis=1).argmax()
    arm = points - points[first]
    second = np.linalg.norm(arm, axis=1).argmax()
    third = np.abs(arm[:, 0] * arm[second, 1] - arm[:, 1] * arm[second, 0]).argmax()
    bending = 6 * np.array([first, second, third])
    if not np.isfinite(shell.radius_of_curvature):
        return bending
    across, up = np.abs(arm[second])
    turning = 2 * second + (1 if across > up else 0)  # u_y turns what lies along x
    in_plane = element.count + np.array([2 * first, 2 * first + 1, turning])
    return np.concatenate([bending, in_plane])
