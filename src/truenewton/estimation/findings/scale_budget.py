"""Where the errors come from, and what would make them smaller."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.findings.estimate import ErrorKind, ErrorSource, ScaleError
from truenewton.records.campaign import Campaign, load_temperatures
from truenewton.statics.load import Load

FROM_READINGS = ErrorSource(ErrorKind.READINGS)
MAGNET_COEFFICIENT = -1.1e-3  # [1/K] of NdFeB, the law of a mirror that nobody tracked [lit]
# Sources of a relative error of the common scale below it are not listed.
NEGLIGIBLE_SCALE_ERROR = 1e-5

SAME_TEMPERATURE = 0.05  # [K] within which no load is warmer than another
# For each independent source, (L,) change of W of each load by one standard uncertainty [N].
WeightErrors = Mapping[ErrorSource, Array]


def weight_errors(campaign: Campaign) -> dict[ErrorSource, Array]:
    """Return (L,) changes [N] by each source of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads; loads with the same TOOL share one error of their added
    weight, each in proportion to its own; every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    errors = defaultdict[ErrorSource, Array](lambda: np.zeros(len(loads)))
    errors[ErrorSource(ErrorKind.MIRROR)] = campaign.weight_error * cosine
    for load_index, load in enumerate(loads):
        if load.added_error > 0:
            errors[added_source(load)][load_index] = load.added_error * cosine[load_index]
    for load_index, load in enumerate(loads):
        if load.tilt_error > 0:
            by_angle = -(campaign.weight + load.added) * sine[load_index]
            source = ErrorSource(ErrorKind.TILT, load.name)
            errors[source][load_index] = by_angle * np.radians(load.tilt_error)
    return {source: change for source, change in errors.items() if change.any()}


def temperature_errors(campaign: Campaign, force: Array) -> dict[ErrorSource, Array]:
    """Return (L,) changes of W [N] that stand for bias magnets warmer under one load than another.

    Their force B, of two magnets each, changes by twice `MAGNET_COEFFICIENT`, and no balance tells
    that from a weight. B from the loads, all alpha alike: W + B + s F = 0, F the mean sum of
    commanded forces.

    Parameters
    ----------
    campaign
        The cycles; nothing where one has no TEMPERATURE, or no load is warmer than another.
    force
        (L,) F [N].
    """
    weights = campaign.effective_weights
    warmth = load_temperatures(campaign)
    if len(weights) < 2 or not np.isfinite(warmth).all() or np.ptp(warmth) < SAME_TEMPERATURE:
        return {}
    bias = np.polyfit(force, -weights, 1)[1] if np.ptp(force) else 0.0
    changes = 2 * MAGNET_COEFFICIENT * bias * (warmth - warmth.mean())
    return {ErrorSource(ErrorKind.BETWEEN_LOADS): changes}


def added_source(load: Load) -> ErrorSource:
    """Return the source of the error of an added weight: its tool, or the load if none is named."""
    if load.tool:
        return ErrorSource(ErrorKind.TOOL, load.tool)
    return ErrorSource(ErrorKind.ADDED, load.name)


def scale_errors(
    alpha: Array, reading_covariance: Array, changes: Array, sources: Iterable[ErrorSource]
) -> tuple[ScaleError, ...]:
    """Return what each source does to the common scale of alpha, largest first.

    Parameters
    ----------
    alpha, reading_covariance
        (n,) and its (n, n) covariance from the readings.
    changes
        (sources, n) change of alpha by one standard uncertainty of each source.
    sources
        Of the errors of the weights.
    """
    direction = alpha / (alpha @ alpha)  # a relative change of all: alpha -> alpha (1 + e)
    lines = [scale_error_from_readings(alpha, reading_covariance)]
    lines += [
        ScaleError(source, abs(float(direction @ change)))
        for source, change in zip(sources, changes, strict=True)
    ]
    return tuple(sorted(lines, key=lambda line: -line.relative))


def scale_error_from_readings(alpha: Array, reading_covariance: Array) -> ScaleError:
    """Return the part of the readings, from (n,) alpha and its (n, n) covariance from them."""
    direction = alpha / (alpha @ alpha)
    return ScaleError(FROM_READINGS, float(np.sqrt(direction @ reading_covariance @ direction)))


def scale_budget(lines: Iterable[ScaleError]) -> dict[str, float]:
    """Return the relative errors of the common scale that are worth telling, by their source."""
    return {
        str(line.source): line.relative for line in lines if line.relative > NEGLIGIBLE_SCALE_ERROR
    }


def typical(error: Array, alpha: Array) -> float:
    """Return the median over actuators of an (n,) error relative to alpha; NaN where disabled."""
    return float(np.nanmedian(error / np.abs(alpha)))


def scale_total(lines: tuple[ScaleError, ...]) -> float:
    """Return the relative standard uncertainty of the common scale."""
    return float(np.sqrt(sum(line.relative**2 for line in lines)))


def tilt_as_load(weight: float, weight_error: float, tilt: float, tilt_error: float) -> float:
    """Return the relative error of the scale if the mirror's own tilt were the second load.

    The change of weight is P (1 - cos tilt); P in N, the tilt in degrees.
    """
    from_angle = np.radians(tilt_error) / np.tan(np.radians(tilt) / 2)
    return float(np.hypot(weight_error / weight, from_angle))
