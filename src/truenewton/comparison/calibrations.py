"""What changed between two calibrations of one mirror, actuator by actuator."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.layers import alpha_layer
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.chance import FALSE_ALARM, normal_isf
from truenewton.errors import CampaignMismatch, OutputFailed, RankDeficient
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.figures.layers import Layer
from truenewton.figures.maps import mark_rings, name_point, numbers_by_ring
from truenewton.figures.style import ACCENT, FAINT, legend_above, on_screen, styled_axes
from truenewton.files.format import Column, TableFormat, quantities
from truenewton.files.outputs import file_beside
from truenewton.records.file import ID, X, Y
from truenewton.records.parts import Parts, has_parts
from truenewton.statics.layout import Layout


def write_table(table: QTable, path: str | os.PathLike[str], *, overwrite: bool) -> None:
    """Write a table of changes; the name ends in .csv, or in .ecsv, which contains units.

    Raises
    ------
    OutputExists, OutputFailed
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".csv", ".ecsv"):
        remedy = "let it end in .csv or .ecsv"
        raise OutputFailed("is no name for a table", remedy=remedy, path=path)
    for column in table.itercols():
        column.info.format = None  # all digits
    with file_beside(path, overwrite=overwrite) as temporary:
        table.write(temporary, format=f"ascii{suffix}")


CHANGE = TableFormat("CHANGE", (ID, X, Y, Column("CHANGE", "relative"), Column("SIGMAS", "sigmas")))


@dataclass(frozen=True, eq=False)
class Change:
    """From one calibration to another, what is common to all actuators taken out.

    Attributes
    ----------
    one, other
        The calibrations.
    ratio, ratio_error
        Median of alpha after over alpha before, and its standard uncertainty; NaN where a scale is
        a convention, and for several segments.
    relative
        (n,) change of alpha beside the ratio, in terms of alpha; NaN where either is disabled.
    sigmas
        (n,) the same in terms of the readings' errors of both (E_STAT), taken as independent.
    limit
        Sigmas that one actuator of all reaches by chance in a hundredth of such comparisons.
    segments
        Of a mirror in several segments the change of each that has alpha in both, by its number.

    Examples
    --------
    >>> tn.compare(calibration, warm).changed
    array([], dtype=int64)
    """

    one: AnyCalibration
    other: AnyCalibration
    ratio: float
    ratio_error: float
    relative: Array
    sigmas: Array
    limit: float
    segments: Mapping[int, Change] = field(default_factory=dict)

    @property
    def layout(self) -> Layout:
        """The actuators."""
        return self.one.layout

    @property
    def changed(self) -> NDArray[np.int64]:
        """(changed,) indices of the actuators beyond the limit, the farthest first."""
        size = np.nan_to_num(np.abs(self.sigmas))
        order = np.argsort(-size, kind="stable")
        return np.asarray(order[size[order] > self.limit])

    @property
    def table(self) -> QTable:
        """The changes of all actuators, with units."""
        return quantities(self, CHANGE)

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the table of changes as .csv, or as .ecsv, which contains units.

        Raises
        ------
        OutputExists, OutputFailed
        """
        write_table(self.table, path, overwrite=overwrite)

    @property
    def layers(self) -> tuple[Layer, ...]:
        """What changed of the actuators, in sigmas first."""
        largest = float(np.nanmax(np.abs(self.sigmas)))
        # Noise shall not look like a change, nor one large change hide the others.
        reach = float(np.clip(largest, self.limit, 3 * self.limit))
        return (
            Layer("sigmas", "change", "sigma", self.sigmas,
                  "Change of alpha beside the common ratio, in terms of the readings' errors.",
                  centre=0.0, reach=reach),
            Layer("relative", "change", "%", 100 * self.relative,
                  "Change of alpha beside the common ratio.", centre=0.0),
            alpha_layer(self.one, "alpha_one", "alpha, first"),
            alpha_layer(self.other, "alpha_other", "alpha, second"),
        )  # fmt: skip

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the change in sigmas on the map of the actuators; return the axes."""
        with on_screen():
            return self.layers[0].plot(self.layout, ax)

    def plot_actuators(self, ax: Axes | None = None) -> Axes:
        """Draw the change in sigmas, ring by ring, and how far chance reaches; return the axes."""
        layout = self.layout
        with on_screen(), styled_axes(ax, 0.75) as ax:
            numbers = numbers_by_ring(layout)
            ax.axhspan(
                -self.limit,
                self.limit,
                color=FAINT,
                alpha=0.2,
                linewidth=0,
                label=f"±{self.limit:.1f} σ_stat: reached by chance in 1 % of comparisons",
            )
            ax.axhline(0.0, color=FAINT, linewidth=0.5)
            ax.plot(numbers, self.sigmas, "o", color=ACCENT, markersize=2.0)
            mark_rings(ax, layout)
            for far in self.changed[:10]:
                name_point(ax, layout.id[far], numbers[far], self.sigmas[far])
            ax.set_ylabel("change of α / σ_stat")
            legend_above(ax)
        return ax


