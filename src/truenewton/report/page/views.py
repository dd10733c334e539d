"""Interactive views of the actuators, by map and by ring, for Bokeh, with one selection.

Text from files must not enter a figure, since Bokeh reads text between certain signs as formulas;
tooltips are not affected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    BasicTicker,
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    LassoSelectTool,
    LinearAxis,
    LinearColorMapper,
    PanTool,
    ResetTool,
    SaveTool,
    TapTool,
    WheelZoomTool,
)
from bokeh.models.annotations import ColorBar, Label, Span
from bokeh.palettes import Cividis256, PuOr11
from bokeh.plotting import figure
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.layers import layers_of
from truenewton.calibration.result import Calibration
from truenewton.comparison.calibrations import Change
from truenewton.comparison.result import AnyChange, change_layers
from truenewton.figures.layers import Layer
from truenewton.figures.maps import (
    bears_names,
    dot_radius,
    names_by_ring,
    numbers_by_ring,
    outside_places,
    ring_edges,
    ring_label,
    ring_names,
    ring_radii,
    shown_rings,
)
from truenewton.figures.style import (
    ACCENT,
    ALARM,
    ALPHA,
    BY_RING,
    CROWDED,
    FAINT,
    INK,
    MILLIMETRE,
    NAMED,
)
from truenewton.report.findings import Evidence
from truenewton.rounding import counted
from truenewton.statics.layout import Layout, ring_centre, ring_of

FONT = "system-ui, sans-serif"
OUTSIDE = ("x0", "y0", "x", "y", "id", "align")  # of IDs around the map, each with a line
Plot = Any  # a figure of Bokeh, whose stubs lack many options


def actuator_source(layout: Layout, layers: tuple[Layer, ...]) -> ColumnDataSource:
    """Return the data that all views share: positions, values and texts of every layer."""
    columns: dict[str, Any] = {
        "id": layout.id.astype(np.int32),
        "called": layout.shown.tolist(),
        "ring": _rings(layout),
        "x": layout.x / MILLIMETRE,
        "y": layout.y / MILLIMETRE,
        "number": numbers_by_ring(layout).astype(np.int32),
        "shown": layers[0].values.copy(),
        "ink": ["#000000"] * layout.n,  # of the name on its dot; the page sets it
        "rim": [INK] * layout.n,  # red and thick of outliers; the page sets both
        "rim_width": [0.5 if layout.n <= CROWDED else 0.1] * layout.n,
    }
    for layer in layers:
        columns[layer.key] = np.array(layer.values)
        columns[f"{layer.key}_text"] = list(layer.texts)
    return ColumnDataSource(columns, name="actuators")


def _rings(layout: Layout) -> NDArray[np.int32]:
    """Return (n,) the ring of each actuator from 1."""
    return (ring_of(layout) + 1).astype(np.int32)


def mirror_map(
    source: ColumnDataSource,
    layout: Layout,
    layers: tuple[Layer, ...],
    edges: Sequence[Array] = (),
) -> Plot:
    """Return the map of the actuators, coloured by the first layer, with edges of the glass [m]."""
    plot = _empty_plot(sizing_mode="scale_width", aspect_ratio=0.92, match_aspect=True)
    plot.xaxis.axis_label, plot.yaxis.axis_label = "x (mm), seen along -z", "y (mm)"
    plot.grid.visible = False
    plot.x_range.range_padding = plot.y_range.range_padding = 0.08  # IDs of outliers are outside
    if radii := ring_radii(layout):
        x, y = np.divide(ring_centre(layout), MILLIMETRE).tolist()
        plot.circle(x=x, y=y, radius=radii, fill_color=None, line_color=FAINT, line_width=0.5,
                    level="underlay")  # fmt: skip
        shown = shown_rings(radii) if len(radii) > 1 else []
        if shown:
            rule = _axis({x + radius: str(k) for k, radius in shown})
            rule.axis_label = "ring"
            plot.add_layout(rule, "below")
    if edges:
        closed = [np.concatenate([edge, edge[:1]]).T / MILLIMETRE for edge in edges]
        plot.multi_line(
            xs=[x.tolist() for x, _ in closed], ys=[y.tolist() for _, y in closed],
            line_color=INK, line_width=1, level="underlay",
        )  # fmt: skip
    low, high = layers[0].limits
    mapper = LinearColorMapper(
        palette=palette(layers[0]), low=low, high=high, nan_color="#ffffff", name="colours"
    )
    dots = plot.circle(
        x="x", y="y", radius=dot_radius(layout), source=source,
        fill_color={"field": "shown", "transform": mapper}, line_color="rim",
        line_width="rim_width",
        selection_line_color=ALARM, selection_line_width=3.0,
        nonselection_fill_alpha=0.35, nonselection_line_alpha=0.35,
    )  # fmt: skip
    if bears_names(layout):
        plot.text(x="x", y="y", text={"field": "id"}, source=source, text_color={"field": "ink"},
                  text_font=value(FONT), text_font_size="0.65em", text_align="center",
                  text_baseline="middle", nonselection_text_alpha=0.6)  # fmt: skip
    outside = ColumnDataSource({name: [] for name in OUTSIDE}, name="outside")
    plot.segment(x0="x0", y0="y0", x1="x", y1="y", source=outside, line_color=ALARM)
    plot.text(x="x", y="y", text={"field": "id"}, source=outside, text_color=ALARM,
              text_font=value(FONT), text_font_size="0.75em", text_baseline="middle",
              text_align={"field": "align"})  # fmt: skip
    bar = ColorBar(color_mapper=mapper, title=layers[0].title, name="bar", height=12,
                   title_text_font_style="normal", title_text_font=FONT,
                   major_label_text_font=FONT)  # fmt: skip
    plot.add_layout(bar, "below")
    _add_actuator_tools(plot, dots, layers)
    return plot


def palette(layer: Layer) -> tuple[str, ...]:
    """Return the colours of a layer."""
    return PuOr11 if layer.diverging else Cividis256


def shown_outliers(layer: Layer, layout: Layout) -> dict[str, Any]:
    """Return the indices of a layer's outliers, and their IDs around the map if dots have none."""
    which = layer.outliers
    places = [] if bears_names(layout) else outside_places(layout, which)
    rows = [(layout.x[k] / MILLIMETRE, layout.y[k] / MILLIMETRE, x, y, str(layout.id[k]),
             "left" if x > 0 else "right") for k, x, y in places]  # fmt: skip
    columns = zip(*rows, strict=True) if rows else [()] * len(OUTSIDE)
    return {"outliers": which.tolist(), "outside": dict(zip(OUTSIDE, columns, strict=True))}


