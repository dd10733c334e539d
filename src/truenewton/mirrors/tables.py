"""Tables that belong to a mirror: where its actuators stand, the points of its outline."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, in_units
from truenewton.errors import FormatError, TrueNewtonError, located
from truenewton.files.fits import read_fits
from truenewton.files.format import Column, FileFormat, TableFormat
from truenewton.files.opening import read_text
from truenewton.records.file import SUFFIXES, read_layout
from truenewton.statics.layout import Layout, layout

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of an outline, x and y (n,) [m]; loop (n,) 0 of the edge, 1, 2, ... of the holes."""

    x: Array
    y: Array
    loop: NDArray[np.int64]

    def __post_init__(self) -> None:
        in_units(self, {"x": "m", "y": "m"})


OUTLINE = FileFormat(
    extensions=(
        TableFormat(
            "OUTLINE",
            (
                Column("X", "x", "m", finite=True),
                Column("Y", "y", "m", finite=True),
                Column("LOOP", "loop", kind="int", absent=0),
            ),
        ),
    )
)


def layout_in(path: Path) -> Layout:
    """Return the actuators of a FITS file, or of a table whose lengths are metres unless it says.

    Its columns are X, Y, and ID, NZ, ENABLED where they stand.

    Raises
    ------
    UnreadableFile, FormatError, GeometryError
    """
    if str(path).endswith(SUFFIXES):
        return read_layout(path)

    def made(table: Any) -> Layout:
        others = {"ID", "NZ", "ENABLED"} & set(table.colnames)
        return layout(**{name.lower(): _cells(table, name) for name in ("X", "Y", *others)})

    return _made_of(path, made, "actuators")


def outline_in(path: Path) -> list[list[list[float]]]:
    """Return the edge and the holes of a table of points: x and y of each [m], in their order.

    The table OUTLINE of a FITS file, or one of text as that of the actuators. Its columns are X, Y
    and, where there are holes, LOOP: 0 of the edge, 1, 2, ... of the holes.

    Raises
    ------
    UnreadableFile, FormatError
    """
    if str(path).endswith(SUFFIXES):
        file = read_fits(path)
        points = file.filled(_Points, file.values(OUTLINE))
    else:
        points = _made_of(path, _points_of, "points")
    loops = np.asarray(points.loop)
    numbers = np.unique(loops)
    if not np.array_equal(numbers, np.arange(numbers.size)) or not numbers.size:
        raise FormatError(
            f"LOOP holds {', '.join(map(str, numbers)) or 'nothing'}",
            remedy="number the points of the edge 0, those of the holes 1, 2, ...",
            path=path,
        )
    places = np.stack([points.x, points.y], axis=1)
    return [places[loops == number].tolist() for number in numbers]


def _points_of(table: Any) -> _Points:
    loop = _cells(table, "LOOP") if "LOOP" in table.colnames else np.zeros(len(table), dtype=int)
    x, y = (_cells(table, name) for name in "XY")
    return _Points(x, y, loop)


def _made_of(path: Path, make: Callable[[Any], Made], what: str) -> Made:
    """Return what is made of a table of text, CSV or ECSV; what is wrong with it names the file."""
    from astropy.table import QTable

    form = "ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv"
    lines = read_text(path).splitlines()
    try:
        # Of what overflows or is odd astropy warns; it is refused below, by what it became.
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            return make(QTable.read(lines, format=form, guess=False))
    except TrueNewtonError as error:
        raise located(error, path) from None
    except KeyError as error:
        raise FormatError(f"lacks column {error}", remedy="give X and Y", path=path) from error
    except Exception as error:
        raise FormatError(
            f"is not a table of {what} ({error})",
            remedy="write columns X and Y as CSV or ECSV, lengths in metres",
            path=path,
        ) from error


def _cells(table: Any, name: str) -> Any:
    """Return a column of a table of text, held against what it is to be."""
    cells = table[name]
    if np.any(getattr(cells, "mask", False)):
        raise FormatError(f"{name} has empty cells", remedy="fill them")
    if name in ("X", "Y"):
        return cells
    values = np.asarray(cells)
    if name == "ENABLED" and values.dtype.kind in "SU":
        values = np.char.lower(values)
        known = {"true": True, "false": False}
        values = np.array([known.get(str(text), 2) for text in values])
    if name == "ENABLED" and not np.isin(values, (0, 1)).all():
        raise FormatError("ENABLED holds other words", remedy="write true or false, or 1 or 0")
    if name in ("ID", "LOOP") and values.dtype.kind not in "iu":
        raise FormatError(f"{name} holds {values.dtype}", remedy="write integers")
    return values
