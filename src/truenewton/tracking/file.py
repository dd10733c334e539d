"""The tracking file (docs/files.md): what electronics need to follow temperature and time."""

from __future__ import annotations

import os

import numpy as np

from truenewton.calibration.file import LARGEST
from truenewton.errors import FormatError
from truenewton.files.content import FitsFile
from truenewton.files.fits import read_fits
from truenewton.files.format import Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.reading import select_segment
from truenewton.records.file import ID, INSTRUMENT, NZ, X, Y
from truenewton.records.parts import KINDS, PartKind, body_or_parts_from
from truenewton.tracking.law import Tracking

UNITS = {"temperature": "1/K", "drift": "1/yr"}

ACTUATORS = TableFormat(
    "TRACKING",
    (
        ID,
        X,
        Y,
        NZ,
        Column("ALPHA", "alpha"),
        Column("E_ALPHA", lambda t: t.errors[0]),
        Column("K", "coefficient", "1/K"),
        Column("E_K", lambda t: t.errors[1], "1/K"),
        Column("DRIFT", "drift", "1/yr"),
        Column("E_DRIFT", lambda t: t.errors[2], "1/yr"),
        Column("SCATTER", "scatter", absent=0.0),
    ),
)
FAMILIES = TableFormat(
    "FAMILIES",
    (
        Column("EFFECT", "effect", kind="str", width=11),
        Column("UNIT", lambda family: UNITS[family.effect], kind="str", width=4),
        Column("MEAN", "mean"),
        Column("E_MEAN", "mean_error"),
        Column("MEAN_LO", "mean_interval.0"),
        Column("MEAN_HI", "mean_interval.1"),
        Column("SPREAD", "spread"),
        Column("SPREAD_LO", "spread_interval.0"),
        Column("SPREAD_HI", "spread_interval.1"),
        Column("MEMBERS", "members", kind="int"),
    ),
    of="families",
)
DEPARTURES = TableFormat(
    "DEPARTURES",
    (
        Column("ID", "actuator", kind="int"),
        Column("EFFECT", "effect", kind="str", width=11),
        Column("SIGMAS", "sigmas"),
        Column("CHANCE", "probability"),
    ),
    of="outliers",
)
DAYS = TableFormat(
    "DAYS",
    (
        Column("FILE", "name", kind="str"),
        Column("DATE", "date", kind="date", width=26),
        Column("TEMPERATURE", "temperature", "deg_C"),
        Column("ALPHA", "alpha", each="TRACKING"),
        Column("E_STAT", "error", each="TRACKING"),
        Column("VERDICT", "verdict", kind="str", absent=""),
    ),
    of="days",
)
TRACKING = FileFormat(
    (
        INSTRUMENT,
        Keyword(
            "DATE-OBS", lambda t: t.days[0].date, "UTC, middle of the first day's data", kind="date"
        ),
        Keyword(
            "DATE-END", lambda t: t.days[-1].date, "UTC, middle of the last day's data", kind="date"
        ),
        Keyword("DATE-REF", "date", "UTC, t0: ALPHA holds here", kind="date"),
        Keyword("TEMPERAT", "temperature", "T0: ALPHA holds here", "deg_C", absent=np.nan),
        Keyword("CHI2", "chi2", "of the days about the lines"),
        Keyword("DOF", "degrees_of_freedom", "degrees of freedom", kind="int"),
        Keyword("SCATTER", "common_scatter", "from day to day, of all in common", absent=0.0),
        Keyword("SCATDOF", "scatter_degrees", "its degrees of freedom", kind="int", absent=0),
    ),
    (
        ACTUATORS,
        ImageFormat("COVARIANCE", "covariance"),
        ImageFormat("SYSTEMATIC", "systematic_covariance"),
        FAMILIES,
        DEPARTURES,
        DAYS,
        TableFormat("LIMITS", (Column("TEXT", "limits", kind="str"),)),
    ),
)


def read_tracking(path: str | os.PathLike[str], *, segment: int | None = None) -> Tracking:
    """Read a tracking file; of a mirror in several segments that of one.

    Parameters
    ----------
    path
        The tracking file, as `Tracking.write` writes it.
    segment
        Number of the one.

    Raises
    ------
    UnreadableFile, FormatError, UnknownName, RankDeficient

    Examples
    --------
    >>> tn.track(calibration, warm).write("track.fits")
    >>> tn.read_tracking("track.fits")
    <Tracking of P45: 2 calibrations, temperature>
    """
    found = body_or_parts_from(read_fits(path), TRACKINGS)
    law: Tracking = select_segment(found, segment, path)
    return law


def tracking_from(file: FitsFile) -> Tracking:
    """Return what a tracking file holds.

    Raises
    ------
    FormatError
        The file breaks the contract of a tracking file.
    """
    values = file.values(TRACKING, LARGEST)
    alpha = values["alpha"]
    file.require_covariances(3 * alpha.size, "ALPHA, K and DRIFT", "track again")
    if not values["days"]["name"]:
        raise FormatError("DAYS is empty", remedy="track again", path=file.path)
    values["layout"]["enabled"] = file.enabled(alpha, "track again")
    values["effects"] = values["families"]["effect"]
    return file.filled(Tracking, values)


TRACKINGS = PartKind(
    TRACKING,
    tracking_from,
    "LAW",
    {
        "DATE-REF": "",
        "TEMPERAT": np.nan,
        "CHI2": np.nan,
        "DOF": 0,
        "SCATTER": np.nan,
        "SCATDOF": 0,
    },
    {"LEFT": lambda law: len(law.outliers)},
)
KINDS[Tracking] = TRACKINGS
