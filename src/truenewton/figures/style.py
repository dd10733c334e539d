"""How figures look: colours, sizes and fonts of a journal column."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

COLUMN = 8.4 / 2.54  # width of the paper's column [inch]
MILLIMETRE = 1e-3
# Labels of quantities, the same in every figure. Unicode: matplotlib's formulas take 0.2 s to load.
ALPHA = "α (true N / commanded N)"
SIGMA_STAT = "statistical σ_stat (E_STAT)"
SIGMA_SCALE = "scale σ_scale (E_SYST)"
SIGMA = "total σ (E_ALPHA)"
COLOURS = "cividis"  # of values, in matplotlib; Bokeh writes it with a capital
DIVERGING = "PuOr_r"  # of values about a centre; below it purple, as in Bokeh
INK, FAINT, ACCENT, ALARM = "#1a1a1a", "#9a9a9a", "#00457c", "#a63603"
# Of several curves; they differ in lightness too, so that they stay apart in grey.
CURVES = ("#00457c", "#c8891c", "#4f8f6b", "#8c3d88", "#5c5c5c")
STYLE: Any = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.8,
}
# Fonts are embedded when a figure is saved, not when it is drawn. Journals take TrueType (42).
FONTS: Any = {"pdf.fonttype": 42, "ps.fonttype": 42}
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")  # without formulas
LONGEST = 40  # letters of a label; longer ones would leave no room for the axes
NAMED = 100  # actuators; more have no names on a map
BY_RING = 300  # actuators; the axis of more has rings as ticks, not actuators
CROWDED = 1000  # actuators; with more, outlines would hide the colours
_ON_SCREEN: ContextVar[bool] = ContextVar("on_screen", default=False)


class ColumnFigure(Figure):
    """A figure whose fonts are always embedded as TrueType."""

    def savefig(self, fname: Any, **kwargs: Any) -> None:
        """Save it as any figure."""
        with mpl.rc_context(FONTS):
            super().savefig(fname, **kwargs)


def new_figure(height: float) -> Figure:
    """Return a figure one column wide and ``height`` columns high."""
    size = (COLUMN, height * COLUMN)
    if _ON_SCREEN.get():
        from matplotlib import pyplot

        return pyplot.figure(figsize=size, layout="constrained", FigureClass=ColumnFigure)
    figure = ColumnFigure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@contextmanager
def on_screen() -> Iterator[None]:
    """Let new axes be pyplot's, so that they show in Jupyter and in windows.

    Files and pages are made without pyplot, which would keep their figures open.
    """
    before = _ON_SCREEN.set(True)
    try:
        yield
    finally:
        _ON_SCREEN.reset(before)


@contextmanager
def styled_axes(ax: Axes | None, height: float) -> Iterator[Axes]:
    """Yield the axes given, or new ones ``height`` columns high, in the style of this module."""
    # The first figure of pyplot sets its backend up, which the context would undo.
    figure = ax.figure if ax else new_figure(height)
    with mpl.rc_context(STYLE):
        yield ax or figure.add_subplot()


def legend_above(ax: Axes) -> None:
    """Put the legend of labelled curves above the axes, where it covers none of them."""
    longest = max(map(len, ax.get_legend_handles_labels()[1]))
    beside = max(1, min(4, 60 // (longest + 9)))  # of a line of some sixty letters
    ax.legend(ncols=beside, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.2)


def plain_ticks(*axes: Axis) -> None:
    """Label ticks of logarithmic axes at 1, 2 and 5, of many decades at 1, without formulas."""
    for axis in axes:
        low, high = axis.get_view_interval()
        some = (1.0,) if high > 300 * low else (1.0, 2.0, 5.0) if high > 5 * low else range(1, 10)
        axis.set_major_locator(LogLocator(subs=some))
        axis.set_major_formatter(FuncFormatter(_plain_number))
        axis.set_minor_locator(NullLocator())  # each tick takes as long as a label


def _plain_number(value: float, _: int) -> str:
    """Return the number of a tick, '0.001' or '2·10⁻⁶'."""
    factor, e, exponent = f"{value:g}".partition("e")
    power = str(int(exponent)).translate(RAISED) if e else ""
    return factor if not e else f"10{power}" if factor == "1" else f"{factor}·10{power}"


def label_line(ax: Axes, level: float, text: str) -> None:
    """Draw a level across the axes, dashed, and write its meaning outside them, at the right."""
    ax.axhline(level, color=INK, linewidth=0.6, linestyle="--", zorder=1)
    ax.annotate(text, (1.0, level), xycoords=("axes fraction", "data"), xytext=(2, 0),
                textcoords="offset points", va="center", fontsize=6.5)  # fmt: skip


def plain(text: str) -> str:
    """Return a name from a file as a label: one line, not too long, without formulas."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return (line if len(line) <= LONGEST else f"{line[:LONGEST]}...").replace("$", r"\$")
