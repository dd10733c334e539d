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
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import SuperLU, splu

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.finite_elements.argyris import Argyris, argyris, quadrature
from truenewton.mirrors.shell.finite_elements.energy import elastic_energy, unknowns
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh
from truenewton.mirrors.shell.finite_elements.meshing import shell_mesh
from truenewton.mirrors.shell.places import Points

AT_ONCE = 64  # forces, which bounds the memory of the solutions
POINTS_AT_ONCE = 4096  # read from them
AREA_DEGREE = 6  # of the quadrature over the glass


def meshed_shell(shell: Shell, x: ArrayLike, y: ArrayLike, *, mesh_size: float) -> MeshedShell:
    """Return a free glass with a vertex of its mesh at every actuator.

    Parameters
    ----------
    shell
        The glass, a ring or outlined; an inner radius of 0 means a full disc.
    x, y
        (n,) positions of the actuators along the glass [m].
    mesh_size
        Length of the triangles' sides [m].

    Raises
    ------
    GeometryError
        A shell or a mesh size that cannot be; polygons that cross, or have corners below 45
        degrees; actuators off the glass, all but on an edge, or all but at one place.
    """
    return MeshedShell(shell, shell_mesh(shell, x, y, mesh_size=mesh_size))


@dataclass(frozen=True, eq=False)
class MeshedShell:
    """A free glass on a mesh, as `free_shell.FreeShell` has it.

    Attributes
    ----------
    shell
        Thickness, material and curvature.
    mesh
        From `shell_mesh`.

    Raises
    ------
    GeometryError
        A shell that cannot be.
    """

    shell: Shell
    mesh: Mesh

    def __post_init__(self) -> None:
        _check(self.shell, self.mesh)

    @cached_property
    def element(self) -> Argyris:
        """The element on every triangle."""
        return argyris(self.mesh)

    @cached_property
    def _held(self) -> tuple[Indices, SuperLU]:
        """The unknowns left free where three vertices hold what is not balanced; the factors."""
        shell, mesh, element = self.shell, self.mesh, self.element
        held = np.concatenate([6 * _apart(mesh), _held_in_plane(shell, mesh, element)])
        free = np.setdiff1d(np.arange(unknowns(shell, mesh, element)), held)
        return free, _factor(elastic_energy(shell, mesh, element)[free][:, free])

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield (some of n_at, n_of) displacement per unit force [m/N].

        Raises
        ------
        GeometryError
            A point, a puck or a sensor off the glass.
        """
        puck = Annulus(puck_radius, puck_radius) if puck_radius else None
        solved = self._solved(self._means(of, puck).T)
        for first in range(0, at[0].size, POINTS_AT_ONCE):
            some = slice(first, first + POINTS_AT_ONCE)
            yield self._means((at[0][some], at[1][some]), sensor) @ solved

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return (n_at,) displacement per unit force spread evenly over the glass [m/N]."""
        element, areas = self.element, self.mesh.areas
        barycentric, weights = quadrature(AREA_DEGREE)
        shapes = element.shapes(np.arange(len(areas)), barycentric @ self.mesh.corners, (0, 0))
        work = areas[:, None] * np.einsum("q,tqj->tj", weights, shapes) / areas.sum()
        pushed = np.bincount(element.unknown.ravel(), work.ravel(), element.count)
        return np.asarray(self._means(at, sensor) @ self._solved(csc_array(pushed[:, None])))[:, 0]

    def quadrature(self, actuators: int) -> tuple[Points, Array]:  # noqa: ARG002
        """Return x, y [m] and areas [m^2] of a rule on each triangle, however many actuators."""
        barycentric, weights = quadrature(AREA_DEGREE)
        x, y = (barycentric @ self.mesh.corners).reshape(-1, 2).T
        return (x, y), (self.mesh.areas[:, None] * weights).ravel()

    def _solved(self, pushed: csc_array) -> Array:
        """Return (unknowns of w, loads) for the work that (unknowns of w, loads) do."""
        free, factor = self._held
        bending = free[: np.count_nonzero(free < self.element.count)]
        loads = csc_array(pushed)[bending]
        solved = np.zeros((self.element.count, loads.shape[1]))
        for first in range(0, loads.shape[1], AT_ONCE):
            some = slice(first, first + AT_ONCE)
            given = np.zeros((free.size, loads[:, some].shape[1]))
            given[: bending.size] = loads[:, some].toarray()
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
        return csr_array(coo_array((values, (rows, columns)), shape=(n, self.element.count)))


def _annulus(sensor: Annulus) -> tuple[Array, Array]:
    """Return (q, 2) places and (q,) weights of the mean over an annulus around the origin."""
    inner, outer = sensor.inner_radius**2, sensor.outer_radius**2
    gauss, weight = np.polynomial.legendre.leggauss(3)
    radius = np.sqrt(inner + (outer - inner) * (gauss + 1) / 2)
    angle = 2 * np.pi * np.arange(16) / 16
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return (radius[:, None, None] * ring).reshape(-1, 2), np.repeat(weight / 32, 16)


def _factor(matrix: csc_array) -> SuperLU:
    """Return the factors of a positive matrix, which needs no pivoting."""
    return splu(
        csc_array(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _apart(mesh: Mesh) -> Indices:
    """Return three vertices that stand far apart and off one line."""
    points = mesh.points - mesh.points.mean(axis=0)
    first = np.linalg.norm(points, axis=1).argmax()
    arm = points - points[first]
    second = np.linalg.norm(arm, axis=1).argmax()
    third = np.abs(arm[:, 0] * arm[second, 1] - arm[:, 1] * arm[second, 0]).argmax()
    return np.array([first, second, third])


def _held_in_plane(shell: Shell, mesh: Mesh, element: Argyris) -> Indices:
    """Return the unknowns that, held, keep a curved glass from sliding and turning."""
    if not np.isfinite(shell.radius_of_curvature):
        return np.zeros(0, dtype=np.int64)
    first, second, _ = _apart(mesh)
    across, up = np.abs(mesh.points[second] - mesh.points[first])
    turning = 2 * second + (1 if across > up else 0)  # u_y turns what lies along x
    return np.asarray(element.count + np.array([2 * first, 2 * first + 1, turning]))


def _check(shell: Shell, mesh: Mesh) -> None:
    stiff, nu = shell.bending_stiffness, shell.poisson_ratio
    if not (0 < stiff < np.inf and shell.thickness > 0 and -1 < nu < 0.5):
        raise GeometryError(
            f"bending stiffness {stiff:.6g} N m and Poisson ratio {nu:.6g}",
            remedy="give positive thickness and Young's modulus, and a ratio in (-1, 0.5)",
        )
    reach = np.linalg.norm(mesh.points, axis=1).max()
    if not abs(shell.radius_of_curvature) > reach:
        raise GeometryError(
            f"radius of curvature {shell.radius_of_curvature:.6g} m of a glass that reaches "
            f"{reach:.6g} m from its vertex",
            remedy="the shell is taken as shallow: give several times its reach, or infinity",
            got=shell.radius_of_curvature,
        )
