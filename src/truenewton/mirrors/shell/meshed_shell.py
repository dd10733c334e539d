"""Thin free glass of any outline and spherical curvature, by finite elements.

For round glass it is the independent check of `truenewton.mirrors.shell.round_shell`. The two share
only `truenewton.mirrors.shell.shell_model.condense`. x and y are coordinates of the shallow shell:
for a deep glass, radii are arc lengths from the vertex. Edges are free.

The displacement w along the normal is that of Argyris' triangle (J. H. Argyris, I. Fried, D. W.
Scharpf, Aeronautical Journal 72 (1968) 701): quintic polynomials with a continuous slope. The
unknowns are w, w_x, w_y, w_xx, w_xy, w_yy at each vertex and the slope across each edge at its
middle; derivatives are in units of the mesh size, so that all unknowns are lengths of similar size.
The polynomials follow from the inverse of the 21 unknowns of the 21 monomials.

The energy is Kirchhoff's bending and the membrane of a shallow shell (L. H. Donnell, NACA Report
479, 1933; K. Marguerre, Proc. 5th Int. Congress of Applied Mechanics, 1938), coupled by the
curvature 1/R:

    2 U = integral of D [(1 - nu) k:k + nu (tr k)^2] + C [(1 - nu) e:e + nu (tr e)^2]
    k = grad grad w,    e = sym grad u - (w / R) I,    C = E t / (1 - nu^2)

u is quadratic on the same triangles: the rigid motions w = 1, x, y have u = (x, y)/R,
(x^2 - y^2, 2 x y)/2R, (2 x y, y^2 - x^2)/2R, which quadratics represent exactly.

Conforming elements make a glass too stiff: by a part in the square of mesh size over actuator
spacing in the stiffest modes under point forces, where the glass bends most under the forces
themselves; much less in soft modes, and where annular sensors read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu
from scipy.special import perm, roots_sh_jacobi

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Points, Shell, rim
from truenewton.mirrors.shell.mesh import Indices, Mesh

DEGREE = 5
POWERS = np.array([(p, k - p) for k in range(DEGREE + 1) for p in range(k, -1, -1)])
VERTEX_DERIVATIVES = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
TRIANGLES_AT_ONCE = 1024  # bounds the memory of the assembly
FORCES_AT_ONCE = 64  # bounds the memory of the solutions
POINTS_AT_ONCE = 4096
AREA_DEGREE = 6  # of the quadrature over the glass: exact for bending


class Argyris:
    """The elements of a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.corners
        # (n_triangles, 2) and (n_triangles,) origin and unit of each triangle's monomials [m]
        self.centre, self.reach = corners.mean(axis=1), np.sqrt(mesh.areas)
        local = (corners - self.centre[:, None]) / self.reach[:, None, None]

        first, second = np.moveaxis(mesh.points[mesh.edges], 1, 0)
        along = (second - first) / np.linalg.norm(second - first, axis=1)[:, None]
        across = np.stack([along[:, 1], -along[:, 0]], axis=1)[mesh.edge_of]
        middle = 0.5 * (local + np.roll(local, -1, axis=1))
        slope = np.stack([monomials(middle, (1, 0)), monomials(middle, (0, 1))], axis=-1)
        at_edges = np.einsum("tejd, ted -> tej", slope, across)
        at_vertices = np.stack([monomials(local, d) for d in VERTEX_DERIVATIVES], axis=2)
        unknowns = np.concatenate([at_vertices.reshape(-1, 18, 21), at_edges], axis=1)

        order = np.array([sum(d) for d in VERTEX_DERIVATIVES] * 3 + [1] * 3)
        scale = (self.reach[:, None] / mesh.size) ** order
        # (n_triangles, 21, 21) coefficients of the monomials, in rows, of the shape of each unknown
        self.polynomials = np.linalg.inv(unknowns) * scale[:, None]
        vertices = len(mesh.points)
        numbers = (6 * mesh.triangles[:, :, None] + np.arange(6)).reshape(-1, 18)
        # (n_triangles, 21) number of each unknown in the mesh, and the number of all
        self.unknown = np.concatenate([numbers, 6 * vertices + mesh.edge_of], axis=1)
        self.count = 6 * vertices + len(mesh.edges)

    def shapes(self, triangle: Indices, places: Array, derivative: tuple[int, int]) -> Array:
        """Return (n, q, 21) derivatives of the shapes, of orders along x and y.

        At (n, q, 2) places [m] of (n,) triangles.
        """
        reach = self.reach[triangle, None, None]
        local = (places - self.centre[triangle, None]) / reach
        values = monomials(local, derivative) @ self.polynomials[triangle]
        return np.asarray(values / reach ** sum(derivative))


