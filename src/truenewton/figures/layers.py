"""A quantity of all actuators, for maps and tables; the map of the actuators (paper, fig. 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.figures.maps import (
    bears_names,
    draw_dots,
    draw_frame,
    name_outside,
)
from truenewton.figures.style import (
    ALARM,
    COLOURS,
    CROWDED,
    DIVERGING,
    FAINT,
    INK,
    MILLIMETRE,
    NAMED,
    styled_axes,
)
from truenewton.rounding import percent, significant, with_error
from truenewton.statics.layout import Layout

FAR = 5.0  # spreads from the median: an outlier, as in the verdict
MAX_OUTLIERS = 8  # named on a map


@dataclass(frozen=True, eq=False)
class Layer:
    """One quantity of all actuators."""

    key: str  # for programs
    name: str  # for people
    unit: str  # '' without one
    values: Array  # (n,), NaN if unknown
    meaning: str  # one sentence
    errors: Array | None = None  # (n,) to which the values are rounded; two digits if None
    centre: float = float("nan")  # white of the colours, if they are for both sides of a value
    own_errors: Array | None = None  # (n,) without what is common to all; None: the errors
    reach: float = float("nan")  # from the centre to the ends of the colours; NaN: from the values

    @property
    def diverging(self) -> bool:
        """Whether colours are for both sides of a value."""
        return bool(np.isfinite(self.centre))

    @property
    def title(self) -> str:
        """Name, with the symbol of alpha, and unit."""
        name = self.name.replace("alpha", "α")
        if not self.unit:
            return name
        return f"{name}, {self.unit}" if name.endswith(")") else f"{name} ({self.unit})"

    @property
    def texts(self) -> tuple[str, ...]:
        """(n,) the values as text."""
        if self.errors is not None:
            return tuple(map(with_error, self.values.tolist(), self.errors.tolist()))
        if (self.values % 1 == 0).all():
            return tuple(f"{value:.0f}" for value in self.values.tolist())
        sign = "+" if self.centre == 0.0 else ""
        values = self.values.tolist()
        return tuple((sign if value > 0 else "") + significant(value) for value in values)

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colours, clipped at the outer 1 % at each end of more than 100 actuators.

        Diverging colours leave outliers out: one reversed coil would make all others equal.
        """
        inner = np.delete(self.values, self.outliers) if self.diverging else self.values
        known = inner[np.isfinite(inner)]
        low, high = np.percentile(known, [1.0, 99.0] if known.size > 100 else [0.0, 100.0])
        if self.diverging:
            own = max(high - self.centre, self.centre - low)
            reach = self.reach if np.isfinite(self.reach) else own
            low, high = self.centre - reach, self.centre + reach
        if high > low:
            return float(low), float(high)
        aside = 0.1 * abs(float(low)) or 1.0
        return float(low) - aside, float(low) + aside

    @property
    def outliers(self) -> NDArray[np.int64]:
        """(k,) indices of at most 8 outliers: farther from the median than 5 times the spread."""
        apart = np.abs(self.values - np.nanmedian(self.values))
        spread = 1.4826 * np.nanmedian(apart)
        if (errors := self.errors if self.own_errors is None else self.own_errors) is not None:
            spread = np.hypot(spread, errors)
        least = 1e-9 * np.nanmax(np.abs(self.values)) or 1.0  # of equal values, rounded
        ratio = np.nan_to_num(apart / np.maximum(spread, least))
        farthest = np.argsort(-ratio, kind="stable")[:MAX_OUTLIERS]
        return np.asarray(farthest[ratio[farthest] > FAR])

    def colour_note(self, low: float, high: float) -> str:
        """Return what the colours between two ends do not show: their centre, what is beyond."""
        notes = [f"White: {significant(self.centre, 3)}."] if self.diverging else []
        with np.errstate(invalid="ignore"):
            beyond = int(((self.values < low) | (self.values > high)).sum())
        if beyond:
            share = percent(beyond / np.isfinite(self.values).sum())
            notes.append(f"Beyond the ends: {beyond} ({share}).")
        return " ".join(notes)

    def plot(
        self,
        layout: Layout,
        ax: Axes | None = None,
        *,
        cmap: str | None = None,
        vmin: float | None = None,
        vmax: float | None = None,
        annotate: bool = False,
    ) -> Axes:
        """Draw it on the map of the actuators (paper, fig. 6); return the axes.

        Up to a hundred actuators have their IDs, if dots have room; with ``annotate`` also their
        values. Outliers have a red rim, and their IDs beside a map of more. An actuator without a
        value (disabled) is an open circle.
        """
        low, high = self.limits
        low, high = low if vmin is None else vmin, high if vmax is None else vmax
        colours = cmap or (DIVERGING if self.diverging else COLOURS)
        with styled_axes(ax, 1.14) as ax:
            draw_frame(layout, ax)
            known = np.isfinite(self.values)
            draw_dots(ax, layout, ~known, facecolor="none", edgecolor=FAINT, linewidth=0.6)
            red = np.isin(np.flatnonzero(known), self.outliers)
            rim = 0.3 if layout.n <= CROWDED else 0.0
            dots = draw_dots(ax, layout, known, cmap=colours, clim=(low, high),
                             edgecolor=np.where(red, ALARM, INK),
                             linewidth=np.where(red, 1.5, rim))  # fmt: skip
            dots.set_array(self.values[known])
            below, above = np.nanmin(self.values) < low, np.nanmax(self.values) > high
            ends = ("neither", "max", "min", "both")[2 * int(below) + int(above)]
            bar = ax.figure.colorbar(
                dots, ax=ax, orientation="horizontal", fraction=0.05, pad=0.02, aspect=35,
                extend=ends,
            )  # fmt: skip
            note = self.colour_note(low, high)
            bar.set_label(f"{self.title}\n{note}" if note else self.title)
            bar.outline.set_linewidth(0.4)
            bar.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
            bar.formatter = ScalarFormatter(useOffset=False)
            bar.formatter.set_scientific(False)  # a power of ten would cover the label
            if bears_names(layout) or (annotate and layout.n <= NAMED):
                self._write_names(ax, layout, dots, annotate=annotate)
            else:
                name_outside(ax, layout, self.outliers)
        return ax

    def _write_names(
        self, ax: Axes, layout: Layout, dots: PatchCollection, *, annotate: bool
    ) -> None:
        """Write on the dots the IDs, and the values if they are annotated."""
        for name, x, y, value in zip(layout.id, layout.x, layout.y, self.values, strict=True):
            known = np.isfinite(value)
            light = np.dot(dots.to_rgba(value)[:3], [0.299, 0.587, 0.114])
            text = f"{name}\n{significant(value, 3)}" if annotate and known else str(name)
            ax.text(x / MILLIMETRE, y / MILLIMETRE, text, ha="center", va="center",
                    fontsize=4.0 if annotate else 5.0, linespacing=1.0,
                    color=FAINT if not known else INK if light > 0.5 else "white")  # fmt: skip
