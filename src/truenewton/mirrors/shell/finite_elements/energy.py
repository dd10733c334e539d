"""Elastic energy of a thin shallow spherical shell on a mesh.

Kirchhoff's bending and the membrane of a shallow shell (L. H. Donnell, NACA Report 479, 1933;
K. Marguerre, Proc. 5th Int. Congress of Applied Mechanics, 1938), coupled by the curvature 1/R:

    2 U = integral of D [(1 - nu) k:k + nu (tr k)^2] + C [(1 - nu) e:e + nu (tr e)^2]
    k = grad grad w,    e = sym grad u - (w / R) I,    C = E t / (1 - nu^2)

w is Argyris' quintic, u quadratic on the same triangles: the rigid motions w = 1, x, y carry
u = (x, y)/R, (x^2 - y^2, 2 x y)/2R, (2 x y, y^2 - x^2)/2R, which quadratics hold exactly.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from truenewton.arrays import Array
from truenewton.mirrors.glass import Shell
from truenewton.mirrors.shell.finite_elements.argyris import Argyris, quadrature
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh

TRIANGLES_AT_ONCE = 1024  # bounds the memory of the assembly


def elastic_energy(shell: Shell, mesh: Mesh, element: Argyris) -> csc_array:
    """Return the matrix A [N/m] of the energy q' A q / 2 in the unknowns q [m].

    The unknowns of w come first, then, where the glass is curved, u_x and u_y at every vertex and
    at the middle of every edge. One rule of degree 6, exact for bending, serves all terms: strains
    that vanish do so at each of its points.
    """
    barycentric, weights = quadrature(6)
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
        strains = _strains(shell, mesh, element, some, barycentric)
        n, q, rows, width = strains.shape
        areas = (mesh.areas[some, None] * weights)[:, :, None, None]
        stresses = areas * (law[:rows, :rows] @ strains)
        flat = (n, q * rows, width)
        blocks.append(np.swapaxes(strains.reshape(flat), 1, 2) @ stresses.reshape(flat))
    rows, columns = np.broadcast_arrays(
        unknown.astype(np.int32)[:, :, None], unknown.astype(np.int32)[:, None, :]
    )
    return csc_array((np.concatenate(blocks).ravel(), (rows.ravel(), columns.ravel())))


def _strains(
    shell: Shell, mesh: Mesh, element: Argyris, some: Indices, barycentric: Array
) -> Array:
    """Return (n, q, 3 or 6, unknowns): k_xx, k_yy, 2 k_xy and e_xx, e_yy, 2 e_xy of each shape."""
    corners = mesh.corners[some]
    places = barycentric @ corners
    curved = np.isfinite(shell.radius_of_curvature)
    strains = np.zeros((*places.shape[:2], 6, 33) if curved else (*places.shape[:2], 3, 21))
    strains[:, :, 0, :21] = element.shapes(some, places, (2, 0))
    strains[:, :, 1, :21] = element.shapes(some, places, (0, 2))
    strains[:, :, 2, :21] = 2 * element.shapes(some, places, (1, 1))
    if curved:
        swelling = element.shapes(some, places, (0, 0)) / shell.radius_of_curvature
        strains[:, :, 3, :21] = strains[:, :, 4, :21] = -swelling
        along_x, along_y = _quadratic_slopes(corners, mesh.areas[some], barycentric)
        strains[:, :, 3, 21:27] = strains[:, :, 5, 27:] = along_x
        strains[:, :, 4, 27:] = strains[:, :, 5, 21:27] = along_y
    return strains


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
