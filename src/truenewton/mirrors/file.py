"""Mirrors that someone else has: numbers from a TOML file, actuators from a table."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.errors import FormatError, GeometryError, located
from truenewton.files.toml import check_keys, filled, read_toml
from truenewton.mirrors.checks import CHECKS, check_actuators, check_outline
from truenewton.mirrors.glass import Outline
from truenewton.mirrors.known import KNOWN, Mirror, MirrorNumbers, mirror
from truenewton.mirrors.segmented import SEGMENTED, Place, SegmentedMirror
from truenewton.mirrors.tables import layout_in, outline_in
from truenewton.quantities import check_quantities
from truenewton.records.file import SUFFIXES
from truenewton.records.segment import require_segment
from truenewton.statics.layout import FARTHEST, Layout


@dataclass(frozen=True, kw_only=True)
class _Written(MirrorNumbers):
    """A mirror as its file gives it, with the file of its actuators."""

    actuators: str


@dataclass(frozen=True)
class _Placed:
    """A segment as the file of its mirror gives it: the file of its own, and its place."""

    file: str
    x: float
    y: float
    turned: float = 0.0


@dataclass(frozen=True)
class _WrittenSegments:
    """A mirror in segments as its file gives it."""

    name: str
    segments: tuple[_Placed, ...]


def whole_mirror_from(name: str | os.PathLike[str]) -> Mirror | SegmentedMirror:
    """Return a mirror in one piece or in segments: known by its name, or of a TOML file.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    path = Path(name)
    if str(name).lower() in SEGMENTED:
        return SEGMENTED[str(name).lower()]()
    if str(name).lower() not in KNOWN and path.suffix == ".toml" and path.exists():
        tables = read_toml(path)
        if "segments" in tables:
            return _segments_in(tables, path)
    return mirror_from(name)


def segment_from(name: str | os.PathLike[str], number: int) -> tuple[Mirror, Layout]:
    """Return a segment of a mirror, and its actuators as the whole mirror names and places them.

    Parameters
    ----------
    name
        As of `whole_mirror_from`.
    number
        Of the segment, which has a frame and numbers of its own.

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
    # Read once, so that segments of one file are seen to share their glass.
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
    if "segments" in read_toml(file):
        raise FormatError(
            f"takes {file.name} for a segment, which is a mirror in segments itself",
            remedy="name the files of its segments here",
            path=whole,
        )
    return _mirror_in(file)


def mirror_from(name: str | os.PathLike[str]) -> Mirror:
    """Return a known mirror by its name, or the one of a TOML file (docs/simulated-bench.md).

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    path = Path(name)
    if str(name).lower() in SEGMENTED:
        raise _is_segmented(str(name))
    if str(name).lower() in KNOWN or not (path.suffix == ".toml" or path.exists()):
        return mirror(str(name))
    if str(name).endswith(SUFFIXES):
        raise FormatError(
            "is a FITS file, which holds no glass",
            remedy="give a known mirror, or a TOML file whose `actuators` names this one",
            path=name,
        )
    return _mirror_in(path)


def _mirror_in(path: Path) -> Mirror:
    tables = read_toml(path)
    if "segments" in tables:
        raise _is_segmented(str(path))
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


def _is_segmented(name: str) -> FormatError:
    return FormatError(
        f"'{name}' is a mirror in segments",
        remedy="simulate, plan and --mirror take it, acquire and serve one segment of it,"
        " --segment; for anything else give the file of one segment",
    )


def _with_points(tables: dict[str, Any], path: Path) -> tuple[dict[str, Any], Path]:
    """Return the tables of a mirror and the file in which its outline stands.

    Points are read from the file that the outline names; radii may be left out beside it.
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
    """Return a mirror with the outer radius that its outline reaches, where it gives none."""
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
    if furthest > FARTHEST:
        raise GeometryError(
            f"the outline reaches {furthest:.3g} m from the axis",
            remedy="x and y are metres; check their unit",
        )
