"""The page's figures of rows, modes and times, for Bokeh.

No text that comes from a file enters a figure, since Bokeh reads text between certain signs as
formulas, but for what a tooltip shows, which it takes as it is. Loads and cycles have numbers here,
and their names beside the figures.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, LinearColorMapper
from bokeh.models.annotations import ColorBar
from bokeh.palettes import Cividis256
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.figures.style import ALARM, CURVES
from truenewton.records.campaign import Campaign
from truenewton.report.evidence import Evidence, ModeResiduals, RowResiduals
from truenewton.report.page.looks import Plot, empty_plot
from truenewton.report.series import by_signed_shape, columns_of_shapes, cycle_times


def row_residuals(
    residuals: RowResiduals, rejected: tuple[RejectedRow, ...], names: list[str]
) -> Plot:
    """Return the imbalance of rows in terms of their noise, by shape and cycle.

    Parameters
    ----------
    residuals
        Of the rows.
    rejected
        Rows left out.
    names
        Of the files of the cycles, for tooltips.
    """
    column, shown = columns_of_shapes(residuals)
    reach, cycles = int(np.abs(column).max()), len(names)
    image = np.full((cycles, 2 * reach + 1), np.nan, dtype=np.float32)
    np.fmax.at(image, (residuals.cycle, column + reach), residuals.after.astype(np.float32))
    plot = empty_plot(height=min(140 + 22 * cycles, 420))
    mapper = LinearColorMapper(palette=Cividis256, low=0.0, high=4.0, nan_color="#ffffff")
    glyph = plot.image([image], x=-reach - 0.5, y=0.5, dw=2 * reach + 1, dh=cycles,
                       color_mapper=mapper)  # fmt: skip
    bar = ColorBar(color_mapper=mapper, width=10, title="x noise", title_text_font_style="normal")
    plot.add_layout(bar, "right")
    plot.x_range.range_padding = plot.y_range.range_padding = 0.0
    plot.y_range.flipped = True
    plot.yaxis.ticker = list(range(1, cycles + 1)) if cycles <= 12 else plot.yaxis[0].ticker
    plot.xaxis.axis_label = shown
    plot.yaxis.axis_label = "cycle"
    plot.add_tools(
        HoverTool(
            renderers=[glyph],
            tooltips=[("shape", "$x{0}"), ("cycle", "$y{0}"), ("imbalance / noise", "@image{0.0}")],
            visible=False,
        )
    )
    if rejected:
        at = {(c, r): k for k, (c, r) in enumerate(
            zip(residuals.cycle.tolist(), residuals.row.tolist(), strict=True))}  # fmt: skip
        rows = [at[gone.cycle, gone.row] for gone in rejected]
        source = ColumnDataSource(
            {
                "x": column[rows],
                "y": residuals.cycle[rows] + 1,
                "file": [names[gone.cycle] for gone in rejected],
                "row": [gone.row + 1 for gone in rejected],
                "sigmas": [f"{gone.sigmas:.0f} from {gone.against}" for gone in rejected],
                "actuator": [gone.actuator for gone in rejected],
            }
        )
        crosses = plot.scatter(x="x", y="y", source=source, marker="circle_x", size=11,
                               fill_color="#ffffff", line_color=ALARM, line_width=2)  # fmt: skip
        plot.add_tools(
            HoverTool(
                renderers=[crosses],
                tooltips=[("rejected", "@file, row @row"), ("sigma", "@sigmas"),
                          ("stands out", "actuator @actuator")],
                visible=False,
            )
        )  # fmt: skip
    return plot


def mode_residuals(residuals: ModeResiduals) -> Plot:
    """Return the imbalance of elastic modes against their stiffness, before and after."""
    plot = empty_plot(x_axis_type="log", y_axis_type="log")
    _before_and_after(plot, residuals.stiffness, residuals.before, residuals.after)
    plot.xaxis.axis_label = "stiffness of the mode (N/m)"
    plot.yaxis.axis_label = "imbalance / force"
    return plot


def balance(residuals: RowResiduals) -> Plot:
    """Return the imbalance of shapes in terms of noise, before and after."""
    plot = empty_plot(y_axis_type="log")
    column, before, after, shown = by_signed_shape(residuals)
    _before_and_after(plot, column, before, after)
    plot.xaxis.axis_label = shown
    plot.yaxis.axis_label = "imbalance / noise"
    return plot


def _before_and_after(plot: Plot, x: NDArray[Any], before: Array, after: Array) -> None:
    source = ColumnDataSource({"x": x, "before": before, "after": after})
    plot.scatter(x="x", y="before", source=source, size=5, marker="circle", fill_color=None,
                 line_color=CURVES[1])  # fmt: skip
    plot.scatter(x="x", y="after", source=source, size=5, marker="square", color=CURVES[0])
    plot.add_tools(
        HoverTool(tooltips=[("at", "@x{0,0}"), ("alpha = 1", "@before{0.000}"),
                            ("calibrated", "@after{0.000}")], visible=False)
    )  # fmt: skip


def singular_values(evidence: Evidence) -> Plot:
    """Return the singular values of the balance, the one of alpha itself marked."""
    plot, values = empty_plot(y_axis_type="log"), evidence.singular_values
    values = np.maximum(values, 1e-16 * values[-1])
    source = ColumnDataSource({"x": np.arange(1, values.size + 1), "y": values})
    first = ColumnDataSource({"x": [1], "y": values[:1]})
    plot.scatter(x="x", y="y", source=source, size=5, color=CURVES[0])
    plot.scatter(x="x", y="y", source=first, size=13, marker="diamond", fill_color=None,
                 line_color=ALARM, line_width=2)  # fmt: skip
    plot.xaxis.axis_label = "pattern of alpha"
    plot.yaxis.axis_label = "singular value" + (" / noise" if evidence.in_noise else "")
    plot.add_tools(
        HoverTool(tooltips=[("pattern", "@x"), ("singular value", "@y{0.000}")], visible=False)
    )
    return plot


def temperatures(campaign: Campaign) -> Plot:
    """Return temperature against time of every cycle; where unknown, when each cycle ran."""
    known = any(cycle.temperature is not None for cycle in campaign.cycles)
    plot = empty_plot(x_axis_type="datetime")
    lines: list[tuple[int, NDArray[Any], Array]] = []
    for k, cycle in enumerate(campaign.cycles):
        time, temperature = cycle_times(cycle)
        if known and temperature is not None:
            lines.append((k, time, temperature))
        elif not known:
            lines.append((k, time[[0, -1]], np.full(2, k + 1.0)))
    for k, time, height in lines:
        load = campaign.load_index[k]
        source = ColumnDataSource({"t": time, "y": height, "cycle": np.full(len(time), k + 1)})
        colour = CURVES[load % len(CURVES)]
        line = plot.line(x="t", y="y", source=source, color=colour, line_width=2 if known else 6)
        plot.add_tools(
            HoverTool(
                renderers=[line],
                tooltips=[("cycle", "@cycle"), ("time", "@t{%F %T}")]
                + ([("temperature", "@y{0.00} deg C")] if known else []),
                formatters={"@t": "datetime"},
                visible=False,
            )
        )
    plot.xaxis.axis_label = "time (UTC)"
    plot.yaxis.axis_label = "temperature (deg C)" if known else "cycle"
    return plot
