"""A mirror's glass between its actuators: what forces hold it, and how it moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shell.condensation import Condensed, condense, holding_forces, rearming
from truenewton.mirrors.shell.fourier import influence, uniform_influence
from truenewton.mirrors.shell.moving_mass import condensed_mass, puck_motion
from truenewton.mirrors.shell.places import Points
from truenewton.statics.arms import arms


@dataclass(frozen=True, eq=False)
class HeldGlass:
    """The glass of a mirror, pushed through its pucks and read by its sensors.

    Attributes
    ----------
    mirror
        Whose glass it is.
    places
        x and y of the actuators along the glass [m].
    exchange
        (n, n) J, from motions of the shallow shell to those of the sphere (`rearming`).
    condensed
        Its stiffness, force per reading, free to move along the arms of the balance.
    """

    mirror: Mirror
    places: Points
    exchange: Array
    condensed: Condensed

    @property
    def stiffness(self) -> Array:
        """(n, n) true force per true displacement as the sensors read it [N/m]."""
        return self.condensed.stiffness


def held_glass(mirror: Mirror) -> HeldGlass:
    """Return the glass of a mirror from the semi-analytic model.

    Raises
    ------
    GeometryError
        What `fourier.influence` and `condense` raise.
    """
    places = mirror.shell.along(mirror.layout.x, mirror.layout.y)
    tilts, lever = np.array([np.ones_like(places[0]), *places]), arms(mirror.layout)
    exchange = rearming(tilts, lever)
    compliance = influence(
        mirror.shell, places, places, sensor=mirror.sensor, puck_radius=mirror.puck_radius
    )
    condensed = condense(exchange @ compliance @ exchange.T, lever, reciprocal=False)
    return HeldGlass(mirror, places, exchange, condensed)


def forces_under(glass: HeldGlass, spread: float, at: Points, force: Array) -> Array:
    """Return the (n,) forces that hold the flat mirror under an external load [N].

    Parameters
    ----------
    glass
        From `held_glass`.
    spread
        Force spread evenly over the glass [N].
    at, force
        x and y [m] and size [N] of forces at points off the actuators, along the glass.
    """
    shell, sensor = glass.mirror.shell, glass.mirror.sensor
    bent = spread * uniform_influence(shell, glass.places, sensor=sensor)
    bent += influence(shell, glass.places, at, sensor=sensor) @ force
    resultants = np.array([spread + force.sum(), at[0] @ force, at[1] @ force])
    flat = np.zeros(glass.places[0].size)
    return holding_forces(glass.condensed, flat, glass.exchange @ bent, resultants)


def moving_mass(glass: HeldGlass) -> tuple[Array, Array]:
    """Return mass [kg] and S in M z'' + K~ z = S' f, z the readings and f the forces, (n, n) each.

    S, the displacement of the pucks for that of the readings, takes the forces to the readings by
    virtual work; K~ = S' K.
    """
    mirror, (x, y) = glass.mirror, glass.places
    mass = condensed_mass(
        mirror.shell, x, y, mirror.magnet_mass, sensor=mirror.sensor,
        puck_radius=mirror.puck_radius,
    )  # fmt: skip
    pucks = puck_motion(mirror.shell, x, y, sensor=mirror.sensor, puck_radius=mirror.puck_radius)
    return mass, pucks
