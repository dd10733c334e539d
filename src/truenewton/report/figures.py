"""Figures of the evidence for papers: one column wide, with the conventions of `figures`.

Every call takes axes or makes its own, and returns them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from truenewton.errors import UnknownName
from truenewton.estimation.estimate import Scale
from truenewton.figures.maps import plot_map
from truenewton.figures.style import (
    ACCENT,
    ALARM,
    CURVES,
    FAINT,
    INK,
    SIGNED_COLOURS,
    STYLE,
    new_axes,
)
from truenewton.modal.dissipation import Budget
from truenewton.modal.figures import modes_figures
from truenewton.records.campaign import Campaign
from truenewton.report.budget import budget_bars
from truenewton.report.change import Change
from truenewton.report.evidence import Evidence, ModeResiduals
from truenewton.report.investigate import Findings
from truenewton.report.layers import calibration_layers, change_layers
from truenewton.report.series import by_signed_shape, columns_of_shapes, cycle_times
from truenewton.rounding import percent
from truenewton.statics.layout import ring_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def still_figures(findings: Findings) -> dict[str, Callable[[], Axes]]:
    """Return the figures that findings allow beside the paper's, by name."""
    if findings.calibration is None:
        return {}
    keys = ("e_stat", "leverage", "residual")
    known = {layer.key for layer in calibration_layers(findings)}
    made: dict[str, Callable[[], Axes]] = {
        f"map-{key.replace('_', '-')}": lambda key=key: plot_layer(findings, key)  # type: ignore[misc]
        for key in keys
        if key in known
    }
    if findings.calibration.scale != Scale.MEAN_ONE:
        made["budget"] = lambda: plot_budget(findings)
    if findings.evidence is not None:
        made["residuals"] = lambda: plot_residuals(findings)
        made["singular-values"] = lambda: plot_singular_values(findings)
        made["balance"] = lambda: plot_balance(findings)
    if isinstance(findings.data, Campaign):
        made["temperatures"] = lambda: plot_temperatures(findings)
    if findings.modes is not None:
        made |= modes_figures(findings.modes, Budget())
    return made


def plot_layer(findings: Findings, key: str, ax: Axes | None = None) -> Axes:
    """Draw one layer of the actuators on the map.

    Raises
    ------
    UnknownName
        There is no such layer; the message names those that are.
    """
    c = findings.calibration
    layers = {layer.key: layer for layer in calibration_layers(findings)}
    if c is None or key not in layers:
        raise UnknownName(
            f"there is no layer '{key}'", remedy=f"choose {', '.join(layers)}", got=key
        )
    return plot_map(c.layout, layers[key].values, ax, label=layers[key].title)


def plot_change_map(change: Change, ax: Axes | None = None) -> Axes:
    """Draw the change per actuator in sigmas on the map."""
    layer = change_layers(change)[0]
    return plot_map(
        change.one.layout, layer.values, ax, label=layer.title, colours=SIGNED_COLOURS,
        limits=layer.limits,
    )  # fmt: skip


def plot_change(change: Change, ax: Axes | None = None) -> Axes:
    """Draw the change per actuator in sigmas, ring by ring, and how far chance alone reaches."""
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.75)
        layout = change.one.layout
        ring = ring_of(layout)
        order = np.argsort(ring, kind="stable")
        place = np.arange(1, layout.n + 1)
        ax.axhspan(-change.limit, change.limit, color=FAINT, alpha=0.2, linewidth=0)
        ax.axhline(0.0, color=FAINT, linewidth=0.5)
        ax.plot(place, change.sigmas[order], "o", color=ACCENT, markersize=2.0)
        for edge in np.flatnonzero(np.diff(ring[order])) + 1.5:
            ax.axvline(edge, color=FAINT, linewidth=0.5, linestyle=":", zorder=0)
        for far in change.changed[:10]:
            at = (float(place[order == far][0]), float(change.sigmas[far]))
            ax.annotate(str(layout.id[far]), at, xytext=(3, 0), textcoords="offset points",
                        fontsize=6.0, va="center")  # fmt: skip
        ax.set_xlabel("actuator, ring by ring from the centre" if ring.max() else "actuator")
        ax.set_ylabel("change (sigma)")
        ax.set_title("band: chance alone, 1 % for all", loc="right", fontsize=6.5, color=INK)
    return ax


def plot_budget(findings: Findings, ax: Axes | None = None) -> Axes:
    """Draw the error budget: of a typical actuator, and of the common scale by source."""
    c = findings.calibration
    bars = () if c is None else budget_bars(c)
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.12 + 0.09 * max(len(bars), 2))
        sizes = [100 * bar.size for bar in bars]
        ax.barh(range(len(bars)), sizes, color=ACCENT, height=0.6)
        for place, bar in enumerate(bars):
            ax.annotate(percent(bar.size), (100 * bar.size, place), xytext=(2, 0),
                        textcoords="offset points", va="center", fontsize=6.5)  # fmt: skip
        ax.set_yticks(range(len(bars)), [bar.name.replace("$", r"\$") for bar in bars])
        ax.invert_yaxis()
        ax.margins(x=0.15)
        ax.set_xlabel("error of alpha (%)")
        ax.spines[["top", "right"]].set_visible(False)
    return ax


