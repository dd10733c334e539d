"""Static shapes of the glass between its actuators, and the mass that moves with them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, rim
from truenewton.mirrors.shell.condensation import Condensed, condense, rigid_motions
from truenewton.mirrors.shell.held_glass import HeldGlass
from truenewton.mirrors.shell.places import Points


def moving_mass(glass: HeldGlass) -> tuple[Array, Array]:
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
        What `held_glass` raises.
    """
    mirror, n = glass.mirror, glass.mirror.layout.n
    condensed = condense(glass.compliance, rigid_motions(*glass.places))
    at, area = glass.free.quadrature(n)
    mass, first = np.zeros((n, n)), 0
    for shapes in _influence_functions(glass, condensed, at, None):
        weighted = area[first : first + len(shapes), None] * shapes
        mass += shapes.T @ weighted
        first += len(shapes)
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks, on_puck = np.eye(n), rim(mirror.puck_radius)
    if mirror.sensor != on_puck:
        pucks = np.concatenate([*_influence_functions(glass, condensed, glass.places, on_puck)])
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks


def _influence_functions(
    glass: HeldGlass, condensed: Condensed, at: Points, sensor: Annulus | None
) -> Iterator[Array]:
    """Yield (some points, n): the shapes of the glass when one actuator reads 1, the others 0."""
    tilts, first = rigid_motions(*at), 0
    for read in glass.free.influence_in_parts(
        at, glass.places, sensor=sensor, puck_radius=glass.mirror.puck_radius
    ):
        rigid = tilts[:, first : first + len(read)]
        yield read @ condensed.stiffness + rigid.T @ condensed.motion
        first += len(read)
