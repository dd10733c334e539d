"""Thin free annular shell, flat or spherical, under point forces: Fourier in angle, p-elements.

Kirchhoff's bending, D lap lap w = q on a flat plate, coupled through the curvature to the membrane
of a shallow sphere; inner and outer edge free of moment, shear and membrane forces. A unit force
gives w = kernel + v (`kernels`). The kernel holds the singularity exactly and needs no harmonics;
it leaves tractions on the edges. The smooth remainder takes them away: for every (phi, psi)

    a((v, u), (phi, psi)) = - [ integral of (moment dphi/dr - shear phi + N_r psi_r + N_rt psi_t)
                                r dtheta ] from r = a to r = b

harmonic by harmonic (`radial_elements`). Harmonic m of a force at radius s fades as (s/b)^m on the
outer edge and as (a/s)^m on the inner one, and v once more so on its way to the point where it is
read: geometry and the digits wanted set the number of harmonics. The tractions of two edges are all
the right-hand sides of a harmonic, whatever the number of forces; one matrix product joins forces
to points. Sensors and pucks add nothing to that: means over circles are exact combinations of w,
lap w and lap lap w at the centre.

x and y are positions along the glass, arcs on a sphere (`Shell.along`). Inside, lengths are in
units of b and displacements in units of b^2 / D per newton.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.kernels import Circles, Kernel
from truenewton.mirrors.shell.loaded_edges import (
    fading,
    loaded_edge,
    mean_over,
    read_remainder,
    turned,
)
from truenewton.mirrors.shell.places import Points, harmonics, on_glass, shallowness
from truenewton.mirrors.shell.radial_elements import RadialElements, graded_nodes

POINTS_AT_ONCE = 1024  # bounds the memory where many points are read
QUADRATURE = 6  # points per spacing of actuators: masses to 5e-4 of the largest


@dataclass(frozen=True)
class RoundShell:
    """A free annulus.

    In the harmonics 0 and 1, where the operator is singular (constant and r), v stands on a spring
    at the outer edge, which balanced forces leave unloaded.

    Attributes
    ----------
    shell
        The glass; |R| several times its outer radius.
    digits
        Decimal digits to keep of the series in harmonics and in radial polynomials.
    """

    shell: Shell
    digits: int = 13

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield some rows of the (n_at, n_of) displacement per unit force [m/N].

        Symmetric only where displacements are read just as forces act: at points under point
        forces, or on a circle as wide as the puck.

        Parameters
        ----------
        at
            x and y, (n_at,) each, of the points where the displacement is read, edges included, or
            of the centres of the sensors.
        of
            x and y, (n_of,) each, of the forces; off the edges.
        sensor
            Over which a reading is the mean; none reads at the points.
        puck_radius
            Radius of the circle on which the force enters the glass [m]; 0 for a point. A stiff
            puck that is glued to the glass presses with its rim, for the glass under it does not
            bend; that it stiffens the glass as well is not modelled.

        Raises
        ------
        GeometryError
            A shell that cannot be, a point off the glass, a force on an edge or all but on it, a
            sensor or a puck over an edge, a sensor over the place where a force acts.
        """
        shell, b, digits = self.shell, self.shell.outer_radius, self.digits
        forces = on_glass(shell, of, "force", puck_radius)
        points = on_glass(shell, at, "point", sensor.outer_radius if sensor else 0.0)
        if points.size == 0 or forces.size == 0:
            yield np.zeros((points.size, forces.size))
            return
        elements = self._elements(np.abs(forces))
        kernel = Kernel(elements.shallowness, puck_radius / b)
        edges = [
            loaded_edge(shell, kernel, elements, edge, forces, np.abs(points), digits)
            for edge in (1.0, shell.inner_radius / b)
        ]
        circles, mean = Circles.of(sensor, b) if sensor else None, mean_over(sensor, shell)
        for some in np.array_split(points, -(-points.size // POINTS_AT_ONCE)):
            read = kernel.displacement(np.abs(some[:, None] - forces), circles)
            rings, ring = np.unique(np.abs(some), return_inverse=True)
            for edge in edges:
                count = harmonics(edge.outgoing * fading(edge.radius, rings), digits, shell)
                remainder = read_remainder(elements, edge.response[:count], rings, mean)
                waves = turned(np.swapaxes(remainder, 1, 2), ring, some)
                for side, traction in zip(waves, edge.traction, strict=True):
                    read += side.T @ traction[: side.shape[0]]
            yield read * (b**2 / shell.bending_stiffness)

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return the (n_at,) displacement per unit force spread evenly, along the normals [m/N].

        Raises
        ------
        GeometryError
            A shell that cannot be, a point off the glass.
        """
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
        """Return functions of radius fine enough for forces at (n_of,) radii [b]."""
        shell, curved = self.shell, shallowness(self.shell)
        nodes = graded_nodes(shell.inner_radius / shell.outer_radius, force_radius, curved)
        return RadialElements(nodes, self.digits + 4, shell.poisson_ratio, curved)

    def quadrature(self, actuators: int) -> tuple[Points, Array]:
        """Return x, y [m] and areas [m^2]: Gauss in radius, even steps in angle.

        Exact for rigid motions, fine enough for the shapes of so many actuators.
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
