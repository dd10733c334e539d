"""Cycle and stiffness files (docs/files.md): their contents, reading and writing."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import Any

from truenewton.errors import FormatError, UnreadableFile, naming
from truenewton.files.content import PRIMARY, FitsFile
from truenewton.files.fits import SUFFIXES, read_fits, write_fits
from truenewton.files.format import Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.files.outputs import folder_beside
from truenewton.records.cycle import Cycle, Segment, Source, check_segments, sums_of
from truenewton.records.stiffness_matrix import StiffnessMatrix, StoredAs
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

FOREIGN_MATRIX = "ff_matrix.fits"  # of a supervisor, which `import` reads
INSTRUMENT = Keyword("INSTRUME", "instrument", "mirror", kind="str")
ID = Column("ID", "layout.id", kind="int")
X, Y = (Column(name, f"layout.{name.lower()}", "m") for name in "XY")
NZ = Column("NZ", "layout.nz", absent=1.0)
ENABLED = Column("ENABLED", "layout.enabled", kind="bool", absent=True)
E_X, E_Y = (Column(f"E_{name}", f"layout.{name.lower()}_error", "m", absent=None) for name in "XY")
SEGMENT = Column("SEGMENT", "layout.segment", kind="int", absent=None)
NUMBER = Column("NUMBER", "layout.number", kind="label", absent=None)
ACTUATORS = TableFormat("ACTUATORS", (ID, X, Y, NZ, ENABLED, E_X, E_Y, SEGMENT, NUMBER))

MEASUREMENTS = TableFormat(
    "MEASUREMENTS",
    (
        Column("TIME", "time", "s"),
        Column("SHAPE", "shape", kind="int"),
        Column("SIGN", "sign", kind="int"),
        Column("TEMPERATURE", "temperature", "deg_C", absent=None),
        Column("FORCE", "force", "N", each="ACTUATORS"),
        Column("POSITION", "position", "m", absent=None, each="ACTUATORS"),
        Column("VALID", "valid", kind="bool", absent=True),
    ),
)
CYCLE = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC, start of the cycle", kind="date"),
        Keyword("TIMES", "times", "assumed: no clock was read", kind="str", absent=None),
        Keyword("LOAD", "load.name", "name of the load", kind="str"),
        Keyword("CYCLE", "number", "number of the cycle under this load", kind="int"),
        Keyword("WEIGHT", "weight", "weight of the mirror along z at TILT 0, P", "N"),
        Keyword("E_WEIGHT", "weight_error", "standard uncertainty of WEIGHT", "N"),
        Keyword("ADDED", "load.added", "added weight, Q", "N"),
        Keyword("E_ADDED", "load.added_error", "standard uncertainty of ADDED", "N"),
        Keyword("TOOL", "load.tool", "name of the added weight", kind="str", absent=None),
        Keyword("TILT", "load.tilt", "angle between axis and vertical", "deg", absent=0.0),
        Keyword("E_TILT", "load.tilt_error", "standard uncertainty of TILT", "deg", absent=0.0),
        Keyword("COILZ", "load.coil_shift", "displacement of the coils along +z", "m", absent=None),
        Keyword(
            "E_COILZ", "load.coil_shift_error", "standard uncertainty of COILZ", "m", absent=None
        ),
        Keyword(
            "COILGRAD", "coil_gradient", "relative change of force along +z", "1/m", absent=None
        ),
        Keyword("BIASGRAD", "bias_gradient", "change of a bias force along +z", "N/m", absent=None),
        Keyword("GAP", "gap", "nominal distance from the reference plate", "m", absent=None),
        Keyword(
            "FORCERR", "force_error", "standard deviation of one force reading", "N", absent=None
        ),
    ),
    (
        ACTUATORS,
        MEASUREMENTS,
    ),
)
SEGMENTS = TableFormat(
    "SEGMENTS",
    (
        Column("SEGMENT", "number", kind="int"),
        Column("WEIGHT", "weight", "N"),
        Column("E_WEIGHT", "weight_error", "N"),
        Column("ADDED", "added", "N"),
        Column("E_ADDED", "added_error", "N"),
    ),
    of="segments",
)
OF_SEGMENTS = tuple(column.name for column in SEGMENTS.columns[1:])
# Of a mirror in several segments: its weights are in SEGMENTS, not in the header.
SEGMENTED_CYCLE = FileFormat(
    tuple(keyword for keyword in CYCLE.keywords if keyword.name not in OF_SEGMENTS),
    (*CYCLE.extensions, SEGMENTS),
)
ROW = Column("ROW", "stored.rows", kind="int", absent=None)
STORED_ACTUATORS = replace(ACTUATORS, columns=(*ACTUATORS.columns, ROW))
STIFFNESS = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC", kind="date"),
        Keyword("DISPLACE", "displaced", "displacements: read or true", kind="str", absent="read"),
        Keyword("MIRROR", "mirror", "known mirror, if positions are its", kind="str", absent=None),
        Keyword("STORFACT", "stored.factor", "N/m per unit of the imported file", absent=None),
        Keyword("STORUNIT", "stored.unit", "unit of the imported file", kind="str", absent=""),
        Keyword("STORTRAN", "stored.transposed", "its rows are sensors", kind="bool", absent=False),
        Keyword("STORSIZE", "stored.size", "number of its rows", kind="int", absent=None),
    ),
    (STORED_ACTUATORS, ImageFormat("STIFFNESS", "stiffness", "N/m")),
)
SOURCES = TableFormat(
    "SOURCES",
    (
        Column("FILE", "file", kind="str"),
        Column("SHA256", "sha256", kind="str", width=64),
        Column("ROWS", "rows", kind="int"),
        Column("REJECTED", "rejected", kind="int"),
    ),
    of="sources",
)


def layout_from(file: FitsFile) -> Layout:
    """Return the layout in a file's ACTUATORS table."""
    return file.filled(Layout, file.values(FileFormat(extensions=(ACTUATORS,)))["layout"])


