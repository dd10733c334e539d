"""Elastic energy of a shallow spherical annulus, harmonic by harmonic, in p-elements of radius.

w = W cos(m t) along the normal, u = (U cos(m t), V sin(m t)) along the glass. Bending after
Kirchhoff, from the curvatures W'', W'/r - m^2 W/r^2 and m (W/r)'; membrane strain sym(grad u) - w/R
after Donnell and Marguerre (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed.,
chapters 9 and 15). Rigid motions, w = 1, x, y with quadratic u, are in the elements exactly.

Lengths are in units of b, w in units of b^2 / D per newton, u in units of b / (R stretch) of those
of w: with the root of the membrane's stiffness in it, its matrix is the same for every curvature
and couples ever less to bending as the shell gets flat. On a flat plate there is no u.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from truenewton.arrays import Array


def graded_nodes(hole: float, force_radius: Array, shallowness: float) -> Array:
    """Return the (nodes,) radii between elements [b], which double in width away from both edges.

    The remainder is smooth up to the images of the forces in the edges, at hole^2/s and 1/s.
    Elements no wider than their distance from those converge at one rate, 3 + sqrt(8) per order;
    none is wider than four decay lengths of bending at the edges.
    """
    inner_image, outer_image = hole**2 / force_radius.min(), 1 / force_radius.max()
    widest = 4 / shallowness if shallowness else np.inf
    nodes = [hole]
    while nodes[-1] < 1:
        width = min(nodes[-1] - inner_image, 0.5 * (outer_image - nodes[-1]), widest)
        last = nodes[-1] + 1.5 * width >= 1
        nodes.append(1.0 if last else nodes[-1] + width)
    return np.array(nodes)


@dataclass(frozen=True, eq=False)
class RadialElements:
    """Functions of radius: W with a continuous slope, U and V continuous.

    The unknowns of an element are W, W', U, V at its inner and at its outer node, then the bubbles
    of W, U and V: Legendre polynomials integrated twice, or once.
    """

    nodes: Array  # radii between elements, from the hole to 1
    order: int  # of the polynomials
    poisson_ratio: float  # nu
    shallowness: float  # lambda, see `kernels`; 0 on a flat plate, which has no U and V

    @property
    def stretch(self) -> float:
        """Root of membrane stiffness times squared curvature: kappa^2 = lambda^4 / (1 - nu^2)."""
        return self.shallowness**2 / float(np.sqrt(1 - self.poisson_ratio**2))

    @property
    def at_node(self) -> int:
        """Number of unknowns at a node."""
        return 4 if self.shallowness else 2

    @cached_property
    def _columns(self) -> list[list[int]]:
        """Unknowns of W, U and V of an element: those at the nodes, then the bubbles."""
        n, p = self.at_node, self.order
        bubbles = np.split(np.arange(2 * n, 2 * n + 3 * p - 5), [p - 3, 2 * p - 4])
        at_nodes = [[0, 1, n, n + 1], [2, n + 2], [3, n + 3]]
        fields = [nodal + list(own) for nodal, own in zip(at_nodes, bubbles, strict=True)]
        return fields if self.shallowness else fields[:1]

    @property
    def unknowns(self) -> int:
        """Number of unknowns of an element."""
        return sum(len(columns) for columns in self._columns)

    @cached_property
    def _series(self) -> list[Array]:
        """Legendre series, in columns, of the shapes of W, and of U or V, on [-1, 1]."""
        p = self.order
        bending = np.zeros((p + 1, p + 1))
        bending[:4, :4] = np.array([
            [1 / 2, 1 / 6, 1 / 2, -1 / 6],
            [-3 / 5, -1 / 10, 3 / 5, -1 / 10],
            [0, -1 / 6, 0, 1 / 6],
            [1 / 10, 1 / 10, -1 / 10, 1 / 10],
        ])  # fmt: skip
        bending[:, 4:] = legendre.legint(np.eye(p - 1)[:, 2:], 2, lbnd=-1)
        membrane = np.zeros((p + 1, p + 1))
        membrane[:2, :2] = [[1 / 2, 1 / 2], [-1 / 2, 1 / 2]]
        membrane[:, 2:] = legendre.legint(np.eye(p)[:, 1:], 1, lbnd=-1)
        return [bending, membrane]

    def element_of(self, r: Array) -> Array:
        """Return the element of each (n_r,) radius, the outer one on a node."""
        last = self.nodes.size - 2
        return np.clip(np.searchsorted(self.nodes, r, side="right") - 1, 0, last)

    def shape(self, r: Array, field: int, derivative: int) -> Array:
        """Return (n_r, unknowns) derivatives of W (field 0), U (1) or V (2) by its own unknowns."""
        element = self.element_of(r)
        half = 0.5 * np.diff(self.nodes)[element]
        xi = (r - self.nodes[element]) / half - 1
        series = legendre.legder(self._series[min(field, 1)], derivative)
        local = legendre.legvander(xi, self.order - derivative) @ series
        if field == 0:
            local[:, [1, 3]] *= half[:, None]  # unknown slopes are those by r
        shape = np.zeros((r.size, self.unknowns))
        shape[:, self._columns[field]] = local / half[:, None] ** derivative
        return shape

    def strains(self, r: Array) -> Array:
        """Return (3, 3 or 6, n_r, unknowns): curvatures, then membrane strains, per power of m.

        Radial, hoop and twist or shear.
        """
        over_r = 1 / r[:, None]
        W, dW, ddW = (self.shape(r, 0, derivative) for derivative in range(3))
        none = np.zeros_like(W)
        bending = [
            [ddW, dW * over_r, none],
            [none, none, dW * over_r - W * over_r**2],
            [none, -W * over_r**2, none],
        ]
        if not self.shallowness:
            return np.array(bending)
        (U, dU), (V, dV) = ((self.shape(r, f, 0), self.shape(r, f, 1)) for f in (1, 2))
        round_w = self.stretch * W
        membrane = [
            [dU - round_w, U * over_r - round_w, dV - V * over_r],
            [none, V * over_r, -U * over_r],
            [none, none, none],
        ]
        return np.concatenate([np.array(bending), np.array(membrane)], axis=1)

    def gauss(self) -> tuple[Array, Array]:
        """Return (elements, points) radii and weights r dr of a quadrature exact for energies."""
        xi, gauss = legendre.leggauss(self.order + 4)
        half = 0.5 * np.diff(self.nodes)[:, None]
        r = self.nodes[:-1, None] + half * (xi + 1)
        return r, half * gauss * r

    @cached_property
    def energy(self) -> Array:
        """(5, elements, unknowns, unknowns) elastic energy per power of m."""
        nu, (r, area) = self.poisson_ratio, self.gauss()
        elastic = np.array([[1, nu, 0], [nu, 1, 0], [0, 0, 2 * (1 - nu)]])
        if self.shallowness:
            plane = np.array([[1, nu, 0], [nu, 1, 0], [0, 0, 0.5 * (1 - nu)]])
            elastic = np.block([[elastic, np.zeros((3, 3))], [np.zeros((3, 3)), plane]])
        energy = np.zeros((5, r.shape[0], self.unknowns, self.unknowns))
        for element, (radii, weights) in enumerate(zip(r, area, strict=True)):
            strains = self.strains(radii)
            stresses = np.einsum("st,ktru,r->ksru", elastic, strains, weights, optimize=True)
            for j, strain in enumerate(strains):
                for k, stress in enumerate(stresses):
                    energy[j + k, element] += np.tensordot(strain, stress, ([0, 1], [0, 1]))
        return energy

    def responses(self, harmonics: Array, loads: Array) -> Array:
        """Return (harmonics, elements, unknowns, n_loads): the shell under loads, by harmonic m.

        The loads are their work on each unknown, (elements, unknowns, n_loads), for unknowns of two
        elements in either. In the harmonics 0 and 1, springs hold the glass at its outer edge along
        w and V; balanced loads do not load them.
        """
        shared, elements, n = 2 * self.at_node, self.nodes.size - 1, self.at_node
        powers = harmonics[:, None] ** np.arange(5)
        energy = np.tensordot(powers, self.energy, 1)
        border = energy[..., :shared, shared:]
        given = np.concatenate(
            [energy[..., shared:, :shared],
             np.broadcast_to(loads[:, shared:], (harmonics.size, *loads[:, shared:].shape))],
            axis=-1,
        )  # fmt: skip
        inner = np.linalg.solve(energy[..., shared:, shared:], given)
        carried = border @ inner
        own = energy[..., :shared, :shared] - carried[..., :shared]
        force = loads[:, :shared] - carried[..., shared:]
        size = n * (elements + 1)
        joined = np.zeros((harmonics.size, size, size))
        right = np.zeros((harmonics.size, size, loads.shape[-1]))
        for element in range(elements):
            here = slice(n * element, n * element + shared)
            joined[:, here, here] += own[:, element]
            right[:, here] += force[:, element]
        loose = np.flatnonzero(harmonics < 2)
        joined[loose, -n, -n] += 1
        if self.shallowness:
            joined[loose, -1, -1] += 1
        at_nodes = np.linalg.solve(joined, right)
        ends = at_nodes[:, n * np.arange(elements)[:, None] + np.arange(shared)]
        bubbles = inner[..., shared:] - inner[..., :shared] @ ends
        return np.concatenate([ends, bubbles], axis=2)
