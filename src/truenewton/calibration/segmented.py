"""The calibration of a mirror in several segments: one for each, and all of them together."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.errors import Fault
from truenewton.files.format import quantities
from truenewton.records.of_segments import OfSegments
from truenewton.records.source import Source
from truenewton.rounding import counted, html_table

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes

    from truenewton.calibration.verdict import Verdict


@dataclass(frozen=True, eq=False, repr=False)
class SegmentedCalibration(OfSegments[Calibration]):
    """True Newtons per commanded Newton of all segments, each calibrated by itself.

    Arrays over actuators are in the order of ``layout``, NaN where an actuator is disabled, or its
    segment gave no alpha.

    Attributes
    ----------
    instrument
        The mirror.
    layout
        The n actuators of all segments.
    segments
        The calibration of each segment that gave alpha, by its number.
    refused
        Why the others did not, each with its remedy, by number.

    Examples
    --------
    >>> made = tn.calibrate(tn.SegmentedData(stiffness=both), processes=1)
    >>> {number: one.method for number, one in made.segments.items()}, len(made.refused)
    ({1: 'ml', 2: 'ml'}, 0)
    """

    def __repr__(self) -> str:
        alpha = self.alpha[np.isfinite(self.alpha)]
        return (
            f"{super().__repr__()[:-1]}, {counted(int(alpha.size), 'actuator')},"
            f" alpha {alpha.min():.3g} .. {alpha.max():.3g}>"
        )

    def _repr_html_(self) -> str:
        from truenewton.calibration.segment_words import segment_rows
        from truenewton.calibration.words import warning_lines

        return html_table(repr(self)[1:-1], segment_rows(self), warning_lines(self.verdict.faults))

    @property
    def verdict(self) -> Verdict:
        """That of the segments together; each fault names its segment."""
        from truenewton.calibration.verdict import verdict_on_segments

        return verdict_on_segments(self)

    def without_unusable(self) -> SegmentedCalibration:
        """Return it without the alpha of segments whose verdict is 'rejected'.

        Itself where they all are.
        """
        from truenewton.estimation.findings.code import Level

        judged = {number: one.verdict for number, one in self.segments.items()}
        out = {n: v.faults for n, v in judged.items() if v.level <= Level.REJECTED}
        if not out or len(out) == len(judged):
            return self
        named = {n: (Fault(f"{Level.REJECTED}: {f[0].fault}", f[0].remedy),
                     *(Fault(each.fault, each.remedy) for each in f[1:]))
                 for n, f in out.items()}  # fmt: skip
        kept = {number: one for number, one in self.segments.items() if number not in out}
        return replace(self, segments=kept, refused={**self.refused, **named})

    @property
    def sources(self) -> tuple[Source, ...]:
        """The files that went in, each once."""
        every = (source for one in self.segments.values() for source in one.sources)
        return tuple({source.sha256: source for source in every}.values())

    @property
    def scale(self) -> str:
        """What fixes the common scale, if the same of all segments; else 'several'."""
        scales = {one.scale for one in self.segments.values()}
        return scales.pop() if len(scales) == 1 else "several"

    @property
    def date(self) -> datetime.datetime:
        """When the data begin (UTC)."""
        return min(one.date for one in self.segments.values())

    @property
    def date_end(self) -> datetime.datetime:
        """When they end (UTC)."""
        return max(one.date_end for one in self.segments.values())

    @property
    def error(self) -> Array:
        """(n,) E_ALPHA, the standard uncertainty of alpha, everything included."""
        return self.of_actuators(lambda one: one.error)

    @property
    def reading_error(self) -> Array:
        """(n,) E_STAT, from the noise of the readings."""
        return self.of_actuators(lambda one: one.reading_error)

    @property
    def systematic_error(self) -> Array:
        """(n,) E_SYST, from the weights: of one segment in common."""
        return self.of_actuators(lambda one: one.systematic_error)

    @property
    def cycle_error(self) -> Array:
        """(n,) E_CYCLE, the paper's."""
        return self.of_actuators(lambda one: one.cycle_error)

    @property
    def table(self) -> QTable:
        """One row per actuator: ID, X, Y, SEGMENT, ALPHA and its errors, with units."""
        from truenewton.calibration.segment_file import ALPHA

        table = quantities(self, ALPHA, without=("NZ", "ENABLED"))
        table.meta = {"INSTRUME": self.instrument}
        return table

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw alpha on the map of the actuators (paper, fig. 6); return the axes."""
        from truenewton.figures.maps import plot_map
        from truenewton.figures.style import on_screen

        with on_screen():
            return plot_map(self.layout, self.alpha, ax)

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the calibration in the form that the name ends in (docs/files.md).

        ``.fits`` and ``.fits.gz`` hold all of it, ``.ecsv`` the table with units and the verdict,
        ``.csv`` the table alone, ``.npy`` alpha alone.

        Raises
        ------
        OutputExists, OutputFailed
        """
        from truenewton.calibration.written import write_calibration

        write_calibration(self, path, overwrite=overwrite)
