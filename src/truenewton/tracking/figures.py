"""Figures of tracking: alpha against temperature and time; coefficients and their population."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.figures.maps import mark_rings, name_point, numbers_by_ring
from truenewton.figures.style import (
    ACCENT,
    ALARM,
    BY_RING,
    FAINT,
    INK,
    NAMED,
    legend_above,
    styled_axes,
)
from truenewton.tracking.days import YEAR
from truenewton.tracking.law import Tracking

PERCENT = 1e2
LABEL = {"temperature": "k (% per K)", "drift": "d / α (% per year)"}


def plot_law(tracking: Tracking, effect: str, ax: Axes | None = None) -> Axes:
    """Draw how alpha of every actuator varies with one effect, after the other is corrected.

    A point is alpha of one day over alpha at T0 and t0, a line the law of an actuator, the band the
    population: mean and twice its spread. Outliers are red with bars of 1 sigma (E_STAT).
    """
    t = tracking
    away = np.array([day.temperature - t.temperature for day in t.days])
    years = np.array([(day.date - t.date) / YEAR for day in t.days])
    if effect == "temperature":
        x, slope, other = away, t.coefficient, np.outer(years, t.drift / t.alpha)
        origin, unit, label = t.temperature, 1.0, "temperature (°C)"
    else:
        x, slope = years, t.drift / t.alpha
        other = np.outer(away, t.coefficient) if "temperature" in t.effects else np.zeros(1)
        unit, name = (365.25, "days") if np.ptp(x) * 365.25 < 730 else (1.0, "years")
        origin = 0.0
        label = f"{name} since {t.date:%Y-%m-%d}"
    alpha = np.array([day.alpha for day in t.days])
    error = PERCENT * np.array([day.error for day in t.days]) / t.alpha
    y = PERCENT * (alpha / t.alpha - 1 - other)
    outlying = _outlying(t, effect)
    on = np.isfinite(t.alpha)
    reach = 0.06 * np.ptp(x)
    ends = np.array([x.min() - reach, x.max() + reach])
    population = next(f for f in t.populations if f.effect == effect)
    shown_x, shown_ends = origin + unit * x, origin + unit * ends
    with styled_axes(ax, 0.8) as ax:
        inside = np.linspace(ends[0], ends[1], 41)
        low = PERCENT * (population.mean * inside - 2 * population.spread * np.abs(inside))
        high = PERCENT * (population.mean * inside + 2 * population.spread * np.abs(inside))
        ax.fill_between(origin + unit * inside, low, high, color=FAINT, alpha=0.35, linewidth=0,
                        label="mean ± 2 spreads")  # fmt: skip
        few = np.count_nonzero(on) <= NAMED
        lines = ax.plot(shown_ends, PERCENT * np.outer(ends, slope[on & ~outlying]),
                        color=ACCENT, linewidth=0.25, alpha=0.6 if few else 0.15)  # fmt: skip
        for line in lines[:1]:
            line.set_label("law of an actuator")
        if few:
            ax.plot(shown_x, y[:, on & ~outlying], "o", color=INK, markersize=1.0, alpha=0.6,
                    markeredgewidth=0)  # fmt: skip
            ax.plot([], [], "o", color=INK, markersize=2.0, label="α of a day")
        ax.plot(shown_ends, PERCENT * population.mean * ends, color=INK, linewidth=1.0,
                label="mean")  # fmt: skip
        first, last = shown_ends
        ax.set_xlim(first, last + 0.06 * (last - first))  # room for names
        order = np.argsort(x)
        for k, one in enumerate(np.flatnonzero(outlying)):
            law = PERCENT * slope[one] * ends
            ax.plot(shown_ends, law, color=ALARM, linewidth=0.6)
            ax.errorbar(shown_x[order], y[order, one], yerr=error[order, one], fmt="o",
                        color=ALARM, markersize=2.0, elinewidth=0.6, capsize=1.5,
                        label=None if k else "outlier, ±σ_stat")  # fmt: skip
            name_point(ax, t.layout.id[one], last, law[-1], 2, color=ALARM)
        ax.set_xlabel(label)
        ax.set_ylabel("change of α (%)")
        legend_above(ax)
    return ax


def plot_population(tracking: Tracking, effect: str, ax: Axes | None = None) -> Axes:
    """Draw one effect of every actuator by ring, with bars of 1 sigma, and its population."""
    errors, layout = tracking.errors, tracking.layout
    values = tracking.coefficient if effect == "temperature" else tracking.drift / tracking.alpha
    error = errors[1] if effect == "temperature" else errors[2] / tracking.alpha
    outlying = _outlying(tracking, effect)
    population = next(f for f in tracking.populations if f.effect == effect)
    with styled_axes(ax, 0.75) as ax:
        numbers = numbers_by_ring(layout)
        low, high = population.mean - 2 * population.spread, population.mean + 2 * population.spread
        ax.axhspan(PERCENT * low, PERCENT * high, color=FAINT, alpha=0.35, linewidth=0,
                   label="population, mean ± 2 spreads")  # fmt: skip
        ax.axhline(PERCENT * population.mean, color=INK, linewidth=0.8)
        few = layout.n <= NAMED
        for some, colour, name in (
            (~outlying & np.isfinite(values), ACCENT, "actuator ±1σ"),
            (outlying, ALARM, "outlier ±1σ"),
        ):
            if some.any():
                ax.errorbar(numbers[some], PERCENT * values[some], yerr=PERCENT * error[some],
                            fmt="o", color=colour, ecolor=FAINT if colour == ACCENT else colour,
                            markersize=1.8 if few else 1.0, label=name,
                            elinewidth=0.5 if layout.n < BY_RING else 0.3)  # fmt: skip
        mark_rings(ax, layout)
        for k in np.flatnonzero(outlying):
            name_point(ax, layout.id[k], numbers[k], PERCENT * values[k], 3, color=ALARM)
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        ax.margins(y=0.12)
        ax.set_ylabel(LABEL[effect])
        legend_above(ax)
    return ax


def tracking_figures(tracking: Tracking) -> dict[str, Callable[..., Axes]]:
    """Return functions that draw each figure, by name; they take axes or make their own."""
    figures: dict[str, Callable[..., Axes]] = {}
    for effect in tracking.effects:
        name = "time" if effect == "drift" else effect
        figures[f"track-{name}"] = partial(plot_law, tracking, effect)
        figures[f"track-population-{effect}"] = partial(plot_population, tracking, effect)
    return figures


def _outlying(tracking: Tracking, effect: str) -> NDArray[np.bool_]:
    """Return (n,) actuators that are outliers by the effect, or lie on no line."""
    left = [one.actuator for one in tracking.outliers if one.effect in (effect, "line")]
    return np.isin(tracking.layout.id, left)
