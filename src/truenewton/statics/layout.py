"""Positions and directions of the actuators, and their rings or segments."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truenewton.arrays import Array, freeze
from truenewton.errors import GeometryError, UnknownName
from truenewton.quantities import Quantity, convert_quantities, taking_units
from truenewton.rounding import listed, named

MAX_DISTANCE = 10.0  # of an actuator from the axis [m]; beyond it the unit is wrong
MAX_ACTUATORS = 20000
PLACE = ("x", "y", "nz")
INTEGERS = dict.fromkeys(("id", "segment"), np.int64)
DTYPES: dict[str, Any] = {**INTEGERS, "enabled": np.bool_, "number": None}
INTEGER = re.compile(r"[-+]?\d{1,18}")
POSITION_TOLERANCE = 1e-6  # [m], and of NZ: the precision of four bytes, or of short tables


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """Actuators in the frame of the torques; Quantities are converted.

    Attributes
    ----------
    id
        (n,) integer names, unique.
    x, y
        (n,) positions of the magnets [m].
    nz
        (n,) cosine between the force of each actuator and +z; 1 on a flat mirror.
    enabled
        (n,) false if an actuator applies no force.
    x_error, y_error
        (n,) standard uncertainties of x and y [m]; None if not declared.
    segment
        (n,) number of the segment of each actuator, from 1; None for a mirror in one piece.
    number
        (n,) the mirror's own designation of each actuator: its number, if ``id`` is the channel of
        the electronics, or a text, as 'B3'; None if it is ``id``.

    Raises
    ------
    GeometryError
        Duplicate names, two actuators at one place, values that are not finite, none enabled.

    Examples
    --------
    >>> layout = tn.layout([0.0, 0.1, -0.1], [0.1, 0.0, 0.0], enabled=[True, True, False])
    >>> layout
    <Layout of 3 actuators, 1 disabled>
    >>> layout.nz
    array([1., 1., 1.])
    """

    QUANTITIES: ClassVar = {
        "x": Quantity("m"), "y": Quantity("m"), "x_error": Quantity("m"), "y_error": Quantity("m"),
        "id": Quantity(), "nz": Quantity(), "enabled": Quantity(), "segment": Quantity(),
        "number": Quantity(),
    }  # fmt: skip

    id: NDArray[np.int64]
    x: Array
    y: Array
    nz: Array
    enabled: NDArray[np.bool_]
    x_error: Array | None = None
    y_error: Array | None = None
    segment: NDArray[np.int64] | None = None
    number: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        convert_quantities(self)
        if self.number is not None:
            object.__setattr__(self, "number", integers_or_texts(self.number))
        given = [field.name for field in fields(self) if getattr(self, field.name) is not None]
        for name in given:
            freeze(self, name, dtype=DTYPES.get(name, np.float64))
            shape = getattr(self, name).shape
            if shape != (self.n,):
                raise GeometryError(
                    f"{name.upper()} has shape {shape}",
                    remedy=f"give one number for each of the {self.n} actuators",
                )
        if self.n == 0:
            raise GeometryError("there are no actuators", remedy="give at least one")
        if self.n > MAX_ACTUATORS:  # matrices of so many by so many exceed any memory
            raise GeometryError(
                f"there are {self.n} actuators", remedy=f"give {MAX_ACTUATORS} at most"
            )
        if not self.enabled.any():
            raise GeometryError(
                "no actuator is ENABLED", remedy="set ENABLED to T for those that give force"
            )
        self._refuse_values()
        self._refuse_twice()

    def _refuse_values(self) -> None:
        """Refuse numbers that no actuator can have, naming the first of them."""
        far = np.maximum(np.abs(self.x), np.abs(self.y))
        errors = {name: getattr(self, name) for name in ("x_error", "y_error")}
        checks = [
            *((~np.isfinite(getattr(self, name)), f"{name.upper()} of actuator {{}} is not finite",
               "give the position and direction of every actuator") for name in PLACE),
            *((~((error >= 0.0) & (error < MAX_DISTANCE)),
               f"E_{name[0].upper()} of actuator {{}} is negative or not finite",
               "give standard uncertainties in m")
              for name, error in errors.items() if error is not None),
            ((far == far.max()) & (far > MAX_DISTANCE),
             f"actuator {{}} is {far.max():.3g} m from the axis",
             "X and Y are metres; check their unit"),
            ((self.nz > 1.0) | (self.nz < 0.01), "NZ lies outside 0.01 to 1",
             "NZ is the cosine between the force and +z"),
        ]  # fmt: skip
        for bad, fault, remedy in checks:
            if bad.any():
                raise GeometryError(fault.format(self.shown[bad][0]), remedy=remedy)
        if self.segment is not None and (self.segment < 1).any():
            raise GeometryError(f"SEGMENT is {self.segment.min()}", remedy="segments count from 1")

    def _refuse_twice(self) -> None:
        """Refuse two actuators of one name, or at one place to the nanometre."""
        # Names that repeat the IDs are not made here: each file of a campaign would keep them.
        for ids in (self.id, self.names) if self.has_texts else (self.id,):
            values, count = np.unique(ids, return_counts=True)
            if (count > 1).any():
                raise GeometryError(
                    f"actuator ID {values[count > 1][0]} occurs {count.max()} times",
                    remedy="give every actuator its own ID, whatever its segment",
                )
        at = np.round([self.x / 1e-9, self.y / 1e-9])
        places, first, count = np.unique(at, axis=1, return_inverse=True, return_counts=True)
        if (count > 1).any():
            which = int(np.argmax(count > 1))
            x, y = places[:, which] * 1e-9
            one, other = self.shown[np.ravel(first) == which][:2]
            raise GeometryError(
                f"two actuators are at x = {x:.6g} m, y = {y:.6g} m: {one} and {other}",
                remedy="correct their positions",
            )

    def __repr__(self) -> str:
        off = f", {np.count_nonzero(~self.enabled)} disabled" if not self.enabled.all() else ""
        pieces = f" of {len(self.segments)} segments" if self.segments else ""
        return f"<Layout of {self.n} actuators{pieces}{off}>"

    @cached_property
    def n(self) -> int:
        """Number of actuators, disabled ones included."""
        return int(np.size(self.id))

    @property
    def has_texts(self) -> bool:
        """Whether ``number`` contains texts."""
        return self.number is not None and self.number.dtype.kind == "U"

    @property
    def has_channels(self) -> bool:
        """Whether ``id`` is the channel of the electronics, and ``number`` that on the mirror."""
        return self.number is not None and not self.has_texts

    @cached_property
    def names(self) -> NDArray[np.str_]:
        """(n,) the names that the user gave to the actuators: texts in ``number``, or ``id``."""
        return np.asarray(self.number if self.has_texts else self.id.astype(np.str_))

    @cached_property
    def shown(self) -> NDArray[np.str_]:
        """(n,) IDs as messages name actuators: '17', or '17 (B3)' if ``number`` is text."""
        pairs = zip(self.id.astype(np.str_).tolist(), self.names.tolist(), strict=True)
        return np.array([id if id == name else f"{id} ({name})" for id, name in pairs])

    def ids_of(self, names: Collection[int | str]) -> list[int]:
        """Return the IDs of actuators that are named by ID, or by the text in ``number``.

        Raises
        ------
        UnknownName
            There is no such actuator.
        """
        ids = self.id.tolist()
        at: dict[int | str, int] = dict(zip((*ids, *self.names.tolist()), 2 * ids, strict=True))
        if unknown := [name for name in dict.fromkeys(names) if name not in at]:
            raise UnknownName(
                f"there is no {named('actuator', unknown, 5)}",
                remedy=f"IDs run from {self.shown[0]} to {self.shown[-1]}",
            )
        return [at[name] for name in names]

    @property
    def segments(self) -> tuple[int, ...]:
        """Numbers of the segments in ascending order; none for a mirror in one piece."""
        numbers = () if self.segment is None else np.unique(self.segment).tolist()
        return tuple(numbers) if len(numbers) > 1 else ()

    def in_segment(self, number: int) -> NDArray[np.bool_]:
        """Return (n,) true for the actuators of a segment; raise UnknownName if there are none."""
        require_segment(number, () if self.segment is None else np.unique(self.segment).tolist())
        return np.asarray(np.asarray(self.segment) == number)

    def part(self, chosen: NDArray[Any]) -> Layout:
        """Return the chosen actuators, (n,) true or their indices."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{k: v[chosen] for k, v in columns.items() if v is not None})

    def same_as(self, other: Layout) -> bool:
        """Return whether actuators and enabled ones are the same."""
        return not self.difference(other)

    def difference(self, other: Layout) -> str:
        """Describe the difference of another layout, named first, from this one, or return ''."""
        if differ := self.other_actuators(other) or self._unlike(other, "enabled"):
            return differ
        if self.segments != other.segments:
            return f"{len(other.segments) or 1} and {len(self.segments) or 1} segments"
        return self._unlike(other, "segment") if self.segments else ""

    def other_actuators(self, other: Layout) -> str:
        """Describe the first actuator of another layout, named first, that differs, or return ''.

        Order and places to `POSITION_TOLERANCE` are compared, not which are enabled.
        """
        if self.n != other.n:
            more, less = (self, other) if self.n > other.n else (other, self)
            lost = more.shown[~np.isin(more.names, less.names)]
            only = f"; only one has {listed(lost, 3)}" if lost.size else ""
            return f"{other.n} and {self.n} actuators{only}"
        farther = max(
            "xy", key=lambda name: np.abs(getattr(self, name) - getattr(other, name)).max()
        )
        names = ("id", farther, "nz")  # of X and Y that in which an actuator is farthest off
        return next(filter(None, (self._unlike(other, name) for name in names)), "")

    def _unlike(self, other: Layout, name: str) -> str:
        """Describe the first difference of a column, for places the largest, or return ''."""
        one, two = (getattr(each, name).astype(float) for each in (other, self))
        apart = np.abs(one - two)
        unlike = int(np.count_nonzero(apart > (POSITION_TOLERANCE if name in PLACE else 0.0)))
        if not unlike:
            return ""
        least = 0.999 * apart.max() if name in PLACE else 0.0  # the first, where all move alike
        k, more = int(np.argmax(apart > least)), f"; and {unlike - 1} more" if unlike > 1 else ""
        if name in ("x", "y"):
            size = f"{1e3 * apart[k]:.3g} mm" if apart[k] >= 1e-3 else f"{1e6 * apart[k]:.3g} um"
            values = f"{one[k]:.7f} and {two[k]:.7f} m, {size} apart"
        elif name == "enabled":
            values = " and ".join("FT"[int(each[k])] for each in (one, two))
        else:
            values = f"{one[k]:.7g} and {two[k]:.7g}"
        which = f"row {k + 1}" if name == "id" else f"actuator {self.shown[k]} (row {k + 1})"
        return f"{name.upper()} of {which}: {values}{more}"


