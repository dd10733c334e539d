"""The edges of a shell under forces, prepared once, and what they add wherever it is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.kernels import Circles, Kernel, Mean
from truenewton.mirrors.shell.places import harmonics, shallowness
from truenewton.mirrors.shell.radial_elements import RadialElements

HARMONICS_AT_ONCE = 64  # these bound the memory while a shell is prepared
RINGS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class LoadedEdge:
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


def loaded_edge(
    shell: Shell,
    kernel: Kernel,
    elements: RadialElements,
    edge: float,
    forces: NDArray[np.complex128],
    radii: Array,
    digits: int,
) -> LoadedEdge:
    """Return an edge with as many harmonics as reading at (radii,) distances [m] takes."""
    s, ring = np.unique(np.abs(forces), return_inverse=True)
    outgoing = fading(edge, s)
    samples = 2 * harmonics(outgoing, digits, shell)
    count = harmonics(outgoing * fading(edge, radii), digits, shell)
    nu, groups = shell.poisson_ratio, np.array_split(s, -(-s.size // RINGS_AT_ONCE))
    left = [kernel.edge_tractions(some, edge, nu, samples)[:count] for some in groups]
    tractions = np.concatenate(left, axis=-1)
    tractions[1:] *= 2.0  # harmonics m and -m
    work = _edge_work(elements, edge)
    parts = np.array_split(np.arange(count, dtype=float), -(-count // HARMONICS_AT_ONCE))
    response = np.concatenate([elements.responses(part, work) for part in parts])
    return LoadedEdge(edge, outgoing, response, turned(tractions, ring, forces))


def fading(edge: float, radii: Array) -> float:
    """Return how harmonics fade between an edge and the nearest of radii, from one to the next."""
    return float(radii.max() if edge == 1.0 else edge / radii.min())


def turned(amplitudes: Array, ring: NDArray[np.intp], places: NDArray[np.complex128]) -> Array:
    """Return (2, count kinds, n) cosines and sines at places of (count, kinds, rings)."""
    phase = np.arange(amplitudes.shape[0])[:, None, None] * np.angle(places)
    at_places = amplitudes[:, :, ring]
    waves = np.empty((2, *at_places.shape))
    np.multiply(at_places, np.cos(phase), out=waves[0])
    np.multiply(at_places, np.sin(phase), out=waves[1])
    return waves.reshape(2, -1, places.size)


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
    for element in np.unique(elements.element_of(r)):
        here = np.flatnonzero(elements.element_of(r) == element)
        strains = elements.strains(r[here])
        rows = mean.first * (strains[:, 0] + strains[:, 1])
        rows[0] += elements.shape(r[here], 0, 0)
        if elements.shallowness:  # lap lap w = N_r + N_t
            stiff = elements.stretch * (1 + elements.poisson_ratio) * mean.second
            rows += stiff * (strains[:, 3] + strains[:, 4])
        for power, row in zip(powers, rows if mean.first else rows[:1], strict=False):
            read[:, here] += power * (row @ response[:, element])
    return read


def mean_over(sensor: Annulus | None, shell: Shell) -> Mean:
    """Return how the mean over a sensor follows from w and its Laplacians at its centre."""
    if sensor is None:
        return Mean(np.zeros(()), np.zeros(()))
    return Circles.of(sensor, shell.outer_radius).mean(shallowness(shell))
