"""Thin free annular shell, flat or spherical, under point forces: Fourier in angle, p-elements.

Kirchhoff's bending, D lap lap w = q on a flat plate, coupled through the curvature to the membrane
of a shallow sphere; inner and outer edge free of moment, shear and membrane forces. A unit force
gives w = kernel + v (`kernels`). The kernel contains the singularity exactly and needs no
harmonics; it leaves tractions on the edges. The smooth remainder takes them away: for every (phi,
psi)

    a((v, u), (phi, psi)) = - [ integral of (moment dphi/dr - shear phi + N_r psi_r + N_rt psi_t)
                                r dtheta ] from r = a to r = b

harmonic by harmonic (`radial_elements`). Harmonic m of a force at radius s fades as (s/b)^m on the
outer edge and as (a/s)^m on the inner one, and v fades again on its way to the point where it is
read: the geometry and the required digits determine the number of harmonics. The only right-hand
sides of a harmonic are the tractions of two edges, whatever the number of forces; one matrix
product connects forces and points. Means over circles, for sensors and pucks, are exact
combinations of w, lap w and lap lap w at the centre.

x and y are positions along the glass, arcs on a sphere (`Shell.along`). Inside, lengths are in
units of b and displacements in units of b^2 / D per newton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus, Points, Shell, check_shell
from truenewton.mirrors.shell.kernels import Circles, Kernel, Mean
from truenewton.mirrors.shell.radial_elements import RadialElements, graded_nodes

MIN_HOLE = 1e-4  # in outer radii; with a smaller one more than eight digits are lost
DIGITS = 13  # decimal digits to keep of the series in harmonics and in radial polynomials
MAX_HARMONICS = 5000  # more are needed only for a force close to an edge
HARMONICS_AT_ONCE = 64  # these bound the memory while a shell is prepared
RINGS_AT_ONCE = 64
POINTS_AT_ONCE = 1024  # bounds the memory where many points are read
QUADRATURE = 6  # points per spacing of actuators: masses to 5e-4 of the largest


def shallowness(shell: Shell) -> float:
    """Return lambda, b in units of the length over which bending decays; 0 on a flat plate."""
    stiffness_ratio = 12 * (1 - shell.poisson_ratio**2)
    length = np.sqrt(shell.thickness * abs(shell.radius_of_curvature))
    return float(shell.outer_radius / length * stiffness_ratio**0.25)


def on_glass(
    shell: Shell, places: Points, what: str, extent: float = 0.0
) -> NDArray[np.complex128]:
    """Return (n,) places as x + i y in units of the outer radius; refuse those off the glass."""
    a, b = shell.inner_radius, shell.outer_radius
    check_shell(shell, MIN_HOLE)
    x, y = (np.asarray(coordinate, dtype=float) for coordinate in places)
    radius = np.hypot(x, y)
    slack = 1e-12 * b - extent  # a point computed to lie on an edge does
    off = np.flatnonzero(~((radius >= a - slack) & (radius <= b + slack)))
    if off.size:
        i = off[0]
        wide = f" and {extent:.6g} m round it" if extent else ""
        raise GeometryError(
            f"{what} {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m{wide} is off the glass",
            remedy=f"bring it between the edges at {a:.6g} m and {b:.6g} m from the axis",
        )
    return np.asarray((x + 1j * y) / b)


def harmonics(fading: float, shell: Shell) -> int:
    """Return the number of harmonics until ``fading`` ** m is below 10 ** -`DIGITS`."""
    if fading >= 10.0 ** (-DIGITS / MAX_HARMONICS):
        nearest = shell.outer_radius * DIGITS * np.log(10) / MAX_HARMONICS
        raise GeometryError(
            "a force acts on an edge of the glass, or so near that its series hardly converges",
            remedy=f"keep forces {nearest:.2g} m away from the edges",
        )
    return max(3, int(np.ceil(-DIGITS * np.log(10) / np.log(fading))))


def fading(edge: float, radii: Array) -> float:
    """Return the ratio of successive harmonics between an edge and the nearest of (n,) radii."""
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
    """Return (elements, unknowns, 2 or 4) negative work of each traction on an edge."""
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
    """Return the mean over a sensor in terms of w and its Laplacians at its centre."""
    if sensor is None:
        return Mean(np.zeros(()), np.zeros(()))
    return Circles(sensor, shell.outer_radius).mean(shallowness(shell))


@dataclass(frozen=True)
class RoundShell:
    """A free annulus.

    In the harmonics 0 and 1, where the operator is singular (constant and r), a spring holds v at
    the outer edge; balanced forces do not load it.
    """

    shell: Shell  # the glass; |R| several times its outer radius

    def influence(
        self, at: Points, of: Points, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Array:
        """Return the (n_at, n_of) displacement per unit force [m/N].

        Displacements are read at (n_at,) x and y, edges included, or as the mean over a sensor
        centred there; the (n_of,) forces are off the edges. Each force enters the glass on a circle
        of ``puck_radius`` [m], 0 for a point: a stiff puck glued to the glass presses with its rim,
        since the glass under it does not bend. Its stiffness is not added to that of the glass.
        Symmetric only if displacements are read at point forces, or on the circle of the puck.
        """
        shell, b = self.shell, self.shell.outer_radius
        forces = on_glass(shell, of, "force", puck_radius)
        points = on_glass(shell, at, "point", sensor.outer_radius if sensor else 0.0)
        found = np.zeros((points.size, forces.size))
        if not found.size:
            return found
        elements = self._elements(np.abs(forces))
        kernel = Kernel(elements.shallowness, puck_radius / b)
        edges = {
            edge: self._loaded_edge(edge, kernel, elements, forces, np.abs(points))
            for edge in (1.0, shell.inner_radius / b)
        }
        circles, mean = Circles(sensor, b) if sensor else None, mean_over(sensor, shell)
        for first in range(0, points.size, POINTS_AT_ONCE):
            some = points[first : first + POINTS_AT_ONCE]
            read = kernel.displacement(np.abs(some[:, None] - forces), circles)
            rings, ring = np.unique(np.abs(some), return_inverse=True)
            for edge, (outgoing, response, tractions) in edges.items():
                count = harmonics(outgoing * fading(edge, rings), shell)
                remainder = read_remainder(elements, response[:count], rings, mean)
                waves = turned(np.swapaxes(remainder, 1, 2), ring, some)
                for side, traction in zip(waves, tractions, strict=True):
                    read += side.T @ traction[: side.shape[0]]
            found[first : first + POINTS_AT_ONCE] = read * (b**2 / shell.bending_stiffness)
        return found

    def _loaded_edge(
        self,
        edge: float,
        kernel: Kernel,
        elements: RadialElements,
        forces: NDArray[np.complex128],
        radii: Array,
    ) -> tuple[float, Array, Array]:
        """Return what forces do by an edge of a radius [b], in the harmonics for (radii,) readings.

        The ratio by which tractions fade from one harmonic to the next; (count, elements, unknowns,
        tractions) the remainder per traction; (2, count tractions, n_of) cosines and sines of the
        tractions of unit forces.
        """
        s, ring = np.unique(np.abs(forces), return_inverse=True)
        outgoing, nu = fading(edge, s), self.shell.poisson_ratio
        samples = 2 * harmonics(outgoing, self.shell)
        count = harmonics(outgoing * fading(edge, radii), self.shell)
        groups = np.array_split(s, -(-s.size // RINGS_AT_ONCE))
        left = [kernel.edge_tractions(some, edge, nu, samples)[:count] for some in groups]
        tractions = np.concatenate(left, axis=-1)
        tractions[1:] *= 2.0  # harmonics m and -m
        work = _edge_work(elements, edge)
        parts = np.array_split(np.arange(count, dtype=float), -(-count // HARMONICS_AT_ONCE))
        response = np.concatenate([elements.responses(part, work) for part in parts])
        return outgoing, response, turned(tractions, ring, forces)

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return the (n_at,) displacement per unit force spread evenly, along the normals [m/N]."""
        shell = self.shell
        r = np.abs(on_glass(shell, at, "point", sensor.outer_radius if sensor else 0.0))
        hole = shell.inner_radius / shell.outer_radius
        elements = self._elements(np.array([hole**0.5]))
        pressure = 1 / (np.pi * (1 - hole**2))
        radii, area = elements.gauss()
        work = [w @ elements.shape(r, 0, 0) for r, w in zip(radii, pressure * area, strict=True)]
        response = elements.responses(np.zeros(1), np.array(work)[:, :, None])
        mean = mean_over(sensor, shell)
        remainder = read_remainder(elements, response, r, mean)[0, :, 0]
        # lap lap w is that of the membrane's forces and the pressure.
        return (remainder + mean.second * pressure) * (
            shell.outer_radius**2 / shell.bending_stiffness
        )

    def _elements(self, force_radius: Array) -> RadialElements:
        """Return functions of radius that resolve forces at (n_of,) radii [b]."""
        shell, curved = self.shell, shallowness(self.shell)
        nodes = graded_nodes(shell.inner_radius / shell.outer_radius, force_radius, curved)
        return RadialElements(nodes, DIGITS + 4, shell.poisson_ratio, curved)

    def quadrature(self, actuators: int) -> tuple[Points, Array]:
        """Return x, y [m] and areas [m^2]: Gauss in radius, even steps in angle.

        Exact for rigid motions; it resolves the shapes of that number of actuators.
        """
        a, b = self.shell.inner_radius, self.shell.outer_radius
        step = np.sqrt(np.pi * (b**2 - a**2) / actuators) / QUADRATURE
        xi, gauss = legendre.leggauss(max(4, int(np.ceil((b - a) / step))))
        radii = 0.5 * (a + b) + 0.5 * (b - a) * xi
        counts = np.maximum(8, np.ceil(2 * np.pi * radii / step)).astype(int)
        radius = np.repeat(radii, counts)
        area = np.repeat(np.pi * (b - a) * gauss * radii / counts, counts)
        angle = np.concatenate([2 * np.pi * (np.arange(k) + 0.5) / k for k in counts])
        return (radius * np.cos(angle), radius * np.sin(angle)), area
