"""Figures of tracking: alpha against temperature and time, and the family with who left it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.figures.style import ACCENT, FAINT, INK, STYLE, new_axes
from truenewton.figures.writing import write_drawn
from truenewton.statics.layout import ring_of
from truenewton.tracking.days import YEAR
from truenewton.tracking.law import Tracking

if TYPE_CHECKING:
    from matplotlib.axes import Axes


OUTLYING = "#b2182b"
FEW = 100  # actuators, beyond which single points would fill the page
PERCENT = 1e2
LABEL = {"temperature": "$k$  (% per K)", "drift": r"$d\,/\,\alpha$  (% per year)"}


def plot_temperature(tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Draw how alpha of every actuator varies with temperature, drift taken out.

    A point is one day's alpha over alpha at T0, a line an actuator's law; the band is the family,
    mean and twice its spread. Who left the family stands in red with error bars (E_STAT).
    """
    away = np.array([day.temperature - tracking.temperature for day in tracking.days])
    years = np.array([(day.date - tracking.date) / YEAR for day in tracking.days])
    taken = np.outer(years, tracking.drift / tracking.alpha)
    return _plot_law(
        tracking, "temperature", away, taken, tracking.coefficient, ax,
        lambda x: x + tracking.temperature, "temperature (°C)",
    )  # fmt: skip


