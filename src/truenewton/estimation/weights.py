"""Where the errors come from, and what would make them smaller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import ScaleError
from truenewton.records.campaign import Campaign

READINGS = "noise of the readings"


@dataclass(frozen=True, eq=False)
class WeightError:
    """One independent source of error of the weights.

    Attributes
    ----------
    source
        E_WEIGHT, E_ADDED of a tool, or E_TILT of a load, in words.
    change
        (L,) change of W of each load by one standard uncertainty [N].
    """

    source: str
    change: Array


def weight_errors(campaign: Campaign) -> tuple[WeightError, ...]:
    """Return the independent sources of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads; loads with the same TOOL share one error of their added
    weight, each in proportion to its own; every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    sources = [WeightError("weight of the mirror", campaign.weight_error * cosine)]
    tools = {load.tool or f"'{load.name}'": load.tool for load in loads if load.added_error > 0}
    for name, tool in tools.items():
        shared = [(load.tool or f"'{load.name}'") == name for load in loads]
        change = np.where(shared, [load.added_error for load in loads], 0.0) * cosine
        words = f"weight of '{tool}'" if tool else f"added weight of load {name}"
        sources.append(WeightError(words, change))
    for load_index, load in enumerate(loads):
        if load.tilt_error > 0:
            change = np.zeros(len(loads))
            total = campaign.weight + load.added
            change[load_index] = -total * sine[load_index] * np.radians(load.tilt_error)
            sources.append(WeightError(f"tilt of load '{load.name}'", change))
    return tuple(source for source in sources if np.any(source.change))


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
