"""One run through all shapes under one load: its rows, the weights, and the file they came from."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, blocks, freeze
from truenewton.errors import FormatError
from truenewton.quantities import Quantity, check_quantities, convert_quantities, mask_of
from truenewton.rounding import counted
from truenewton.statics.layout import Layout
from truenewton.statics.load import (
    ADDED_WEIGHT,
    LARGEST_FORCE,
    LEAST_NOISE,
    MIRROR_WEIGHT,
    SMALLEST_FORCE,
    Load,
    check_load,
)

LARGEST_DISPLACEMENT = 1e3  # [m]
ANY_LENGTH = Quantity("m", -np.inf, np.inf)
ASSUMED = "assumed"  # times of a cycle that no clock gave
# The arrays of a cycle and their types.
ARRAYS = {"time": float, "shape": np.int64, "sign": np.int64, "valid": bool, "temperature": float,
          "force": float, "position": float}  # fmt: skip


@dataclass(frozen=True)
class Source:
    """A file that was read.

    Attributes
    ----------
    file, sha256
        Its path, in a result its name; the digest of its bytes.
    rows, rejected
        Number of its rows that are part of a result, and number of rows rejected as outliers.
    """

    file: str
    sha256: str
    rows: int = 0
    rejected: int = 0


class Segment(NamedTuple):
    """A row of SEGMENTS: the weights of one segment under one load.

    Attributes
    ----------
    number
        As in SEGMENT of ACTUATORS.
    weight, weight_error
        P and its standard uncertainty [N].
    added, added_error
        Q and its standard uncertainty [N].

    Examples
    --------
    >>> tn.Segment(1, weight=-2.92, weight_error=0.005, added=-0.289, added_error=0.005).weight
    -2.92
    """

    number: int
    weight: float
    weight_error: float
    added: float = 0.0
    added_error: float = 0.0


def check_date(date: object) -> None:
    """Raise FormatError for anything but a date."""
    if not isinstance(date, datetime.datetime):
        raise FormatError(f"the date is {date!r}", remedy="give a datetime.datetime, UTC")


def check_segments(segments: tuple[Segment, ...], layout: Layout) -> None:
    """Raise FormatError if weights are invalid, or not those of the segments of the actuators."""
    there = () if layout.segment is None else np.unique(layout.segment).tolist()
    if layout.segments and not segments:
        raise FormatError(
            f"ACTUATORS has {len(there)} segments, and their weights are not given",
            remedy="add the table SEGMENTS: SEGMENT, WEIGHT, E_WEIGHT, ADDED, E_ADDED"
            " (docs/files.md)",
        )
    named = [segment.number for segment in segments]
    for number in named:
        if named.count(number) > 1:
            raise FormatError(f"segment {number} is twice in SEGMENTS", remedy="keep one row")
        if number not in there:
            raise FormatError(
                f"SEGMENTS has a row of segment {number}, which has no actuators",
                remedy="correct SEGMENT of ACTUATORS, or remove the row",
            )
    lacking = [number for number in there if number not in named] if named else []
    if lacking:
        raise FormatError(
            f"SEGMENTS has no row of {counted(lacking, 'segment')}:"
            f" {', '.join(map(str, lacking[:9]))}",
            remedy="give WEIGHT, E_WEIGHT, ADDED and E_ADDED of each segment (docs/files.md)",
        )
    for segment in segments:
        try:
            for name, quantity in (MIRROR_WEIGHT | ADDED_WEIGHT).items():
                quantity.check(getattr(segment, name))
        except FormatError as error:
            raise error.changed(fault=f"{error.fault} of segment {segment.number}") from None


def whole_mirror(instrument: str, layout: Layout) -> str:
    """Return INSTRUME without the number of a segment, if the actuators are of a single one."""
    number = () if layout.segment is None or layout.segments else layout.segment[:1]
    return instrument.removesuffix("".join(f" segment {k}" for k in number))


def sums_of(segments: tuple[Segment, ...]) -> dict[str, float]:
    """Return weight, its error, added weight and its error [N] of all segments together."""
    weights = np.array([segment[1:] for segment in segments])
    values, errors = weights[:, ::2].sum(axis=0), np.sqrt((weights[:, 1::2] ** 2).sum(axis=0))
    names = ("weight", "added", "weight_error", "added_error")
    return dict(zip(names, [*values.tolist(), *errors.tolist()], strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class Cycle:
    """One run through all shapes under one load (docs/files.md).

    Quantities are converted. Rows with masked numbers of enabled actuators are not valid.

    Attributes
    ----------
    instrument, date, number
        INSTRUME; start (UTC); CYCLE, from 1.
    load
        The added weight and tilt.
    weight, weight_error
        P and its standard uncertainty [N].
    layout
        The n actuators.
    time, shape, sign, valid
        (N,) seconds since ``date``; index of the shape from 1; +1 or -1; false for rows that are
        not used, whatever they contain.
    force
        (N, n) commanded forces c [N].
    temperature, position
        (N,) [deg C] and (N, n) [m], or None.
    coil_gradient, bias_gradient
        COILGRAD [1/m] and BIASGRAD [N/m], or None.
    gap, force_error
        GAP [m] and FORCERR [N], or None.
    source
        The file, or None.
    segments
        Weights of each segment; empty for a mirror in one piece. ``weight`` and the added weight
        of ``load`` are the sums over all segments.
    times
        'assumed' if ``date`` or ``time`` was not measured, otherwise None.

    Raises
    ------
    FormatError
        A number, or a value in a valid row, is not allowed.

    Examples
    --------
    >>> cycle = campaign.cycles[0]
    >>> cycle.load.name, cycle.force.shape
    ('bare', (90, 45))
    >>> stronger = dataclasses.replace(cycle, force=0.9 * cycle.force)
    """

    QUANTITIES: ClassVar = MIRROR_WEIGHT | {
        "time": Quantity("s", -1e8, 1e8, "count TIME in seconds from DATE-OBS"),
        "temperature": Quantity(
            "deg_C", -150.0, 150.0,
            "declare the unit of TEMPERATURE, deg_C or K; leave the column out where it was not"
            " measured",
        ),
        "force": Quantity("N", -LARGEST_FORCE, LARGEST_FORCE, "check the unit of FORCE"),
        "position": Quantity(
            "m", -LARGEST_DISPLACEMENT, LARGEST_DISPLACEMENT, "check the unit of POSITION"
        ),
        "shape": Quantity(), "sign": Quantity(), "valid": Quantity(), "gap": ANY_LENGTH,
        "number": Quantity("", 1, why="cycles count from 1", fault="CYCLE is {:g}"),
        "force_error": Quantity(
            "N", LEAST_NOISE, LARGEST_FORCE,
            "a standard deviation is positive; leave it out if unknown", "FORCERR is {:g} N",
        ),
        "coil_gradient": Quantity(
            "1/m", -LARGEST_FORCE, LARGEST_FORCE, "check its unit", "COILGRAD is {:g}"
        ),
        "bias_gradient": Quantity(
            "N/m", -LARGEST_FORCE, LARGEST_FORCE, "check its unit", "BIASGRAD is {:g}"
        ),
    }  # fmt: skip

    instrument: str
    date: datetime.datetime
    number: int
    load: Load
    weight: float
    weight_error: float
    layout: Layout
    time: Array
    shape: NDArray[np.int64]
    sign: NDArray[np.int64]
    force: Array
    valid: NDArray[np.bool_]
    temperature: Array | None = None
    position: Array | None = None
    coil_gradient: float | None = None
    bias_gradient: float | None = None
    gap: float | None = None
    force_error: float | None = None
    source: Source | None = None
    segments: tuple[Segment, ...] = ()
    times: str | None = None

    def __post_init__(self) -> None:
        convert_quantities(self)
        self._check_segments()
        self._take_masks()
        for name, dtype in ARRAYS.items():
            if getattr(self, name) is not None:
                freeze(self, name, dtype=dtype)
        check_date(self.date)
        if self.times not in (None, ASSUMED):
            raise FormatError(f"TIMES is '{self.times}'", remedy=f"remove it, or give '{ASSUMED}'")
        check_load(self.load)
        check_quantities(self)
        self._check_rows()

    def _take_masks(self) -> None:
        """Mark rows with masked numbers of enabled actuators as not valid."""
        masks = {name: mask_of(getattr(self, name)) for name in ARRAYS if name != "valid"}
        for name, mask in masks.items():
            if mask is not None:
                rows = mask[:, self.layout.enabled].any(axis=1) if mask.ndim == 2 else mask
                object.__setattr__(self, "valid", np.asarray(self.valid, dtype=bool) & ~rows)
                number = np.where(mask, 0, np.asarray(getattr(self, name)))
                object.__setattr__(self, name, number)

    def _check_segments(self) -> None:
        check_segments(self.segments, self.layout)
        if self.segments:
            ordered = tuple(sorted(self.segments)) if self.layout.segments else ()
            own = (self.weight, self.load.added, self.weight_error, self.load.added_error)
            sums = sums_of(self.segments)
            if not np.allclose(own, list(sums.values()), rtol=1e-6, atol=1e-9):
                raise FormatError(
                    "WEIGHT or ADDED is not the sum of the weights of all segments",
                    remedy="give the sums, and of their errors the root of the sum of squares",
                )
            object.__setattr__(self, "segments", ordered)

    def _check_rows(self) -> None:
        rows, n = np.size(self.time), self.layout.n
        for name in ARRAYS:
            value = getattr(self, name)
            want = (rows, n) if name in ("force", "position") else (rows,)
            if value is not None and value.shape != want:
                raise FormatError(
                    f"{name.upper()} has shape {value.shape} for {counted(rows, 'row')} and"
                    f" {counted(n, 'actuator')}",
                    remedy=f"give it the shape {want}",
                )
        if not self.valid.any():
            what = "valid rows" if rows else "rows"
            raise FormatError(f"MEASUREMENTS has no {what}", remedy="leave this file out")
        for row in np.flatnonzero(~np.isin(self.sign, (-1, 1)) & self.valid):
            raise FormatError(f"SIGN in row {row + 1} is {self.sign[row]}", remedy="it is +1 or -1")
        for row in np.flatnonzero((self.shape < 1) & self.valid):
            raise FormatError(
                f"SHAPE in row {row + 1} is {self.shape[row]}", remedy="shapes count from 1"
            )
        for name in ("time", "temperature", "force", "position"):
            if getattr(self, name) is not None:
                self._check_finite(name, self.QUANTITIES[name])
        if self.largest_force < SMALLEST_FORCE:
            raise FormatError(
                f"FORCE is {f'below {SMALLEST_FORCE:g} N' if self.largest_force else 'zero'}"
                " throughout",
                remedy="record the commanded forces, and check their unit",
            )
        if self.force_error and self.force_error > self.largest_force:
            raise FormatError(
                f"FORCERR is {self.force_error:g} N, and no FORCE is beyond {self.largest_force:g}"
                " N",
                remedy="check the units of both; leave FORCERR out if it is unknown",
            )

    def _check_finite(self, name: str, quantity: Quantity) -> None:
        values, largest = getattr(self, name), quantity.high
        counted = self.layout.enabled if values.ndim == 2 else np.ones(1, dtype=bool)
        values = values if values.ndim == 2 else values[:, None]
        for row in np.flatnonzero(~(_largest(values, counted) <= largest) & self.valid):
            some = values[row][counted]
            wrong = ~(np.abs(some) <= largest)
            bad, of, remedy = some[wrong][0], "", "mark the row as not VALID, or correct it"
            if len(some) > 1:
                of = f" for actuator {self.layout.shown[counted][wrong][0]}"
                remedy += "; if it is so in all rows, set ENABLED of the actuator to F"
            if np.isfinite(bad):
                remedy = f"{quantity.why}, or mark the row as not VALID"
            raise FormatError(f"{name.upper()} in row {row + 1} is {bad:g}{of}", remedy=remedy)

    def __repr__(self) -> str:
        return (
            f"<Cycle {self.number} of {self.instrument}, load '{self.load.name}':"
            f" {counted(self.time, 'row')}, {counted(self.layout.n, 'actuator')}>"
        )

    @property
    def name(self) -> str:
        """The file; if there is none, load and number."""
        return self.source.file if self.source else f"{self.load.name} {self.number}"

    @property
    def mirror(self) -> str:
        """The whole mirror: INSTRUME without the number of a single segment."""
        return whole_mirror(self.instrument, self.layout)

    def of_segment(self, number: int) -> Cycle:
        """Return the data of one segment as those of a mirror in one piece.

        Raises
        ------
        UnknownName
            There is no such segment.
        """
        chosen, instrument = self.layout.in_segment(number), f"{self.mirror} segment {number}"
        if chosen.all():
            return replace(self, instrument=instrument)
        (own,) = [segment for segment in self.segments if segment.number == number]
        return replace(
            self,
            instrument=instrument,
            load=replace(self.load, added=own.added, added_error=own.added_error),
            weight=own.weight,
            weight_error=own.weight_error,
            layout=self.layout.part(chosen),
            force=self.force[:, chosen],
            position=None if self.position is None else self.position[:, chosen],
            segments=(),
        )

    @property
    def used_force(self) -> Array:
        """(N_valid, n_enabled) commanded forces of valid rows and enabled actuators [N]."""
        return self.used(self.force, slice(None))

    @cached_property
    def _counting(self) -> NDArray[np.int64] | None:
        """Indices of the valid rows; None if all are valid."""
        return None if self.valid.all() else np.flatnonzero(self.valid)

    def used(self, values: Array, rows: slice | NDArray[np.int64]) -> Array:
        """Return FORCE [N] or POSITION [m] of some of the valid rows, (rows, n_enabled)."""
        chosen = values[rows if self._counting is None else self._counting[rows]]
        return chosen if self.layout.enabled.all() else chosen[:, self.layout.enabled]

    @cached_property
    def used_blocks(self) -> list[slice]:
        """The blocks in which valid rows are taken."""
        return blocks(int(self.valid.sum()), 8 * self.layout.n)

    @property
    def largest_force(self) -> float:
        """Largest commanded force of valid rows and enabled actuators [N]."""
        return float(_largest(self.force, self.layout.enabled)[self.valid].max())

    @cached_property
    def _paired(self) -> NDArray[np.bool_]:
        """(N_valid,) true if the shape of a row is also measured with the opposite sign."""
        code = self.sign[self.valid] * self.shape[self.valid]
        return np.isin(-code, code)

    @cached_property
    def has_opposites(self) -> bool:
        """Whether a shape is measured with both signs, so that their mean is the mirror at rest."""
        return bool(self._paired.any())

    @cached_property
    def paired_rows(self) -> NDArray[np.bool_]:
        """(N_valid,) true for the rows whose mean is the mirror at rest; or for all rows."""
        return self._paired if self.has_opposites else np.ones_like(self._paired)

    @cached_property
    def rest_position(self) -> Array:
        """(n_enabled,) mean reading of each sensor over ``paired_rows`` [m]; 0 without POSITION."""
        return self._rest_and_stroke[0]

    @cached_property
    def stroke(self) -> Array:
        """(n_enabled,) rms of the readings about ``rest_position`` [m]; 0 without POSITION."""
        return self._rest_and_stroke[1]

    @cached_property
    def _rest_and_stroke(self) -> tuple[Array, Array]:
        """Both, in one pass relative to the first row: a large offset costs no digits."""
        n = int(self.layout.enabled.sum())
        if self.position is None:
            return np.zeros(n), np.zeros(n)
        counted = np.stack([self.paired_rows, np.ones(self._paired.size)])
        first, sums, square = self.used(self.position, slice(1))[0], np.zeros((2, n)), np.zeros(n)
        for some in self.used_blocks:
            moved = self.used(self.position, some) - first
            sums += counted[:, some] @ moved
            square += np.einsum("ij,ij->j", moved, moved)
        rest, mean = sums / counted.sum(axis=1)[:, None]
        square = square / self._paired.size - 2.0 * rest * mean + rest**2
        return first + rest, np.sqrt(np.maximum(square, 0.0))


def _largest(values: Array, columns: NDArray[np.bool_]) -> Array:
    """Return (N,) the largest magnitude of some columns in each row; NaN if one is NaN."""
    largest = np.empty(len(values))
    for some in blocks(len(values), 8 * values.shape[1]):
        largest[some] = np.abs(values[some][:, columns]).max(axis=1, initial=0.0)
    return largest


def common_rest(cycles: Sequence[Cycle]) -> Array:
    """Return (n_enabled,) mean readings at rest over cycles [m].

    NaN for a sensor whose zero moved by more than its stroke; for all, if most did.
    """
    whole = [cycle for cycle in cycles if cycle.has_opposites] or cycles
    reference = np.array([cycle.rest_position for cycle in whole])
    stroke = np.sqrt(np.mean([cycle.stroke**2 for cycle in whole], axis=0))
    common = reference[0] + (reference - reference[0]).mean(axis=0)  # equal ones to the last digit
    anew = (np.abs(reference - common) > stroke).any(axis=0)
    return np.where(anew | (anew.mean() > 0.5), np.nan, common)
