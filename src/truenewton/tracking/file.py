"""The tracking file (docs/files.md): what electronics need to follow temperature and time."""

from __future__ import annotations

import datetime
import os
from typing import TYPE_CHECKING

import numpy as np

from truenewton.errors import FormatError
from truenewton.files.fits import Sheet, read_fits, write_fits
from truenewton.records.file import iso
from truenewton.statics.layout import Layout
from truenewton.tracking.family import Family
from truenewton.tracking.law import DayRecord, Outlier, Tracking

if TYPE_CHECKING:
    from truenewton.files.content import FitsFile


UNITS = {"temperature": "1/K", "drift": "1/yr"}


def write_tracking(
    tracking: Tracking, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write the tracking file.

    Raises
    ------
    OutputExists, OutputFailed
    """
    t, errors = tracking, tracking.errors
    law = Sheet(
        "TRACKING",
        columns=(
            ("ID", "J", None, t.layout.id),
            ("X", "D", "m", t.layout.x),
            ("Y", "D", "m", t.layout.y),
            ("NZ", "D", None, t.layout.nz),
            ("ALPHA", "D", None, t.alpha),
            ("E_ALPHA", "D", None, errors[0]),
            ("K", "D", "1/K", t.coefficient),
            ("E_K", "D", "1/K", errors[1]),
            ("DRIFT", "D", "1/yr", t.drift),
            ("E_DRIFT", "D", "1/yr", errors[2]),
        ),
    )
    ends = np.array([(*f.mean_interval, *f.spread_interval) for f in t.families]).reshape(-1, 4)
    families = Sheet(
        "FAMILIES",
        columns=(
            ("EFFECT", "11A", None, [f.effect for f in t.families]),
            ("UNIT", "4A", None, [UNITS[f.effect] for f in t.families]),
            ("MEAN", "D", None, [f.mean for f in t.families]),
            ("E_MEAN", "D", None, [f.mean_error for f in t.families]),
            ("MEAN_LO", "D", None, ends[:, 0]),
            ("MEAN_HI", "D", None, ends[:, 1]),
            ("SPREAD", "D", None, [f.spread for f in t.families]),
            ("SPREAD_LO", "D", None, ends[:, 2]),
            ("SPREAD_HI", "D", None, ends[:, 3]),
            ("MEMBERS", "J", None, [f.members for f in t.families]),
        ),
    )
    departures = Sheet(
        "DEPARTURES",
        columns=(
            ("ID", "J", None, [d.actuator for d in t.outliers]),
            ("EFFECT", "11A", None, [d.effect for d in t.outliers]),
            ("SIGMAS", "D", None, [d.sigmas for d in t.outliers]),
            ("CHANCE", "D", None, [d.probability for d in t.outliers]),
        ),
    )
    names = [_ascii(day.name) for day in t.days]
    n = t.layout.n
    days = Sheet(
        "DAYS",
        columns=(
            ("FILE", f"{max(map(len, names))}A", None, names),
            ("DATE", "26A", None, [iso(day.date) for day in t.days]),
            ("TEMPERATURE", "D", "deg_C", [day.temperature for day in t.days]),
            ("ALPHA", f"{n}D", None, np.array([day.alpha for day in t.days])),
            ("E_STAT", f"{n}D", None, np.array([day.error for day in t.days])),
        ),
    )
    widest = max(map(len, t.limits), default=1)
    limits = Sheet("LIMITS", columns=(("TEXT", f"{widest}A", None, list(t.limits)),))
    sheets = [
        law,
        Sheet("COVARIANCE", data=t.covariance),
        Sheet("SYSTEMATIC", data=t.systematic_covariance),
        families,
        departures,
        days,
        limits,
    ]
    header = {
        "INSTRUME": (t.instrument, "mirror"),
        "DATE-OBS": (iso(t.days[0].date), "UTC, middle of the first day's data"),
        "DATE-END": (iso(t.days[-1].date), "UTC, middle of the last day's data"),
        "DATE-REF": (iso(t.date), "UTC, t0: ALPHA holds here"),
        "TEMPERAT": (t.temperature, "[deg_C] T0: ALPHA holds here"),
        "CHI2": (t.chi2, "of the days about the lines"),
        "DOF": (t.degrees_of_freedom, "degrees of freedom"),
    }
    write_fits(path, header, sheets, overwrite=overwrite)


def is_tracking_file(file: FitsFile) -> bool:
    """Tell a tracking file from the others by its TRACKING."""
    return file.holds("TRACKING")


def read_tracking(path: str | os.PathLike[str]) -> Tracking:
    """Read a tracking file.

    Raises
    ------
    UnreadableFile, FormatError
    """
    return tracking_from(read_fits(path))


def tracking_from(file: FitsFile) -> Tracking:
    """Return what a tracking file holds."""
    law, families, days = (file.table(name) for name in ("TRACKING", "FAMILIES", "DAYS"))
    departures = file.table("DEPARTURES")
    images = {name: file.image(name).values() for name in ("COVARIANCE", "SYSTEMATIC")}
    for name, image in images.items():
        if image.shape != (3 * law.rows, 3 * law.rows):
            raise FormatError(
                f"{name} has the shape {image.shape}",
                remedy=f"it is square, of {3 * law.rows}: ALPHA, K and DRIFT",
                path=file.path,
            )
    if not days.rows:
        raise FormatError("DAYS is empty", remedy="track again", path=file.path)
    alpha = law.column("ALPHA")
    temperature = file.optional_number("TEMPERAT")
    numbers = np.array(
        [families.column(name) for name in
         ("MEAN", "E_MEAN", "MEAN_LO", "MEAN_HI", "SPREAD", "SPREAD_LO", "SPREAD_HI")]
    ).T  # fmt: skip
    found = tuple(
        Family(str(name).strip(), mean, error, (low, high), spread, (least, most), int(count))
        for name, (mean, error, low, high, spread, least, most), count in zip(
            families.column("EFFECT", "str"),
            numbers.tolist(),
            families.column("MEMBERS", "int"),
            strict=True,
        )
    )
    return Tracking(
        instrument=file.text("INSTRUME"),
        layout=Layout(
            id=law.column("ID", "int"),
            x=law.column("X", unit="m"),
            y=law.column("Y", unit="m"),
            nz=law.column("NZ"),
            enabled=np.isfinite(alpha),
        ),
        temperature=float("nan") if temperature is None else temperature,
        date=file.date("DATE-REF"),
        alpha=alpha,
        coefficient=law.column("K", unit="1/K"),
        drift=law.column("DRIFT", unit="1/yr"),
        covariance=images["COVARIANCE"],
        systematic_covariance=images["SYSTEMATIC"],
        effects=tuple(family.effect for family in found),
        families=found,
        outliers=tuple(
            Outlier(int(actuator), str(what).strip(), sigmas, chance)
            for actuator, what, sigmas, chance in zip(
                departures.column("ID", "int"),
                departures.column("EFFECT", "str"),
                departures.column("SIGMAS").tolist(),
                departures.column("CHANCE").tolist(),
                strict=True,
            )
        ),
        chi2=file.number("CHI2"),
        degrees_of_freedom=file.integer("DOF"),
        limits=tuple(str(text).strip() for text in file.table("LIMITS").column("TEXT", "str")),
        days=tuple(
            DayRecord(str(name).strip(), _date(str(date), file.path), temperature, of_day, error)
            for name, date, temperature, of_day, error in zip(
                days.column("FILE", "str"),
                days.column("DATE", "str"),
                days.column("TEMPERATURE", unit="deg_C").tolist(),
                days.column("ALPHA", width=law.rows),
                days.column("E_STAT", width=law.rows),
                strict=True,
            )
        ),
    )


def _date(text: str, path: str) -> datetime.datetime:
    try:
        return datetime.datetime.fromisoformat(text.strip()).replace(tzinfo=datetime.UTC)
    except ValueError:
        raise FormatError(
            f"DATE in DAYS is '{text.strip()}'", remedy="track again", path=path, got=text
        ) from None


def _ascii(text: str) -> str:
    """FITS holds ASCII only; a file name may hold anything."""
    return text.encode("ascii", "backslashreplace").decode()
