"""Figures of a calibration (paper, figs. 5 and 6), and all of them as files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from truenewton.calibration.result import Calibration
from truenewton.estimation.estimate import Scale
from truenewton.estimation.weights import typical
from truenewton.figures.maps import (
    ALPHA_LABEL,
    mark_rings,
    name_point,
    numbers_by_ring,
    plot_layout,
    plot_map,
)
from truenewton.figures.style import ACCENT, INK, NAMED, styled_axes
from truenewton.figures.writing import write_drawn


def plot_actuators(calibration: Calibration, ax: Axes | None = None) -> Axes:
    """Draw alpha per actuator, ring by ring, with error bars (paper, fig. 5).

    The bars are three standard uncertainties from the readings (3 E_STAT), the paper's level. The
    error of the common scale moves all points together: it stands above.
    """
    with styled_axes(ax, 0.75) as ax:
        layout, alpha = calibration.layout, calibration.alpha
        numbers, few = numbers_by_ring(layout), layout.n <= NAMED
        ax.errorbar(
            numbers, alpha, yerr=3 * calibration.reading_error, fmt="o", color=ACCENT, ecolor=INK,
            markersize=1.8 if few else 1.0, elinewidth=0.6, capsize=1.5 if few else 0.0,
        )  # fmt: skip
        mark_rings(ax, layout)
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        for extreme in (np.nanargmin(alpha), np.nanargmax(alpha)):
            name_point(ax, layout.id[extreme], numbers[extreme], alpha[extreme])
        ax.set_ylabel(ALPHA_LABEL)
        ax.margins(y=0.12)
        note = "bars: 3σ, readings"
        if calibration.scale != Scale.MEAN_ONE:
            scale = typical(calibration.systematic_error, alpha)
            note += f"; common scale ±{100 * scale:.1f} % (1σ)"
        else:
            note += f"; scale: {calibration.scale}"
        ax.set_title(note)
    return ax


def write_figures(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    more: Mapping[str, Callable[[], Axes]] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write figures 2, 5 and 6, and more by name, as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    figures: dict[str, Callable[[], Axes]] = {
        "fig2-actuators": lambda: plot_layout(calibration.layout),
        "fig5-alpha": lambda: plot_actuators(calibration),
        "fig6-alpha-map": lambda: plot_map(calibration.layout, calibration.alpha),
        **(more or {}),
    }
    return write_drawn(figures, folder, overwrite=overwrite)