def read_layout(path: str | os.PathLike[str]) -> Layout:
    """Read the ACTUATORS table of any file that has one."""
    return layout_from(read_fits(path))


def cycle_from(file: FitsFile) -> Cycle:
    """Return the cycle in a file."""
    if not holds_cycle(file):
        there = ", ".join(name for name in file.extensions if name != PRIMARY)
        raise FormatError(
            "there is no table MEASUREMENTS",
            remedy=f"there is {there or 'a plain image'}; give cycle files only, or a stiffness"
            " file, with an image STIFFNESS; `truenewton import` converts other files",
            path=file.path,
        )
    return file.filled(Cycle, _values(file))


def _values(file: FitsFile) -> dict[str, Any]:
    """Return the values of a cycle; weights of segments are only in SEGMENTS."""
    layout = layout_from(file)  # its faults are reported first: FORCE has its width
    known = {"layout": layout, "source": Source(file.path, file.sha256)}
    if SEGMENTS.name not in file.extensions:
        with naming(file.path):
            check_segments((), layout)
        return file.values(CYCLE) | known
    if both := [name for name in OF_SEGMENTS if name in file.header]:
        raise FormatError(
            f"{' and '.join(both)} are both in the primary header and in SEGMENTS",
            remedy="remove them from the header: SEGMENTS contains them for each segment",
            path=file.path,
        )
    values = file.values(SEGMENTED_CYCLE)
    columns = values.pop("segments")
    if len(columns["number"]) == 0:
        raise FormatError(
            "SEGMENTS has no rows", remedy="give one for each segment", path=file.path
        )
    segments = tuple(starmap(Segment, zip(*(v.tolist() for v in columns.values()), strict=True)))
    sums = sums_of(segments)
    values["weight"], values["weight_error"] = sums["weight"], sums["weight_error"]
    values["load"] |= {"added": sums["added"], "added_error": sums["added_error"]}
    return values | known | {"segments": segments}


