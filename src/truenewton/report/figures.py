"""Figures of the evidence for papers, one column wide, in the style of `figures`.

Every function takes axes or makes its own, and returns them.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.layers import layers_of
from truenewton.calibration.result import Calibration
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.figures.style import (
    ACCENT,
    ALARM,
    COLOURS,
    CURVES,
    SIGMA,
    SIGMA_SCALE,
    SIGMA_STAT,
    label_line,
    legend_above,
    plain,
    plain_ticks,
    styled_axes,
)
from truenewton.modal.figures import modes_figures
from truenewton.modal.modal_base import Budget
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.result import figures_of
from truenewton.report.findings import Evidence, Findings, ModeResiduals, RowResiduals
from truenewton.rounding import percent

MAX_POINTS = 200  # of a cycle over time; more cannot be distinguished
MAPS = (  # written; that of alpha is the paper's
    "map-e-stat",
    "map-leverage",
    "map-residual",
    "map-sensor-gain",
    "map-sensor-dx",
    "map-sensor-dy",
)


@figures_of.register(Findings)
def findings_figures(findings: Findings) -> dict[str, Callable[..., Axes]]:
    """Return functions that draw each figure of the findings, by name; they take axes or none."""
    c, evidence, data = findings.calibration, findings.evidence, findings.data
    drawn: dict[str, Callable[..., Axes]] = {}
    if c is not None:
        for layer in layers_of(c, evidence):
            drawn[f"map-{layer.key.replace('_', '-')}"] = partial(layer.plot, c.layout)
        if c.scale != Scale.MEAN_ONE:
            drawn["budget"] = partial(plot_budget, c)
    if evidence is not None:
        residuals = evidence.residuals
        if isinstance(residuals, ModeResiduals):
            drawn["residuals"] = partial(plot_balance, residuals)
        elif isinstance(data, Campaign):
            drawn["residuals"] = partial(plot_residuals, residuals, data)
        if evidence.singular_values.size:
            drawn["singular-values"] = partial(plot_singular_values, evidence)
        drawn["balance"] = partial(plot_balance, residuals)
    if isinstance(data, Campaign):
        drawn["temperatures"] = partial(plot_temperatures, data)
    if findings.modes is not None:
        drawn |= modes_figures(findings.modes, Budget())
    return drawn


def still_figures(findings: Findings) -> dict[str, Callable[..., Axes]]:
    """Return the figures that are written beside those of the paper, by name."""
    drawn = findings_figures(findings)
    return {n: draw for n, draw in drawn.items() if n in MAPS or not n.startswith("map-")}


def plot_budget(c: Calibration, ax: Axes | None = None) -> Axes:
    """Draw the error budget of a typical actuator: statistics, scale and total."""
    with styled_axes(ax, 0.36) as ax:
        names = {SIGMA_STAT: c.statistical_error, SIGMA_SCALE: c.systematic_error, SIGMA: c.error}
        sizes = [typical(error, c.alpha) for error in names.values()]
        bars = ax.barh(list(names), [100 * size for size in sizes], color=ACCENT, height=0.6)
        ax.bar_label(bars, [percent(size) for size in sizes], padding=2, fontsize=6.5)
        ax.invert_yaxis()
        ax.margins(x=0.15)
        ax.set_xlabel("typical 1σ error of α (%)")
        ax.spines[["top", "right"]].set_visible(False)
    return ax


def plot_residuals(residuals: RowResiduals, campaign: Campaign, ax: Axes | None = None) -> Axes:
    """Draw the imbalance of rows by shape and cycle, up to the largest of a row that was kept."""
    column, name = columns_of_shapes(residuals)
    cycles, reach = len(campaign.cycles), int(np.abs(column).max())
    image = np.full((cycles, 2 * reach + 1), np.nan)
    np.fmax.at(image, (residuals.cycle, column + reach), residuals.after)
    rejected = ~residuals.kept
    with styled_axes(ax, 0.66) as ax:
        shown = ax.imshow(
            image, aspect="auto", cmap=COLOURS, vmin=0.0, vmax=residuals.after[~rejected].max(),
            interpolation="nearest", extent=(-reach - 0.5, reach + 0.5, cycles + 0.5, 0.5),
        )  # fmt: skip
        for k, load in enumerate(campaign.loads):  # a band at the left of its cycles
            own = np.flatnonzero(np.array(campaign.load_index) == k)
            ax.vlines(np.full(own.size, -0.012), own + 0.5, own + 1.5, color=_load_colour(k),
                      linewidth=3.0, transform=ax.get_yaxis_transform(), clip_on=False,
                      label=plain(load.name))  # fmt: skip
        if rejected.any():
            ax.plot(column[rejected], residuals.cycle[rejected] + 1, "x", color=ALARM,
                    markersize=4.0, label="rejected row")  # fmt: skip
        ax.tick_params(axis="y", length=0.0, pad=5.0)
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_xlabel(name)
        ax.set_ylabel("cycle")
        bar = ax.figure.colorbar(shown, ax=ax, extend="max" if rejected.any() else "neither",
                                 aspect=30, pad=0.02)  # fmt: skip
        bar.set_label("imbalance / noise")
        legend_above(ax)
    return ax


def _load_colour(index: int) -> str:
    return CURVES[index % len(CURVES)]


def columns_of_shapes(residuals: RowResiduals) -> tuple[NDArray[np.int64], str]:
    """Return (N,) positions of rows on an axis of signed shapes, and its label.

    They are SHAPE times SIGN, or ranks if the numbers of shapes have wide gaps.
    """
    signed = residuals.signed_shape
    names, index = np.unique(np.abs(signed), return_inverse=True)
    if names[-1] <= 4 * names.size:
        return signed, "shape × sign"
    return (index + 1) * np.sign(signed), "place of the shape × sign"


def plot_balance(residuals: RowResiduals | ModeResiduals, ax: Axes | None = None) -> Axes:
    """Draw the imbalance of shapes or modes with alpha = 1 and with the calibration."""
    with styled_axes(ax, 0.7) as ax:
        if isinstance(residuals, ModeResiduals):
            x: NDArray[Any] = residuals.stiffness / 1e3
            before, after = residuals.before, residuals.after
            ax.set_xscale("log")
            ax.set_xlabel("stiffness of the mode (kN/m)")
            ax.set_ylabel("imbalance / force")
        else:
            x, before, after, name = _by_signed_shape(residuals)
            ax.set_xlabel(name)
            ax.set_ylabel("imbalance / noise")
            label_line(ax, 1.0, "noise")
        ax.set_yscale("log")
        size = 3.0 if len(x) <= 200 else 1.5
        ax.plot(x, before, "o", color=CURVES[1], markersize=size, markerfacecolor="none",
                label="α = 1")  # fmt: skip
        ax.plot(x, after, "s", color=CURVES[0], markersize=0.8 * size, label="calibrated")
        plain_ticks(ax.yaxis, *([ax.xaxis] if ax.get_xscale() == "log" else []))
        legend_above(ax)
    return ax


def _by_signed_shape(residuals: RowResiduals) -> tuple[NDArray[np.int64], Array, Array, str]:
    """Return signed shapes, their rms imbalance over kept rows before and after, and the label."""
    column, name = columns_of_shapes(residuals)
    shapes, member = np.unique(column[residuals.kept], return_inverse=True)
    before, after = (
        np.sqrt(np.bincount(member, values[residuals.kept] ** 2) / np.bincount(member))
        for values in (residuals.before, residuals.after)
    )
    return shapes, before, after, name


def plot_singular_values(evidence: Evidence, ax: Axes | None = None) -> Axes:
    """Draw the singular values of the balance."""
    values = np.maximum(evidence.singular_values, 1e-16 * evidence.singular_values[-1])
    with styled_axes(ax, 0.62) as ax:
        ax.semilogy([1], values[:1], "D", color=ALARM, markersize=3.0, label="α itself")
        ax.semilogy(np.arange(2, values.size + 1), values[1:], "o", color=ACCENT, markersize=1.8,
                    label="other patterns")  # fmt: skip
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
        plain_ticks(ax.yaxis)
        ax.set_xlabel("pattern of α, number")
        ax.set_ylabel("singular value" + (" / noise" if evidence.in_noise else ""))
        legend_above(ax)
    return ax


def plot_temperatures(campaign: Campaign, ax: Axes | None = None) -> Axes:
    """Draw the times of the cycles, and their temperatures if known."""
    known = any(cycle.temperature is not None for cycle in campaign.cycles)
    with styled_axes(ax, 0.55) as ax:
        for k, cycle in enumerate(campaign.cycles):
            time, temperature = _times(cycle)
            load = campaign.load_index[k]
            colour = _load_colour(load)
            first = campaign.load_index.index(load) == k
            label = plain(campaign.loads[load].name) if first else None
            if known and temperature is not None:
                ax.plot(time, temperature, color=colour, label=label)
            elif not known:
                ax.plot(time[[0, -1]], [k + 1, k + 1], color=colour, linewidth=3.0, label=label)
        locator: Any = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        ax.set_xlabel("time (UTC)")
        ax.set_ylabel("temperature (°C)" if known else "cycle")
        legend_above(ax)
    return ax


def _times(cycle: Cycle) -> tuple[NDArray[Any], Array | None]:
    """Return at most 200 times (UTC) and temperatures [deg C] of a cycle."""
    valid = np.flatnonzero(cycle.valid)
    valid = valid[np.argsort(cycle.time[valid], kind="stable")]
    some = valid[np.linspace(0, valid.size - 1, min(valid.size, MAX_POINTS)).round().astype(int)]
    time = np.array([cycle.date + datetime.timedelta(seconds=t) for t in cycle.time[some].tolist()])
    return time, None if cycle.temperature is None else cycle.temperature[some]
