"""Tables that belong to a mirror: where its actuators stand, the points of its outline."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError, TrueNewtonError, located
from truenewton.files.fits import read_fits
from truenewton.files.format import Column, FileFormat, TableFormat
from truenewton.files.opening import read_text
from truenewton.quantities import Quantity, convert_quantities
from truenewton.records.file import SUFFIXES, read_layout
from truenewton.rounding import listed
from truenewton.statics.layout import Layout, layout

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of an outline, x and y (n,) [m]; loop (n,) 0 of the edge, 1, 2, ... of the holes."""

    QUANTITIES: ClassVar = {"x": Quantity("m"), "y": Quantity("m")}

    x: Array
    y: Array
    loop: NDArray[np.int64]

    def __post_init__(self) -> None:
        convert_quantities(self)


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
    return _Points(table["X"], table["Y"], loop)


def _made_of(path: Path, make: Callable[[Any], Made], what: str) -> Made:
    """Return what is made of a table of text, CSV or ECSV; what is wrong with it names the file."""
    from astropy.table import QTable

    form = "ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv"
    lines = read_text(path).splitlines()
    numbers = [k for k, line in enumerate(lines, 1) if line.strip() and line[0] != "#"][1:]
    try:
        # Of what overflows or is odd astropy warns; it is refused below, by what it became.
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            table = QTable.read(lines, format=form, guess=False)
            for name in "XY":
                if name not in table.colnames:
                    raise _lacking(name, table.colnames)
                _check_numbers(table[name], name, numbers if len(numbers) == len(table) else None)
            return make(table)
    except TrueNewtonError as error:
        raise located(error, path) from None
    except Exception as error:
        raise FormatError(
            f"is not a table of {what} ({error})",
            remedy="write columns X and Y as CSV or ECSV, lengths in metres",
            path=path,
        ) from error


def _lacking(name: str, columns: Sequence[str]) -> FormatError:
    has = listed([f"'{column}'" for column in columns], 4) if columns else "none"
    return FormatError(
        f"lacks column '{name}'; it has {has}",
        remedy="name the columns X and Y in the first line, in metres, with commas between; or"
        " name the FITS file that `truenewton import` makes of a matrix and positions as they are",
    )


def _check_numbers(cells: Any, name: str, lines: Sequence[int] | None) -> None:
    """Refuse the first cell of a column that is no finite number; its line where they are known.

    That is, where no cell goes over several.
    """
    empty = np.broadcast_to(getattr(cells, "mask", False), len(cells)).tolist()
    for i, value in enumerate(np.asarray(cells).tolist()):
        if empty[i] or not _is_finite(value):
            where = f"row {i + 1}" if lines is None else f"line {lines[i]}"
            raise FormatError(
                f"{where}: {name} is {'empty' if empty[i] else repr(value)[:60]}",
                remedy="give a number",
            )


def _is_finite(value: Any) -> bool:
    try:
        return bool(np.isfinite(float(value)))
    except ValueError:
        return False


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
