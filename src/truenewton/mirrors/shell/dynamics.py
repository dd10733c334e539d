"""The mass that moves with the glass."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import rim
from truenewton.mirrors.shell.shell_model import ShellModel, StaticShapes, shapes_at


def moving_mass(glass: ShellModel, shapes: StaticShapes) -> tuple[Array, Array]:
    """Return M [kg] and S, (n, n) each, in M z'' + K~ z = S' f, z the readings and f the forces.

    M = rho t integral of phi_i phi_j + magnet_mass S' S (Guyan's reduction), with phi the influence
    functions and S the displacement of the pucks with their magnets per reading, 1 if actuators are
    read at the points of their forces. S transforms the forces to the readings by virtual work; K~
    = S' K. Motion along the glass and the inertia of rotation are neglected. M is symmetric; for
    rigid motions it is that of the whole.
    """
    mirror = glass.mirror
    mass = shapes.shape.T @ (shapes.area[:, None] * shapes.shape)
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks, on_puck = np.eye(mirror.layout.n), rim(mirror.puck_radius)
    if mirror.sensor != on_puck:
        pucks = shapes_at(glass, glass.places, on_puck)
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks
