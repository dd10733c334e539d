"""Cycle and stiffness files (docs/files.md): between FITS and the measurement records."""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile, located
from truenewton.files.content import FitsFile, Table
from truenewton.files.fits import Sheet, read_fits, write_fits
from truenewton.files.outputs import folder_beside
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

SUFFIXES = (".fits", ".fits.gz")


def is_cycle_file(file: FitsFile) -> bool:
    """Tell a cycle file from the others by its MEASUREMENTS."""
    return file.holds("MEASUREMENTS")


def is_stiffness_file(file: FitsFile) -> bool:
    """Tell a stiffness file from the others by its STIFFNESS."""
    return file.holds("STIFFNESS")


def layout_from(file: FitsFile) -> Layout:
    """Return the layout in a file's ACTUATORS table."""
    table = file.table("ACTUATORS")
    try:
        return Layout(
            id=table.column("ID", "int"),
            x=table.column("X", unit="m"),
            y=table.column("Y", unit="m"),
            nz=table.column("NZ") if table.has("NZ") else np.ones(table.rows),
            enabled=_flags(table, "ENABLED"),
        )
    except TrueNewtonError as error:
        raise located(error, file.path) from None


def read_layout(path: str | os.PathLike[str]) -> Layout:
    """Read the ACTUATORS table of any FITS file that has one."""
    return layout_from(read_fits(path, whole=False))


def cycle_from(file: FitsFile) -> Cycle:
    """Return the cycle that a file holds.

    Raises
    ------
    FormatError
        The file breaks the contract of a cycle file.
    """
    layout = layout_from(file)
    table = file.table("MEASUREMENTS")
    valid = _flags(table, "VALID")

    def per_row(name: str, unit: str, width: int | None = None) -> Any:
        return table.column(name, unit=unit, width=width) if table.has(name) else None

    try:
        return Cycle(
            instrument=file.text("INSTRUME"),
            date=file.date("DATE-OBS"),
            number=file.integer("CYCLE"),
            load=Load(
                name=file.text("LOAD"),
                added=file.number("ADDED"),
                added_error=file.number("E_ADDED"),
                tool=file.optional_text("TOOL") or None,
                tilt=file.optional_number("TILT") or 0.0,
                tilt_error=file.optional_number("E_TILT") or 0.0,
            ),
            weight=file.number("WEIGHT"),
            weight_error=file.number("E_WEIGHT"),
            layout=layout,
            time=table.column("TIME", unit="s"),
            shape=table.column("SHAPE", "int"),
            sign=table.column("SIGN", "int"),
            force=table.column("FORCE", unit="N", width=layout.n),
            valid=valid,
            temperature=per_row("TEMPERATURE", "deg_C"),
            position=per_row("POSITION", "m", layout.n),
            coil_gradient=file.optional_number("COILGRAD"),
            bias_gradient=file.optional_number("BIASGRAD"),
            gap=file.optional_number("GAP"),
            force_error=file.optional_number("FORCERR"),
            source=Source(file.path, file.sha256),
        )
    except TrueNewtonError as error:
        raise located(error, file.path) from None


def stiffness_from(file: FitsFile) -> StiffnessMatrix:
    """Return the stiffness matrix that a file holds.

    Raises
    ------
    FormatError
        The file breaks the contract of a stiffness file.
    """
    try:
        return StiffnessMatrix(
            instrument=file.text("INSTRUME"),
            date=file.date("DATE-OBS"),
            layout=layout_from(file),
            stiffness=file.image("STIFFNESS").values("N/m"),
            source=Source(file.path, file.sha256),
        )
    except TrueNewtonError as error:
        raise located(error, file.path) from None


def _flags(table: Table, name: str) -> Any:
    return table.column(name, "bool") if table.has(name) else np.ones(table.rows, dtype=bool)


