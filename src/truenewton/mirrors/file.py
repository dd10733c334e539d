"""Mirrors from files: numbers from TOML, actuators and outlines from tables, and their checks."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import FormatError, GeometryError, naming
from truenewton.files.fits import SUFFIXES, read_fits
from truenewton.files.format import Column, FileFormat, TableFormat
from truenewton.files.tables import Item, table_in, text_of
from truenewton.files.toml import check_keys, filled, read_toml
from truenewton.mirrors.glass import Outline, check_shell
from truenewton.mirrors.known import GRAVITY, KNOWN, Mirror, MirrorNumbers, mirror
from truenewton.mirrors.segmented import SEGMENTED, Place, SegmentedMirror
from truenewton.mirrors.shell.mesh import (
    check_mesh_size,
    checked_polygons,
    depth_inside,
    mesh_size_of,
)
from truenewton.mirrors.shell.round_shell import MIN_HOLE
from truenewton.mirrors.shell.shell_model import tool_wedges
from truenewton.quantities import check_quantities
from truenewton.records.file import read_layout
from truenewton.records.tables import layout_of, positions_from
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

MAX_WEIGHT_RATIO = 3.0  # and its inverse, to the weight of glass and magnets
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


@dataclass(frozen=True, kw_only=True)
class _Written(MirrorNumbers):
    """The content of the file of a mirror, with the file of its actuators."""

    actuators: str


@dataclass(frozen=True, kw_only=True)
class _Placed(Place):
    """A segment in the file of a mirror: its place, and its own file."""

    file: str


@dataclass(frozen=True)
class _WrittenSegments:
    """The content of the file of a segmented mirror."""

    name: str
    segments: tuple[_Placed, ...]


def whole_mirror_from(name: str | os.PathLike[str]) -> Mirror | SegmentedMirror:
    """Return a mirror in one piece or in segments, by its name or from a TOML file."""
    path, known = Path(name), str(name).lower()
    if known in SEGMENTED:
        return SEGMENTED[known]()
    if known in KNOWN or not (path.suffix == ".toml" or path.exists()):
        return mirror(str(name))
    if str(name).endswith(SUFFIXES):
        raise FormatError(
            "is a FITS file, which does not describe the glass",
            remedy="give a known mirror, or a TOML file whose `actuators` names this one",
            path=name,
        )
    tables = read_toml(path)
    return (_segments_in if "segments" in tables else _mirror_in)(tables, path)


def mirror_from(name: str | os.PathLike[str]) -> Mirror:
    """Return a mirror in one piece by its name or from a TOML file (docs/mirrors.md)."""
    whole = whole_mirror_from(name)
    if isinstance(whole, SegmentedMirror):
        raise FormatError(
            f"'{name}' is a mirror in segments",
            remedy="give the file of one segment; `acquire` accepts --segment",
        )
    return whole


def segment_from(name: str | os.PathLike[str], number: int) -> tuple[Mirror, Layout]:
    """Return a segment of a mirror in its own frame, and its actuators in that of the mirror."""
    whole = whole_mirror_from(name)
    if not isinstance(whole, SegmentedMirror):
        raise FormatError(f"{whole.name} is in one piece", remedy="leave the segment out")
    chosen = whole.layout.in_segment(number)
    own = replace(whole.segments[number - 1], name=f"{whole.name} segment {number}")
    return own, whole.layout.part(chosen)


def _segments_in(tables: dict[str, Any], path: Path) -> SegmentedMirror:
    written = filled(_WrittenSegments, tables, path)
    made = {}  # segments of one file are one object, so that their shell is modelled once
    for file in sorted({placed.file for placed in written.segments}):
        tables = read_toml(path.parent / file)
        if "segments" in tables:
            raise FormatError(
                f"takes {file} for a segment, which is a mirror in segments itself",
                remedy="name the files of its segments here",
                path=path,
            )
        made[file] = _mirror_in(tables, path.parent / file)
    with naming(path):
        return SegmentedMirror(
            name=written.name,
            segments=tuple(made[placed.file] for placed in written.segments),
            places=tuple(Place(one.x, one.y, one.turned) for one in written.segments),
        )


def _mirror_in(tables: dict[str, Any], path: Path) -> Mirror:
    tables, points = _with_points(tables, path)
    written = filled(_Written, tables, path)
    numbers = dict(vars(written))
    actuators = path.parent / numbers.pop("actuators")
    with naming(path):
        check_quantities(written)
        if written.alpha_range[0] > written.alpha_range[1]:
            raise FormatError(f"alpha_range is {list(written.alpha_range)}", remedy="lowest first")
        if abs(written.coil_gradient) * written.gap >= 1.0:
            raise FormatError(
                f"coil_gradient is {written.coil_gradient:g} per metre, with which a coil's force"
                " would change its sign within the gap",
                remedy="give the relative change of force per metre, as 600",
            )
        made = Mirror(layout=layout_in(actuators), **numbers)
        check_mirror(made, points=points, actuators=actuators)
    return made


def _with_points(tables: dict[str, Any], path: Path) -> tuple[dict[str, Any], Path]:
    """Return the tables of a mirror with the points of its outline, and the file of these.

    With an outline, radii are optional.
    """
    shell = tables.get("shell")
    if not isinstance(shell, dict) or not isinstance(shell.get("outline"), dict):
        return tables, path
    outline, points = shell["outline"], path
    known = ("points", *(field.name for field in fields(Outline)))
    with naming(path):
        check_keys(outline, known, "shell.outline")
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
    radii = {"inner_radius": 0.0, "outer_radius": np.inf}
    return {**tables, "shell": {**radii, **shell, "outline": outline}}, points


# -- tables of actuators and of points --------------------------------------------------------


def layout_in(path: Path) -> Layout:
    """Return the actuators of a FITS file, or of a text table, by default in metres.

    Its columns are X, Y and, optionally, ID, NZ, ENABLED.
    """
    if str(path).endswith(SUFFIXES):
        return read_layout(path)
    with naming(path):
        return layout_of(table_in(text_of(path)).columns)


def outline_in(path: Path) -> list[list[list[float]]]:
    """Return the edge and the holes of a table of points: x and y of each [m], in their order.

    It is the table OUTLINE of a FITS file, or a text table. Its columns are X, Y and, if there are
    holes, LOOP: 0 for the edge, 1, 2, ... for the holes.
    """
    if str(path).endswith(SUFFIXES):
        values = read_fits(path).values(OUTLINE)
        x, y, loops = (np.asarray(values[name]) for name in ("x", "y", "loop"))
    else:
        with naming(path):
            columns = table_in(text_of(path)).columns
            at = positions_from(columns)
            x, y, others = at.x, at.y, Item(np.zeros(len(at.x)))
            loops = columns.get("LOOP", others).numbers("LOOP", finite=True)
    numbers = np.unique(loops)
    if not np.array_equal(numbers, np.arange(numbers.size)) or not numbers.size:
        raise FormatError(
            f"LOOP contains {', '.join(f'{number:g}' for number in numbers) or 'nothing'}",
            remedy="number the points of the edge 0, those of the holes 1, 2, ...",
            path=path,
        )
    places = np.stack([x, y], axis=1)
    return [places[loops == number].tolist() for number in numbers]


# -- checks -----------------------------------------------------------------------------------


def check_mirror(mirror: Mirror, points: Path | None = None, actuators: Path | None = None) -> None:
    """Refuse a mirror that cannot be simulated, naming the file of its points or actuators."""
    shell, loops = mirror.shell, mirror.shell.polygons()
    check_shell(shell, MIN_HOLE if not loops and shell.inner_radius else 0.0)
    places = np.stack(shell.along(mirror.layout.x, mirror.layout.y), axis=1)
    where = f"that is from {shell.inner_radius:g} m to {shell.outer_radius:g} m"
    if loops:
        with naming(points):
            checked_polygons(loops)
        check_mesh_size(loops, mesh_size_of(shell, *places.T))
        furthest, where = float(np.hypot(*loops[0].T).max()), "bring it further within the outline"
        if furthest > shell.outer_radius:
            raise GeometryError(
                f"the outline reaches {furthest:.6g} m from the axis",
                remedy=f"leave outer_radius out, or give more than {shell.outer_radius:g} m",
            )
    reach = max(mirror.puck_radius, mirror.sensor.outer_radius)
    off = _depth(mirror, places) < reach
    if off.any():
        i = off.argmax()
        raise GeometryError(
            f"actuator {mirror.layout.id[i]} is {np.hypot(*places[i]):.4g} m from the axis: it"
            " or its sensor reaches off the glass",
            remedy=f"{where}; the sensor reaches {reach:g} m",
            path=actuators,
        )
    wedges = np.stack(tool_wedges(mirror), axis=1)
    if (_depth(mirror, wedges) < 0).any():
        raise GeometryError(
            f"the weight tool, {np.hypot(*wedges[0]):g} m from the axis, is not on the glass",
            remedy="give as tool_radius that of a circle on the glass, about x = y = 0",
        )
    magnets = mirror.layout.n
    expected = -GRAVITY * (shell.mass + magnets * mirror.magnet_mass)
    if not expected * MAX_WEIGHT_RATIO < mirror.weight < expected / MAX_WEIGHT_RATIO:
        raise GeometryError(
            f"weight is {mirror.weight:.4g} N, but glass of {1e3 * shell.thickness:.3g} mm and"
            f" {counted(magnets, 'magnet')} of {1e3 * mirror.magnet_mass:.3g} g weigh"
            f" {expected:.3g} N",
            remedy="correct weight (N, not kg), thickness, density or magnet_mass",
        )


def _depth(mirror: Mirror, places: Array) -> Array:
    """Return (n,) how far (n, 2) places along a glass lie from its edges [m], negative off it."""
    shell = mirror.shell
    if shell.outline is not None:
        return depth_inside(shell.polygons(), places)
    a, b, r = shell.inner_radius, shell.outer_radius, np.hypot(*places.T)
    return np.asarray(np.minimum(r - a if a else np.inf, b - r))
