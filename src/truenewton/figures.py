"""The paper's figures: the actuators (2), alpha with errors (5), alpha on the map (6).

Drawn at the width of a journal's column. Every call takes axes or makes its own, and returns them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from truenewton.actuators import Array, Layout, ring_of
from truenewton.colours import ACCENT, COLOURS, FAINT, INK
from truenewton.errors import OutputFailed
from truenewton.outputs import file_beside, folder_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from truenewton.calibration import Calibration

COLUMN = 8.4 / 2.54  # width of the paper's column [inch]
MILLIMETRE = 1e-3
ALPHA_LABEL = r"$\alpha$  (true N / commanded N)"
STYLE: Any = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.8,
    "pdf.fonttype": 42,
}


def new_axes(height: float) -> Axes:
    """Return axes on a figure of its own, one column wide and ``height`` columns high."""
    figure = Figure(figsize=(COLUMN, height * COLUMN), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def plot_layout(layout: Layout, ax: Axes | None = None) -> Axes:
    """Draw the actuators with their names, rings and axes (paper, fig. 2)."""
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(1.0)
        _frame(layout, ax)
        ax.add_collection(
            PatchCollection(circles(layout), facecolor="white", edgecolor=INK, linewidth=0.6)
        )
        if layout.n <= 100:
            for name, x, y in zip(layout.id, layout.x, layout.y, strict=True):
                ax.text(x / MILLIMETRE, y / MILLIMETRE, str(name), ha="center", va="center",
                        fontsize=5.5)  # fmt: skip
    return ax


def plot_map(
    layout: Layout,
    values: Array,
    ax: Axes | None = None,
    *,
    label: str = ALPHA_LABEL,
    colours: str = COLOURS,
    limits: tuple[float, float] | None = None,
) -> Axes:
    """Draw values on the map of the actuators, rings and axes as in fig. 2 (paper, fig. 6).

    An actuator without a value (disabled) is an open circle. Among many, the few farthest out take
    up no colours of their own, unless ``limits`` say where the colours end.
    """
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(1.02)
        _frame(layout, ax)
        known = np.isfinite(values)
        patches = np.array(circles(layout), dtype=object)
        ax.add_collection(
            PatchCollection(patches[~known], facecolor="none", edgecolor=FAINT, linewidth=0.6)
        )
        dots = PatchCollection(patches[known], cmap=colours, edgecolor=INK, linewidth=0.3)
        dots.set_array(values[known])
        clipped = layout.n > 100 or limits is not None
        if clipped:
            ends = limits or np.percentile(values[known], [1.0, 99.0])
            dots.set_clim(float(ends[0]), float(ends[1]))
        ax.add_collection(dots)
        bar = ax.figure.colorbar(
            dots,
            ax=ax,
            orientation="horizontal",
            fraction=0.05,
            pad=0.02,
            aspect=35,
            extend="both" if clipped else "neither",
        )
        bar.set_label(label)
        bar.outline.set_linewidth(0.4)
        if layout.n <= 100:
            for name, x, y, value in zip(layout.id, layout.x, layout.y, values, strict=True):
                light = np.dot(dots.to_rgba(value)[:3], [0.299, 0.587, 0.114])
                colour = INK if light > 0.5 else "white"
                ax.text(x / MILLIMETRE, y / MILLIMETRE, str(name), ha="center", va="center",
                        fontsize=5.0, color=colour if np.isfinite(value) else FAINT)  # fmt: skip
    return ax


def plot_actuators(calibration: Calibration, ax: Axes | None = None) -> Axes:
    """Draw alpha per actuator, ring by ring, with error bars (paper, fig. 5).

    The bars are three standard uncertainties from the readings (3 E_STAT), the paper's level. The
    error of the common scale moves all points together: it stands above.
    """
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.75)
        layout, alpha = calibration.layout, calibration.alpha
        bars = 3 * calibration.statistical
        ring = ring_of(layout)
        order = np.argsort(ring, kind="stable")
        place = np.arange(1, layout.n + 1)
        few = layout.n <= 100
        ax.errorbar(
            place, alpha[order], yerr=bars[order], fmt="o", color=ACCENT, ecolor=INK,
            markersize=1.8 if few else 1.0, elinewidth=0.6, capsize=1.5 if few else 0.0,
        )  # fmt: skip
        edges = np.flatnonzero(np.diff(ring[order])) + 1.5
        for edge in edges:
            ax.axvline(edge, color=FAINT, linewidth=0.5, linestyle=":", zorder=0)
        ax.set_xlim(-0.02 * layout.n, 1.02 * layout.n + 1)
        for extreme in (np.nanargmin(alpha), np.nanargmax(alpha)):
            at = (place[order == extreme][0], alpha[extreme])
            ax.annotate(str(layout.id[extreme]), at, xytext=(3, 0), textcoords="offset points",
                        fontsize=6.0, va="center")  # fmt: skip
        ax.set_xlabel("actuator, ring by ring from the centre" if len(edges) else "actuator")
        ax.set_ylabel(ALPHA_LABEL)
        ax.margins(y=0.12)
        note = "bars: 3σ, readings"
        if calibration.scale != "mean 1":
            scale = np.nanmedian(calibration.systematic_error / np.abs(alpha))
            note += f"; common scale ±{100 * scale:.1f} % (1σ)"
        else:
            note += f"; scale: {calibration.scale}"
        ax.set_title(note, loc="right", fontsize=6.5, color=INK)
    return ax


def plot_step_responses(
    time: Array, position: Array, stiffness: Array, ax: Axes | None = None
) -> Axes:
    """Draw how modes answer a step of the closed loop.

    Parameters
    ----------
    time
        (steps,) since the command [s].
    position
        (steps, m) displacement in units of what was commanded.
    stiffness
        (m,) of the modes [N/m].
    ax
        Axes to draw on; their own unless given.
    """
    with mpl.rc_context(STYLE):
        ax = ax or new_axes(0.72)
        ax.axhspan(0.9, 1.1, color=FAINT, alpha=0.25, linewidth=0)
        ax.axhline(1.0, color=FAINT, linewidth=0.5)
        # Even in lightness apart, and told apart by their dashes in print.
        looks = zip(mpl.colormaps[COLOURS](np.linspace(0.0, 0.8, len(stiffness))),
                    ("-", "--", "-.") * len(stiffness), strict=False)  # fmt: skip
        for response, k, (colour, dashes) in zip(position.T, stiffness, looks, strict=True):
            power = int(np.floor(np.log10(k)))
            label = rf"${k / 10.0**power:.1f} \times 10^{power}$ N/m"
            ax.plot(1e3 * time, response, color=colour, linestyle=dashes, label=label)
        ax.set_xlabel("time since the command (ms)")
        ax.set_ylabel("displacement / command")
        ax.set_xlim(0, 1e3 * time[-1])
        ax.legend(title="stiffness of the mode", frameon=False, fontsize=6.5, title_fontsize=6.5)
        ax.set_title("band: ±10 %", loc="right", fontsize=6.5, color=INK)
    return ax


def write_figures(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    more: Mapping[str, Callable[[], Axes]] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write figures 2, 5 and 6, and more by name, as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    figures: dict[str, Callable[[], Axes]] = {
        "fig2-actuators": lambda: plot_layout(calibration.layout),
        "fig5-alpha": lambda: plot_actuators(calibration),
        "fig6-alpha-map": lambda: plot_map(calibration.layout, calibration.alpha),
        **(more or {}),
    }
    return write_drawn(figures, folder, overwrite=overwrite)


def write_drawn(
    figures: Mapping[str, Callable[[], Axes]],
    folder: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Draw figures and write them, by name, as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    names = []
    with folder_beside(folder, (".pdf", ".png"), overwrite=overwrite) as temporary:
        for name, draw in figures.items():
            figure = _figure_of(draw())
            for suffix in (".pdf", ".png"):
                _save(figure, temporary / (name + suffix))
                names.append(name + suffix)
    return [Path(folder) / name for name in names]


def write_figure(ax: Axes, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the figure of some axes as PNG, PDF or SVG, whatever the name ends in.

    Raises
    ------
    OutputExists, OutputFailed
    """
    if Path(path).suffix not in (".png", ".pdf", ".svg"):
        raise OutputFailed(
            "is no name for a figure", remedy="let it end in .png, .pdf or .svg", path=path
        )
    with file_beside(path, overwrite=overwrite) as temporary:
        _save(_figure_of(ax), temporary)


