"""Actuators that do not do as they say: a reading that is stuck, no force, the poles exchanged."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, f_isf, normal_sf
from truenewton.errors import Fault
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import Noise
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign

MIN_VARIANCE_RATIO = 100.0  # times its noise the variance of a typical reading over shapes is
MIN_RELATIVE_CHANGE = 0.03  # of a typical change, where nothing tells the noise
STUCK_CHANGE = 1e-9  # of a typical reading: it does not change at all
MAX_ALPHA_SIGMAS = 3.0  # from 0
MAX_DEAD_FRACTION = 0.03  # of the actuators
WELL_KNOWN_ERROR = 0.1  # error of an alpha in terms of the typical one


class ReadingsChange(NamedTuple):
    """How the readings of n actuators change over shapes.

    Attributes
    ----------
    rms
        (n,) change [N].
    size
        Of a typical reading [N].
    within_noise, zero
        (n,) whether noise makes as much; whether the reading is 0 at rest as well.
    """

    rms: Array
    size: float
    within_noise: NDArray[np.bool_]
    zero: NDArray[np.bool_]


def constant_actuators(campaign: Campaign, change: ReadingsChange) -> tuple[Finding, ...]:
    """Name actuators whose reading does not change from shape to shape by more than noise."""
    ids = campaign.layout.id[campaign.layout.enabled]
    dead = Code.DEAD_NO_FORCE, "look at its coil, driver and cable"
    stuck = Code.STUCK_READING, "have its electronics looked at"
    return tuple(
        Finding(
            code=code,
            where=f"actuator {ids[i]}",
            actuators=(int(ids[i]),),
            size=float(change.rms[i]),
            unit="N",
            remedy=f"{remedy}; set ENABLED to F if it exerts no force",
        )
        for i in np.flatnonzero(change.within_noise)
        for code, remedy in [dead if change.zero[i] else stuck]
    )


def stuck_faults(campaign: Campaign, change: ReadingsChange) -> tuple[Fault, ...]:
    """Name actuators whose reading does not change at all: no alpha of theirs can be had.

    Nor the common scale: whatever force it exerts, and it may be any, could carry the load.
    """
    stuck = change.rms <= STUCK_CHANGE * change.size
    ids = campaign.layout.id[campaign.layout.enabled][stuck]
    if stuck.all():
        return (
            Fault(
                "FORCE is the same for all shapes",
                "record the forces commanded for each shape, once the mirror has settled",
            ),
        )
    if not ids.size:
        return ()
    which = f"actuator{'s' if ids.size > 1 else ''} {', '.join(map(str, ids.tolist()))}"
    return (
        Fault(
            f"the reading of {which} is stuck: it is the same for all shapes",
            "have its electronics looked at; set ENABLED to F if it exerts no force",
        ),
    )


def readings_change(moments: Moments, noise: Noise) -> ReadingsChange:
    """Return how the readings of (n,) actuators change over shapes."""
    weight, mean, n = moments.weight, moments.mean, moments.mean.shape[1]
    share = (moments.of_load * weight[:, None]).T
    total = share.sum(axis=1)
    centre = share @ mean / np.where(total > 0.0, total, 1.0)[:, None]
    square, statics, count = np.zeros(n), np.abs(centre).max(axis=0), np.count_nonzero(total)
    for start in range(0, len(mean), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        square += weight[some] @ (mean[some] - centre[moments.labels[some, 0]]) ** 2
    freedom = moments.groups - count
    if freedom < 1:
        nothing = np.zeros(n, dtype=bool)
        return ReadingsChange(np.ones(n), 1.0, nothing, nothing)
    ratio = square / freedom / noise.variance
    known = moments.repeats if moments.repeats else 1e9
    limit = float(f_isf(FALSE_ALARM / n, freedom, known))
    dead = (ratio <= limit) & (np.median(ratio) > MIN_VARIANCE_RATIO * limit)
    change = np.sqrt(square / weight.sum())
    if noise.source == NoiseSource.MINIMUM:
        dead = change < MIN_RELATIVE_CHANGE * np.median(change)
    at_zero = statics < 5.0 * change * np.sqrt(count / moments.groups)
    size = float(np.sqrt(np.mean(change**2 + statics**2)))
    return ReadingsChange(change, size, np.asarray(dead), np.asarray(at_zero))


def strange_alphas(campaign: Campaign, alpha: Array, error: Array) -> tuple[Finding, ...]:
    """Name actuators whose alpha is 0 or negative while that of the others is not.

    Parameters
    ----------
    campaign
        The actuators.
    alpha, error
        (n,) of the enabled ones, and E_STAT.
    """
    typical = float(np.median(alpha))
    if typical <= 0.0:
        return ()
    ids = campaign.layout.id[campaign.layout.enabled]
    known = error < WELL_KNOWN_ERROR * typical
    dead = known & (np.abs(alpha) < MAX_ALPHA_SIGMAS * error)
    negative = known & (alpha <= -MAX_ALPHA_SIGMAS * error)
    if np.count_nonzero(dead | negative) > max(
        2, MAX_DEAD_FRACTION * alpha.size
    ):  # the model is wrong, not they
        return ()
    codes = (
        (dead, Code.DEAD_ALPHA_ZERO, "look at its coil and magnet"),
        (negative, Code.NEGATIVE_ALPHA,
         "exchange the poles of its cable, or the sign of its column of FORCE"),
    )  # fmt: skip
    return tuple(
        Finding(
            code=code,
            where=f"actuator {ids[i]}",
            actuators=(int(ids[i]),),
            probability=float(normal_sf((typical - alpha[i]) / error[i])),
            size=float(alpha[i]),
            remedy=remedy,
        )
        for which, code, remedy in codes
        for i in np.flatnonzero(which)
    )