def alpha_by_ring(
    source: ColumnDataSource, calibration: Calibration, layers: tuple[Layer, ...]
) -> Plot:
    """Return alpha by ring, with grey bars of 3 E_STAT."""
    plot, layout = _empty_plot(), calibration.layout
    alpha, error = calibration.alpha, calibration.statistical_error
    source.data["low"], source.data["high"] = alpha - 3 * error, alpha + 3 * error
    plot.segment(x0="number", x1="number", y0="low", y1="high", source=source, line_color=FAINT,
                 nonselection_line_alpha=0.2)  # fmt: skip
    _actuator_points(plot, source, layout, "alpha", layers)
    plot.yaxis.axis_label = ALPHA
    texts = {k: f"{alpha[k]:.2f}" for k in np.flatnonzero(alpha < 0.0).tolist()}
    _mark_reversed(plot, layout, texts, alpha[alpha > 0.0])
    return plot


def _mark_reversed(plot: Plot, layout: Layout, texts: dict[int, str], shown: Array) -> None:
    """Name reversed coils at the lower edge, with their values; they would stretch the axis.

    The axis has the range of the values that are shown.
    """
    if not texts:
        return
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    plot.y_range.start, plot.y_range.end = low - 0.15 * (high - low), high + 0.05 * (high - low)
    numbers = numbers_by_ring(layout)
    for k, text in texts.items():
        plot.add_layout(Label(x=int(numbers[k]), y=2, y_units="screen", text_color=ALARM,
                              text=f"▼ {layout.id[k]}: {text}", text_font=FONT,
                              text_font_size="0.75em"))  # fmt: skip


def change_by_ring(
    source: ColumnDataSource, layout: Layout, layers: tuple[Layer, ...], limit: float
) -> Plot:
    """Return the first layer of a change by ring, with its limit if there is one."""
    plot = _empty_plot()
    for level in (-limit, 0.0, limit):
        if np.isfinite(level):
            plot.add_layout(Span(location=level, dimension="width", line_color=FAINT,
                                 line_dash="solid" if level == 0.0 else "dashed"))  # fmt: skip
            if level:
                plot.add_layout(Label(x=0, x_units="screen", y=level, text="limit", text_font=FONT,
                                      text_font_size="0.75em"))  # fmt: skip
    _actuator_points(plot, source, layout, layers[0].key, layers)
    plot.yaxis.axis_label = layers[0].title
    [change, *_] = (layer.values for layer in layers if layer.unit == "%")
    reversed_coils, values = change < -100.0, layers[0].values
    texts = {k: f"{change[k]:.0f} %" for k in np.flatnonzero(reversed_coils).tolist()}
    shown = np.append(values[~reversed_coils], [0.0] if np.isnan(limit) else [-limit, limit])
    _mark_reversed(plot, layout, texts, shown)
    return plot


def _actuator_points(
    plot: Plot, source: ColumnDataSource, layout: Layout, key: str, layers: tuple[Layer, ...]
) -> None:
    """Draw a value of each actuator, ring by ring."""
    dots = plot.scatter(
        x="number", y=key, source=source, size=7 if layout.n <= NAMED else 4, color=ACCENT,
        selection_color=ALARM, selection_line_color=INK, nonselection_alpha=0.25,
    )  # fmt: skip
    for edge in ring_edges(layout).tolist():
        plot.add_layout(Span(location=edge, dimension="height", line_color=FAINT,
                             line_dash="dotted", line_width=1))  # fmt: skip
    plot.xaxis.axis_label = ring_label(layout)
    if names := names_by_ring(layout):
        plot.xaxis.ticker = BasicTicker(min_interval=1)
        plot.xaxis.major_label_overrides = {0: "", **names}
    if rings := ring_names(layout):
        plot.add_layout(_axis(rings), "below" if layout.n >= BY_RING else "above")
    if rings and layout.n >= BY_RING:  # as ticks, instead of actuators
        actuators, numbers = plot.below
        actuators.visible, numbers.axis_label = False, "ring"
    plot.x_range.range_padding = 0.04  # the first and the last dot shall not be cut
    plot.y_range.range_padding = 0.15
    _add_actuator_tools(plot, dots, layers)


