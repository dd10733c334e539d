"""A shell prepared once for its forces, then read anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.kernels import Circles, Kernel, Mean
from truenewton.mirrors.shell.places import harmonics, shallowness
from truenewton.mirrors.shell.radial_elements import RadialElements, graded_nodes

HARMONICS_AT_ONCE = 64  # these bound the memory while a shell is prepared
RINGS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class LoadedShell:
    """A shell under unit forces at places, ready to be read.

    Attributes
    ----------
    shell, kernel, elements
        The glass, the force, and functions of radius.
    forces
        (n_of,) places, x + i y [b].
    digits
        Wanted of the series in harmonics.
    edges
        The outer edge and the inner one.
    """

    shell: Shell
    kernel: Kernel
    elements: RadialElements
    forces: NDArray[np.complex128]
    digits: int
    edges: tuple[_LoadedEdge, _LoadedEdge]

    @classmethod
    def of(
        cls,
        shell: Shell,
        forces: NDArray[np.complex128],
        radii: Array,
        puck_radius: float,
        digits: int,
    ) -> LoadedShell:
        """Prepare a shell under forces for being read at radii [b]."""
        hole, curved = shell.inner_radius / shell.outer_radius, shallowness(shell)
        nodes = graded_nodes(hole, np.abs(forces), curved)
        elements = RadialElements(nodes, digits + 4, shell.poisson_ratio, curved)
        kernel = Kernel(curved, puck_radius / shell.outer_radius)
        outer, inner = (
            _loaded_edge(shell, kernel, elements, edge, forces, radii, digits)
            for edge in (1.0, hole)
        )
        return cls(shell, kernel, elements, forces, digits, (outer, inner))

    def read(self, points: NDArray[np.complex128], sensor: Annulus | None) -> Array:
        """Return (n_at, n_of) displacement [m/N] at places, or its mean over sensors there."""
        shell, b = self.shell, self.shell.outer_radius
        circles = Circles.of(sensor, b) if sensor else None
        read = self.kernel.displacement(np.abs(points[:, None] - self.forces), circles)
        mean = mean_over(sensor, shell)
        rings, ring = np.unique(np.abs(points), return_inverse=True)
        for edge in self.edges:
            count = harmonics(edge.outgoing * _fading(edge.radius, rings), self.digits, shell)
            remainder = read_remainder(self.elements, edge.response[:count], rings, mean)
            turned = _turned(np.swapaxes(remainder, 1, 2), ring, points)
            for side, traction in zip(turned, edge.traction, strict=True):
                read += side.T @ traction[: side.shape[0]]
        return read * (b**2 / shell.bending_stiffness)


@dataclass(frozen=True, eq=False)
class _LoadedEdge:
    """An edge, what unit forces leave on it, and what that does to the shell.

    Attributes
    ----------
    radius
        Of the edge [b].
    outgoing
        Ratio by which tractions fade from one harmonic to the next.
    response
        (count, elements, unknowns, tractions) remainder per traction.
    traction
        (2, count tractions, n_of) cosines and sines of the tractions of the forces.
    """

    radius: float
    outgoing: float
    response: Array
    traction: Array


def _loaded_edge(
    shell: Shell,
    kernel: Kernel,
    elements: RadialElements,
    edge: float,
    forces: NDArray[np.complex128],
    radii: Array,
    digits: int,
) -> _LoadedEdge:
    """Return an edge with as many harmonics as reading at radii takes."""
    s, ring = np.unique(np.abs(forces), return_inverse=True)
    outgoing = _fading(edge, s)
    samples = 2 * harmonics(outgoing, digits, shell)
    count = harmonics(outgoing * _fading(edge, radii), digits, shell)
    tractions = np.concatenate(
        [
            kernel.edge_tractions(some, edge, shell.poisson_ratio, samples)[:count]
            for some in np.array_split(s, -(-s.size // RINGS_AT_ONCE))
        ],
        axis=-1,
    )
    tractions[1:] *= 2.0  # harmonics m and -m
    work = _edge_work(elements, edge)
    parts = np.array_split(np.arange(count, dtype=float), -(-count // HARMONICS_AT_ONCE))
    response = np.concatenate([elements.responses(part, work) for part in parts])
    return _LoadedEdge(edge, outgoing, response, _turned(tractions, ring, forces))


def _fading(edge: float, radii: Array) -> float:
    """Return how harmonics fade between an edge and the nearest of radii, from one to the next."""
    return float(radii.max() if edge == 1.0 else edge / radii.min())


def _turned(amplitudes: Array, ring: NDArray[np.intp], places: NDArray[np.complex128]) -> Array:
    """Return (2, count kinds, n) cosines and sines at places of (count, kinds, rings)."""
    phase = np.arange(amplitudes.shape[0])[:, None, None] * np.angle(places)
    at_places = amplitudes[:, :, ring]
    turned = np.empty((2, *at_places.shape))
    np.multiply(at_places, np.cos(phase), out=turned[0])
    np.multiply(at_places, np.sin(phase), out=turned[1])
    return turned.reshape(2, -1, places.size)


def _edge_work(elements: RadialElements, edge: float) -> Array:
    """Return (elements, unknowns, 2 or 4) work that each traction on an edge takes away."""
    outer, n = edge == 1.0, elements.at_node
    work = np.zeros((elements.nodes.size - 1, elements.unknowns, n))
    element, node, sign = (-1, n, edge) if outer else (0, 0, -edge)
    tractions = [-sign, sign, -sign, -sign]  # moment on the slope, shear, N_r, N_rt
    for kind, unknown in enumerate([1, 0, 2, 3][:n]):
        work[element, node + unknown, kind] = tractions[kind]
    return work


def read_remainder(elements: RadialElements, response: Array, r: Array, mean: Mean) -> Array:
    """Return (count, n_r, tractions) remainder at radii, or its mean, per traction and harmonic."""
    read = np.zeros((response.shape[0], r.size, response.shape[-1]))
    powers = np.arange(response.shape[0])[:, None, None] ** np.arange(3.0)[:, None, None, None]
    averaged = bool(mean.first)
    for element in np.unique(elements.element_of(r)):
        here = np.flatnonzero(elements.element_of(r) == element)
        rows = [elements.shape(r[here], 0, 0)]
        if averaged:
            strains = elements.strains(r[here])
            of_laplacian = mean.first * (strains[:, 0] + strains[:, 1])
            rows = [row + lap for row, lap in zip([rows[0], 0, 0], of_laplacian, strict=True)]
            if elements.shallowness:  # lap lap w = N_r + N_t
                stiff = elements.stretch * (1 + elements.poisson_ratio) * mean.second
                rows = [row + stiff * (e[3] + e[4]) for row, e in zip(rows, strains, strict=True)]
        for power, row in zip(powers, rows, strict=False):
            read[:, here] += power * (row @ response[:, element])
    return read


def mean_over(sensor: Annulus | None, shell: Shell) -> Mean:
    """Return how the mean over a sensor follows from w and its Laplacians at its centre."""
    if sensor is None:
        return Mean(np.zeros(()), np.zeros(()))
    return Circles.of(sensor, shell.outer_radius).mean(shallowness(shell))
