"""Mirrors from files: numbers from TOML, actuators and outlines from tables."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError, GeometryError, TrueNewtonError, located
from truenewton.files.fits import read_fits
from truenewton.files.format import Column, FileFormat, TableFormat
from truenewton.files.opening import read_text
from truenewton.files.toml import check_keys, filled, read_toml
from truenewton.mirrors.checks import CHECKS, check_actuators, check_outline
from truenewton.mirrors.glass import Outline
from truenewton.mirrors.known import KNOWN, Mirror, MirrorNumbers, mirror
from truenewton.mirrors.segmented import SEGMENTED, Place, SegmentedMirror
from truenewton.quantities import Quantity, check_quantities, convert_quantities
from truenewton.records.file import SUFFIXES, read_layout
from truenewton.records.parts import require_segment
from truenewton.rounding import listed
from truenewton.statics.layout import MAX_DISTANCE, Layout, layout

Made = TypeVar("Made")
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


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of an outline, x and y (n,) [m]; loop (n,) 0 of the edge, 1, 2, ... of the holes."""

    QUANTITIES: ClassVar = {"x": Quantity("m"), "y": Quantity("m")}

    x: Array
    y: Array
    loop: NDArray[np.int64]

    def __post_init__(self) -> None:
        convert_quantities(self)


def layout_in(path: Path) -> Layout:
    """Return the actuators of a FITS file, or of a text table, by default in metres.

    Its columns are X, Y and, optionally, ID, NZ, ENABLED.

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

    It is the table OUTLINE of a FITS file, or a text table. Its columns are X, Y and, if there are
    holes, LOOP: 0 for the edge, 1, 2, ... for the holes.

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
    """Return the result of a function of a CSV or ECSV table; errors name the file."""
    from astropy.table import QTable

    form = "ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv"
    lines = read_text(path).splitlines()
    numbers = [k for k, line in enumerate(lines, 1) if line.strip() and line[0] != "#"][1:]
    try:
        # astropy warns of overflows; the resulting values are refused below.
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
    """Refuse the first cell of a column that is not a finite number; name its line if known."""
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
    """Return a column of a text table after checking its type."""
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


@dataclass(frozen=True, kw_only=True)
class _Written(MirrorNumbers):
    """The content of the file of a mirror, with the file of its actuators."""

    actuators: str


@dataclass(frozen=True)
class _Placed:
    """A segment in the file of a mirror: its own file, and its place."""

    file: str
    x: float
    y: float
    turned: float = 0.0


@dataclass(frozen=True)
class _WrittenSegments:
    """The content of the file of a segmented mirror."""

    name: str
    segments: tuple[_Placed, ...]


def whole_mirror_from(name: str | os.PathLike[str]) -> Mirror | SegmentedMirror:
    """Return a mirror in one piece or in segments, by its name or from a TOML file.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    path, known = Path(name), str(name).lower()
    if known in SEGMENTED:
        return SEGMENTED[known]()
    if known in KNOWN or not (path.suffix == ".toml" or path.exists()):
        return mirror(str(name))
    if str(name).endswith(SUFFIXES):
        raise FormatError(
            "is a FITS file, which holds no glass",
            remedy="give a known mirror, or a TOML file whose `actuators` names this one",
            path=name,
        )
    tables = read_toml(path)
    return (_segments_in if "segments" in tables else _mirror_in)(tables, path)


def mirror_from(name: str | os.PathLike[str]) -> Mirror:
    """Return a mirror in one piece by its name or from a TOML file (docs/simulated-bench.md).

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    whole = whole_mirror_from(name)
    if isinstance(whole, SegmentedMirror):
        raise FormatError(
            f"'{name}' is a mirror in segments",
            remedy="simulate, plan and --mirror take it, acquire and serve one segment of it,"
            " --segment; for anything else give the file of one segment",
        )
    return whole


def segment_from(name: str | os.PathLike[str], number: int) -> tuple[Mirror, Layout]:
    """Return a segment of a mirror in its own frame, and its actuators in that of the mirror.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    whole = whole_mirror_from(name)
    if not isinstance(whole, SegmentedMirror):
        raise FormatError(f"{whole.name} is in one piece", remedy="leave the segment out")
    require_segment(number, whole.layout.segments)
    chosen = np.asarray(whole.layout.segment) == number
    own = replace(whole.segments[number - 1], name=f"{whole.name} segment {number}")
    return own, whole.layout.part(chosen)


