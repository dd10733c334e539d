"""The matrix and the positions among the arrays of a file, and their units."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import astropy.units as u
import numpy as np

from truenewton.arrays import Array
from truenewton.errors import FormatError, UnreadableFile, naming
from truenewton.estimation.matrix.order import refuse_no_stiffness
from truenewton.files.tables import Item, without_group
from truenewton.importers.stored import Stored, read_stored
from truenewton.records.tables import Positions, positions_by_columns, positions_of

MATRIX_NAMES = ("stiffness", "ffwd", "ff_matrix", "ff", "ffmatrix", "feedforward", "feed_forward")
POSITION_NAMES = ("coordinates", "coords", "act_coordinates", "act_coord", "positions", "xy")
MAX_NAMED = 12  # arrays, columns or actuators in a line
MAX_COORDINATE = 1e12  # in any unit: a larger one is not a position
# Distance of the farthest actuator from the mean position, by unit.
LIKELY_SIZES = {"m": (0.02, 5.0), "mm": (40.0, 5e3), "um": (2e4, 5e6)}
LIKELY_STIFFNESS = (2e4, 1e9)  # median diagonal element of a mirror [N/m]
MAX_ELEMENT = 1e30  # element in any unit
NOMINAL_STIFFNESS = 1e6  # median diagonal element of a matrix of unknown unit [N/m]


def _squeezed(stored: Stored) -> dict[str, Item]:
    """Return the arrays of a file without axes of length 1."""
    return {name: Item(np.squeeze(item.values), item.unit) for name, item in stored.arrays.items()}


def matrix_in(stored: Stored, dataset: str | None) -> tuple[Item, str]:
    """Return the (n, n) or (shells, n, n) matrix of a file, and a text if there are several."""
    with naming(stored.path or None):
        items = _squeezed(stored)
        if dataset is not None:
            named = [item for name, item in items.items() if name.lower() == dataset.lower()]
            if not named:
                raise FormatError(f"has no array '{dataset}'", remedy=there_is(stored))
            items = {dataset: named[0]}
        square = {
            name: item
            for name, item in items.items()
            if item.values.ndim in (2, 3)
            and item.values.shape[-1] == item.values.shape[-2]
            and item.values.shape[-1] > 2
        }
        every = square
        if len(square) > 1:
            known = {n: i for n, i in square.items() if without_group(n.lower()) in MATRIX_NAMES}
            square = known or square
        if len(square) != 1:
            fault = (
                f"contains {len(square)} square matrices" if square else "contains no square matrix"
            )
            many = "choose one by --dataset (dataset=): " + ", ".join(square)
            raise FormatError(fault, remedy=many if square else _none_square(stored))
        ((name, item),) = square.items()
        return item, f", '{name}' of {', '.join(every)}" if len(every) > 1 else ""


def read_positions(path: str | os.PathLike[str]) -> Positions:
    """Read a file of positions."""
    if Path(path).is_dir():
        raise UnreadableFile("is a folder", remedy="give a file of positions", path=path)
    stored = read_stored(path)
    found = positions_in(stored)
    if found is None:
        remedy = f"give columns X and Y, or an (n, 2) or (2, n) array; {there_is(stored)}"
        raise FormatError("contains no positions", remedy=remedy, path=path)
    return found


def positions_in(stored: Stored) -> Positions | None:
    """Return the positions of a file: columns X and Y, or an (n, 2) or (2, n) array; or None."""
    with naming(stored.path or None):
        every = _squeezed(stored)
        vectors = {name: item for name, item in every.items() if item.values.ndim == 1}
        named = positions_by_columns({**vectors, **stored.columns})
        if named is not None:
            return named
        arrays = {name: item for name, item in every.items() if item.values.ndim == 2}
        known = {n: i for n, i in arrays.items() if without_group(n.lower()) in POSITION_NAMES}
        fitting = known or {n: i for n, i in arrays.items() if min(i.values.shape) in (2, 3)}
        if not fitting:
            return None
        if len(fitting) > 1:
            remedy = "give positions in a file of their own"
            several = f"several arrays may be positions: {', '.join(fitting)}"
            raise FormatError(several, remedy=remedy)
        return positions_of(next(iter(fitting.values())))


def _none_square(stored: Stored) -> str:
    """Return the remedy for a file without a square matrix."""
    shapes = [item.values.shape for item in stored.arrays.values()]
    twice = any(len(shape) == 2 and shape[1] == 2 * shape[0] for shape in shapes)
    commas = ": where commas are decimal ones too, put semicolons between columns" if twice else ""
    return f"give as many rows as columns{commas}; {there_is(stored)}"


def there_is(stored: Stored) -> str:
    """Return a text on the arrays and columns of numbers in a file."""
    parts = [f"{n or 'one'} {item.values.shape}" for n, item in stored.arrays.items()]
    parts += [f"column '{name}'" for name in stored.columns]
    return f"there is {', '.join(parts[:MAX_NAMED])}" if parts else "there are no arrays in it"


@dataclass(frozen=True)
class Surface:
    """How positions are given.

    Attributes
    ----------
    unit
        Their unit, or '': as declared by the file, or the likeliest by their size.
    curvature
        Radius of curvature R of the surface [m], negative if it is convex, or None or 0: NZ is that
        of the file, or 1.
    arc
        Whether radii are measured along the surface, R t, instead of from the axis, R sin t.
    """

    unit: str = ""
    curvature: float | None = None
    arc: bool = False


def in_metres(positions: Positions, surface: Surface) -> Positions:
    """Return positions in metres, on a curved surface with their directions."""
    arc = surface.arc
    # R = 0 is that of a flat mirror, R < 0 of a convex one, whose forces have the same arms.
    curvature = abs(surface.curvature) if surface.curvature else None
    x, y = (np.asarray(values, dtype=float).ravel() for values in (positions.x, positions.y))
    if x.shape != y.shape:
        raise FormatError(
            f"contains {x.size} X and {y.size} Y", remedy="give both for every actuator"
        )
    x, y = (np.where(np.abs(values) < MAX_COORDINATE, values, np.nan) for values in (x, y))
    if not np.isfinite(x + y).any():
        raise FormatError("contains no finite positions", remedy="give X and Y")
    unit = surface.unit or positions.unit
    how = "as specified" if surface.unit else "as declared"
    if not unit:
        unit, how = _likeliest_unit(x, y), "by their size"
    factor = _factor(unit, "m", "positions")
    x, y = x * factor, y * factor
    far, nz = 1e3 * np.hypot(x, y), positions.nz
    notes = [f"{unit} {how}", f"{np.nanmin(far):.4g} to {np.nanmax(far):.4g} mm from the axis"]
    if curvature is not None:
        if not curvature < np.inf:
            raise FormatError(
                f"the curvature radius is {curvature:g} m", remedy="give R in m; 0 if it is flat"
            )
        radius = np.hypot(x, y)
        if np.nanmax(radius) >= (np.pi / 2 if arc else 1.0) * curvature:
            raise FormatError(
                f"an actuator is {np.nanmax(radius):.3g} m from the axis of a surface of R ="
                f" {curvature:.3g} m",
                remedy="check the unit of positions, and R in m",
            )
        sine = np.sin(radius / curvature) if arc else radius / curvature
        shrunk = np.divide(sine * curvature, radius, out=np.ones_like(radius), where=radius > 0)
        x, y, nz = x * shrunk, y * shrunk, np.sqrt(1.0 - sine**2)
        notes.append(f"R {surface.curvature:g} m{', radii along the surface' if arc else ''}")
    elif nz is None:
        notes.append("NZ 1 (no curvature given)")
    if nz is not None:
        notes.append(f"NZ {np.nanmin(nz):.4f} .. {np.nanmax(nz):.4f}")
    return replace(positions, x=x, y=y, unit="m", nz=nz, notes=tuple(notes))


def _factor(unit: str, want: str, what: str) -> float:
    """Return the factor from a unit to the one wanted."""
    try:
        return float(u.Unit(unit).to(want))
    except (ValueError, TypeError):
        example = "N/um" if want == "N/m" else "mm"
        steps = ", or 'unknown' for steps of electronics" if want == "N/m" else ""
        raise FormatError(
            f"the unit of {what} is '{unit}'", remedy=f"give one as {example}{steps}"
        ) from None


def _likeliest_unit(x: Array, y: Array) -> str:
    """Return the unit in which positions have the size of a mirror."""
    size = float(np.nanmax(np.hypot(x - np.nanmean(x), y - np.nanmean(y)), initial=0.0))
    fitting = [unit for unit, (least, most) in LIKELY_SIZES.items() if least <= size < most]
    if not fitting:
        raise FormatError(
            f"positions reach {size:.3g} from their middle, and their unit is not declared",
            remedy="give it by --lengths (lengths=), as mm",
        )
    return fitting[0]


def in_newton_per_metre(k: Array, unit: str | None, declared: str) -> tuple[Array, str]:
    """Return an (n, n) matrix in N/m, which may contain NaN, and a text on its unit."""
    most = float(np.max(np.abs(k), where=np.isfinite(k), initial=0.0))
    if most > MAX_ELEMENT:
        raise FormatError(f"contains an element of {most:.3g}", remedy="measure it again")
    if not np.isfinite(k).any():
        raise FormatError("contains no finite number", remedy="measure it again")
    refuse_no_stiffness(np.nan_to_num(k, posinf=0.0, neginf=0.0))
    own = np.abs(np.diag(k))
    own = own[np.isfinite(own) & (own > 0.0)]
    typical = float(np.median(own)) if own.size else 0.0
    if not typical:
        raise FormatError(
            "is zero on its diagonal", remedy="give a stiffness or feed-forward matrix"
        )
    if unit == "unknown":
        said = f"unit unknown: its median diagonal is called {NOMINAL_STIFFNESS:g} N/m;"
        said += " alpha does not depend on it, forces and modes are in that unit"
        return k * (NOMINAL_STIFFNESS / typical), said
    said = unit or declared
    if said:
        factor = _factor(said, "N/m", "the matrix")
        how = f"as {'specified' if unit else 'declared'}: median diagonal"
        how += f" {abs(factor) * typical:.3g} N/m"
        doubt = "" if _is_likely(abs(factor) * typical) else ", UNLIKELY for a mirror: check it"
        return k * factor, f"{said} {how}{doubt}"
    if not _is_likely(typical):
        per = {"N/um": 1e6, "N/mm": 1e3, "mN/um": 1e3, "N/nm": 1e9, "uN/nm": 1e3}
        fitting = [name for name, f in per.items() if _is_likely(typical * f)]
        raise FormatError(
            f"declares no unit, and a median diagonal of {typical:.3g} N/m is implausible",
            remedy=f"give it by --unit (unit=), as {', '.join((*fitting, 'unknown'))}; if it is"
            " displacement per force, invert it",
        )
    return k, f"N/m, inferred from the median diagonal {typical:.3g}"


def _is_likely(stiffness: float) -> bool:
    """Return whether a median diagonal element [N/m] may be that of a mirror."""
    return LIKELY_STIFFNESS[0] <= stiffness < LIKELY_STIFFNESS[1]
