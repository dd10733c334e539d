"""A mirror's free shell by the model that its glass takes: Fourier for rings, else finite elements.

Both give displacements up to rigid motions, right for every sum of forces that balances.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell import fourier
from truenewton.mirrors.shell.places import Points

QUADRATURE = 6  # points per spacing of actuators: masses to 5e-4 of the largest


class FreeShell(Protocol):
    """What is asked of a model; arguments, units and errors as of `fourier.influence`."""

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield (some of n_at, n_of) displacement per unit force [m/N]."""

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return (n_at,) displacement per unit force spread evenly [m/N]."""

    def quadrature(self, actuators: int) -> tuple[Points, Array]:
        """Return x, y [m] and areas [m^2], fine enough for the shapes of so many actuators."""


def free_shell(shell: Shell, at: Points) -> FreeShell:
    """Return the model of a shell whose actuators stand at x and y along the glass [m].

    Raises
    ------
    GeometryError
        An outlined glass that cannot be, or that cannot be meshed.
    """
    if shell.outline is None:
        return RoundShell(shell)
    from truenewton.mirrors.shell.finite_elements.meshing import shell_mesh
    from truenewton.mirrors.shell.finite_elements.stiffness import MeshedShell

    return MeshedShell(shell, shell_mesh(shell, *at, mesh_size=shell.outline.mesh_size))


@dataclass(frozen=True)
class RoundShell:
    """An annulus by `fourier`."""

    shell: Shell

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield the rows of `fourier.influence`."""
        return fourier.influence_in_parts(
            self.shell, at, of, sensor=sensor, puck_radius=puck_radius
        )

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return `fourier.uniform_influence`."""
        return fourier.uniform_influence(self.shell, at, sensor=sensor)

    def quadrature(self, actuators: int) -> tuple[Points, Array]:
        """Return Gauss in radius, even steps in angle: exact for rigid motions."""
        a, b = self.shell.inner_radius, self.shell.outer_radius
        step = np.sqrt(np.pi * (b**2 - a**2) / actuators) / QUADRATURE
        xi, gauss = legendre.leggauss(max(4, int(np.ceil((b - a) / step))))
        radii = 0.5 * (a + b) + 0.5 * (b - a) * xi
        counts = np.maximum(8, np.ceil(2 * np.pi * radii / step)).astype(int)
        radius = np.repeat(radii, counts)
        area = np.repeat(np.pi * (b - a) * gauss * radii / counts, counts)
        angle = np.concatenate([2 * np.pi * (np.arange(k) + 0.5) / k for k in counts])
        return (radius * np.cos(angle), radius * np.sin(angle)), area