def compare_calibrations(one: AnyCalibration, other: AnyCalibration) -> Change:
    """Compare two calibrations of one mirror; of several segments each by itself.

    With r the median of alpha'/alpha, the change of actuator i is alpha'_i / r - alpha_i, with the
    variance E_STAT_i^2 + (E_STAT'_i / r)^2. The errors of the weights move all alphas together, so
    they are in r and not in the change.

    Parameters
    ----------
    one, other
        Before and after.

    Raises
    ------
    CampaignMismatch
        The calibrations are not of the same actuators.
    RankDeficient
        No segment has alpha in both.
    """
    if has_parts(one) != has_parts(other):
        raise CampaignMismatch(
            "one calibration is of several segments, the other of one body",
            remedy="choose the segment: --segment, or part(...) in Python",
        )
    a, b = one.layout, other.layout
    # Which are enabled may differ, and what was taken for their direction.
    apart = b.other_actuators(a if a.n != b.n else replace(a, nz=b.nz))
    if not apart and a.segments != b.segments:
        apart = "their segments differ"
    both = np.zeros(0, dtype=bool) if apart else a.enabled & b.enabled
    if not both.any():
        raise CampaignMismatch(
            f"the calibrations of {one.instrument} and {other.instrument} are not of the same"
            f" actuators: {apart or 'none is enabled in both'}",
            remedy="compare two calibrations of one mirror",
        )
    parts, ratio, ratio_error = dict[int, Change](), math.nan, math.nan
    if has_parts(one) and has_parts(other):
        for number in one.found.keys() & other.found.keys():
            parts[number] = compare_calibrations(one.found[number], other.found[number])
        if not parts:
            remedy = "look at each file with `info`"
            raise RankDeficient("no segment has alpha in both", remedy=remedy)
        lacking = {number: () for number in one.numbers if number not in parts}
        whole = Parts(one.instrument, a, parts, failed=lacking)
        relative, sigmas = whole.column("relative"), whole.column("sigmas")
    else:
        assert isinstance(one, Calibration)
        assert isinstance(other, Calibration)
        ratio = float(np.median(other.alpha[both] / one.alpha[both]))
        moved = np.where(both, other.alpha / ratio - one.alpha, np.nan)
        error = np.hypot(one.statistical_error, other.statistical_error / ratio)
        if Scale.MEAN_ONE not in (one.scale, other.scale):
            scales = (typical(c.systematic_error, c.alpha) for c in (one, other))
            ratio_error = ratio * math.hypot(*scales)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative, sigmas = moved / one.alpha, moved / error
        sigmas[~np.isfinite(sigmas)] = np.nan
    # Segments are judged at the limit of all actuators together.
    limit = float(normal_isf(FALSE_ALARM / 2 / np.isfinite(relative).sum()))
    segments = {number: replace(parts[number], limit=limit) for number in sorted(parts)}
    return Change(one, other, ratio, ratio_error, relative, sigmas, limit, segments)
