"""The calibration file of a mirror in several segments (docs/files.md).

Alpha of all actuators stands in one table; what is known of each segment stands beside it as in a
calibration file of its own, its extensions under its number as EXTVER.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from truenewton.calibration.file import CALIBRATION, calibration_from
from truenewton.calibration.result import Calibration
from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.errors import Fault, FormatError, TrueNewtonError, located
from truenewton.estimation.findings.code import Level
from truenewton.files.content import FitsFile
from truenewton.files.format import Column, FileFormat, Keyword, TableFormat
from truenewton.records.file import ENABLED, ID, INSTRUMENT, NZ, X, Y
from truenewton.records.of_segments import OfSegments
from truenewton.statics.layout import Layout

ALPHA = TableFormat(
    "ALPHA",
    (
        ID,
        X,
        Y,
        Column("SEGMENT", "layout.segment", kind="int"),
        Column("ALPHA", "alpha"),
        Column("E_ALPHA", lambda c: c.error),
        Column("E_STAT", lambda c: c.reading_error),
        Column("E_SYST", lambda c: c.systematic_error),
        Column("E_CYCLE", lambda c: c.cycle_error),
        NZ,
        ENABLED,
    ),
)

REFUSED = TableFormat(
    "REFUSED",
    (
        Column("SEGMENT", "segment", kind="int"),
        Column("FAULT", "fault", kind="str"),
        Column("REMEDY", "remedy", kind="str"),
    ),
    of="refusals",
    optional=True,
)
Whole = TypeVar("Whole", bound=OfSegments[Any])


def _each(value: Callable[[Calibration], Any], none: Any) -> Callable[[SegmentedCalibration], Any]:
    """Return what gives, segment by segment, a value of its calibration, or another if refused."""
    return lambda c: [value(c.segments[n]) if n in c.segments else none for n in c.numbers]


SEGMENTED = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", lambda c: c.date, "UTC, start of the data", kind="date"),
        Keyword("DATE-END", lambda c: c.date_end, "UTC, end of the data", kind="date"),
        Keyword("VERDICT", lambda c: str(c.verdict.level), "of all segments", kind="str"),
    ),
    (
        ALPHA,
        TableFormat(
            "SEGMENTS",
            (
                Column("SEGMENT", lambda c: c.numbers, kind="int"),
                Column(
                    "VERDICT",
                    _each(lambda one: str(one.verdict.level), str(Level.NONE)),
                    kind="str",
                ),
                Column("METHOD", _each(lambda one: one.method, ""), kind="str"),
                Column("SCALE", _each(lambda one: one.scale, ""), kind="str"),
                Column("NSHAPES", _each(lambda one: one.shapes_used, 0), kind="int"),
                Column("NREJECT", _each(lambda one: one.rejected, 0), kind="int"),
                Column("BIAS", _each(lambda one: one.bias_force, np.nan), "N"),
                Column("E_BIAS", _each(lambda one: one.bias_force_error, np.nan), "N"),
                Column("NOISE", _each(lambda one: one.noise, np.nan), "N"),
                Column(
                    "FITCHI2",
                    _each(lambda one: one.goodness.chi2 if one.goodness else np.nan, np.nan),
                ),
                Column("DOF", _each(lambda one: one.degrees_of_freedom or 0, 0), kind="int"),
            ),
        ),
        REFUSED,
    ),
)


def segmented_from(file: FitsFile) -> SegmentedCalibration:
    """Return the calibration of all segments that a file holds.

    Raises
    ------
    FormatError
        The file breaks the contract of such a calibration file.
    """
    return whole_from(file, SEGMENTED, SegmentedCalibration, calibration_from)


def whole_from(
    file: FitsFile, form: FileFormat, kind: type[Whole], part_from: Callable[[FitsFile], Any]
) -> Whole:
    """Return what a file holds of all segments.

    Parameters
    ----------
    file
        As it was read.
    form
        Of what is common to the segments: its first table holds ALPHA of all actuators.
    kind, part_from
        What is made, and what makes that of a segment of what stands under its EXTVER.

    Raises
    ------
    FormatError
    """
    values = file.values(form)
    layout = file.filled(Layout, values["layout"])
    rows = values.get("refusals", {"segment": np.empty(0, dtype=int), "fault": (), "remedy": ()})
    refused: dict[int, tuple[Fault, ...]] = {}
    for number, *fault in zip(rows["segment"].tolist(), rows["fault"], rows["remedy"], strict=True):
        refused[number] = (*refused.get(number, ()), Fault(*fault))
    segments = {}
    for number, version in file.versions.items():
        try:
            segments[number] = part_from(version)
        except TrueNewtonError as error:
            raise error.changed(fault=f"of segment {number}, {error.fault}") from None
    try:
        made = kind(values["instrument"], layout, segments, refused)
    except TrueNewtonError as error:
        raise located(error, file.path) from None
    if not np.array_equal(made.alpha, values["alpha"], equal_nan=True):
        raise FormatError(
            "ALPHA is not that of the segments", remedy="make the file again", path=file.path
        )
    return made


def versions_of(calibration: SegmentedCalibration) -> Mapping[str, Any]:
    """Return what `write_fits` is told of the segments."""
    return {"versions": calibration.segments, "of_version": CALIBRATION}


def any_calibration_from(file: FitsFile) -> Calibration | SegmentedCalibration:
    """Return the calibration that a file holds, of one body or of several segments.

    Raises
    ------
    FormatError
    """
    return segmented_from(file) if "SEGMENTS" in file.extensions else calibration_from(file)
