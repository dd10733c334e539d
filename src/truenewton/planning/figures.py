"""The figure of a plan: error of alpha against cycles and against the added weight."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullLocator

from truenewton.arrays import Array
from truenewton.figures.style import (
    ACCENT,
    FAINT,
    INK,
    SIGMA,
    SIGMA_SCALE,
    SIGMA_STAT,
    STYLE,
    label_line,
    new_figure,
    plain_ticks,
)
from truenewton.planning.plan_prediction import Curve, PlanPrediction


def plot_plan(outcome: PlanPrediction, target: float | None = None) -> Axes:
    """Draw the typical error of alpha and its two parts, the plan as a dot, the target as a line.

    Returns the axes of the first of two panels; without added weights there is only one.
    """
    plan, by_weight = outcome.ready.plan, outcome.against_weight
    heaviest = max(abs(load.added) for load in plan.loads)
    with mpl.rc_context(STYLE):
        count = 2 if by_weight.values.size else 1
        figure = new_figure(0.62)
        panels: list[Axes] = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
        first, *second = panels
        _panel(first, outcome.against_cycles.values, outcome.against_cycles, plan.cycles)
        better = outcome.reciprocity.against_cycles
        if better.values.size:
            first.plot(
                better.values, 100 * better.statistical_error, "-.", color=INK, linewidth=0.8,
                label="σ_stat, by reciprocity",
            )  # fmt: skip
        first.set_xlabel("cycles")
        first.set_ylabel("typical error of α, 1σ (%)")
        for ax in second:
            _panel(ax, heaviest * by_weight.values, by_weight, heaviest)
            ax.set_xlabel("added weight (N)")
        if target is not None:
            for ax in panels:
                label_line(ax, 100 * target, "target" if ax is panels[-1] else "")
        figure.legend(
            *first.get_legend_handles_labels(), frameon=False, fontsize=6.5, ncols=2,
            loc="outside upper center", handlelength=1.8, columnspacing=1.2,
        )  # fmt: skip
    return first


def _panel(ax: Axes, x: Array, curve: Curve, planned: float) -> None:
    """Draw the curves against x, where the plan stands at one of the points."""
    for values, line, colour, width, name in (
        (curve.error, "-", ACCENT, 1.8, SIGMA),
        (curve.statistical_error, "--", INK, 0.8, SIGMA_STAT),
        (curve.systematic_error, ":", FAINT, 1.2, SIGMA_SCALE),
    ):
        if np.isfinite(values).all():
            ax.plot(x, 100 * values, line, color=colour, linewidth=width, label=name)
    at = int(np.argmin(np.abs(x - planned)))
    if np.isfinite(curve.error[at]):
        ax.plot(x[at], 100 * curve.error[at], "o", color=ACCENT, markersize=4.5, label="this plan")
    ax.set_xscale("log", base=2)
    ax.set_xticks(x)
    ax.set_yscale("log")
    ax.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:{'.2g' if value < 1 else 'g'}}")
    )
    ax.xaxis.set_minor_locator(NullLocator())
    plain_ticks(ax.yaxis)
