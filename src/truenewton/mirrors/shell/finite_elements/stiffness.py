"""Thin free glass of any outline and spherical curvature, by finite elements.

Seen from its actuators: stiffness, influence, and the frequencies at which it rings. For round
glass it is the independent check of `truenewton.mirrors.shell.fourier`, with which it shares the
last step alone, `truenewton.mirrors.shell.condensation`. x and y are the shallow shell's own
coordinates: where the glass is deep, give arc lengths from the vertex as radii. Edges are free.

Elements that conform make a glass too stiff: by a part in the square of mesh size to spacing of
actuators in the stiffest modes under point forces, where the glass bends most under the forces
themselves; by far less in soft modes, and where annular sensors read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import LinearOperator, SuperLU, eigsh, splu

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.condensation import condense
from truenewton.mirrors.shell.finite_elements.argyris import Argyris, argyris
from truenewton.mirrors.shell.finite_elements.energy import elastic_energy, inertia, unknowns
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh
from truenewton.mirrors.shell.finite_elements.meshing import annulus_mesh, outline_mesh

FORCES_AT_ONCE = 64  # bounds the memory of the solutions


def stiffness(
    shell: Shell,
    x: ArrayLike,
    y: ArrayLike,
    *,
    mesh_size: float,
    sensor: Annulus | None = None,
) -> Array:
    """Return the stiffness between point actuators on a free round glass.

    Parameters
    ----------
    shell
        The glass; an inner radius of 0 means a full disc.
    x, y
        (n,) positions of the actuators [m].
    mesh_size
        Length of the triangles' sides [m].
    sensor
        Around each actuator, over which a reading is the mean; none reads at the actuator.

    Returns
    -------
    numpy.ndarray
        (n, n) force per displacement read [N/m], exact for displacements that balanced forces
        make; its null space is {1, x, y}. Symmetric where forces act at the points that are read.

    Raises
    ------
    GeometryError
        A shell, a mesh size or a sensor that cannot be; actuators off the glass, all but on an
        edge, on one line, or all but at one place; a sensor that reaches over an edge.
    """
    return _stiffness(shell, annulus_mesh(shell, x, y, mesh_size=mesh_size), sensor)


def outline_stiffness(
    shell: Shell,
    outline: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    *,
    mesh_size: float,
    holes: Sequence[ArrayLike] = (),
    sensor: Annulus | None = None,
) -> Array:
    """Return the stiffness between point actuators on a free glass of any outline.

    Parameters
    ----------
    shell
        Thickness, material and curvature; its radii do not count.
    outline
        (n_vertices, 2) the polygon around the glass [m], convex or not, either way round.
    x, y, mesh_size, sensor
        As in `stiffness`.
    holes
        Polygons, as the outline, where there is no glass.

    Returns
    -------
    numpy.ndarray
        (n, n) as from `stiffness`.

    Raises
    ------
    GeometryError
        As in `stiffness`; polygons that cross, or have corners below 45 degrees.
    """
    return _stiffness(shell, outline_mesh(outline, x, y, mesh_size=mesh_size, holes=holes), sensor)


def influence(shell: Shell, mesh: Mesh, at: tuple[ArrayLike, ArrayLike]) -> Array:
    """Return the displacement at points per unit force at the actuators of a mesh.

    Right, up to rigid motions, for every combination of forces whose sum and torques vanish.

    Parameters
    ----------
    shell
        Thickness, material and curvature.
    mesh
        From `annulus_mesh` or `outline_mesh`.
    at
        x and y, (n_at,) each, of the points where the displacement is read [m].

    Returns
    -------
    numpy.ndarray
        (n_at, n) displacement along z [m/N].

    Raises
    ------
    GeometryError
        A shell that cannot be, a point off the glass.
    """
    _check(shell, mesh)
    element = argyris(mesh)
    places = np.stack([np.asarray(coordinate, dtype=float) for coordinate in at], axis=1)
    return _influence(shell, mesh, element, _means(mesh, element, places[:, None], np.ones(1)))


def natural_frequencies(shell: Shell, mesh: Mesh, count: int) -> Array:
    """Return the lowest frequencies of the free glass, without its three rigid motions.

    The glass has mass for motion along z alone, as is usual for shallow shells.

    Parameters
    ----------
    shell
        Thickness, material and curvature.
    mesh
        From `annulus_mesh` or `outline_mesh`.
    count
        How many.

    Returns
    -------
    numpy.ndarray
        (count,) frequencies [Hz], ascending.

    Raises
    ------
    GeometryError
        A shell that cannot be.
    """
    _check(shell, mesh)
    element = argyris(mesh)
    free = np.setdiff1d(
        np.arange(unknowns(shell, mesh, element)), _held_in_plane(shell, mesh, element)
    )
    energy = elastic_energy(shell, mesh, element)[free][:, free]
    mass = inertia(shell, mesh, element)[free][:, free]
    areal = shell.density * shell.thickness
    below = -shell.bending_stiffness / (areal * mesh.areas.sum() ** 2)  # clear of the rigid zeros
    factor = _factor(energy - below * mass)
    squared = eigsh(
        energy,
        k=count + 3,
        M=mass,
        sigma=below,
        OPinv=LinearOperator(energy.shape, matvec=factor.solve, dtype=float),
        v0=factor.solve(mass @ np.random.default_rng(0).normal(size=free.size)),
        return_eigenvectors=False,
    )
    return np.asarray(np.sqrt(np.sort(squared)[3:]) / (2 * np.pi))


def _stiffness(shell: Shell, mesh: Mesh, sensor: Annulus | None) -> Array:
    _check(shell, mesh)
    places = mesh.points[: mesh.actuators]
    tilts = np.vstack([np.ones(mesh.actuators), places.T])
    if np.linalg.matrix_rank(tilts) < 3:
        raise GeometryError(
            f"the {mesh.actuators} actuators stand on one line and cannot hold a tilt",
            remedy="give at least three that do not",
        )
    element = argyris(mesh)
    around, weights = _annulus(sensor) if sensor else (np.zeros((1, 2)), np.ones(1))
    try:
        reading = _means(mesh, element, places[:, None] + around, weights)
    except GeometryError as off:
        raise GeometryError(
            "a sensor reaches over an edge of the glass",
            remedy="give a smaller sensor, or bring the actuators off the edges",
            got=sensor,
        ) from off
    compliance = _influence(shell, mesh, element, reading)
    return condense(compliance, tilts, reciprocal=sensor is None).stiffness


def _influence(shell: Shell, mesh: Mesh, element: Argyris, reading: csr_array) -> Array:
    """Return (n_read, n) readings per unit force; three vertices hold what is not balanced."""
    held = np.concatenate([6 * _apart(mesh), _held_in_plane(shell, mesh, element)])
    count = unknowns(shell, mesh, element)
    free = np.setdiff1d(np.arange(count), held)
    factor = _factor(elastic_energy(shell, mesh, element)[free][:, free])
    pushed = csc_array(
        (np.ones(mesh.actuators), (6 * np.arange(mesh.actuators), np.arange(mesh.actuators))),
        shape=(count, mesh.actuators),
    )[free]
    bending = np.count_nonzero(free < element.count)
    reading = reading[:, free[:bending]]
    compliance = np.zeros((reading.shape[0], mesh.actuators))
    for first in range(0, mesh.actuators, FORCES_AT_ONCE):
        some = slice(first, first + FORCES_AT_ONCE)
        compliance[:, some] = reading @ factor.solve(pushed[:, some].toarray())[:bending]
    return compliance


def _means(mesh: Mesh, element: Argyris, places: Array, weights: Array) -> csr_array:
    """Return the matrix (n, unknowns of w) of the weighted sums of w over (n, q, 2) places."""
    n, q = places.shape[:2]
    triangle = mesh.triangle_at(places.reshape(-1, 2))
    shapes = element.shapes(triangle, places.reshape(-1, 1, 2), (0, 0)).reshape(n, q, 21)
    values = (weights[:, None] * shapes).ravel()
    rows, columns = np.repeat(np.arange(n), 21 * q), element.unknown[triangle].ravel()
    return csr_array(coo_array((values, (rows, columns)), shape=(n, element.count)))


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
