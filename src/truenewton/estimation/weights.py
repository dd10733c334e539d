"""Where the errors come from, and what would make them smaller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import ErrorKind, ErrorSource, ScaleError
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load

READINGS = ErrorSource(ErrorKind.READINGS)


@dataclass(frozen=True, eq=False)
class WeightError:
    """One independent source of error of the weights.

    Attributes
    ----------
    source
        E_WEIGHT, E_ADDED of a tool, or E_TILT of a load.
    change
        (L,) change of W of each load by one standard uncertainty [N].
    """

    source: ErrorSource
    change: Array


def weight_errors(campaign: Campaign) -> tuple[WeightError, ...]:
    """Return the independent sources of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads; loads with the same TOOL share one error of their added
    weight, each in proportion to its own; every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    errors = [WeightError(ErrorSource(ErrorKind.MIRROR), campaign.weight_error * cosine)]
    for source in dict.fromkeys(added_source(load) for load in loads if load.added_error > 0):
        shared = [added_source(load) == source for load in loads]
        change = np.where(shared, [load.added_error for load in loads], 0.0) * cosine
        errors.append(WeightError(source, change))
    for load_index, load in enumerate(loads):
        if load.tilt_error > 0:
            change = np.zeros(len(loads))
            total = campaign.weight + load.added
            change[load_index] = -total * sine[load_index] * np.radians(load.tilt_error)
            errors.append(WeightError(ErrorSource(ErrorKind.TILT, load.name), change))
    return tuple(error for error in errors if np.any(error.change))


def added_source(load: Load) -> ErrorSource:
    """Return the source of the error of an added weight: its tool, or the load if none is named."""
    if load.tool:
        return ErrorSource(ErrorKind.TOOL, load.tool)
    return ErrorSource(ErrorKind.ADDED, load.name)


def scale_errors(
    alpha: Array, reading_covariance: Array, changes: Array, sources: tuple[WeightError, ...]
) -> tuple[ScaleError, ...]:
    """Return what each source does to the common scale of alpha, largest first.

    Parameters
    ----------
    alpha, reading_covariance
        (n,) and its (n, n) covariance from the readings.
    changes
        (sources, n) change of alpha by one standard uncertainty of each source.
    sources
        The errors of the weights.
    """
    direction = alpha / (alpha @ alpha)  # a relative change of all: alpha -> alpha (1 + e)
    lines = [scale_error_from_readings(alpha, reading_covariance)]
    lines += [
        ScaleError(source.source, abs(float(direction @ change)))
        for source, change in zip(sources, changes, strict=True)
    ]
    return tuple(sorted(lines, key=lambda line: -line.relative))


def scale_error_from_readings(alpha: Array, reading_covariance: Array) -> ScaleError:
    """Return the part of the readings, from (n,) alpha and its (n, n) covariance from them."""
    direction = alpha / (alpha @ alpha)
    return ScaleError(READINGS, float(np.sqrt(direction @ reading_covariance @ direction)))


def scale_total(lines: tuple[ScaleError, ...]) -> float:
    """Return the relative standard uncertainty of the common scale."""
    return float(np.sqrt(sum(line.relative**2 for line in lines)))


def tilt_as_load(weight: float, weight_error: float, tilt: float, tilt_error: float) -> float:
    """Return the relative error of the scale if the mirror's own tilt were the second load.

    The change of weight is P (1 - cos tilt); P in N, the tilt in degrees.
    """
    from_angle = np.radians(tilt_error) / np.tan(np.radians(tilt) / 2)
    return float(np.hypot(weight_error / weight, from_angle))
