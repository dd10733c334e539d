"""Where actuators stand: lengths in metres, and a curved surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import astropy.units as u
import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.foreign.choice import Places

# Farthest actuator from the middle of all, in metres and in what it looks like otherwise.
FARTHEST = 1e12  # in any unit: no place
LIKELY = {"m": (0.02, 5.0), "mm": (40.0, 5e3), "um": (2e4, 5e6)}


@dataclass(frozen=True, eq=False)
class Positions:
    """Positions in metres.

    Attributes
    ----------
    x, y, nz
        (n,) [m] and cosine between force and +z, or None.
    ids, enabled
        (n,) or None.
    columns
        Names of the columns of their file.
    notes
        What was found and done, in words.
    """

    x: Array
    y: Array
    nz: Array | None
    ids: NDArray[np.int64] | None
    enabled: NDArray[np.bool_] | None
    notes: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()

    def part(self, rows: Any) -> Positions:
        """Return those of some rows."""
        some: dict[str, Any] = {
            name: None if (values := getattr(self, name)) is None else np.asarray(values)[rows]
            for name in ("x", "y", "nz", "ids", "enabled")
        }
        return replace(self, **some)


def in_metres(
    places: Places, lengths: str | None, curvature: float | None, path: str, *, arc: bool
) -> Positions:
    """Return positions in metres; on a curved surface with their directions.

    Parameters
    ----------
    places
        As they stand in a file.
    lengths
        Their unit, unless the file declares it or it can be told from their size.
    curvature
        Radius R of the surface [m], or None: then NZ is that of the file, or 1.
    path
        Named where they are refused.
    arc
        Radii are measured along the surface, R t, and not from the axis, R sin t.

    Raises
    ------
    FormatError
    """
    x, y = (np.asarray(values, dtype=float).ravel() for values in (places.x, places.y))
    if x.shape != y.shape:
        raise FormatError(
            f"holds {x.size} X and {y.size} Y", remedy="give both for every actuator", path=path
        )
    x, y = (np.where(np.abs(values) < FARTHEST, values, np.nan) for values in (x, y))
    if not np.isfinite(x + y).any():
        raise FormatError("holds no finite positions", remedy="give X and Y", path=path)
    unit, how = lengths or places.unit, "as told" if lengths else "as declared"
    if not unit:
        unit, how = _likeliest_unit(x, y, path), "by their size"
    factor = in_unit(1.0, unit, "m", "positions", path)
    x, y = x * factor, y * factor
    notes, nz = [f"{unit} {how}"], places.nz
    if curvature is not None:
        if not 0.0 < curvature < np.inf:
            raise FormatError(
                f"the curvature radius is {curvature:g} m", remedy="give R in m, positive"
            )
        radius = np.hypot(x, y)
        if np.nanmax(radius) >= (np.pi / 2 if arc else 1.0) * curvature:
            raise FormatError(
                f"an actuator stands {np.nanmax(radius):.3g} m from the axis of a surface of R ="
                f" {curvature:.3g} m",
                remedy="check the unit of positions, and R in m",
                path=path,
            )
        sine = np.sin(radius / curvature) if arc else radius / curvature
        shrunk = np.divide(sine * curvature, radius, out=np.ones_like(radius), where=radius > 0)
        x, y, nz = x * shrunk, y * shrunk, np.sqrt(1.0 - sine**2)
        notes.append(f"R {curvature:g} m{', radii along the surface' if arc else ''}")
    elif nz is None:
        notes.append("NZ 1, a flat mirror (--curvature R for another)")
    if nz is not None:
        notes.append(f"NZ {np.nanmin(nz):.4f} .. {np.nanmax(nz):.4f}")
    return Positions(x, y, nz, places.ids, places.enabled, tuple(notes), places.columns)


def in_unit(value: Any, unit: str, want: str, what: str, path: Any) -> float:
    """Return a factor from a unit by name to the one wanted.

    Raises
    ------
    FormatError
    """
    try:
        return float((value * u.Unit(unit)).to_value(want))
    except (ValueError, TypeError):
        example = "N/um" if want == "N/m" else "mm"
        steps = ", or 'unknown' for steps of electronics" if want == "N/m" else ""
        raise FormatError(
            f"the unit of {what} is '{unit}'", remedy=f"give one as {example}{steps}", path=path
        ) from None


def _likeliest_unit(x: Array, y: Array, path: str) -> str:
    """Return the unit that makes positions those of a mirror."""
    size = float(np.nanmax(np.hypot(x - np.nanmean(x), y - np.nanmean(y)), initial=0.0))
    fitting = [unit for unit, (least, most) in LIKELY.items() if least <= size < most]
    if not fitting:
        raise FormatError(
            f"positions reach {size:.3g} from their middle, in no unit that is declared",
            remedy="say which by --lengths (lengths=), as mm",
            path=path,
        )
    return fitting[0]
