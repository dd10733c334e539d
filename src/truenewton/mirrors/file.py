"""Mirrors that someone else has: numbers from a TOML file, actuators from a table."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from truenewton.errors import FormatError, GeometryError, TrueNewtonError, UnreadableFile
from truenewton.files.toml import filled, read_toml
from truenewton.mirrors.known import KNOWN, Mirror, MirrorNumbers, mirror
from truenewton.records.file import SUFFIXES, read_layout
from truenewton.statics.layout import Layout, layout


@dataclass(frozen=True, kw_only=True)
class _Written(MirrorNumbers):
    """A mirror as its file gives it, with the file of its actuators."""

    actuators: str


def mirror_from(name: str | os.PathLike[str]) -> Mirror:
    """Return a known mirror by its name, or the mirror that a TOML file describes.

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
    return read_mirror(path)


def read_mirror(path: str | os.PathLike[str]) -> Mirror:
    """Read a mirror from a TOML file (docs/simulated-bench.md).

    Raises
    ------
    UnreadableFile, FormatError, GeometryError
    """
    written = filled(_Written, read_toml(path), path)
    for name, low in (("weight", -np.inf), ("added_weight", -np.inf), ("weight_error", 0.0),
                      ("added_weight_error", 0.0), ("magnet_mass", 0.0), ("gap", 0.0)):  # fmt: skip
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
    numbers = {part.name: getattr(written, part.name) for part in fields(MirrorNumbers)}
    made = Mirror(layout=read_actuators(Path(path).parent / written.actuators), **numbers)
    try:
        check_glass(made)
    except GeometryError as error:
        raise GeometryError(error.fault, remedy=error.remedy, path=path) from None
    return made


def read_actuators(path: str | os.PathLike[str]) -> Layout:
    """Return the actuators of a table: columns X, Y, and ID, NZ, ENABLED where they stand.

    A FITS file with ACTUATORS, or text (ECSV, CSV) whose lengths are metres unless it gives a unit.

    Raises
    ------
    UnreadableFile, FormatError, GeometryError
    """
    if str(path).endswith(SUFFIXES):
        return read_layout(path)
    from astropy.table import QTable

    form = "ascii.ecsv" if str(path).endswith(".ecsv") else "ascii.csv"
    try:
        table = QTable.read(path, format=form)
        columns = {name: table[name] for name in ("ID", "NZ", "ENABLED") if name in table.colnames}
        return layout(
            table["X"], table["Y"], **{name.lower(): column for name, column in columns.items()}
        )
    except TrueNewtonError as error:
        raise type(error)(error.fault, remedy=error.remedy, path=path) from None
    except OSError as error:
        raise UnreadableFile(
            f"cannot be read ({error.strerror or error})", remedy="check its name", path=path
        ) from error
    except KeyError as error:
        raise FormatError(f"lacks column {error}", remedy="give X and Y", path=path) from error
    except Exception as error:
        raise FormatError(
            f"is not a table of actuators ({error})",
            remedy="write columns X and Y as CSV or ECSV, lengths in metres",
            path=path,
        ) from error


def check_glass(mirror: Mirror) -> None:
    """Refuse a shell that cannot be, and actuators off the glass.

    Raises
    ------
    GeometryError
    """
    shell = mirror.shell
    if not 0 < shell.inner_radius < shell.outer_radius < np.inf or not shell.thickness > 0:
        raise GeometryError(
            f"the glass reaches from {shell.inner_radius:g} m to {shell.outer_radius:g} m, "
            f"{shell.thickness:g} m thick",
            remedy="give an inner radius below the outer one and a thickness",
        )
    radius = abs(shell.radius_of_curvature)
    if not radius > shell.outer_radius:
        raise GeometryError(
            f"a radius of curvature of {shell.radius_of_curvature:g} m cannot carry a shell of"
            f" {shell.outer_radius:g} m",
            remedy="give a larger one, with sign; leave it out for a plate",
        )
    r = np.hypot(*shell.along(mirror.layout.x, mirror.layout.y))
    reach = max(mirror.puck_radius, mirror.sensor.outer_radius)
    off = np.flatnonzero((r - reach < shell.inner_radius) | (r + reach > shell.outer_radius))
    if off.size:
        raise GeometryError(
            f"actuator {mirror.layout.id[off[0]]} stands {r[off[0]]:.4g} m from the axis: it or its"
            " sensor reaches off the glass",
            remedy=f"that is from {shell.inner_radius:g} m to {shell.outer_radius:g} m; the sensor"
            f" reaches {reach:g} m",
        )
