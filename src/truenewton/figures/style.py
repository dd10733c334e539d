"""How figures look: colours, sizes and fonts of a journal column."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


COLUMN = 8.4 / 2.54  # width of the paper's column [inch]
MILLIMETRE = 1e-3
STYLE: Any = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.8,
    "pdf.fonttype": 42,
}
COLOURS = "cividis"  # of values, in matplotlib; Bokeh writes it with a capital
SIGNED_COLOURS = "PuOr_r"  # of values about zero; negative purple, as in Bokeh
INK, FAINT, ACCENT, ALARM = "#1a1a1a", "#9a9a9a", "#00457c", "#a63603"
# Of several curves; they differ in lightness too, so that they stay apart in grey.
CURVES = ("#00457c", "#c8891c", "#4f8f6b", "#8c3d88", "#5c5c5c")


def new_axes(height: float) -> Axes:
    """Return axes on a figure of its own, one column wide and ``height`` columns high."""
    figure = Figure(figsize=(COLUMN, height * COLUMN), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.add_subplot()
