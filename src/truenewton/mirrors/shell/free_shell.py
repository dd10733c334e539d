"""A free shell under forces, by either model: Fourier for rings, finite elements for any outline.

Displacements are along the normal, up to rigid motions, and right for every combination of forces
whose sum and torques vanish. One force alone finds no equilibrium on a free shell; its column means
something only in such sums. x and y are positions along the glass [m].
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.condensation import condense
from truenewton.mirrors.shell.fourier import RoundShell
from truenewton.mirrors.shell.places import Points


class FreeShell(Protocol):
    """What is asked of a model."""

    def influence_in_parts(
        self, at: Points, of: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
    ) -> Iterator[Array]:
        """Yield rows of `influence` [m/N], some at a time: all of them would fill the memory."""

    def uniform_influence(self, at: Points, *, sensor: Annulus | None = None) -> Array:
        """Return the same, (n_at,), per unit force spread evenly over the glass [m/N]."""

    def quadrature(self, actuators: int) -> tuple[Points, Array]:
        """Return x, y [m] and areas [m^2], fine enough for the shapes of so many actuators."""


def free_shell(shell: Shell, at: Points) -> FreeShell:
    """Return the model of a shell whose actuators stand at x and y.

    Raises
    ------
    GeometryError
        An outlined glass that cannot be, or that cannot be meshed.
    """
    if shell.outline is None:
        return RoundShell(shell)
    from truenewton.mirrors.shell.finite_elements.meshed_shell import meshed_shell

    return meshed_shell(shell, *at, mesh_size=shell.outline.mesh_size)


def influence(
    free: FreeShell,
    at: Points,
    of: Points,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
) -> Array:
    """Return the displacement at points, or the reading of sensors, per unit force.

    Where forces and readings share their places this is the compliance of the actuators. It is
    symmetric only where displacements are read just as forces act: at points under point forces,
    or on a circle as wide as the puck.

    Parameters
    ----------
    free
        The shell.
    at
        x and y, (n_at,) each, of the points where the displacement is read, edges included, or of
        the centres of the sensors.
    of
        x and y, (n_of,) each, of the forces; off the edges.
    sensor
        Over which a reading is the mean; none reads at the points.
    puck_radius
        Radius of the circle on which the force enters the glass [m]; 0 for a point. A stiff puck
        that is glued to the glass presses with its rim, for the glass under it does not bend; that
        it stiffens the glass as well is not modelled. Nobody vouches for a radius [guess].

    Returns
    -------
    numpy.ndarray
        (n_at, n_of) [m/N].

    Raises
    ------
    GeometryError
        What the model raises.
    """
    parts = free.influence_in_parts(at, of, sensor=sensor, puck_radius=puck_radius)
    return np.concatenate([*parts])


def stiffness(
    free: FreeShell, at: Points, *, sensor: Annulus | None = None, puck_radius: float = 0.0
) -> Array:
    """Return the stiffness between actuators: force per displacement as read.

    Read by sensors, this is what a mirror is driven by and what a measured feed-forward matrix is:
    f = K z with z the readings. Forces on the right still balance and rigid motions still cost
    nothing, but K is not symmetric: a sensor sees another mean of the shape than the force does,
    z = S w, and K = K_w S^-1 with K_w, symmetric, the stiffness by the displacement w that the
    forces do work on. That is physics, not an error of the model.

    Parameters
    ----------
    free, sensor, puck_radius
        As in `influence`.
    at
        x and y, (n,) each, of the actuators.

    Returns
    -------
    numpy.ndarray
        (n, n) force per displacement [N/m]; its null space is {1, x, y}. Symmetric without a
        sensor.

    Raises
    ------
    GeometryError
        Actuators on one line or several at one place; what the model raises.
    """
    compliance = influence(free, at, at, sensor=sensor, puck_radius=puck_radius)
    tilts = np.array([np.ones_like(at[0]), *at])
    return condense(compliance, tilts, reciprocal=sensor == rim(puck_radius)).stiffness


def rim(puck_radius: float) -> Annulus | None:
    """Return the sensor that reads displacements just as a puck's force acts."""
    return Annulus(puck_radius, puck_radius) if puck_radius else None