def monomials(places: Array, derivative: tuple[int, int]) -> Array:
    """Return (..., 21) a derivative of the monomials x^p y^q, p + q <= 5, at (..., 2) places."""
    ladders = np.stack([places**k for k in range(DEGREE + 1)], axis=-2)
    values = np.ones(())
    for axis, order in enumerate(derivative):
        power = POWERS[:, axis]
        factor = perm(power, order)  # 0 if the derivative vanishes
        values = values * (factor * ladders[..., np.maximum(power - order, 0), axis])
    return values


def quadrature() -> tuple[Array, Array]:
    """Return a rule on triangles, exact for polynomials of degree `AREA_DEGREE`.

    Gauss' rule on a square with one side contracted to a vertex (A. H. Stroud, Approximate
    Calculation of Multiple Integrals, 1971, section 2.4): (q, 3) barycentric coordinates and (q,)
    weights, which sum to 1.
    """
    n = AREA_DEGREE // 2 + 1
    u, weight_u = roots_sh_jacobi(n, 2, 1)  # weight 1 - u
    v, weight_v = roots_sh_jacobi(n, 1, 1)
    across, up = np.repeat(u, n), np.outer(1 - u, v).ravel()
    weights = 2 * np.outer(weight_u, weight_v).ravel()
    return np.stack([1 - across - up, across, up], axis=1), weights / weights.sum()


def _quadratic_slopes(corners: Array, areas: Array, barycentric: Array) -> tuple[Array, Array]:
    """Return d/dx and d/dy, (n, q, 6) each, of the quadratic shapes s (2 s - 1) and 4 s s'."""
    opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    slopes = np.stack([-opposite[..., 1], opposite[..., 0]]) / (2 * areas[:, None])  # of each s
    slope, next_slope = slopes[:, :, None], np.roll(slopes, -1, axis=2)[:, :, None]
    s, next_s = barycentric, np.roll(barycentric, -1, axis=1)
    along_x, along_y = np.concatenate(
        [(4 * s - 1) * slope, 4 * (s * next_slope + next_s * slope)], axis=-1
    )
    return along_x, along_y


