"""Frozen records of what was measured; nothing here knows how it was measured or what is true."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.files.stored_rows import Rows, StoredRows, blocks, columns_of, largest_in_rows
from truenewton.quantities import Quantity, check_quantities, convert_quantities, mask_of
from truenewton.records.segment import Segment, check_segments, lacks_weights, sums_of
from truenewton.records.source import Source, check_date
from truenewton.rounding import counted
from truenewton.statics.layout import Layout
from truenewton.statics.load import (
    LARGEST_FORCE,
    LEAST_NOISE,
    MIRROR_WEIGHT,
    SMALLEST_FORCE,
    Load,
    check_load,
)

LARGEST_DISPLACEMENT = 1e3  # [m]
ANY_LENGTH = Quantity("m", -np.inf, np.inf)
# The arrays of a cycle and their types.
ARRAYS = {"time": float, "shape": np.int64, "sign": np.int64, "valid": bool, "temperature": float,
          "force": float, "position": float}  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Cycle:
    """One run through all shapes under one load (docs/files.md).

    Quantities are converted; rows with masked numbers of enabled actuators are not valid.

    Attributes
    ----------
    instrument, date, number
        INSTRUME; start (UTC); CYCLE, from 1.
    load
        What hung on the mirror.
    weight, weight_error
        P and its standard uncertainty [N].
    layout
        The n actuators.
    time, shape, sign, valid
        (N,) seconds since ``date``; index of the shape from 1; +1 or -1; false for rows that take
        no part, whatever they hold.
    force
        (N, n) commanded forces c [N]; of a campaign larger than memory `StoredRows`, which
        ``numpy.asarray`` reads.
    temperature, position
        (N,) [deg C] and (N, n) [m], as ``force``; or None.
    coil_gradient, bias_gradient
        COILGRAD [1/m] and BIASGRAD [N/m], or None.
    gap, force_error
        GAP [m] and FORCERR [N], or None.
    source
        The file, or None.
    segments
        Weights of each segment, by its number; none of a mirror in one piece. ``weight`` and the
        added weight of ``load`` are those of all segments together.

    Raises
    ------
    FormatError
        Rows that count hold what they may not.

    Examples
    --------
    >>> cycle = campaign.cycles[0]
    >>> cycle.load.name, cycle.force.shape
    ('bare', (90, 45))
    >>> stronger = dataclasses.replace(cycle, force=0.9 * np.asarray(cycle.force))
    """

    QUANTITIES: ClassVar = MIRROR_WEIGHT | {
        "time": Quantity("s", -1e8, 1e8, "count TIME in seconds from DATE-OBS"),
        "temperature": Quantity(
            "deg_C", -150.0, 150.0,
            "declare the unit of TEMPERATURE, deg_C or K; leave the column out where it was not"
            " measured",
        ),
        "force": Quantity("N", -LARGEST_FORCE, LARGEST_FORCE, "check the unit that FORCE declares"),
        "position": Quantity(
            "m", -LARGEST_DISPLACEMENT, LARGEST_DISPLACEMENT,
            "check the unit that POSITION declares",
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
    force: Rows
    valid: NDArray[np.bool_]
    temperature: Array | None = None
    position: Rows | None = None
    coil_gradient: float | None = None
    bias_gradient: float | None = None
    gap: float | None = None
    force_error: float | None = None
    source: Source | None = None
    segments: tuple[Segment, ...] = ()

    def __post_init__(self) -> None:
        convert_quantities(self)
        self._check_segments()
        self._take_masks()
        for name, dtype in ARRAYS.items():
            if not isinstance(getattr(self, name), StoredRows | None):
                freeze(self, name, dtype=dtype)
        check_date(self.date)
        check_load(self.load)
        check_quantities(self)
        self._check_rows()

    def _take_masks(self) -> None:
        """Mark rows as not valid in which a number that counts is masked."""
        masks = {name: mask_of(getattr(self, name)) for name in ARRAYS if name != "valid"}
        for name, mask in masks.items():
            if mask is not None:
                rows = mask[:, self.layout.enabled].any(axis=1) if mask.ndim == 2 else mask
                object.__setattr__(self, "valid", np.asarray(self.valid, dtype=bool) & ~rows)
                number = np.where(mask, 0, np.asarray(getattr(self, name)))
                object.__setattr__(self, name, number)

    def _check_segments(self) -> None:
        if self.layout.segments and not self.segments:
            raise lacks_weights(self.layout)
        if self.segments:
            check_segments(self.segments, self.layout)
            ordered = tuple(sorted(self.segments)) if self.layout.segments else ()
            own = (self.weight, self.weight_error, self.load.added, self.load.added_error)
            sums = sums_of(self.segments)
            if not np.allclose(own, list(sums.values()), rtol=1e-6, atol=1e-9):
                raise FormatError(
                    "WEIGHT or ADDED is not what all segments weigh together",
                    remedy="give the sums, and of their errors the root of the sum of squares",
                    got=own,
                    want=tuple(sums.values()),
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
                    got=value.shape,
                    want=want,
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
                got=self.force_error,
            )

    def _check_finite(self, name: str, quantity: Quantity) -> None:
        values, largest = getattr(self, name), quantity.high
        counted = self.layout.enabled if values.ndim == 2 else np.ones(1, dtype=bool)
        values = values if values.ndim == 2 else values[:, None]
        for row in np.flatnonzero(~(largest_in_rows(values, counted) <= largest) & self.valid):
            some = values[row][counted]
            wrong = ~(np.abs(some) <= largest)
            bad, of, remedy = some[wrong][0], "", "mark the row as not VALID, or correct it"
            if len(some) > 1:
                of = f" for actuator {self.layout.id[counted][wrong][0]}"
                remedy += "; if it is so in all rows, set ENABLED of the actuator to F"
            if np.isfinite(bad):
                remedy = f"{quantity.why}, or mark the row as not VALID"
            raise FormatError(
                f"{name.upper()} in row {row + 1} is {bad:g}{of}", remedy=remedy, got=bad
            )

    def __repr__(self) -> str:
        return (
            f"<Cycle {self.number} of {self.instrument}, load '{self.load.name}':"
            f" {counted(self.time, 'row')}, {counted(self.layout.n, 'actuator')}>"
        )

    @property
    def name(self) -> str:
        """Its file, or its load and number where it has none."""
        return self.source.file if self.source else f"{self.load.name} {self.number}"

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the segments that it is of, ascending; none where ACTUATORS names none."""
        segment = self.layout.segment
        return () if segment is None else tuple(np.unique(segment).tolist())

    def of_segment(self, number: int) -> Cycle:
        """Return what concerns one segment, which is a mirror in one piece.

        Raises
        ------
        GeometryError, FormatError
            It has no actuator that is enabled, or its readings hold what they may not.
        """
        (own,) = [segment for segment in self.segments if segment.number == number]
        chosen = np.asarray(self.layout.segment) == number
        part = replace(
            self,
            instrument=f"{self.instrument} segment {number}",
            load=replace(self.load, added=own.added, added_error=own.added_error),
            weight=own.weight,
            weight_error=own.weight_error,
            layout=self.layout.part(chosen),
            force=columns_of(self.force, chosen),
            position=None if self.position is None else columns_of(self.position, chosen),
            segments=(),
        )
        if "_rest_and_stroke" in vars(self):  # POSITION is not read again
            own_enabled = chosen[self.layout.enabled]
            vars(part)["_rest_and_stroke"] = tuple(v[own_enabled] for v in self._rest_and_stroke)
        return part

    @property
    def used_force(self) -> Array:
        """(N_valid, n_enabled) commanded forces of the rows and actuators that count [N]."""
        return self.used(self.force, slice(None))

    @cached_property
    def _counting(self) -> NDArray[np.int64] | None:
        """The rows that count; None where all do."""
        return None if self.valid.all() else np.flatnonzero(self.valid)

    def used(self, values: Rows, rows: slice | NDArray[np.int64]) -> Array:
        """Return FORCE [N] or POSITION [m] of some rows that count, (rows, n_enabled)."""
        chosen = values[rows if self._counting is None else self._counting[rows]]
        return chosen if self.layout.enabled.all() else chosen[:, self.layout.enabled]

    def used_blocks(self) -> Iterator[slice]:
        """Cut the rows that count into blocks that are taken at once."""
        return blocks(int(self.valid.sum()), 8 * self.layout.n)

    @property
    def largest_force(self) -> float:
        """Largest magnitude of a commanded force that counts [N]."""
        return float(largest_in_rows(self.force, self.layout.enabled)[self.valid].max())

    @cached_property
    def _paired(self) -> NDArray[np.bool_]:
        """(N_valid,) whether a row has its opposite."""
        code = self.sign[self.valid] * self.shape[self.valid]
        return np.isin(-code, code)

    @property
    def has_opposites(self) -> bool:
        """Whether a shape stands with both signs, so that ``rest_position`` is no displacement."""
        return bool(self._paired.any())

    @property
    def paired_rows(self) -> NDArray[np.bool_]:
        """(N_valid,) the rows that have their opposite: their mean is the mirror at rest.

        All rows where none has one.
        """
        return self._paired if self.has_opposites else np.ones_like(self._paired)

    @property
    def rest_position(self) -> Array:
        """(n_enabled,) mean reading of each sensor over ``paired_rows`` [m]; 0 without POSITION.

        That is the flat mirror, whatever rows are missing.
        """
        return self._rest_and_stroke[0]

    @property
    def stroke(self) -> Array:
        """(n_enabled,) rms distance of the readings from ``rest_position`` [m]; or 0."""
        return self._rest_and_stroke[1]

    @cached_property
    def _rest_and_stroke(self) -> tuple[Array, Array]:
        """Take both in one pass, from the first row on: a zero far off costs no digits."""
        n = int(self.layout.enabled.sum())
        if self.position is None:
            return np.zeros(n), np.zeros(n)
        counted = np.stack([self.paired_rows, np.ones(self._paired.size)])
        first, sums, square = self.used(self.position, slice(1))[0], np.zeros((2, n)), np.zeros(n)
        for some in self.used_blocks():
            moved = self.used(self.position, some) - first
            sums += counted[:, some] @ moved
            square += np.einsum("ij,ij->j", moved, moved)
        rest, mean = sums / counted.sum(axis=1)[:, None]
        square = square / self._paired.size - 2.0 * rest * mean + rest**2
        return first + rest, np.sqrt(np.maximum(square, 0.0))