def require_segment(number: int, numbers: Collection[int]) -> None:
    """Raise UnknownName if there is no segment of this number."""
    if number not in numbers:
        choice = f"choose {', '.join(map(str, sorted(numbers)))}"
        raise UnknownName(
            f"there is no segment {number}",
            remedy=choice if numbers else "the mirror is in one piece: leave the segment out",
        )


def integers_or_texts(given: Any) -> NDArray[Any]:
    """Return (n,) IDs as integers if all are, otherwise as texts.

    Raises
    ------
    GeometryError
        One is missing, or a number that is no integer.
    """
    array = np.atleast_1d(given)
    values = (array.astype(np.str_) if array.dtype.kind == "S" else array).tolist()
    texts = [f"{one:.15g}" if isinstance(one, float) else str(one).strip() for one in values]
    if all(map(INTEGER.fullmatch, texts)):
        return np.array(texts, dtype=np.int64)
    for row, (one, text) in enumerate(zip(values, texts, strict=True), 1):
        if not (INTEGER.fullmatch(text) or (isinstance(one, str) and text)):
            no_id = text in ("", "nan", "<NA>", "None")
            fault = f"the ID in row {row} is {'missing' if no_id else text}"
            raise GeometryError(fault, remedy="give an integer or a text for each actuator")
    return np.array(texts, dtype=np.str_)


