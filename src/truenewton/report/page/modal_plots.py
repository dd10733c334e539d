"""The page's figures of the modal base, for Bokeh: modes on the mirror, residual and power."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, FixedTicker, HoverTool, LinearColorMapper
from bokeh.palettes import PuOr11

from truenewton.arrays import Array
from truenewton.figures.style import CURVES, INK
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.words import chosen_modes, least_power, stiffness_text
from truenewton.report.page.actuator_plots import MILLIMETRE, NAMED, dot_radius
from truenewton.report.page.looks import FONT, Plot, empty_plot

ACROSS = 4  # maps beside each other
WIDE, HIGH = 2.3, 2.75  # from map to map, in units of a map's radius
DASHES = ("solid", "dashed", "dotdash")  # of the three bases
LONG = 4  # decades of an axis with ticks at 2 and 5


def modes(base: ModalBase) -> Plot:
    """Return small maps of modes, softest first; each coloured up to its largest displacement."""
    layout, chosen = base.stiffness.layout, chosen_modes(base.modes.stiffness.size)
    dot = dot_radius(layout)
    reach = float(np.hypot(layout.x, layout.y).max()) / MILLIMETRE + dot
    down, across = np.divmod(np.arange(len(chosen)), ACROSS)
    right, up = WIDE * reach * across, -HIGH * reach * down
    shown = base.modes.modes[:, chosen]
    source = ColumnDataSource(
        {
            "x": np.add.outer(right, layout.x / MILLIMETRE).ravel().astype(np.float32),
            "y": np.add.outer(up, layout.y / MILLIMETRE).ravel().astype(np.float32),
            "part": (shown / np.abs(shown).max(axis=0)).T.ravel().astype(np.float32),
            "mode": np.repeat(np.add(chosen, 1), layout.n).astype(np.uint16),
            "id": np.tile(layout.id, len(chosen)).astype(np.int32),
        }
    )
    titles = [f"{k + 1}: {stiffness_text(base.modes.stiffness[k])}" for k in chosen]
    plot = empty_plot(height=None, aspect=True)
    plot.aspect_ratio = WIDE * ACROSS / (HIGH * (down[-1] + 1))
    plot.axis.visible = plot.grid.visible = False
    dots = plot.circle(
        x="x", y="y", radius=dot, source=source, line_width=0.5,
        fill_color={"field": "part",
                    "transform": LinearColorMapper(palette=PuOr11, low=-1.0, high=1.0)},
        line_color=INK if layout.n <= NAMED else None,
    )  # fmt: skip
    plot.text(x=right, y=up + 1.12 * reach, text=titles, text_font=value(FONT),
              text_font_size="0.75em", text_align="center", text_color=INK)  # fmt: skip
    told = [("mode", "@mode"), ("actuator", "@id"), ("of its largest", "@part{0.00}")]
    plot.add_tools(HoverTool(renderers=[dots], tooltips=told, visible=False))
    return plot


def residual(base: ModalBase) -> Plot:
    """Return the wavefront that the first N modes of each base leave."""
    plot = empty_plot(x_axis_type="log", y_axis_type="log")
    # All modes leave nothing on the actuators: no point of a logarithmic axis.
    left = {cost.base: 1e9 * cost.residual[:-1] for cost in base.costs}
    _lines(plot, left, "nm", 2.5)
    values = np.concatenate([*left.values()])
    _named_ticks(plot.xaxis, 1.0, base.modes.stiffness.size)
    _named_ticks(plot.yaxis, values.min(), values.max())
    plot.yaxis.axis_label = "residual wavefront, rms (nm)"
    return plot


def power(base: ModalBase) -> Plot:
    """Return the power of the worst coil and the mean over all, static force included."""
    plot = empty_plot(y_axis_type="log")
    worst = {cost.base: cost.power.max(axis=0) for cost in base.costs}
    _lines(plot, worst, "W, worst", 2.5)
    _lines(plot, {cost.base: cost.power.mean(axis=0) for cost in base.costs}, "W, mean", 1.2)
    plot.y_range.start, most = least_power(base), max(values.max() for values in worst.values())
    _named_ticks(plot.yaxis, plot.y_range.start, most)
    plot.yaxis.axis_label = "power of a coil (W)"
    return plot


def _lines(plot: Plot, curves: dict[str, Array], unit: str, width: float) -> None:
    """Draw a curve for each base against the number of modes."""
    count = len(next(iter(curves.values())))
    source = ColumnDataSource(
        {"n": np.arange(1, count + 1, dtype=np.uint16)}
        | {name: values.astype(np.float32) for name, values in curves.items()}
    )
    drawn = [
        plot.line(x="n", y=name, source=source, color=colour, line_dash=dash, line_width=width)
        for name, colour, dash in zip(curves, CURVES, DASHES, strict=False)
    ]
    told = [("modes", "@n"), *((name, f"@{{{name}}}{{%.3g}} {unit}") for name in curves)]
    formats: dict[str, Any] = {f"@{{{name}}}": "printf" for name in curves}
    plot.add_tools(HoverTool(renderers=drawn[:1], tooltips=told, formatters=formats, visible=False))
    plot.xaxis.axis_label = "number of modes"


def _named_ticks(axis: Plot, low: float, high: float) -> None:
    """Put ticks at 1, 2, 5, 10, ... of a logarithmic axis; at powers of ten only if it is long."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    parts = (1, 2, 5) if last - first <= LONG else (1,)
    ticks = [float(f"{part}e{power}") for power in range(first, last + 1) for part in parts]
    axis.ticker = FixedTicker(ticks=ticks)
    axis.major_label_overrides = {tick: f"{tick:g}".replace("e-0", "e-") for tick in ticks}
