"""A measured stiffness matrix: commanded force per displacement of each sensor."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, freeze, rms
from truenewton.errors import FormatError
from truenewton.quantities import MAX_MAGNITUDE, Quantity, convert_quantities
from truenewton.records.cycle import Source, check_date, whole_mirror
from truenewton.statics.layout import Layout

DISPLACED = ("read", "true")
# Elements between segments that are more than noise: they are reciprocal, which noise is not, or
# their rms is large relative to that of a segment's own elements; or they are only rounding.
MIN_RECIPROCITY = 6.0  # standard deviations
MAX_RELATIVE_RMS, ROUNDING = 0.3, 1e-9
MIN_ELEMENT = 1e-30  # an element below it is 0 [N/m]: squares of what remains stay above zero


@dataclass(frozen=True, eq=False)
class StoredAs:
    """How the file that was imported stores the matrix, to write others for the same electronics.

    Attributes
    ----------
    factor
        N/m of one unit of the file; negative if the file has the opposite sign.
    unit
        That of the file; '' if it is unknown.
    transposed
        Whether rows of the file are sensors.
    rows, size
        (n,) row of each actuator in the file, from 0; the number of rows of the file.
    """

    factor: float
    unit: str
    transposed: bool
    rows: NDArray[np.int64]
    size: int

    def __post_init__(self) -> None:
        rows = np.asarray(self.rows)
        if not (np.isfinite(self.factor) and self.factor):
            raise FormatError(f"STORFACT is {self.factor}", remedy="import the matrix again")
        if np.unique(rows).size != rows.size or not ((rows >= 0) & (rows < self.size)).all():
            raise FormatError(
                f"ROW of ACTUATORS does not number rows of a matrix of {self.size}",
                remedy="import the matrix again",
            )

    def array(self, stiffness: Array) -> Array:
        """Return an (n, n) matrix [N/m] as the file stores it, (size, size); 0 for other rows."""
        whole = np.zeros((self.size, self.size))
        whole[np.ix_(self.rows, self.rows)] = stiffness / self.factor
        return whole.T if self.transposed else whole


@dataclass(frozen=True, eq=False, repr=False)
class StiffnessMatrix:
    """A measured stiffness or feed-forward matrix (docs/files.md).

    Attributes
    ----------
    instrument, date
        INSTRUME; when it was measured (UTC).
    layout
        The n actuators.
    stiffness
        (n, n) commanded force of actuator i per displacement of sensor j [N/m]; a Quantity is
        converted.
    source
        The file, or None.
    displaced
        'read' if displacements are sensor readings, 'true' if they are corrected for the sensors.
    mirror
        The known mirror that the positions are from, or None.
    stored
        How the file stores it that was imported; None of others.
    coupling
        Of a segment that is coupled to others by more than noise: the rms of the elements between
        it and them, and of its own elements [N/m]; otherwise None.

    Examples
    --------
    >>> date = datetime.datetime(2026, 11, 22, tzinfo=datetime.UTC)
    >>> tn.StiffnessMatrix("P45", date, layout, truth.stiffness)
    <StiffnessMatrix of P45: 45 actuators>
    """

    QUANTITIES: ClassVar = {"stiffness": Quantity("N/m")}

    instrument: str
    date: datetime.datetime
    layout: Layout
    stiffness: Array
    source: Source | None = None
    displaced: str = "read"
    mirror: str | None = None
    stored: StoredAs | None = None
    coupling: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_date(self.date)
        if self.displaced not in DISPLACED:
            raise FormatError(
                f"DISPLACE is '{self.displaced}'",
                remedy=f"give {' or '.join(map(repr, DISPLACED))}, or leave it out",
            )
        convert_quantities(self)
        freeze(self, "stiffness")
        sizes = np.abs(self.stiffness)
        tiny = sizes < MIN_ELEMENT
        if (tiny & (sizes > 0.0)).any():
            object.__setattr__(self, "stiffness", np.where(tiny, 0.0, self.stiffness))
            freeze(self, "stiffness")
        n = self.layout.n
        if self.stiffness.shape != (n, n):
            raise FormatError(
                f"STIFFNESS is {' x '.join(map(str, self.stiffness.shape))} for {n} actuators",
                remedy=f"give an image of {n} x {n}",
            )
        if self.stored is not None and len(self.stored.rows) != n:
            raise FormatError("ROW is not one number for each actuator", remedy="import it again")
        counted = self.used_stiffness
        if not np.isfinite(counted).all() or np.abs(counted).max(initial=0.0) > MAX_MAGNITUDE:
            raise FormatError("STIFFNESS contains NaN, inf or absurd values", remedy="correct them")
        if not np.abs(counted).max(initial=0.0) > 1e-9:
            raise FormatError(
                "STIFFNESS is zero throughout, or next to it", remedy="measure it; in N/m"
            )

    def __repr__(self) -> str:
        return f"<StiffnessMatrix of {self.instrument}: {self.layout.n} actuators>"

    @property
    def used_stiffness(self) -> Array:
        """(n_enabled, n_enabled) stiffness between the actuators that are enabled [N/m]."""
        on = self.layout.enabled
        return np.asarray(self.stiffness[np.ix_(on, on)])

    def of_segment(self, number: int) -> StiffnessMatrix:
        """Return the stiffness of one segment as that of a mirror in one piece.

        Raises
        ------
        UnknownName
            There is no such segment.
        """
        chosen = self.layout.in_segment(number)
        instrument = f"{whole_mirror(self.instrument, self.layout)} segment {number}"
        if chosen.all():
            return replace(self, instrument=instrument)
        return replace(
            self,
            instrument=instrument,
            layout=self.layout.part(chosen),
            stiffness=self.stiffness[np.ix_(chosen, chosen)],
            stored=None,
            coupling=self._coupling_of(chosen),
        )

    def _coupling_of(self, chosen: NDArray[np.bool_]) -> tuple[float, float] | None:
        """Return the rms of the elements between a segment and others, and of its own elements.

        None if they are noise. Segments do not touch, so elements between them should be noise:
        neither reciprocal (Maxwell-Betti) nor as large as the segment's own.
        """
        own, others = self.layout.enabled & chosen, self.layout.enabled & ~chosen
        if not (own.any() and others.any()):
            return None
        usual = rms(self.stiffness[np.ix_(own, own)])
        there = self.stiffness[np.ix_(others, own)]
        back = self.stiffness[np.ix_(own, others)].T
        size = max(rms(there), rms(back))
        if not size > ROUNDING * usual:
            return None
        alike = float(np.mean(there * back)) / max(rms(there) * rms(back), 1e-300)
        joined = alike * np.sqrt(there.size) > MIN_RECIPROCITY or size > MAX_RELATIVE_RMS * usual
        return (size, usual) if joined else None
