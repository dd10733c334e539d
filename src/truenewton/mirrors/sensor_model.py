"""The glass of a mirror, and what its sensors see of it, for data that were taken on it."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.puck_motion import model_sensors
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.statics.layout import Layout


def sensor_model(mirror: Mirror | SegmentedMirror, layout: Layout) -> Array:
    """Return what sensors see of a mirror whose actuators are those of data.

    Returns
    -------
    numpy.ndarray
        (6, n, n): `puck_motion` and `displaced_readings`. (1, n, n) where the latter are not known:
        of a sensor that touches its puck, another's or an edge. Zeros between segments.

    Parameters
    ----------
    mirror
        The glass and its actuators.
    layout
        The n actuators of the data, of a mirror in segments all or those of some.

    Raises
    ------
    CampaignMismatch
        The actuators are others.
    GeometryError
        What `model_shell` raises.

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
    """Return the same of each segment of a layout by its number, (6, k, k) or (1, k, k).

    Raises
    ------
    CampaignMismatch, GeometryError
    """
    number = np.unique(np.asarray(_same_in(mirror, layout).segment)).tolist()
    blocks: dict[int, Array] = {}
    for glass, alike in mirror.kinds:
        if measured := sorted(set(alike) & set(number)):
            seen = model_sensors(model_shell(glass))
            blocks |= {k: _turned(seen, mirror.places[k - 1].turned) for k in measured}
    return blocks


def edges_for(mirror: Mirror | SegmentedMirror, layout: Layout) -> list[Array]:
    """Return the edges of the glass behind the actuators of data, (vertices, 2) each [m].

    Of a mirror in segments those of the segments that the layout holds.

    Raises
    ------
    CampaignMismatch
        The actuators are others.
    """
    known = _same_in(mirror, layout)
    if isinstance(mirror, SegmentedMirror):
        return mirror.seen_edges(np.unique(np.asarray(known.segment)).tolist())
    return mirror.shell.seen_edges()


def _same_in(mirror: Mirror | SegmentedMirror, layout: Layout) -> Layout:
    """Return the actuators of data as a mirror has them, its segments included.

    Raises
    ------
    CampaignMismatch
        They are others, or behind other segments.
    """
    segmented, known = isinstance(mirror, SegmentedMirror), mirror.layout
    if segmented:
        measured = np.isin(known.id, layout.id)
        known = known.part(measured) if measured.any() else known
    if apart := layout.other_actuators(known):
        part = layout.segment is not None and not segmented
        whole = "; of a segment, that of the whole" if part else ""
        raise CampaignMismatch(
            f"the actuators of {mirror.name} are not those of the data: {apart}",
            remedy=f"give the mirror that was measured, with its ACTUATORS table{whole}",
        )
    if known.segments and not np.array_equal(np.asarray(layout.segment), np.asarray(known.segment)):
        raise CampaignMismatch(
            f"the data have other actuators behind a segment than {mirror.name}, or tell of none",
            remedy="give ACTUATORS the column SEGMENT, numbered as the segments of the mirror are",
        )
    return known


def _turned(seen: Array, degrees: float) -> Array:
    """Return (6, n, n) or (1, n, n), derivatives along axes that the segment is turned from."""
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