def _save(figure: Figure, path: Path) -> None:
    """Save a figure without a date in it: the same data give the same bytes."""
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    figure.savefig(path, dpi=300, metadata=undated.get(path.suffix, {}))


def _figure_of(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes have been taken off their figure")
    return figure


def _frame(layout: Layout, ax: Axes) -> None:
    """Draw rings and axes, in millimetres, seen along -z."""
    radius = np.hypot(layout.x, layout.y) / MILLIMETRE
    ring = ring_of(layout)
    if ring.max() > 0:
        for k in range(ring.max() + 1):
            r = radius[ring == k].mean()
            ax.add_patch(Circle((0, 0), r, fill=False, color=FAINT, linewidth=0.4, zorder=0))
    reach = 1.08 * (radius.max() + _dot(layout))
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    for name, (x, y), ha, va in (("$x$", (reach, 0.0), "right", "bottom"),
                                 ("$y$", (0.0, reach), "left", "top")):  # fmt: skip
        ax.annotate("", (x, y), (-x, -y), arrowprops=arrow, zorder=0)
        ax.annotate(name, (x, y), xytext=(2, 2), textcoords="offset points", ha=ha, va=va)
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_axis_off()
    bar = _round_length(radius.max() / 2)
    ax.plot([reach - bar, reach], [-0.97 * reach] * 2, color=INK, linewidth=1.0,
            solid_capstyle="butt")  # fmt: skip
    ax.text(reach - bar / 2, -0.95 * reach, f"{bar:g} mm", ha="center", va="bottom", fontsize=6.5)


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten below a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(k for k in (1, 2, 5) if k * power <= length))


def _dot(layout: Layout) -> float:
    """Return the radius of a dot that leaves its neighbours free [mm]."""
    from scipy.spatial import cKDTree

    if layout.n == 1:
        return 1.0
    points = np.stack([layout.x, layout.y], axis=1) / MILLIMETRE
    distance = np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1]
    return float(0.42 * np.median(distance))


def circles(layout: Layout) -> list[Circle]:
    """Return a dot for each actuator, in millimetres."""
    radius = _dot(layout)
    return [
        Circle((x / MILLIMETRE, y / MILLIMETRE), radius)
        for x, y in zip(layout.x, layout.y, strict=True)
    ]
