"""Figures of a calibration (paper, figs. 5 and 6), and all of them as files.

Its class is in a module that needs this one, so that it is no type here.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from truenewton.calibration.layers import alpha_layer
from truenewton.estimation.findings.estimate import Scale
from truenewton.figures.maps import mark_rings, name_rings, numbers_by_ring, plot_layout
from truenewton.figures.style import (
    ACCENT,
    ALARM,
    ALPHA,
    BY_RING,
    COLUMN,
    CURVES,
    FAINT,
    NAMED,
    legend_above,
    plain_ticks,
    styled_axes,
)
from truenewton.figures.writing import write_drawn


def plot_actuators(calibration: Any, ax: Axes | None = None) -> Axes:
    """Draw alpha per actuator, ring by ring, with error bars (paper, fig. 5).

    The bars are three standard uncertainties from the readings (3 E_STAT), as in the paper, unless
    all are smaller than the symbols. Reversed coils are marked below: they would stretch the axis.
    A figure of its own has a second panel with the errors.
    """
    own = ax is None
    with styled_axes(ax, 1.2 if own else 0.75) as ax:
        layout, every = calibration.layout, calibration.alpha
        alpha = np.where(every > 0.0, every, np.nan)
        numbers, size = numbers_by_ring(layout), 1.8 if layout.n <= NAMED else 1.0
        error = 3 * calibration.statistical_error
        points = 0.35 * 72 * COLUMN / (np.nanmax(alpha) - np.nanmin(alpha))  # for one unit of alpha
        if 2 * points * np.nanmax(error) > size:
            width = 0.6 if layout.n < BY_RING else 0.4
            ax.errorbar(numbers, alpha, yerr=error, fmt="none", ecolor=FAINT, elinewidth=width,
                        label="±3 σ_stat")  # fmt: skip
            label = "α"
        else:
            label = "α; bars of ±3 σ_stat would be smaller than the symbols"
        if calibration.scale == Scale.MEAN_ONE:
            label += "; mean α = 1 by convention"
        ax.plot(numbers, alpha, "o", color=ACCENT, markersize=size, label=label)
        mark_rings(ax, layout)
        name_rings(ax, layout)
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        for extreme, up in ((np.nanargmin(alpha), -1), (np.nanargmax(alpha), 1)):
            ax.annotate(str(layout.id[extreme]), (numbers[extreme], alpha[extreme]),
                        xytext=(0, 3 * up), textcoords="offset points", fontsize=6.0, ha="center",
                        va="bottom" if up > 0 else "top")  # fmt: skip
        for k in np.flatnonzero(every < 0.0):
            ax.plot(numbers[k], 0.03, "v", color=ALARM, markersize=3.0,
                    transform=ax.get_xaxis_transform())  # fmt: skip
            ax.annotate(f"{layout.id[k]}: {every[k]:.2f}", (numbers[k], 0.03), xytext=(3, 0),
                        xycoords=ax.get_xaxis_transform(), textcoords="offset points",
                        fontsize=6.0, va="center", color=ALARM)  # fmt: skip
        ax.set_ylabel(ALPHA)
        ax.margins(y=0.16)  # for the names of rings and extremes
        legend_above(ax)
        if own:
            panels = ax.figure.add_gridspec(2, 1, height_ratios=(3, 2))
            ax.set_subplotspec(panels[0])
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
            plot_errors(calibration, ax.figure.add_subplot(panels[1], sharex=ax))
            ax.figure.align_ylabels()
    return ax


def plot_errors(calibration: Any, ax: Axes | None = None) -> Axes:
    """Draw the errors of alpha per actuator at one sigma, ring by ring, relative to alpha.

    E_SYST from the weights, E_STAT from the readings, and a third of E_CYCLE, which is the paper's
    three sigma of the scatter of the cycles. Errors that are unknown or zero are left out.
    """
    with styled_axes(ax, 0.6) as ax:
        c, size = calibration, 2.0 if calibration.layout.n <= NAMED else 1.0
        alpha = np.abs(c.alpha)
        for name, error, mark, colour in (
            ("σ_scale", c.systematic_error, "_", CURVES[4]),
            ("σ_cycle = E_CYCLE / 3", c.cycle_error / 3, "s", CURVES[1]),
            ("σ_stat", c.statistical_error, "o", CURVES[0]),
        ):
            known = error > 0.0  # false of NaN, too
            if known.any():
                ax.semilogy(
                    numbers_by_ring(c.layout)[known], 100 * (error / alpha)[known], mark,
                    color=colour, markersize=2 * size if mark == "_" else size,
                    markerfacecolor="none", markeredgewidth=0.6, label=name,
                )  # fmt: skip
        mark_rings(ax, c.layout)
        ax.set_ylabel("1σ error of α (%)")
        plain_ticks(ax.yaxis)
        if ax.lines:
            legend_above(ax)
    return ax


def write_figures(
    calibration: Any,
    folder: str | os.PathLike[str],
    *,
    more: Mapping[str, Callable[[], Axes]] | None = None,
    numbers: bool = False,
    overwrite: bool = False,
) -> list[Path]:
    """Write figures 2, 5 and 6, and more by name, as PDF and PNG into a folder; return the paths.

    Parameters
    ----------
    calibration
        The calibration.
    folder
        For the figures; created if it does not exist.
    more
        Further figures by name: functions that draw one and return its axes.
    numbers
        Write alpha, too, at each actuator of figure 6.
    overwrite
        Replace existing figures.

    Raises
    ------
    OutputExists, OutputFailed

    Examples
    --------
    >>> files = tn.write_figures(calibration, "figures", numbers=True)
    >>> [file.name for file in files if file.suffix == ".pdf"]
    ['fig2-actuators.pdf', 'fig5-alpha.pdf', 'fig6-alpha-map.pdf']
    """
    figures: dict[str, Callable[[], Axes]] = {
        "fig2-actuators": lambda: plot_layout(calibration.layout),
        "fig5-alpha": lambda: plot_actuators(calibration),
        "fig6-alpha-map": lambda: alpha_layer(calibration, "alpha", "alpha").plot(
            calibration.layout, annotate=numbers
        ),
        **(more or {}),
    }
    return write_drawn(figures, folder, overwrite=overwrite)