@taking_units(x="m", y="m")
def layout(
    x: ArrayLike,
    y: ArrayLike,
    *,
    id: ArrayLike | None = None,
    nz: ArrayLike | None = None,
    enabled: ArrayLike | None = None,
    x_error: ArrayLike | None = None,
    y_error: ArrayLike | None = None,
    segment: ArrayLike | None = None,
    number: ArrayLike | None = None,
) -> Layout:
    """Return a layout; by default IDs count from 1, forces point along +z, and all are enabled.

    Parameters
    ----------
    x, y
        (n,) positions: numbers [m], or Quantities of any length.
    id, nz, enabled, x_error, y_error, segment, number
        (n,) each, see `Layout`, which also lists what is refused. If IDs are texts, as F01 or B3,
        they become ``number``, and ``id`` counts the actuators from 1.

    Examples
    --------
    >>> import astropy.units as u
    >>> tn.layout([0, 100, -100] * u.mm, [100, 0, 0] * u.mm, id=[7, 8, 9]).x
    array([ 0. ,  0.1, -0.1])
    >>> tn.layout([0.0, 0.1, -0.1], [0.1, 0.0, 0.0], id=["A1", "B1", "B2"]).shown.tolist()
    ['1 (A1)', '2 (B1)', '3 (B2)']
    """
    n = np.size(x)
    if id is not None and (ids := integers_or_texts(id)).dtype.kind == "U":
        if number is not None:
            raise GeometryError("IDs are texts, and NUMBER is given", remedy="give one of them")
        id, number = None, ids
    columns: dict[str, Any] = {
        "id": np.arange(1, n + 1) if id is None else id,
        "nz": np.ones(n) if nz is None else nz,
        "enabled": np.ones(n, dtype=bool) if enabled is None else enabled,
        "x_error": x_error, "y_error": y_error, "segment": segment, "number": number,
    }  # fmt: skip
    return Layout(x=x, y=y, **columns)  # type: ignore[arg-type]


