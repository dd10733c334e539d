"""What the sensors of a mirror read, by the model of its shell, for data measured on it.

Forces act on the pucks; annular sensors round them, centred on the magnets or not, read the mean
displacement of the glass. A reading at another place is a combination of the readings at the
magnets, since the shape of the glass between them is known. Its derivatives with the place are
central differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch, GeometryError
from truenewton.mirrors.glass import rim
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.shell_model import (
    ShellModel,
    model_shell,
    rigid_motions,
    shapes_at,
)
from truenewton.statics.arms import arms
from truenewton.statics.layout import Layout

STEP = 2.5e-4  # [m]; first differences err by 1e-4 if pucks are 12 mm from the edge of a sensor


def puck_motion(glass: ShellModel) -> Array:
    """Return (n, n) H, the displacements of the pucks per displacement that the sensors read.

    H = J S J^-1 with S that of the shallow shell and J its exchange for the sphere; by virtual work
    H'K is symmetric, K the forces by the readings.
    """
    on_puck = rim(glass.mirror.puck_radius)
    if glass.mirror.sensor == on_puck:
        return np.eye(glass.mirror.layout.n)
    pucks = shapes_at(glass, glass.places, on_puck)
    return np.asarray(glass.exchange @ pucks @ np.linalg.inv(glass.exchange))


def model_sensors(glass: ShellModel) -> Array:
    """Return `puck_motion` and `displaced_readings` of a shell, (6, n, n).

    If a sensor touches its puck, another's or an edge, only the former, (1, n, n).
    """
    motion = puck_motion(glass)[None]
    try:
        return np.concatenate([motion, displaced_readings(glass)])
    except GeometryError:
        return motion


def displaced_readings(glass: ShellModel) -> Array:
    """Return the derivatives of readings by the places of sensors, per reading at the magnets.

    (5, n, n): along x, y [1/m], xx, xy, yy [1/m2] of the layout, with fixed normals. A
    GeometryError refuses a sensor that touches its puck, another's or an edge.
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
    """Return (n, n) readings of sensors that are (k, 2) steps off, per reading at the magnets.

    Rigid motions are those of the sphere, see `rearming`.
    """
    mirror = glass.mirror
    layouts = [
        replace(mirror.layout, x=mirror.layout.x + x, y=mirror.layout.y + y) for x, y in steps
    ]
    x, y = np.stack([mirror.shell.along(each.x, each.y) for each in layouts], axis=1)
    all_places = x.ravel(), y.ravel()
    read = glass.free.influence(all_places, glass.places, mirror.sensor, mirror.puck_radius)
    tilts = rigid_motions(*all_places)
    condensed = glass.shallow
    shallow = read @ condensed.stiffness + tilts.T @ condensed.motion
    apart = np.concatenate([arms(each) for each in layouts], axis=1) - tilts
    seen = shallow + apart.T @ np.linalg.pinv(rigid_motions(*glass.places)).T
    return np.split(seen @ np.linalg.inv(glass.exchange), len(steps))


def sensor_model(mirror: Mirror | SegmentedMirror, layout: Layout) -> Array:
    """Return the linear model of what the sensors of a mirror read, for the actuators of data.

    Returns
    -------
    numpy.ndarray
        (6, n, n): `puck_motion` and `displaced_readings`. (1, n, n) if the latter are not known
        because a sensor touches its puck, another's or an edge. Zeros between segments.

    Parameters
    ----------
    mirror
        The glass and its actuators.
    layout
        The n actuators of the data; of a segmented mirror all or those of some segments.

    Raises
    ------
    CampaignMismatch
        The actuators are not those of the mirror.
    GeometryError
        See `model_shell`.

    Examples
    --------
    >>> motion = tn.sensor_model(tn.mirrors.p45(), campaign.layout)
    >>> tn.calibrate(campaign, motion=motion).method
    'reciprocity'
    """
    known = _same_in(mirror, layout)
    if isinstance(mirror, SegmentedMirror):
        blocks, number = segment_sensor_models(mirror, layout), np.asarray(known.segment)
        depth = min(map(len, blocks.values()))
        whole = np.zeros((depth, layout.n, layout.n))
        for k, seen in blocks.items():
            whole[:, *np.ix_(number == k, number == k)] = seen[:depth]
        return whole
    return model_sensors(model_shell(mirror))


def segment_sensor_models(mirror: SegmentedMirror, layout: Layout) -> dict[int, Array]:
    """Return the model of each segment of a layout by its number, (6, k, k) or (1, k, k)."""
    number = np.unique(np.asarray(_same_in(mirror, layout).segment)).tolist()
    blocks: dict[int, Array] = {}
    for glass, alike in mirror.kinds:
        if measured := sorted(set(alike) & set(number)):
            seen = model_sensors(model_shell(glass))
            blocks |= {k: _turned(seen, mirror.places[k - 1].turned) for k in measured}
    return blocks


def edges_for(mirror: Mirror | SegmentedMirror, layout: Layout) -> list[Array]:
    """Return the edges of the glass of the segments in a layout, (vertices, 2) each [m]."""
    known = _same_in(mirror, layout)
    if isinstance(mirror, SegmentedMirror):
        return mirror.seen_edges(np.unique(np.asarray(known.segment)).tolist())
    return mirror.shell.seen_edges()


def _same_in(mirror: Mirror | SegmentedMirror, layout: Layout) -> Layout:
    """Return the actuators of data as the mirror has them, with their segments."""
    segmented, known = isinstance(mirror, SegmentedMirror), mirror.layout
    if segmented:
        measured = np.isin(known.id, layout.id)
        known = known.part(measured) if measured.any() else known
    elif known.n == layout.n:  # data may number them by channel: places decide
        known = replace(known, id=layout.id)
    if apart := layout.other_actuators(known):
        part = layout.segment is not None and not segmented
        whole = "; of a segment, that of the whole" if part else ""
        raise CampaignMismatch(
            f"the actuators of {mirror.name} are not those of the data: {apart}",
            remedy=f"give the mirror that was measured, with its ACTUATORS table{whole}",
        )
    if known.segments and not np.array_equal(np.asarray(layout.segment), np.asarray(known.segment)):
        raise CampaignMismatch(
            f"the data have other actuators behind a segment than {mirror.name}, or no segments",
            remedy="give ACTUATORS the column SEGMENT, numbered as the segments of the mirror are",
        )
    return known


def _turned(seen: Array, degrees: float) -> Array:
    """Return a (6, n, n) or (1, n, n) model of a segment along the axes of the mirror."""
    if len(seen) == 1 or not degrees:
        return seen
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    motion, x, y, xx, xy, yy = seen
    return np.stack(
        [
            motion,
            c * x - s * y,
            s * x + c * y,
            c * c * xx - 2 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2 * c * s * xy + c * c * yy,
        ]
    )
