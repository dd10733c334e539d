"""Mirrors that someone else has: numbers from a TOML file, actuators from a table."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import FormatError, GeometryError, TrueNewtonError, located
from truenewton.files.opening import read_text
from truenewton.files.toml import filled, read_toml
from truenewton.mirrors.glass import check_shell
from truenewton.mirrors.known import KNOWN, Mirror, MirrorNumbers, mirror
from truenewton.mirrors.shell.finite_elements.outline import checked_sides, depth_inside
from truenewton.mirrors.shell.held_glass import tool_wedges
from truenewton.mirrors.shell.places import SMALLEST_HOLE
from truenewton.records.file import SUFFIXES, read_layout
from truenewton.statics.layout import Layout, layout

MOST = 1e15  # of any number of a mirror, stiff glass included


@dataclass(frozen=True, kw_only=True)
class _Written(MirrorNumbers):
    """A mirror as its file gives it, with the file of its actuators."""

    actuators: str


def mirror_from(name: str | os.PathLike[str]) -> Mirror:
    """Return a known mirror by its name, or the one of a TOML file (docs/simulated-bench.md).

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError
    """
    path = Path(name)
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
    written = filled(_Written, read_toml(path), path)
    _refuse_absurd(written, path)
    for name, low in (("weight", -np.inf), ("added_weight", -np.inf), ("weight_error", 0.0),
                      ("added_weight_error", 0.0), ("magnet_mass", 0.0), ("gap", 0.0),
                      ("vent_radius", 0.0)):  # fmt: skip
        value, high = getattr(written, name), 0.0 if low < 0 else np.inf
        if not low <= value <= high or np.isinf(value):
            raise FormatError(
                f"{name} is {value:g}",
                remedy="weights are negative (z points up), the rest is not",
                path=path,
            )
    low, high = written.alpha_range
    if not 0 < low <= high < np.inf:
        raise FormatError(
            f"alpha_range is {list(written.alpha_range)}",
            remedy="give the lowest and highest alpha, positive",
            path=path,
        )
    numbers = dict(vars(written))
    actuators = path.parent / numbers.pop("actuators")
    made = Mirror(layout=_layout_in(actuators), **numbers)
    try:
        check_glass(made)
    except GeometryError as error:
        raise located(error, path) from None
    return made


def _refuse_absurd(written: Any, path: Path, inside: str = "") -> None:
    """Refuse numbers that are a slip of the unit in any mirror, their squares to stay numbers."""
    for field in fields(written):
        value = getattr(written, field.name)
        if is_dataclass(value):
            _refuse_absurd(value, path, f"{inside}{field.name}.")
        sizes = np.abs(np.ravel(value)) if isinstance(value, float | tuple) else np.zeros(0)
        flat = field.default == np.inf and value == np.inf  # no radius of curvature
        if sizes.dtype.kind == "f" and not (flat or (sizes <= MOST).all()):
            raise FormatError(
                f"{inside}{field.name} is {value}",
                remedy=f"check its unit; numbers are in SI units, up to {MOST:g}",
                path=path,
            )


def _layout_in(path: Path) -> Layout:
    """Return the actuators of a FITS file, or of a table whose lengths are metres unless it says.

    Its columns are X, Y, and ID, NZ, ENABLED where they stand.
    """
    if str(path).endswith(SUFFIXES):
        return read_layout(path)
    from astropy.table import QTable

    form = "ascii.ecsv" if path.suffix == ".ecsv" else "ascii.csv"
    lines = read_text(path).splitlines()
    try:
        # Of what overflows or is odd astropy warns; it is refused below, by what it became.
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            table = QTable.read(lines, format=form, guess=False)
            others = {"ID", "NZ", "ENABLED"} & set(table.colnames)
            columns = {name.lower(): _cells(table, name) for name in ("X", "Y", *others)}
            return layout(**columns)
    except TrueNewtonError as error:
        raise located(error, path) from None
    except KeyError as error:
        raise FormatError(f"lacks column {error}", remedy="give X and Y", path=path) from error
    except Exception as error:
        raise FormatError(
            f"is not a table of actuators ({error})",
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
    if name == "ID" and values.dtype.kind not in "iu":
        raise FormatError(f"ID holds {values.dtype}", remedy="write integers")
    return values


def check_glass(mirror: Mirror) -> None:
    """Refuse a shell that cannot be, and actuators off the glass.

    Raises
    ------
    GeometryError
    """
    shell = mirror.shell
    check_shell(shell, 0.0 if shell.outline else SMALLEST_HOLE)
    at = shell.along(mirror.layout.x, mirror.layout.y)
    r, reach = np.hypot(*at), max(mirror.puck_radius, mirror.sensor.outer_radius)
    if shell.outline is None:
        off = (r - reach < shell.inner_radius) | (r + reach > shell.outer_radius)
        where = f"that is from {shell.inner_radius:g} m to {shell.outer_radius:g} m"
    else:
        off = _depth_in_outline(mirror, at) < reach
        where = "bring it further within the outline"
    if off.any():
        i = off.argmax()
        raise GeometryError(
            f"actuator {mirror.layout.id[i]} stands {r[i]:.4g} m from the axis: it or its"
            " sensor reaches off the glass",
            remedy=f"{where}; the sensor reaches {reach:g} m",
        )


def _depth_in_outline(mirror: Mirror, at: tuple[Array, Array]) -> Array:
    """Return (n,) how far from the edges places lie within an outlined glass; negative off it [m].

    Refuses polygons that cannot be, that reach beyond the outer radius, or leave no glass for the
    weight tool.
    """
    shell = mirror.shell
    assert shell.outline is not None
    loops = checked_sides(shell.polygons(), shell.outline.mesh_size)
    furthest = np.hypot(*loops[0].T).max()
    if furthest > shell.outer_radius:
        raise GeometryError(
            f"the outline reaches {furthest:.6g} m from the axis",
            remedy=f"give an outer radius that it stays within, more than {shell.outer_radius:g} m",
        )
    if (depth_inside(loops, np.stack(tool_wedges(shell), axis=1)) < 0).any():
        raise GeometryError(
            f"the weight tool, {shell.inner_radius:g} m from the axis, stands off the glass",
            remedy="give as inner radius that of a circle on the glass",
        )
    return depth_inside(loops, np.stack(at, axis=1))