def plot_residuals(findings: Findings, ax: Axes | None = None) -> Axes:
    """Draw how far rows, by shape and cycle, or modes are out of balance.

    Raises
    ------
    ValueError
        The findings hold no residuals.
    """
    residuals = _evidence(findings).residuals
    if isinstance(residuals, ModeResiduals):
        return plot_balance(findings, ax)
    column, name = columns_of_shapes(residuals)
    cycles, reach = int(residuals.cycle.max()) + 1, int(np.abs(column).max())
    image = np.full((cycles, 2 * reach + 1), np.nan)
    np.fmax.at(image, (residuals.cycle, column + reach), residuals.after)
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.62)
        shown = ax.imshow(
            image, aspect="auto", cmap="cividis", vmin=0.0, vmax=4.0, interpolation="nearest",
            extent=(-reach - 0.5, reach + 0.5, cycles + 0.5, 0.5),
        )  # fmt: skip
        lost = ~residuals.kept
        ax.plot(column[lost], residuals.cycle[lost] + 1, "x", color=ALARM, markersize=4.0)
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_xlabel(name)
        ax.set_ylabel("cycle")
        bar = ax.figure.colorbar(shown, ax=ax, extend="max", aspect=30, pad=0.02)
        bar.set_label("imbalance / noise")
        if lost.any():
            ax.set_title("crosses: rejected", loc="right", fontsize=6.5, color=INK)
    return ax


def plot_balance(findings: Findings, ax: Axes | None = None) -> Axes:
    """Draw the imbalance of shapes or modes with alpha = 1 and with alpha as found.

    Raises
    ------
    ValueError
        The findings hold no residuals.
    """
    residuals = _evidence(findings).residuals
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.7)
        if isinstance(residuals, ModeResiduals):
            x: NDArray[Any] = residuals.stiffness
            before, after = residuals.before, residuals.after
            ax.set_xscale("log")
            ax.set_xlabel("stiffness of the mode (N/m)")
            ax.set_ylabel("imbalance / force")
        else:
            x, before, after, name = by_signed_shape(residuals)
            ax.set_xlabel(name)
            ax.set_ylabel("imbalance / noise")
        ax.set_yscale("log")
        size = 3.0 if len(x) <= 200 else 1.5
        ax.plot(x, before, "o", color=CURVES[1], markersize=size, markerfacecolor="none",
                label=r"$\alpha = 1$")  # fmt: skip
        ax.plot(x, after, "s", color=CURVES[0], markersize=0.8 * size, label="calibrated")
        ax.legend(frameon=False, fontsize=6.5, ncols=2, loc="lower right",
                  bbox_to_anchor=(1.0, 1.0), borderpad=0.0)  # fmt: skip
    return ax


def plot_singular_values(findings: Findings, ax: Axes | None = None) -> Axes:
    """Draw how clearly the data hold each pattern of alpha.

    Raises
    ------
    ValueError
        The findings hold no singular values.
    """
    evidence = _evidence(findings)
    values = np.maximum(evidence.singular_values, 1e-16 * evidence.singular_values[-1])
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.62)
        ax.semilogy(np.arange(1, values.size + 1), values, "o", color=ACCENT, markersize=1.8)
        ax.semilogy([1], values[:1], "D", color=ALARM, markerfacecolor="none", markersize=5.0)
        ax.set_xlabel(r"pattern of $\alpha$")
        ax.set_ylabel("singular value" + (" / noise" if evidence.in_noise else ""))
        ax.set_title(r"diamond: $\alpha$ itself", loc="right", fontsize=6.5, color=INK)
    return ax


def plot_temperatures(findings: Findings, ax: Axes | None = None) -> Axes:
    """Draw when the cycles ran, and how warm it was where that is known.

    Raises
    ------
    ValueError
        The findings are not of a campaign.
    """
    campaign = findings.data
    if not isinstance(campaign, Campaign):
        raise ValueError("only the cycles of a campaign have times")
    known = any(cycle.temperature is not None for cycle in campaign.cycles)
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.55)
        for k, cycle in enumerate(campaign.cycles):
            time, temperature = cycle_times(cycle)
            load = campaign.load_index[k]
            colour = CURVES[load % len(CURVES)]
            first = campaign.load_index.index(load) == k
            label = campaign.loads[load].name.replace("$", r"\$") if first else None
            if known and temperature is not None:
                ax.plot(time, temperature, color=colour, label=label)
            elif not known:
                ax.plot(time[[0, -1]], [k + 1, k + 1], color=colour, linewidth=3.0, label=label)
        locator: Any = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        ax.set_xlabel("time (UTC)")
        ax.set_ylabel("temperature (deg C)" if known else "cycle")
        ax.legend(frameon=False, fontsize=6.5, ncols=4, loc="lower right",
                  bbox_to_anchor=(1.0, 1.0), borderpad=0.0)  # fmt: skip
    return ax


def _evidence(findings: Findings) -> Evidence:
    if findings.evidence is None:
        raise ValueError("a calibration file holds no residuals; give the cycles")
    return findings.evidence
