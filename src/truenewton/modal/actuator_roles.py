"""Who is commanded, off or slaved; alpha and sensors, matched to the actuators of a mirror."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, UnknownName
from truenewton.estimation.reciprocity.sensor_model import Places, seen_from
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

FEWEST = 4  # actuators that leave a motion that bends the glass


def off_and_slaved(
    layout: Layout, off: Sequence[int], slaved: Sequence[int]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (n,) which actuators are off, and (n,) which are slaved, by their IDs.

    Raises
    ------
    UnknownName
        An ID that no actuator has, or that is both.
    RankDeficient
        Too few are left to command.
    """
    floats, follows = _named(layout, off, "off"), _named(layout, slaved, "slaved")
    if (floats & follows).any():
        both = int(layout.id[floats & follows][0])
        raise UnknownName(
            f"actuator {both} is both off and slaved", remedy="name it once", got=both
        )
    commanded = int(np.count_nonzero(~(floats | follows)))
    if commanded < FEWEST:
        raise RankDeficient(
            f"only {counted(commanded, 'actuator')} of {layout.n} left to command",
            remedy=f"leave {FEWEST} at least",
            got=commanded,
            want=FEWEST,
        )
    return floats, follows


def _named(layout: Layout, ids: Sequence[int], what: str) -> NDArray[np.bool_]:
    """Return (n,) which actuators are named."""
    if not all(isinstance(name, int | np.integer) for name in ids):
        raise UnknownName(
            f"{list(ids)!r} are not all IDs", remedy="give whole numbers, as [3, 17]", got=ids
        )
    unknown = sorted({*map(int, ids)} - {*layout.id.tolist()})  # Python's, which know no overflow
    if unknown:
        raise UnknownName(
            f"no enabled actuator has the ID {unknown[0]} that is to be {what}",
            remedy=f"IDs go from {layout.id.min()} to {layout.id.max()}",
            got=int(unknown[0]),
        )
    return np.isin(layout.id, ids)


def matched_alpha(layout: Layout, instrument: str, calibration: Calibration | None) -> Array:
    """Return (n,) alpha of the actuators of a mirror, matched by their IDs; 1 without calibration.

    Raises
    ------
    CampaignMismatch
        The calibration is of another mirror, or lacks an actuator.
    """
    if calibration is None:
        return np.ones(layout.n)
    remedy = "give the calibration of the same mirror"
    if calibration.instrument != instrument:
        raise CampaignMismatch(
            f"the stiffness is of {instrument}, the calibration of {calibration.instrument}",
            remedy=remedy,
        )
    theirs = calibration.layout
    at = indices_of(theirs, layout.id)
    unknown = (theirs.id[at] != layout.id) | ~np.isfinite(calibration.alpha[at])
    if unknown.any():
        raise CampaignMismatch(
            f"the calibration has no alpha for actuator {layout.id[unknown][0]}",
            remedy="calibrate all actuators that the stiffness has enabled",
            got=int(layout.id[unknown][0]),
        )
    if apart := theirs.part(at).other_actuators(layout):
        raise CampaignMismatch(f"stiffness and calibration disagree on {apart}", remedy=remedy)
    return np.asarray(calibration.alpha[at])


def matched_sensors(layout: Layout, calibration: Calibration | None) -> tuple[Array, Array]:
    """Return what a calibration knows of the sensors of a mirror; 1 and 0 where nothing.

    Returns
    -------
    gain
        (n,) true displacement / reading.
    offset
        (2, n) x and y of magnet less sensor [m].

    Raises
    ------
    FormatError
    """
    gain, offset = np.ones(layout.n), np.zeros((2, layout.n))
    if calibration is not None:
        at = indices_of(calibration.layout, layout.id)
        theirs = calibration.of_sensors("gain")[at]
        gain = np.where(np.isnan(theirs), 1.0, theirs)
        offset = np.nan_to_num([calibration.of_sensors(axis)[at] for axis in "xy"])
    return checked_gain(gain, np.ones(layout.n, dtype=bool)), offset


def per_true_displacement(k: Array, places: Places, gain: Array, offset: Array) -> Array:
    """Return (n, n) forces per true displacement for those per reading, which are overwritten.

    ``gain`` and ``offset`` as of `matched_sensors`, of the enabled, as ``places``. Between the
    actuators the glass bends as a plate, unless a model of it tells (`sight`).
    """
    k /= gain
    if places.motion is None and not offset.any():
        return k
    factors = lu_factor(seen_from(places, offset).T, overwrite_a=True)
    return np.asarray(lu_solve(factors, k.T, overwrite_b=True).T)


def readings(moved: Array, places: Places, gain: Array, offset: Array) -> Array:
    """Return (n, k) what the sensors read of (n, k) true displacements."""
    if places.motion is None and not offset.any():
        return moved / gain[:, None]
    factors = lu_factor(seen_from(places, offset), overwrite_a=True)
    return np.asarray(lu_solve(factors, moved) / gain[:, None])


def indices_of(layout: Layout, names: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (k,) indices in a layout of actuators named by (k,) IDs; any for one it has not."""
    order = np.argsort(layout.id)
    at = np.searchsorted(layout.id, names, sorter=order)
    return np.asarray(order[np.minimum(at, layout.n - 1)])


def checked_gain(sensor_gain: Array | None, on: NDArray[np.bool_]) -> Array:
    """Return true displacement / reading of those of (n,) actuators that are on; 1 without gains.

    Raises
    ------
    FormatError
    """
    if sensor_gain is None:
        return np.ones(int(on.sum()))
    gain = np.asarray(sensor_gain, dtype=float)
    if gain.shape != on.shape:
        raise FormatError(
            f"sensor_gain has shape {gain.shape}",
            remedy=f"give one number for each of the {on.size} actuators",
            got=gain.shape,
            want=on.shape,
        )
    if not (np.isfinite(gain[on]).all() and (gain[on] > 0).all()):
        raise FormatError(
            "sensor_gain holds numbers that are not positive", remedy="they are about 1"
        )
    return gain[on]