@taking_units(radii="m", nz="", turned="rad")
def rings(
    radii: Sequence[float],
    counts: Sequence[int],
    *,
    nz: Sequence[float] = (),
    turned: Sequence[float] = (),
) -> Layout:
    """Make a layout of concentric rings, with one actuator of each ring on the +y axis.

    Numbered from the innermost ring outward, counter-clockwise from +y. With counts divisible by
    three this has the 120 degree symmetry of the paper's mirror (paper, section 2).

    Parameters
    ----------
    radii
        Radius of each ring [m], projected on the x, y plane.
    counts
        Actuators on each ring.
    nz
        Cosine between force and +z on each ring; by default 1.
    turned
        Rotation of each ring, counter-clockwise [rad]; by default 0.

    Examples
    --------
    >>> tn.rings([0.04, 0.07], [9, 15])
    <Layout of 24 actuators>
    """
    start = 0.5 * np.pi + (np.asarray(turned) if len(turned) else np.zeros(len(counts)))
    angle = np.concatenate(
        [first + 2 * np.pi * np.arange(k) / k for first, k in zip(start, counts, strict=True)]
    )
    radius = np.repeat(radii, counts)
    cosines = np.repeat(nz, counts) if len(nz) else None
    return layout(radius * np.cos(angle), radius * np.sin(angle), nz=cosines)


@taking_units(polar_angles="rad", radius="m", turned="rad")
def spherical_rings(
    polar_angles: Sequence[float],
    counts: Sequence[int],
    radius: float,
    *,
    turned: Sequence[float] = (),
) -> Layout:
    """Make a layout of rings on a spherical shell whose actuators push along its normals.

    An actuator at polar angle t has nz = cos t and, for the torques, the radius R sin t: the exact
    arms for piston and tilts about the vertex (docs/method.md).

    Parameters
    ----------
    polar_angles
        Angle of each ring from the axis, seen from the centre of curvature [rad].
    counts
        Actuators on each ring.
    radius
        Radius of curvature R [m].
    turned
        As in `rings`.

    Examples
    --------
    >>> shell = tn.spherical_rings([0.02, 0.04], [9, 15], radius=1.955)
    >>> shell.nz[[0, -1]].round(4)
    array([0.9998, 0.9992])
    """
    t = np.asarray(polar_angles, dtype=float)
    return rings(list(radius * np.sin(t)), counts, nz=list(np.cos(t)), turned=turned)


def ring_centre(layout: Layout) -> tuple[float, float]:
    """Return x and y of the centre of the rings [m]: the origin, or the mean position of actuators.

    The latter is used for a segment off the axis, if it makes fewer rings.
    """
    own = float(layout.x.mean()), float(layout.y.mean())
    return min(((0.0, 0.0), own), key=lambda centre: int(_radius_number(layout, centre).max()))


def ring_of(layout: Layout) -> NDArray[np.int64]:
    """Return (n,) rings of the actuators about `ring_centre`, 0 the innermost, radii to 0.1 mm.

    All are 0 if there are no rings: as many radii as half the actuators.
    """
    ring = _radius_number(layout, ring_centre(layout))
    return ring if ring.max() < layout.n // 2 else np.zeros(layout.n, dtype=np.int64)


def _radius_number(layout: Layout, centre: tuple[float, float]) -> NDArray[np.int64]:
    """Return (n,) number of the radius of each actuator, 0 the smallest."""
    radius = np.hypot(layout.x - centre[0], layout.y - centre[1])
    order = np.argsort(radius, kind="stable")
    steps = np.diff(radius[order], prepend=radius[order[0]]) > 1e-4
    number = np.empty(layout.n, dtype=np.int64)
    number[order] = np.cumsum(steps)
    return number