def _axis(names: dict[float, str]) -> LinearAxis:
    """Return an axis without line that has names at some places."""
    looks: dict[str, Any] = {"ticker": FixedTicker(ticks=list(names)),
                             "major_label_overrides": names}  # fmt: skip
    return LinearAxis(
        axis_line_color=None, major_tick_line_color=None, minor_tick_line_color=None,
        major_label_text_font=FONT, major_label_text_color=INK, axis_label_text_font=FONT,
        axis_label_text_font_style="normal", **looks,
    )  # fmt: skip


def _empty_plot(**size: Any) -> Plot:
    """Return an empty figure in the style of the page, by default as wide as the page."""
    size = size or {"sizing_mode": "stretch_width", "height": 300}
    tools = [PanTool(), BoxZoomTool(), WheelZoomTool(), ResetTool(), SaveTool()]
    plot = figure(tools=tools, toolbar_location="above", min_border=4, **size)
    plot.toolbar.logo = None
    plot.toolbar.active_drag = None  # so that a finger scrolls the page
    plot.toolbar.active_scroll = None
    plot.outline_line_color = None
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font = plot.axis.major_label_text_font = FONT
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = INK
    plot.grid.grid_line_color = "#e4e4e4"
    return plot


def _add_actuator_tools(plot: Plot, dots: Any, layers: tuple[Layer, ...]) -> None:
    """Add tooltips, and tools that select actuators in all views."""
    tooltips = [("actuator", "@called"), ("ring", "@ring"), ("x, y", "@x{0.0}, @y{0.0} mm")]
    tooltips += [(layer.name, f"@{layer.key}_text {layer.unit}".rstrip()) for layer in layers]
    plot.add_tools(
        HoverTool(renderers=[dots], tooltips=tooltips, visible=False),
        TapTool(renderers=[dots]),
        BoxSelectTool(renderers=[dots]),
        LassoSelectTool(renderers=[dots]),
    )


@dataclass(frozen=True)
class View:
    """A figure of Bokeh: key for links, title, caption, and what it shows for screen readers."""

    key: str
    title: str
    plot: Plot
    caption: str
    more: str = ""


@dataclass(frozen=True)
class Actuators:
    """The actuators with their layers; the map first, then a figure by ring."""

    layout: Layout
    layers: tuple[Layer, ...]
    views: tuple[View, View]


def calibration_views(
    c: Calibration, evidence: Evidence | None, edges: Sequence[Array] = ()
) -> Actuators:
    """Return the views of alpha; edges of the glass are (vertices, 2) polygons [m]."""
    layers = layers_of(c, evidence)
    source, rings, alpha = actuator_source(c.layout, layers), _rings(c.layout), c.alpha
    known = np.unique(rings[np.isfinite(alpha)]).tolist()
    means = ", ".join(f"{k}: {np.nanmean(alpha[rings == k]):.3f}" for k in known)
    by = "by ring" if len(known) > 1 else "by actuator"
    by_ring = View("rings", f"Alpha {by}", alpha_by_ring(source, c, layers),
                   "Bars: ±3 σ_stat, hidden if smaller than the symbols.",
                   f"Mean alpha by ring: {means}.")  # fmt: skip
    return _with_map("Map of the mirror", source, c.layout, layers, edges, by_ring)


def change_views(change: AnyChange, edges: Sequence[Array] = ()) -> Actuators:
    """Return the views of what changed; edges (vertices, 2) [m]."""
    layers, layout, limit = change_layers(change), change.layout, np.nan
    source, title = actuator_source(layout, layers), "Change by ring"
    caption = "New alpha / old alpha, relative to the mean of the actuators that did not change."
    if isinstance(change, Change):
        limit = change.limit
        caption = f"Dashed: limit of {limit:.1f} sigma (exceeded by chance in 1 % of comparisons)."
    by_ring = View("rings", title, change_by_ring(source, layout, layers, limit), caption)
    return _with_map("Map of the change", source, layout, layers, edges, by_ring)


def _with_map(
    title: str,
    source: ColumnDataSource,
    layout: Layout,
    layers: tuple[Layer, ...],
    edges: Sequence[Array],
    by_ring: View,
) -> Actuators:
    caption = "Seen along -z. Red: outliers." + (" Lines: edges of the glass." if edges else "")
    more = (
        f"{counted(layout.n, 'actuator')}, coloured by the layer selected below. The table of"
        " actuators contains all values."
    )
    shown = View("map", title, mirror_map(source, layout, layers, edges), caption, more)
    return Actuators(layout, layers, (shown, by_ring))
