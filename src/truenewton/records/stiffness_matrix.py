"""A measured stiffness matrix: commanded force per displacement of each sensor."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.quantities import MAX_MAGNITUDE, Quantity, convert_quantities
from truenewton.records.cycle import Source, check_date
from truenewton.statics.layout import Layout

DISPLACED = ("read", "true")
MIN_ELEMENT = 1e-30  # an element below it is 0 [N/m]: squares of what remains stay above zero


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
