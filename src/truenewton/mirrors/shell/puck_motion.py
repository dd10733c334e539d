"""What the pucks do where forces act, for what sensors round them read, at their magnets or off.

What a sensor reads at another place is a combination of what all read at their magnets: the shape
of the glass between them is known. Its differences from place to place are central ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import rim
from truenewton.mirrors.shell.condensation import condense, rigid_motions
from truenewton.mirrors.shell.moving_mass import shapes_at
from truenewton.mirrors.shell.shell_model import ShellModel, influence
from truenewton.statics.arms import arms

# Between places [m]: first differences are then good to 1e-4 of themselves, where neighbouring
# pucks are 12 mm from the edge of a sensor.
STEP = 2.5e-4


def puck_motion(glass: ShellModel) -> Array:
    """Return (n, n) H, displacements of the pucks for those that the sensors see.

    H = J S J^-1 with S that of the shallow shell and J its exchange for the sphere; by virtual work
    H'K is symmetric, K the forces by the readings.
    """
    on_puck = rim(glass.mirror.puck_radius)
    if glass.mirror.sensor == on_puck:
        return np.eye(glass.mirror.layout.n)
    pucks = shapes_at(glass, glass.places, on_puck)
    return np.asarray(glass.exchange @ pucks @ np.linalg.inv(glass.exchange))


def model_sensors(glass: ShellModel) -> Array:
    """Return `puck_motion` and `displaced_readings` of a glass, (6, n, n).

    Or the former alone, (1, n, n), of a sensor that touches its puck, another's or an edge.
    """
    motion = puck_motion(glass)[None]
    try:
        return np.concatenate([motion, displaced_readings(glass)])
    except GeometryError:
        return motion


def displaced_readings(glass: ShellModel) -> Array:
    """Return how readings change with the places of the sensors, for what all read at the magnets.

    Returns
    -------
    numpy.ndarray
        (5, n, n) derivatives along x, y [1/m], xx, xy, yy [1/m2] in those of the layout; the
        normals stay as they are.

    Raises
    ------
    GeometryError
        A sensor that touches its puck, another's or an edge.
    """
    steps = STEP * np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)])
    here = np.eye(glass.mirror.layout.n)
    east, west, north, south, far, back = (read - here for read in _read_at(glass, steps))
    along, across = east + west, north + south
    once, twice = 1 / STEP, 1 / STEP**2
    return np.array(
        [
            0.5 * once * (east - west),
            0.5 * once * (north - south),
            twice * along,
            0.5 * twice * (far + back - along - across),
            twice * across,
        ]
    )


def _read_at(glass: ShellModel, steps: Array) -> list[Array]:
    """Return (n, n) what sensors read that sit (k, 2) steps off, for what they read at the magnets.

    As `rearming` puts the sphere's rigid motions in place of the shallow shell's.
    """
    mirror = glass.mirror
    layouts = [
        replace(mirror.layout, x=mirror.layout.x + x, y=mirror.layout.y + y) for x, y in steps
    ]
    x, y = np.stack([mirror.shell.along(each.x, each.y) for each in layouts], axis=1)
    all_places = x.ravel(), y.ravel()
    read = influence(glass.free, all_places, glass.places, mirror.sensor, mirror.puck_radius)
    tilts = rigid_motions(*all_places)
    condensed = condense(glass.compliance, rigid_motions(*glass.places))
    shallow = read @ condensed.stiffness + tilts.T @ condensed.motion
    apart = np.concatenate([arms(each) for each in layouts], axis=1) - tilts
    seen = shallow + apart.T @ np.linalg.pinv(rigid_motions(*glass.places)).T
    return np.split(seen @ np.linalg.inv(glass.exchange), len(steps))
