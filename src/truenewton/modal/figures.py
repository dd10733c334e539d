"""Figures of the modal base: modes on the mirror, residual and power, before and after."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from truenewton.figures.maps import circles
from truenewton.figures.style import COLUMN, CURVES, FAINT, INK, SIGNED_COLOURS, STYLE, new_axes
from truenewton.figures.writing import write_drawn
from truenewton.modal.dissipation import Budget
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.words import chosen_modes, least_power, stiffness_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NANOMETRE, MILLINEWTON = 1e-9, 1e-3
ACROSS = 4  # maps of modes beside each other


def plot_modes(base: ModalBase) -> Axes:
    """Draw modes on the map of the actuators, softest first, with their stiffness.

    Colours go from the lowest to the highest displacement of each mode, white where there is none.
    """
    shown = chosen_modes(base.modes.stiffness.size)
    down = -(-len(shown) // ACROSS)
    layout, patches = base.stiffness.layout, circles(base.stiffness.layout)
    reach = 1.2e3 * float(np.hypot(layout.x, layout.y).max())
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(COLUMN, 0.29 * down * COLUMN), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(down, ACROSS, squeeze=False)
        for ax in grid.flat[len(shown) :]:
            ax.set_axis_off()
        for ax, k in zip(grid.flat, shown, strict=False):
            mode = base.modes.modes[:, k]
            dots = PatchCollection(patches, cmap=SIGNED_COLOURS, edgecolor=INK,
                                   linewidth=0.2 if layout.n <= 100 else 0.0)  # fmt: skip
            dots.set_array(mode)
            dots.set_clim(-np.abs(mode).max(), np.abs(mode).max())
            ax.add_collection(dots)
            ax.set_xlim(-reach, reach)
            ax.set_ylim(-reach, reach)
            ax.set_aspect("equal")
            ax.set_axis_off()
            ax.set_title(
                f"{k + 1}: {stiffness_text(base.modes.stiffness[k])}", fontsize=6.0, pad=1.5
            )
    first: Axes = grid[0, 0]
    return first


def plot_residual(base: ModalBase, ax: Axes | None = None) -> Axes:
    """Draw the wavefront that the first N modes of each base leave."""
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.7)
        for cost, colour in zip(base.costs, CURVES, strict=False):
            left = cost.residual[:-1] / NANOMETRE  # all modes leave nothing on the actuators
            ax.loglog(np.arange(1, left.size + 1), left, color=colour, label=cost.base)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
        ax.set_xlabel("number of modes")
        ax.set_ylabel("residual wavefront, rms (nm)")
        ax.legend(frameon=False, fontsize=6.5, loc="lower left")
    return ax


def plot_power(base: ModalBase, limits: Budget, ax: Axes | None = None) -> Axes:
    """Draw the power of the worst coil and the mean, static force included, against modes."""
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.7)
        for cost, colour in zip(base.costs, CURVES, strict=False):
            number = np.arange(1, cost.residual.size + 1)
            power = cost.power
            ax.semilogy(number, power.max(axis=0), color=colour, label=cost.base)
            ax.semilogy(number, power.mean(axis=0), color=colour, linestyle=":")
        ax.set_ylim(bottom=least_power(base))
        if np.isfinite(limits.power):
            ax.axhline(limits.power, color=FAINT, linewidth=0.6, linestyle="--")
        ax.set_xlabel("number of modes")
        ax.set_ylabel("power of a coil (W)")
        ax.set_title("full: the worst coil; dotted: the mean", loc="right", fontsize=6.5, color=INK)
        ax.legend(fontsize=6.5, edgecolor="none", framealpha=1.0)
    return ax


def plot_comparison(found: ModalFindings, ax: Axes | None = None) -> Axes:
    """Draw how far the modes taken with alpha = 1 lie from those with alpha as it is."""
    c = found.comparison
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.7)
        number = np.arange(1, c.rms_angle.size)
        told = ~c.cuts[:-1]
        ax.semilogy(number[told], np.degrees(c.rms_angle[:-1][told]), "o", color=CURVES[0],
                    markersize=1.8, label="rms of the N")  # fmt: skip
        ax.semilogy(c.orders, np.degrees(c.largest_angle), "s", color=CURVES[1], markersize=1.8,
                    markerfacecolor="none", label="largest of the N")  # fmt: skip
        ax.set_xlabel("first N modes")
        ax.set_ylabel(r"angle between spans (°)")
        ax.set_title(r"$\alpha = 1$ against calibrated", loc="right", fontsize=6.5, color=INK)
        ax.legend(frameon=False, fontsize=6.5)
    return ax


def modes_figures(found: ModalFindings, limits: Budget) -> dict[str, Callable[[], Axes]]:
    """Return the figures of the modal base by name."""
    return {
        "modes": lambda: plot_modes(found.after),
        "modes-residual": lambda: plot_residual(found.after),
        "modes-power": lambda: plot_power(found.after, limits),
        "modes-comparison": lambda: plot_comparison(found),
    }


def write_modes_figures(
    found: ModalFindings,
    folder: str | os.PathLike[str],
    limits: Budget,
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Write the figures as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    return write_drawn(modes_figures(found, limits), folder, overwrite=overwrite)
