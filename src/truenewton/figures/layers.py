"""A quantity of all actuators, for maps and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from truenewton.arrays import Array
from truenewton.figures.maps import plot_map
from truenewton.figures.style import SIGNED_COLOURS
from truenewton.rounding import significant, with_error
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class Layer:
    """One quantity of all actuators."""

    key: str  # for programs
    name: str  # for people
    unit: str  # '' without one
    values: Array  # (n,), NaN if unknown
    meaning: str  # one sentence
    errors: Array | None = None  # (n,) to which the values are rounded; two digits if None
    signed: bool = False  # whether colours are centred on zero
    reach: float = float("nan")  # largest value of the colours, if signed; NaN: from the values

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def texts(self) -> tuple[str, ...]:
        """(n,) the values as text."""
        if self.errors is not None:
            return tuple(map(with_error, self.values.tolist(), self.errors.tolist()))
        sign = "+" if self.signed else ""
        values = self.values.tolist()
        return tuple((sign if value > 0 else "") + significant(value) for value in values)

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colours; of more than 100 actuators the outer 1 % at each end are clipped."""
        if np.isfinite(self.reach):
            return -self.reach, self.reach
        known = self.values[np.isfinite(self.values)]
        low, high = np.percentile(known, [1.0, 99.0] if known.size > 100 else [0.0, 100.0])
        if self.signed:
            high = max(abs(low), abs(high))
            low = -high
        if high > low:
            return float(low), float(high)
        aside = 0.1 * abs(float(low)) or 1.0
        return float(low) - aside, float(low) + aside

    def plot(self, layout: Layout, ax: Axes | None = None) -> Axes:
        """Draw it on the map of the actuators; return the axes."""
        if not self.signed:
            return plot_map(layout, self.values, ax, label=self.title)
        return plot_map(
            layout, self.values, ax, label=self.title, colours=SIGNED_COLOURS, limits=self.limits
        )
