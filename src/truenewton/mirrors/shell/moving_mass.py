"""Static shapes of the glass between its actuators, and the mass that moves with them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.shell.condensation import Condensed, condense
from truenewton.mirrors.shell.free_shell import influence, rim
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
    mirror, places, n = glass.mirror, glass.places, glass.places[0].size
    compliance = influence(
        glass.free, places, places, sensor=mirror.sensor, puck_radius=mirror.puck_radius
    )
    condensed = condense(compliance, _tilts(places), reciprocal=False)
    at, area = glass.free.quadrature(n)
    mass = np.zeros((n, n))
    first = 0
    for shapes in _influence_functions(glass, condensed, at):
        weighted = area[first : first + shapes.shape[0], None] * shapes
        mass += shapes.T @ weighted
        first += shapes.shape[0]
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks = _puck_motion(glass, condensed)
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks


def _influence_functions(glass: HeldGlass, condensed: Condensed, at: Points) -> Iterator[Array]:
    """Yield (some points, n): the shapes of the glass when one actuator reads 1, the others 0."""
    tilts, first = _tilts(at), 0
    for read in glass.free.influence_in_parts(
        at, glass.places, puck_radius=glass.mirror.puck_radius
    ):
        rigid = tilts[:, first : first + len(read)]
        yield read @ condensed.stiffness + rigid.T @ condensed.motion
        first += len(read)


def _puck_motion(glass: HeldGlass, condensed: Condensed) -> Array:
    """Return S, (n, n) displacement of each puck for that read at each actuator."""
    mirror, places = glass.mirror, glass.places
    on_puck = rim(mirror.puck_radius)
    if mirror.sensor == on_puck:
        return np.eye(places[0].size)
    read = influence(glass.free, places, places, sensor=on_puck, puck_radius=mirror.puck_radius)
    return read @ condensed.stiffness + _tilts(places).T @ condensed.motion


def _tilts(at: Points) -> Array:
    """Return (3, points) the rigid motions of a shallow shell, 1, x, y."""
    return np.array([np.ones_like(at[0]), *at])