def fits_paths(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return the files meant by files and folders; of a folder its FITS files, sorted by name.

    Raises
    ------
    UnreadableFile
        A path does not exist, or a folder holds no FITS file.
    """
    found: list[Path] = []
    for path in map(Path, paths):
        try:
            if not path.is_dir():
                found.append(path)
                continue
            inside = sorted(
                p
                for p in path.iterdir()
                if p.name.endswith(SUFFIXES) and not p.name.startswith(".")
            )
        except OSError as error:
            raise UnreadableFile(
                f"cannot be read ({error.strerror})", remedy="check its permissions", path=path
            ) from error
        if not inside:
            raise UnreadableFile(
                "holds no FITS files", remedy="give the folder of a campaign", path=path
            )
        found += inside
    return list({p.resolve(): p for p in found}.values())


def write_cycle(cycle: Cycle, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a cycle file."""
    load, n = cycle.load, cycle.layout.n
    header: dict[str, tuple[Any, str]] = {
        "INSTRUME": (cycle.instrument, "mirror"),
        "DATE-OBS": (iso(cycle.date), "UTC, start of the cycle"),
        "LOAD": (load.name, "name of the load"),
        "CYCLE": (cycle.number, "number of the cycle under this load"),
        "WEIGHT": (cycle.weight, "[N] weight of the mirror along z at TILT 0, P"),
        "E_WEIGHT": (cycle.weight_error, "[N] standard uncertainty of WEIGHT"),
        "ADDED": (load.added, "[N] added weight, Q"),
        "E_ADDED": (load.added_error, "[N] standard uncertainty of ADDED"),
        "TOOL": (load.tool, "name of the added weight"),
        "TILT": (load.tilt, "[deg] angle between axis and vertical"),
        "E_TILT": (load.tilt_error, "[deg] standard uncertainty of TILT"),
        "COILGRAD": (cycle.coil_gradient, "[1/m] relative change of force along +z"),
        "BIASGRAD": (cycle.bias_gradient, "[N/m] change of a bias force along +z"),
        "GAP": (cycle.gap, "[m] nominal distance from the reference plate"),
        "FORCERR": (cycle.force_error, "[N] standard deviation of one force reading"),
    }
    columns: list[tuple[str, str, str | None, Any]] = [
        ("TIME", "D", "s", cycle.time),
        ("SHAPE", "J", None, cycle.shape),
        ("SIGN", "J", None, cycle.sign),
        ("FORCE", f"{n}D", "N", np.asarray(cycle.force)),
        ("VALID", "L", None, cycle.valid),
    ]
    if cycle.temperature is not None:
        columns.insert(3, ("TEMPERATURE", "D", "deg_C", cycle.temperature))
    if cycle.position is not None:
        columns.insert(-1, ("POSITION", f"{n}D", "m", np.asarray(cycle.position)))
    sheets = [actuators_sheet(cycle.layout), Sheet("MEASUREMENTS", columns=tuple(columns))]
    write_fits(path, header, sheets, overwrite=overwrite)


def cycle_name(load: Load, number: int) -> str:
    """Return the name of a cycle's file, LOAD-CYCLE.fits."""
    name = re.sub(r"[^\w-]", "_", load.key)  # a leading dot would hide the file
    return f"{name}-{number:03d}.fits"


def write_campaign(
    cycles: Iterable[Cycle], folder: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write cycles as LOAD-CYCLE.fits into a folder, which is complete or not there.

    Raises
    ------
    OutputExists, OutputFailed
    """
    with folder_beside(folder, SUFFIXES, overwrite=overwrite) as temporary:
        for cycle in cycles:
            write_cycle(cycle, temporary / cycle_name(cycle.load, cycle.number))


def write_stiffness(
    matrix: StiffnessMatrix, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a stiffness file."""
    header = {
        "INSTRUME": (matrix.instrument, "mirror"),
        "DATE-OBS": (iso(matrix.date), "UTC"),
    }
    sheets = [
        actuators_sheet(matrix.layout),
        Sheet("STIFFNESS", data=matrix.stiffness, unit="N/m"),
    ]
    write_fits(path, header, sheets, overwrite=overwrite)


def actuators_sheet(layout: Layout) -> Sheet:
    """Return the ACTUATORS table of a layout."""
    return Sheet(
        "ACTUATORS",
        columns=(
            ("ID", "J", None, layout.id),
            ("X", "D", "m", layout.x),
            ("Y", "D", "m", layout.y),
            ("NZ", "D", None, layout.nz),
            ("ENABLED", "L", None, layout.enabled),
        ),
    )


def iso(date: datetime.datetime) -> str:
    """Return a date as FITS writes it: ISO 8601, UTC, no zone, to the microsecond if need be."""
    digits = "microseconds" if date.microsecond % 1000 else "milliseconds"
    if date.tzinfo is not None:
        date = date.astimezone(datetime.UTC).replace(tzinfo=None)
    return date.isoformat(timespec=digits)


def campaign_from(files: Iterable[FitsFile]) -> Campaign:
    """Return the campaign that cycle files make together.

    Raises
    ------
    FormatError, CampaignMismatch
    """
    cycles = []
    for file in files:
        if not is_cycle_file(file):
            raise FormatError(
                "there is no table MEASUREMENTS",
                remedy="a campaign holds cycle files only, a stiffness file an image STIFFNESS",
                path=file.path,
            )
        cycles.append(cycle_from(file))
    return Campaign(tuple(cycles))