def plot_time(tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Draw how alpha of every actuator drifts, temperature taken out; otherwise as with it."""
    years = np.array([(day.date - tracking.date) / YEAR for day in tracking.days])
    away = np.array([day.temperature - tracking.temperature for day in tracking.days])
    taken = np.outer(away, tracking.coefficient) if "temperature" in tracking.effects else 0.0
    span = np.ptp(years) * 365.25
    unit, words = (365.25, "days") if span < 730 else (1.0, "years")
    return _plot_law(
        tracking, "drift", years, taken, tracking.drift / tracking.alpha, ax,
        lambda x: x * unit, f"{words} since {tracking.date:%Y-%m-%d}",
    )  # fmt: skip


def _plot_law(
    tracking: Tracking,
    effect: str,
    x: Array,
    taken: Array | float,
    slope: Array,
    ax: Axes | None,
    shown: Callable[[Array], Array],
    label: str,
) -> Axes:
    alpha = np.array([day.alpha for day in tracking.days])
    error = PERCENT * np.array([day.error for day in tracking.days]) / tracking.alpha
    y = PERCENT * (alpha / tracking.alpha - 1 - taken)
    left = _left(tracking, (effect, "line"))
    on = np.isfinite(tracking.alpha)
    reach = 0.06 * np.ptp(x)
    ends = np.array([x.min() - reach, x.max() + reach])
    family = next(f for f in tracking.families if f.effect == effect)
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.8)
        inside = np.linspace(ends[0], ends[1], 41)
        low = PERCENT * (family.mean * inside - 2 * family.spread * np.abs(inside))
        high = PERCENT * (family.mean * inside + 2 * family.spread * np.abs(inside))
        ax.fill_between(shown(inside), low, high, color=FAINT, alpha=0.35, linewidth=0)
        ax.plot(shown(ends), PERCENT * np.outer(ends, slope[on & ~left]), color=ACCENT,
                linewidth=0.25, alpha=0.6)  # fmt: skip
        if np.count_nonzero(on) <= FEW:
            ax.plot(shown(x), y[:, on & ~left], "o", color=INK, markersize=1.0, alpha=0.6,
                    markeredgewidth=0)  # fmt: skip
        ax.plot(shown(ends), PERCENT * family.mean * ends, color=INK, linewidth=1.0)
        left_end, right_end = shown(ends)
        ax.set_xlim(left_end, right_end + 0.06 * (right_end - left_end))  # room for names
        order = np.argsort(x)
        for one in np.flatnonzero(left):
            ax.plot(shown(ends), PERCENT * slope[one] * ends, color=OUTLYING, linewidth=0.6)
            ax.errorbar(shown(x)[order], y[order, one], yerr=error[order, one], fmt="o",
                        color=OUTLYING, markersize=2.0, elinewidth=0.6, capsize=1.5)  # fmt: skip
            ax.annotate(str(tracking.layout.id[one]), (shown(ends)[1], PERCENT * slope[one]
                        * ends[1]), xytext=(2, 0), textcoords="offset points", fontsize=6.0,
                        va="center", color=OUTLYING)  # fmt: skip
        ax.set_xlabel(label)
        ax.set_ylabel(r"change of $\alpha$ (%)")
        ax.set_title("band: family, mean ± 2 spreads", loc="right", fontsize=6.5, color=INK)
    return ax


def plot_family(tracking: Tracking, effect: str, ax: Axes | None = None) -> Axes:
    """Draw one effect of every actuator, ring by ring, and its family.

    Bars are one standard uncertainty; the band is the family, mean and twice its spread.

    Parameters
    ----------
    tracking
        Whose days determine the effect.
    effect
        'temperature' or 'drift'.
    ax
        Axes to draw on; their own unless given.
    """
    errors, layout = tracking.errors, tracking.layout
    values = tracking.coefficient if effect == "temperature" else tracking.drift / tracking.alpha
    error = errors[1] if effect == "temperature" else errors[2] / tracking.alpha
    left = _left(tracking, (effect, "line"))
    family = next(f for f in tracking.families if f.effect == effect)
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.75)
        ring = ring_of(layout)
        order = np.argsort(ring, kind="stable")
        place = np.arange(1, layout.n + 1)
        band = PERCENT * np.array(
            [family.mean - 2 * family.spread, family.mean + 2 * family.spread]
        )
        ax.axhspan(*band, color=FAINT, alpha=0.35, linewidth=0)
        ax.axhline(PERCENT * family.mean, color=INK, linewidth=0.8)
        few = layout.n <= FEW
        for some, colour in ((~left, ACCENT), (left, OUTLYING)):
            at = some[order]
            ax.errorbar(place[at], PERCENT * values[order][at], yerr=PERCENT * error[order][at],
                        fmt="o", color=colour, ecolor=INK if colour == ACCENT else colour,
                        markersize=1.8 if few else 1.0, elinewidth=0.5,
                        capsize=1.2 if few else 0.0)  # fmt: skip
        for edge in np.flatnonzero(np.diff(ring[order])) + 1.5:
            ax.axvline(edge, color=FAINT, linewidth=0.5, linestyle=":", zorder=0)
        for where in np.flatnonzero(left[order]):
            name = str(layout.id[order][where])
            ax.annotate(name, (place[where], PERCENT * values[order][where]), xytext=(3, 0),
                        textcoords="offset points", fontsize=6.0, va="center",
                        color=OUTLYING)  # fmt: skip
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        ax.margins(y=0.12)
        ax.set_xlabel("actuator, ring by ring from the centre")
        ax.set_ylabel(LABEL[effect])
        ax.set_title("bars: 1σ; band: family, mean ± 2 spreads", loc="right", fontsize=6.5,
                     color=INK)  # fmt: skip
    return ax


def write_tracking_figures(
    tracking: Tracking, folder: str | os.PathLike[str], *, overwrite: bool = False
) -> list[Path]:
    """Write the figures as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    figures: dict[str, Callable[[], Axes]] = {}
    if "temperature" in tracking.effects:
        figures["track-temperature"] = lambda: plot_temperature(tracking)
        figures["track-family-temperature"] = lambda: plot_family(tracking, "temperature")
    if "drift" in tracking.effects:
        figures["track-time"] = lambda: plot_time(tracking)
        figures["track-family-drift"] = lambda: plot_family(tracking, "drift")
    return write_drawn(figures, folder, overwrite=overwrite)


def _left(tracking: Tracking, kinds: tuple[str, ...]) -> NDArray[np.bool_]:
    gone = [one.actuator for one in tracking.outliers if one.effect in kinds]
    return np.isin(tracking.layout.id, gone)
