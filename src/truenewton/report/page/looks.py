"""How the page's figures look: fonts, colours and tools that all share."""

from __future__ import annotations

from typing import Any

from bokeh.models import BoxZoomTool, PanTool, ResetTool, SaveTool, WheelZoomTool
from bokeh.plotting import figure

from truenewton.figures.style import INK

FONT = "system-ui, sans-serif"
Plot = Any  # a figure of Bokeh, whose stubs lack many options


def empty_plot(height: int | None = 300, *, aspect: bool = False, **options: Any) -> Plot:
    """Return an empty figure in the page's looks."""
    size: dict[str, Any] = (
        {"sizing_mode": "scale_width", "aspect_ratio": 0.92, "match_aspect": True}
        if aspect
        else {"sizing_mode": "stretch_width", "height": height}
    )
    tools = [PanTool(), BoxZoomTool(), WheelZoomTool(), ResetTool(), SaveTool()]
    plot = figure(tools=tools, toolbar_location="above", min_border=4, **size, **options)
    plot.toolbar.logo = None
    plot.toolbar.active_drag = None  # so that a finger scrolls the page
    plot.toolbar.active_scroll = None
    plot.outline_line_color = None
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font = plot.axis.major_label_text_font = FONT
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = INK
    plot.grid.grid_line_color = "#e4e4e4"
    return plot
