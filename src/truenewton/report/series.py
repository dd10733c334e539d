"""Rows of a campaign as figures draw them: by signed shape, and over time."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.records.cycle import Cycle
from truenewton.report.evidence import RowResiduals

POINTS = 200  # of a cycle over time; more cannot be told apart


def columns_of_shapes(residuals: RowResiduals) -> tuple[NDArray[np.int64], str]:
    """Return (N,) where rows stand on an axis of signed shapes, and what the axis is called.

    SHAPE with its SIGN; where shapes are numbered with wide gaps, their place among all instead.
    """
    names, index = np.unique(residuals.shape, return_inverse=True)
    if names[-1] <= 4 * names.size:
        return residuals.shape * residuals.sign, "shape, with its sign"
    return (index.ravel() + 1) * residuals.sign, "place of the shape, with its sign"


def by_signed_shape(
    residuals: RowResiduals,
) -> tuple[NDArray[np.int64], Array, Array, str]:
    """Return signed shapes, their rms imbalance over kept rows before and after, and the axis."""
    column, name = columns_of_shapes(residuals)
    shapes, member = np.unique(column[residuals.kept], return_inverse=True)
    count = np.bincount(member.ravel())
    before, after = (
        np.sqrt(np.bincount(member.ravel(), values[residuals.kept] ** 2) / count)
        for values in (residuals.before, residuals.after)
    )
    return shapes, before, after, name


def cycle_times(cycle: Cycle) -> tuple[NDArray[Any], Array | None]:
    """Return times (UTC, datetime64) and temperatures [deg C] of a cycle, a few hundred at most."""
    valid = np.flatnonzero(cycle.valid)
    valid = valid[np.argsort(cycle.time[valid], kind="stable")]
    some = valid[np.linspace(0, valid.size - 1, min(valid.size, POINTS)).round().astype(int)]
    start = cycle.date
    if start.tzinfo is not None:
        start = start.astimezone(datetime.UTC).replace(tzinfo=None)
    time = np.datetime64(start, "ms") + (1e3 * cycle.time[some]).astype("timedelta64[ms]")
    return time, None if cycle.temperature is None else cycle.temperature[some]
