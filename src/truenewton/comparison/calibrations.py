"""What changed between two calibrations of one mirror, actuator by actuator."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.layers import alpha_layer
from truenewton.calibration.result import Calibration
from truenewton.chance import FALSE_ALARM, normal_isf
from truenewton.errors import CampaignMismatch
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.figures.layers import Layer
from truenewton.figures.maps import mark_rings, name_point, numbers_by_ring
from truenewton.figures.style import ACCENT, FAINT, legend_above, on_screen, styled_axes
from truenewton.files.format import Column, TableFormat, quantities
from truenewton.records.file import ID, X, Y
from truenewton.records.result import OTHER_FORMATS, OtherFormat, write
from truenewton.statics.layout import Layout


def write_table(c: Any, path: Path) -> None:
    """Write the table of changes as .csv, or as .ecsv, which contains units."""
    table = c.table
    for column in table.itercols():
        column.info.format = None  # all digits
    table.write(path, format=f"ascii{path.suffix.lower()}")


TABLES = {".csv": OtherFormat(write_table), ".ecsv": OtherFormat(write_table)}
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
        a convention.
    relative
        (n,) change of alpha beside the ratio, in terms of alpha; NaN where either is disabled.
    sigmas
        (n,) the same in terms of the readings' errors of both (E_STAT), taken as independent.
    limit
        Sigmas that one actuator of all reaches by chance in a hundredth of such comparisons.

    Examples
    --------
    >>> tn.compare(calibration, warm).changed
    array([], dtype=int64)
    """

    one: Calibration
    other: Calibration
    ratio: float
    ratio_error: float
    relative: Array
    sigmas: Array
    limit: float

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
        write(self, path, overwrite=overwrite)

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


def compare_calibrations(one: Calibration, other: Calibration) -> Change:
    """Compare two calibrations of one mirror.

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
    """
    a, b = one.layout, other.layout
    # Which are enabled may differ, and what was taken for their direction.
    apart = b.other_actuators(a if a.n != b.n else replace(a, nz=b.nz))
    both = np.zeros(0, dtype=bool) if apart else a.enabled & b.enabled
    if not both.any():
        raise CampaignMismatch(
            f"the calibrations of {one.instrument} and {other.instrument} are not of the same"
            f" actuators: {apart or 'none is enabled in both'}",
            remedy="compare two calibrations of one mirror",
        )
    ratio, ratio_error = float(np.median(other.alpha[both] / one.alpha[both])), math.nan
    moved = np.where(both, other.alpha / ratio - one.alpha, np.nan)
    error = np.hypot(one.statistical_error, other.statistical_error / ratio)
    if Scale.MEAN_ONE not in (one.scale, other.scale):
        scales = (typical(c.systematic_error, c.alpha) for c in (one, other))
        ratio_error = ratio * math.hypot(*scales)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative, sigmas = moved / one.alpha, moved / error
    sigmas[~np.isfinite(sigmas)] = np.nan
    limit = float(normal_isf(FALSE_ALARM / 2 / np.isfinite(relative).sum()))
    return Change(one, other, ratio, ratio_error, relative, sigmas, limit)


OTHER_FORMATS[Change] = TABLES
