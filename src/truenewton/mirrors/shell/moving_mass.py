"""Static shapes of the glass between its actuators, and the mass that moves with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, rim
from truenewton.mirrors.shell.condensation import condense, rigid_motions
from truenewton.mirrors.shell.places import Points
from truenewton.mirrors.shell.shell_model import ShellModel, influence


@dataclass(frozen=True, eq=False)
class StaticShapes:
    """The shapes of a glass when one actuator reads 1, the others 0, over all of it.

    Attributes
    ----------
    at, area
        x and y of points along the glass [m], and (points,) the area that each stands for [m^2].
    shape
        (points, n) displacement per reading.
    """

    at: Points
    area: Array
    shape: Array


def static_shapes(glass: ShellModel) -> StaticShapes:
    """Return the influence functions of a glass, where integrals over it want them.

    Raises
    ------
    GeometryError
        What `model_shell` raises.
    """
    at, area = glass.free.quadrature(glass.mirror.layout.n)
    return StaticShapes(at, area, shapes_at(glass, at))


def shapes_at(glass: ShellModel, at: Points, over: Annulus | None = None) -> Array:
    """Return (points, n) of the influence functions at points, or means over a sensor there."""
    condensed = condense(glass.compliance, rigid_motions(*glass.places))
    read = influence(glass.free, at, glass.places, over, glass.mirror.puck_radius)
    return np.asarray(read @ condensed.stiffness + rigid_motions(*at).T @ condensed.motion)


def moving_mass(glass: ShellModel, shapes: StaticShapes) -> tuple[Array, Array]:
    """Return M and S in M z'' + K~ z = S' f, z the readings and f the forces.

    M = rho t integral of phi_i phi_j + magnet_mass S' S (Guyan's reduction), with phi the
    influence functions and S the displacement of the pucks, with their magnets, for that of the
    readings: 1 where actuators are read at the points of their forces. S takes the forces to the
    readings by virtual work; K~ = S' K. Motion along the glass and the inertia of rotation are
    left away.

    Returns
    -------
    tuple of numpy.ndarray
        (n, n) mass by the readings [kg], symmetric; a rigid motion finds the mass and moments of
        the whole. (n, n) S.

    Raises
    ------
    GeometryError
        What `model_shell` raises.
    """
    mirror = glass.mirror
    mass = shapes.shape.T @ (shapes.area[:, None] * shapes.shape)
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks, on_puck = np.eye(mirror.layout.n), rim(mirror.puck_radius)
    if mirror.sensor != on_puck:
        pucks = shapes_at(glass, glass.places, on_puck)
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks
