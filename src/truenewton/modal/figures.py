"""Figures of the modal basis: modes on the mirror, residual and power, before and after."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from truenewton.figures.maps import dot_radius
from truenewton.figures.style import (
    CURVES,
    DIVERGING,
    INK,
    MILLIMETRE,
    NAMED,
    label_line,
    legend_above,
    plain_ticks,
    styled_axes,
)
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import Budget, ModalBase
from truenewton.modal.summary import stiffness_text

NANOMETRE = 1e-9
MAPS_PER_ROW = 4
LINES = ("-", "--", "-.")  # of the bases, whose curves may coincide
MIN_POWER = 1e-5  # on the axis, relative to the largest: that of piston may be nearly 0
MAP_WIDTH, MAP_HEIGHT = 2.3, 2.6  # in units of the radius of a map


def chosen_modes(count: int) -> list[int]:
    """Return the modes to draw: the softest eight, and four more up to the stiffest."""
    more = np.geomspace(8, count, 5)[1:] - 1
    return sorted({*range(min(8, count)), *(round(k) for k in more if count > 8)})


def plot_modes(base: ModalBase, ax: Axes | None = None) -> Axes:
    """Draw modes on the map of the actuators, softest first, with their stiffness."""
    layout, shown = base.stiffness.layout, chosen_modes(base.modes.stiffness.size)
    radius = dot_radius(layout)
    reach = float(np.hypot(layout.x, layout.y).max()) / MILLIMETRE + radius
    down, across = np.divmod(np.arange(len(shown)), MAPS_PER_ROW)
    right, up = MAP_WIDTH * reach * across, -MAP_HEIGHT * reach * down
    rows = down[-1] + 1
    with styled_axes(ax, MAP_HEIGHT * rows / (MAP_WIDTH * MAPS_PER_ROW)) as ax:
        modes = base.modes.modes[:, shown]
        dots = EllipseCollection(
            [2 * radius], [2 * radius], [0.0], units="xy", offset_transform=ax.transData,
            offsets=np.stack([np.add.outer(right, layout.x / MILLIMETRE).ravel(),
                              np.add.outer(up, layout.y / MILLIMETRE).ravel()], axis=1),
            cmap=DIVERGING, edgecolor=INK, linewidth=0.2 if layout.n <= NAMED else 0.0,
            clip_on=False,
        )  # fmt: skip
        dots.set_array((modes / np.abs(modes).max(axis=0)).T.ravel())
        dots.set_clim(-1.0, 1.0)
        ax.add_collection(dots)
        for x, y, k in zip(right, up, shown, strict=True):
            ax.text(x, y + 1.06 * reach, f"{k + 1}: {stiffness_text(base.modes.stiffness[k])}",
                    fontsize=6.0, ha="center", va="bottom")  # fmt: skip
        ax.set_xlim(-0.5 * MAP_WIDTH * reach, (MAPS_PER_ROW - 0.5) * MAP_WIDTH * reach)
        ax.set_ylim((-rows + 0.55) * MAP_HEIGHT * reach, 0.55 * MAP_HEIGHT * reach)
        ax.set_aspect("equal")
        legend = "displacement / largest of the mode: purple -1, brown +1"
        for x, text, side in ((0.0, legend, "left"), (1.0, "seen along -z", "right")):
            ax.text(x, 0.0, text, transform=ax.transAxes, fontsize=6.0, ha=side, va="top")
        ax.set_axis_off()
    return ax


def plot_residual(base: ModalBase, ax: Axes | None = None) -> Axes:
    """Draw the residual wavefront of the first N modes of each basis."""
    with styled_axes(ax, 0.7) as ax:
        for cost, colour, line in zip(base.costs, CURVES, LINES, strict=False):
            left = cost.residual[:-1] / NANOMETRE  # without the last, which is 0
            ax.loglog(np.arange(1, left.size + 1), left, line, color=colour, label=cost.base)
        plain_ticks(ax.xaxis, ax.yaxis)
        ax.set_xlabel("number of modes N")
        ax.set_ylabel("residual wavefront, rms (nm)")
        legend_above(ax)
    return ax


def plot_power(base: ModalBase, limits: Budget, ax: Axes | None = None) -> Axes:
    """Draw the power of the worst coil and the mean, static force included, against modes."""
    with styled_axes(ax, 0.7) as ax:
        number = np.arange(1, base.modes.stiffness.size + 1)
        for cost, colour in zip(base.costs, CURVES, strict=False):
            ax.semilogy(number, cost.power_worst, color=colour, label=cost.base)
            ax.semilogy(number, cost.power_mean, color=colour, linestyle=":")
        ax.plot([], [], color=INK, label="worst coil")
        ax.plot([], [], color=INK, linestyle=":", label="mean of all coils")
        if np.isfinite(limits.power):
            label_line(ax, limits.power, "limit")
        least = min(cost.power_mean.min() for cost in base.costs)
        most = max(cost.power_worst.max() for cost in base.costs)
        ax.set_ylim(bottom=max(0.8 * least, MIN_POWER * most))
        plain_ticks(ax.yaxis)
        ax.set_xlabel("number of modes N")
        ax.set_ylabel("power of a coil (W)")
        legend_above(ax)
    return ax


def plot_comparison(modes: ModalFindings, ax: Axes | None = None) -> Axes:
    """Draw the angles between the modes with alpha = 1 and with the calibrated alpha."""
    c = modes.comparison
    with styled_axes(ax, 0.7) as ax:
        number = np.arange(1, c.rms_angle.size)
        uncut = ~c.cuts[:-1]
        ax.semilogy(number[uncut], np.degrees(c.rms_angle[:-1][uncut]), "o", color=CURVES[0],
                    markersize=1.8, label="rms over N modes")  # fmt: skip
        ax.semilogy(c.orders, np.degrees(c.largest_angle), "s", color=CURVES[1], markersize=1.8,
                    markerfacecolor="none", label="largest of N modes")  # fmt: skip
        plain_ticks(ax.yaxis)
        ax.set_xlabel("number of modes N")
        ax.set_ylabel("angle of modes by α = 1 (°)")
        legend_above(ax)
    return ax


def modes_figures(modes: ModalFindings, limits: Budget) -> dict[str, Callable[..., Axes]]:
    """Return the functions that draw the figures of the modal basis, by name."""
    drawn: dict[str, Callable[..., Axes]] = {"modes": partial(plot_modes, modes.after)}
    if modes.after.costs:
        drawn["modes-residual"] = partial(plot_residual, modes.after)
        if np.isfinite(modes.after.costs[0].efficiency):
            drawn["modes-power"] = partial(plot_power, modes.after, limits)
    if modes.compares:
        drawn["modes-comparison"] = partial(plot_comparison, modes)
    return drawn
