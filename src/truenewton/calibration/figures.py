"""Figures of a calibration (paper, figs. 5 and 6), and all of them as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from truenewton.arrays import Array
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.figures.maps import (
    ALPHA_LABEL,
    mark_rings,
    name_point,
    name_rings,
    numbers_by_ring,
    plot_layout,
    plot_map,
)
from truenewton.figures.style import ACCENT, CURVES, INK, NAMED, legend_above, styled_axes
from truenewton.figures.writing import write_drawn
from truenewton.records.parts import by_number
from truenewton.statics.layout import Layout


class HasColumns(Protocol):
    """A calibration, of one body or of several segments."""

    @property
    def layout(self) -> Layout:
        """The actuators."""

    def column(self, name: str, /) -> Array:
        """Return (n,) a quantity of the actuators."""


def plot_actuators(calibration: HasColumns, ax: Axes | None = None) -> Axes:
    """Draw alpha per actuator, ring by ring, with error bars (paper, fig. 5).

    The bars are three standard uncertainties from the readings (3 E_STAT), as in the paper. The
    error of the common scale, which moves all points together, is in the title. A figure of its own
    has a second panel with the errors (`plot_errors`), since bars may be smaller than the symbols.
    """
    own = ax is None
    with styled_axes(ax, 1.2 if own else 0.75) as ax:
        layout, alpha = calibration.layout, calibration.column("alpha")
        numbers, few = numbers_by_ring(layout), layout.n <= NAMED
        error = 3 * calibration.column("statistical_error")
        ax.errorbar(
            numbers, alpha, yerr=error, fmt="o", color=ACCENT, ecolor=INK,
            markersize=1.8 if few else 1.0, elinewidth=0.6, capsize=1.5 if few else 0.0,
        )  # fmt: skip
        mark_rings(ax, layout)
        name_rings(ax, layout)
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        for extreme in (np.nanargmin(alpha), np.nanargmax(alpha)):
            name_point(ax, layout.id[extreme], numbers[extreme], alpha[extreme])
        ax.set_ylabel(ALPHA_LABEL)
        ax.margins(y=0.16)  # names of the rings stand in it
        note = "bars: 3σ, readings"
        every: Mapping[int, Any] = by_number(calibration)
        if {one.scale for one in every.values()} != {Scale.MEAN_ONE}:
            scale = typical(calibration.column("systematic_error"), alpha)
            note += f"; common scale ±{100 * scale:.1f} % (1σ)"
        else:
            note += f"; scale: {Scale.MEAN_ONE}"
        ax.set_title(note)
        if own:
            panels = ax.figure.add_gridspec(2, 1, height_ratios=(3, 2))
            ax.set_subplotspec(panels[0])
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
            plot_errors(calibration, ax.figure.add_subplot(panels[1], sharex=ax))
            ax.figure.align_ylabels()
    return ax


def plot_errors(calibration: HasColumns, ax: Axes | None = None) -> Axes:
    """Draw the errors of alpha per actuator, ring by ring, relative to alpha.

    E_SYST from the weights and E_STAT from the readings at one sigma, E_CYCLE from the scatter of
    the cycles at three, as in the paper. Errors that are unknown or zero are left out.
    """
    with styled_axes(ax, 0.6) as ax:
        c, few = calibration, calibration.layout.n <= NAMED
        alpha = np.abs(c.column("alpha"))
        for name, error, mark, colour in (
            ("E_SYST, 1σ", c.column("systematic_error"), "_", CURVES[4]),
            ("E_CYCLE, 3σ", c.column("cycle_error"), "s", CURVES[1]),
            ("E_STAT, 1σ", c.column("statistical_error"), "o", CURVES[0]),
        ):
            known = error > 0.0  # false of NaN, too
            if known.any():
                ax.semilogy(
                    numbers_by_ring(c.layout)[known], 100 * (error / alpha)[known], mark,
                    color=colour, markersize=2.0 if few else 1.0, markerfacecolor="none",
                    markeredgewidth=0.6, label=name,
                )  # fmt: skip
        mark_rings(ax, c.layout)
        ax.set_ylabel(r"error of $\alpha$ (%)")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        if ax.lines:
            legend_above(ax)
    return ax


def write_figures(
    calibration: HasColumns,
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
        Write alpha at each actuator of figure 6 instead of its name.
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
        "fig6-alpha-map": lambda: plot_map(
            calibration.layout, calibration.column("alpha"), numbers=numbers
        ),
        **(more or {}),
    }
    return write_drawn(figures, folder, overwrite=overwrite)