@dataclass(frozen=True, eq=False)
class MeshedShell:
    """A free glass on a mesh."""

    shell: Shell  # Thickness, material and curvature
    mesh: Mesh  # from `shell_mesh`

    @cached_property
    def element(self) -> Argyris:
        """The element on every triangle."""
        return Argyris(self.mesh)

    @cached_property
    def _held(self) -> tuple[Indices, SuperLU]:
        """The free unknowns if three vertices are fixed, and the factors of their energy."""
        energy = self._energy()
        free = np.setdiff1d(np.arange(energy.shape[0]), self._held_still())
        factor = splu(  # a positive matrix needs no pivoting
            csc_array(energy[free][:, free]),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return free, factor

    def _energy(self) -> csc_array:
        """Return the matrix A [N/m] of the energy q' A q / 2 in the unknowns q [m].

        The unknowns of w come first, then, if the glass is curved, u_x and u_y at every vertex and
        at the middle of every edge. All terms use one rule, which is exact for bending.
        """
        shell, mesh, element = self.shell, self.mesh, self.element
        barycentric, weights = quadrature()
        nu, D = shell.poisson_ratio, shell.bending_stiffness
        plane = np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
        law = np.kron(np.diag([D, 12 * D / shell.thickness**2]), plane)  # 12 D / t^2 = C
        unknown = element.unknown
        if np.isfinite(shell.radius_of_curvature):
            node = np.concatenate([mesh.triangles, len(mesh.points) + mesh.edge_of], axis=1)
            u_x = element.count + 2 * node
            unknown = np.concatenate([unknown, u_x, u_x + 1], axis=1)

        blocks, triangles = [], np.arange(len(mesh.triangles))
        for some in np.array_split(triangles, -(-triangles.size // TRIANGLES_AT_ONCE)):
            strains = self._strains(some, barycentric)
            n, q, rows, width = strains.shape
            areas = (mesh.areas[some, None] * weights)[:, :, None, None]
            stresses = areas * (law[:rows, :rows] @ strains)
            flat = (n, q * rows, width)
            blocks.append(np.swapaxes(strains.reshape(flat), 1, 2) @ stresses.reshape(flat))
        rows, columns = np.broadcast_arrays(
            unknown.astype(np.int32)[:, :, None], unknown.astype(np.int32)[:, None, :]
        )
        return csc_array((np.concatenate(blocks).ravel(), (rows.ravel(), columns.ravel())))

    def _strains(self, some: Indices, barycentric: Array) -> Array:
        """Return k_xx, k_yy, 2 k_xy, e_xx, e_yy, 2 e_xy of shapes, (n, q, 3 or 6, unknowns)."""
        element, corners = self.element, self.mesh.corners[some]
        places = barycentric @ corners
        curved = np.isfinite(self.shell.radius_of_curvature)
        strains = np.zeros((*places.shape[:2], 6, 33) if curved else (*places.shape[:2], 3, 21))
        strains[:, :, 0, :21] = element.shapes(some, places, (2, 0))
        strains[:, :, 1, :21] = element.shapes(some, places, (0, 2))
        strains[:, :, 2, :21] = 2 * element.shapes(some, places, (1, 1))
        if curved:
            swelling = element.shapes(some, places, (0, 0)) / self.shell.radius_of_curvature
            strains[:, :, 3, :21] = strains[:, :, 4, :21] = -swelling
            along_x, along_y = _quadratic_slopes(corners, self.mesh.areas[some], barycentric)
            strains[:, :, 3, 21:27] = strains[:, :, 5, 27:] = along_x
            strains[:, :, 4, 27:] = strains[:, :, 5, 21:27] = along_y
        return strains

    def _held_still(self) -> Indices:
        """Return the unknowns that fix the rigid motions of a glass.

        They are w at three distant vertices and, for a curved glass, two displacements along it and
        one rotation.
        """
        points = self.mesh.points - self.mesh.points.mean(axis=0)
        first = np.linalg.norm(points, axis=1).argmax()
        arm = points - points[first]
        second = np.linalg.norm(arm, axis=1).argmax()
        third = np.abs(arm[:, 0] * arm[second, 1] - arm[:, 1] * arm[second, 0]).argmax()
        bending = 6 * np.array([first, second, third])
        if not np.isfinite(self.shell.radius_of_curvature):
            return bending
        across, up = np.abs(arm[second])
        turning = 2 * second + (1 if across > up else 0)  # u_y rotates an arm along x
        in_plane = self.element.count + np.array([2 * first, 2 * first + 1, turning])
        return np.concatenate([bending, in_plane])

    def influence(
        self, at: Points, of: Points, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Array:
        """Return the (n_at, n_of) displacement per unit force [m/N], as `RoundShell`."""
        solved = self._solved(self._means(of, rim(puck_radius)).T)
        found = np.empty((at[0].size, solved.shape[1]))
        for first in range(0, at[0].size, POINTS_AT_ONCE):
            some = slice(first, first + POINTS_AT_ONCE)
            found[some] = self._means((at[0][some], at[1][some]), sensor) @ solved
        return found

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return (n_at,) displacement per unit force spread evenly over the glass [m/N]."""
        places, areas = self.quadrature(at[0].size)
        pushed = self._means(places, None).T @ (areas / areas.sum())
        return np.asarray(self._means(at, sensor) @ self._solved(csc_array(pushed[:, None])))[:, 0]

    def quadrature(self, actuators: int) -> tuple[Points, Array]:  # noqa: ARG002
        """Return x, y [m] and areas [m^2] of a rule on each triangle."""
        barycentric, weights = quadrature()
        x, y = (barycentric @ self.mesh.corners).reshape(-1, 2).T
        return (x, y), (self.mesh.areas[:, None] * weights).ravel()

    def _solved(self, pushed: csc_array) -> Array:
        """Return (unknowns of w, loads) displacements for the work of loads on each unknown."""
        free, factor = self._held
        bending = free[free < self.element.count]
        loads = csc_array(pushed)[bending]
        solved = np.zeros((self.element.count, loads.shape[1]))
        for first in range(0, loads.shape[1], FORCES_AT_ONCE):
            some = slice(first, first + FORCES_AT_ONCE)
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
