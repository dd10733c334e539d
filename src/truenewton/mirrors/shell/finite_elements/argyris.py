"""Argyris' triangle: quintic polynomials with a continuous slope, and quadrature on triangles.

J. H. Argyris, I. Fried, D. W. Scharpf, Aeronautical Journal 72 (1968) 701. The unknowns are
w, w_x, w_y, w_xx, w_xy, w_yy at each vertex of the mesh and the slope across each edge at its
middle, derivatives in units of the mesh's size so that all are lengths of like magnitude. The
polynomials of a triangle come from the inverse of its 21 unknowns of the 21 monomials, all
triangles at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import perm, roots_sh_jacobi

from truenewton.arrays import Array
from truenewton.mirrors.shell.finite_elements.mesh import Indices, Mesh

DEGREE = 5
POWERS = np.array([(p, k - p) for k in range(DEGREE + 1) for p in range(k, -1, -1)])
VERTEX_DERIVATIVES = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


@dataclass(frozen=True, eq=False)
class Argyris:
    """The element on every triangle of a mesh.

    Attributes
    ----------
    centre, reach
        (n_triangles, 2) and (n_triangles,) origin and unit of each triangle's monomials [m].
    polynomials
        (n_triangles, 21, 21) coefficients of the monomials, in rows, of each unknown's shape.
    unknown
        (n_triangles, 21) number of each unknown in the mesh.
    count
        How many unknowns the mesh has.
    """

    centre: Array
    reach: Array
    polynomials: Array
    unknown: Indices
    count: int

    def shapes(self, triangle: Indices, places: Array, derivative: tuple[int, int]) -> Array:
        """Return the shapes' derivative at places.

        Parameters
        ----------
        triangle
            (n,) the triangle of each row of places.
        places
            (n, q, 2) places [m].
        derivative
            Order along x and along y.

        Returns
        -------
        numpy.ndarray
            (n, q, 21), per metre to the order of the derivative.
        """
        reach = self.reach[triangle, None, None]
        local = (places - self.centre[triangle, None]) / reach
        values = monomials(local, derivative) @ self.polynomials[triangle]
        return np.asarray(values / reach ** sum(derivative))


def argyris(mesh: Mesh) -> Argyris:
    """Return the element on every triangle of a mesh."""
    corners = mesh.corners
    centre = corners.mean(axis=1)
    reach = np.sqrt(mesh.areas)
    local = (corners - centre[:, None]) / reach[:, None, None]

    first, second = np.moveaxis(mesh.points[mesh.edges], 1, 0)
    along = (second - first) / np.linalg.norm(second - first, axis=1)[:, None]
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)[mesh.edge_of]
    middle = 0.5 * (local + np.roll(local, -1, axis=1))
    slope = np.stack([monomials(middle, (1, 0)), monomials(middle, (0, 1))], axis=-1)
    at_edges = np.einsum("tejd, ted -> tej", slope, across)
    at_vertices = np.stack([monomials(local, d) for d in VERTEX_DERIVATIVES], axis=2)
    unknowns = np.concatenate([at_vertices.reshape(-1, 18, 21), at_edges], axis=1)

    order = np.array([sum(d) for d in VERTEX_DERIVATIVES] * 3 + [1] * 3)
    scale = (reach[:, None] / mesh.size) ** order
    six = np.arange(6)
    vertices = len(mesh.points)
    numbers = (6 * mesh.triangles[:, :, None] + six).reshape(-1, 18)
    return Argyris(
        centre=centre,
        reach=reach,
        polynomials=np.linalg.inv(unknowns) * scale[:, None],
        unknown=np.concatenate([numbers, 6 * vertices + mesh.edge_of], axis=1),
        count=6 * vertices + len(mesh.edges),
    )


def monomials(places: Array, derivative: tuple[int, int]) -> Array:
    """Return (..., 21) a derivative of the monomials x^p y^q, p + q <= 5, at (..., 2) places."""
    ladders = np.stack([places**k for k in range(DEGREE + 1)], axis=-2)
    values = np.ones(())
    for axis, order in enumerate(derivative):
        power = POWERS[:, axis]
        factor = perm(power, order)  # 0 where it differentiates away
        values = values * (factor * ladders[..., np.maximum(power - order, 0), axis])
    return values


def quadrature(degree: int) -> tuple[Array, Array]:
    """Return a rule on triangles, exact for polynomials up to a degree.

    Gauss' rule on a square, one side of it drawn together to a vertex (A. H. Stroud, Approximate
    Calculation of Multiple Integrals, 1971, section 2.4).

    Returns
    -------
    tuple of numpy.ndarray
        (q, 3) barycentric coordinates and (q,) weights, which sum to 1.
    """
    n = degree // 2 + 1
    u, weight_u = roots_sh_jacobi(n, 2, 1)  # weight 1 - u
    v, weight_v = roots_sh_jacobi(n, 1, 1)
    across, up = np.repeat(u, n), np.outer(1 - u, v).ravel()
    weights = 2 * np.outer(weight_u, weight_v).ravel()
    return np.stack([1 - across - up, across, up], axis=1), weights / weights.sum()