def holds_cycle(file: FitsFile) -> bool:
    """Return whether a file contains a cycle."""
    return MEASUREMENTS.name in file.extensions


def stiffness_from(file: FitsFile) -> StiffnessMatrix:
    """Return the stiffness matrix in a file."""
    values = file.values(STIFFNESS)
    stored = values.pop("stored")
    with naming(file.path):
        whole = all(value is not None for value in stored.values())
        known = StoredAs(**stored) if whole else None
    more = {"source": Source(file.path, file.sha256), "stored": known}
    return file.filled(StiffnessMatrix, values | more)


def fits_paths(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return files, and the FITS files of folders, sorted by name in each folder."""
    files: list[Path] = []
    for path in map(Path, paths):
        try:
            inside = sorted(path.iterdir()) if path.is_dir() else [path]
        except OSError as error:
            raise UnreadableFile(
                f"cannot be read ({error.strerror})", remedy="check its permissions", path=path
            ) from error
        if path.is_dir():
            inside = [p for p in inside if p.name.endswith(SUFFIXES) and p.name[0] != "."]
            deeper = () if inside else ("*/", "*/*/")
            if any(any(path.glob(f"{at}{FOREIGN_MATRIX}")) for at in ("", *deeper)):
                command = shlex.join(["truenewton", "import", str(path), "-o", "matrix.fits"])
                raise UnreadableFile(
                    f"is a folder with {FOREIGN_MATRIX}, which has to be imported first",
                    remedy=f"run `{command}`, and give matrix.fits",
                    path=path,
                )
        if not inside:
            remedy = (
                "give the folder of a campaign, whose files end in .fits or .fits.gz; to"
                " convert your own files, see `truenewton import --example`"
            )
            raise UnreadableFile("contains no FITS files", remedy=remedy, path=path)
        files += inside
    return list({os.path.realpath(p): p for p in files}.values())


def write_cycle(cycle: Cycle, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a cycle file.

    Parameters
    ----------
    cycle
        One run through all shapes.
    path
        The file.
    overwrite
        Replace an existing file.

    Raises
    ------
    OutputExists, OutputFailed

    Examples
    --------
    >>> tn.write_cycle(campaign.cycles[0], "bare.fits")
    >>> tn.read_campaign("bare.fits")
    <Campaign of P45: 45 actuators, 1 cycle under bare>
    """
    write_fits(path, SEGMENTED_CYCLE if cycle.segments else CYCLE, cycle, overwrite=overwrite)


def cycle_name(load: Load, number: int) -> str:
    """Return the name of a cycle's file, LOAD-CYCLE.fits."""
    name = re.sub(r"[^\w-]", "_", load.key)  # a leading dot would hide the file
    return f"{name}-{number:03d}.fits"


def write_campaign(
    cycles: Iterable[Cycle], folder: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write cycles as LOAD-CYCLE.fits into a new folder; on failure none is left.

    Parameters
    ----------
    cycles
        Of one mirror, or a campaign.
    folder
        The folder.
    overwrite
        Replace an existing folder.

    Raises
    ------
    OutputExists, OutputFailed

    Examples
    --------
    >>> tn.write_campaign(campaign, "copy")
    >>> tn.read_campaign("copy")
    <Campaign of P45: 45 actuators, 4 cycles under bare, ring>
    """
    with folder_beside(folder, SUFFIXES, overwrite=overwrite) as temporary:
        for cycle in cycles:
            write_cycle(cycle, temporary / cycle_name(cycle.load, cycle.number))


def write_stiffness(
    matrix: StiffnessMatrix, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a stiffness file.

    Parameters
    ----------
    matrix
        (n, n) [N/m] with its actuators.
    path
        The file.
    overwrite
        Replace an existing file.

    Raises
    ------
    OutputExists, OutputFailed

    Examples
    --------
    >>> tn.write_stiffness(matrix, "feedforward.fits")
    """
    write_fits(path, STIFFNESS, matrix, overwrite=overwrite)