def _segments_in(tables: dict[str, Any], path: Path) -> SegmentedMirror:
    written = filled(_WrittenSegments, tables, path)
    files = {placed.file for placed in written.segments}
    # Segments of one file are one object, so that their shell is modelled once.
    made = {file: _segment_from(path.parent / file, path) for file in sorted(files)}
    try:
        return SegmentedMirror(
            name=written.name,
            segments=tuple(made[placed.file] for placed in written.segments),
            places=tuple(Place(one.x, one.y, one.turned) for one in written.segments),
        )
    except GeometryError as error:
        raise located(error, path) from None


def _segment_from(file: Path, whole: Path) -> Mirror:
    tables = read_toml(file)
    if "segments" in tables:
        raise FormatError(
            f"takes {file.name} for a segment, which is a mirror in segments itself",
            remedy="name the files of its segments here",
            path=whole,
        )
    return _mirror_in(tables, file)


def _mirror_in(tables: dict[str, Any], path: Path) -> Mirror:
    tables, points = _with_points(tables, path)
    written = _within_reach(filled(_Written, tables, path), points)
    try:
        check_quantities(written)
    except FormatError as error:
        raise located(error, path) from None
    if written.alpha_range[0] > written.alpha_range[1]:
        raise FormatError(
            f"alpha_range is {list(written.alpha_range)}", remedy="lowest first", path=path
        )
    if abs(written.coil_gradient) * written.gap >= 1.0:
        raise FormatError(
            f"coil_gradient is {written.coil_gradient:g} per metre, with which a coil's force would"
            " change its sign within the gap",
            remedy="give the relative change of force per metre, as 600",
            path=path,
        )
    numbers = dict(vars(written))
    actuators = path.parent / numbers.pop("actuators")
    made = Mirror(layout=layout_in(actuators), **numbers)
    files = {check_outline: points, check_actuators: actuators}
    for check in CHECKS:
        try:
            check(made)
        except GeometryError as error:
            raise located(error, files.get(check, path)) from None
    return made


def _with_points(tables: dict[str, Any], path: Path) -> tuple[dict[str, Any], Path]:
    """Return the tables of a mirror with the points of its outline, and the file of these.

    With an outline, radii are optional.
    """
    shell = tables.get("shell")
    if not isinstance(shell, dict) or not isinstance(shell.get("outline"), dict):
        return tables, path
    outline = shell["outline"]
    known = ("points", *(field.name for field in fields(Outline)))
    check_keys(outline, known, path, "shell.outline")
    shell, points = {"inner_radius": 0.0, "outer_radius": np.inf, **shell}, path
    if isinstance(outline.get("points"), str):
        for twice in {"edge", "holes"} & set(outline):
            raise FormatError(
                f"[shell.outline] has points and {twice}",
                remedy="give the outline here or in a file of points, not both",
                path=path,
            )
        points = path.parent / outline["points"]
        edge, *holes = outline_in(points)
        own = {key: value for key, value in outline.items() if key != "points"}
        outline = {**own, "edge": edge, "holes": holes}
    return {**tables, "shell": {**shell, "outline": outline}}, points


def _within_reach(written: _Written, points: Path) -> _Written:
    """Return a mirror with the outer radius of its outline, if it has none of its own."""
    shell = written.shell
    if shell.outline is None:
        return written
    try:
        _check_reach(shell.outline)
        if shell.outer_radius < np.inf:
            return written
        reach = float(np.hypot(*shell.polygons()[0].T).max(initial=0.0))
    except GeometryError as error:
        raise located(error, points) from None
    return replace(written, shell=replace(shell, outer_radius=reach))


def _check_reach(outline: Outline) -> None:
    loops = outline.edge, *outline.holes
    furthest = max((abs(part) for loop in loops for at in loop for part in at), default=0.0)
    if furthest > MAX_DISTANCE:
        raise GeometryError(
            f"the outline reaches {furthest:.3g} m from the axis",
            remedy="x and y are metres; check their unit",
        )
