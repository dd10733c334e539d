"""What the pucks do where forces act, for what sensors round them read."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch
from truenewton.mirrors.glass import rim
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.shell.held_glass import HeldGlass, held_glass
from truenewton.mirrors.shell.moving_mass import shapes_at
from truenewton.statics.layout import Layout


def puck_motion(glass: HeldGlass) -> Array:
    """Return (n, n) H, displacements of the pucks for those that the sensors see.

    H = J S J^-1 with S that of the shallow shell and J its exchange for the sphere; by virtual work
    H'K is symmetric, K the forces by the readings.
    """
    on_puck = rim(glass.mirror.puck_radius)
    if glass.mirror.sensor == on_puck:
        return np.eye(glass.mirror.layout.n)
    pucks = shapes_at(glass, glass.places, on_puck)
    return np.asarray(glass.exchange @ pucks @ np.linalg.inv(glass.exchange))


def motion_for(mirror: Mirror, layout: Layout) -> Array:
    """Return (n, n) `puck_motion` of a mirror whose actuators are those of data.

    Parameters
    ----------
    mirror
        The glass and its actuators.
    layout
        The n actuators of the data.

    Raises
    ------
    CampaignMismatch
        They are not.
    GeometryError
        What `held_glass` raises.

    Examples
    --------
    >>> motion = tn.motion_for(tn.mirrors.p45(), campaign.layout)
    >>> tn.calibrate(campaign, motion=motion).method
    'reciprocity'
    """
    if not mirror.layout.same_actuators_as(layout):
        raise CampaignMismatch(
            f"the actuators of {mirror.name} are not those of the data",
            remedy="give the mirror that was measured, with its ACTUATORS table",
        )
    return puck_motion(held_glass(mirror))
