"""How alpha of a mirror in several segments varies: a law for each, and all of them together."""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truenewton.arrays import Array
from truenewton.files.fits import write_fits
from truenewton.files.format import quantities
from truenewton.records.of_segments import OfSegments
from truenewton.tracking.law import DayRecord, Tracking

if TYPE_CHECKING:
    from astropy.table import QTable


@dataclass(frozen=True, eq=False, repr=False)
class SegmentedTracking(OfSegments[Tracking]):
    """The laws of all segments, each tracked by itself.

    Arrays over actuators are in the order of ``layout``, NaN where a segment gave no law.

    Attributes
    ----------
    instrument
        The mirror.
    layout
        The n actuators of all segments.
    segments
        The law of each segment that gave one, by its number.
    refused
        Why the others did not, each with its remedy, by number.
    """

    @property
    def days(self) -> tuple[DayRecord, ...]:
        """The days of the first segment that gave a law: those of all, with its alpha."""
        return next(iter(self.segments.values())).days

    @property
    def coefficient(self) -> Array:
        """(n,) k [1/K]."""
        return self.of_actuators(lambda law: law.coefficient)

    @property
    def drift(self) -> Array:
        """(n,) d [1/yr], years of 365.25 days."""
        return self.of_actuators(lambda law: law.drift)

    @property
    def scatter(self) -> Array:
        """(n,) from day to day, of the actuator by itself, relative."""
        return self.of_actuators(lambda law: law.scatter)

    @property
    def errors(self) -> Array:
        """(3, n) standard uncertainties of alpha, k and d."""
        return np.stack([self.of_actuators(_error(row)) for row in range(3)])

    @property
    def date(self) -> datetime.datetime:
        """The middle of the first day's data (UTC)."""
        return min(law.days[0].date for law in self.segments.values())

    @property
    def date_end(self) -> datetime.datetime:
        """The middle of the last day's data (UTC)."""
        return max(law.days[-1].date for law in self.segments.values())

    @property
    def table(self) -> QTable:
        """One row per actuator: its segment, alpha, k and d with their errors and units."""
        from truenewton.tracking.file import LAW

        return quantities(self, LAW, without=("X", "Y", "NZ", "ENABLED"))

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the tracking file of all segments (docs/files.md).

        Raises
        ------
        OutputExists, OutputFailed
        """
        from truenewton.tracking.file import SEGMENTED_TRACKING, TRACKING

        write_fits(path, SEGMENTED_TRACKING, self, versions=self.segments, of_version=TRACKING,
                   overwrite=overwrite)  # fmt: skip


def _error(row: int) -> Callable[[Tracking], Array]:
    def of(law: Tracking) -> Array:
        return np.asarray(law.errors[row])

    return of
