"""Maps of a mirror: the actuators (paper, fig. 2), alpha or another value at each (fig. 6).

Drawn at the width of a journal's column. Every call takes axes or makes its own, and returns them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.figures.style import COLOURS, CROWDED, FAINT, INK, MILLIMETRE, NAMED, styled_axes
from truenewton.rounding import significant
from truenewton.statics.layout import Layout, group_name, group_of, ring_centre, ring_of

NUMBER = 0.045  # half the height of a segment's number, over the mirror's radius
MIN_DOT = 0.02  # radius of a dot with room for three digits, over the width of the mirror
MIN_RING, WIDE_RING = 0.03, 0.15  # of all actuators: room for a ring's number, for its name
ALPHA_LABEL = r"$\alpha$  (true N / commanded N)"


def numbers_by_ring(layout: Layout) -> NDArray[np.int64]:
    """Return (n,) numbers of the actuators from 1, ring by ring outward, or segment by segment."""
    return np.argsort(np.argsort(group_of(layout), kind="stable")) + 1


def names_by_ring(layout: Layout) -> dict[int, str]:
    """Return the IDs by number ring by ring; empty if they are equal."""
    numbers = numbers_by_ring(layout)
    if np.array_equal(numbers, layout.id):
        return {}
    return {int(k): str(name) for k, name in zip(numbers, layout.id, strict=True)}


def ring_edges(layout: Layout) -> Array:
    """Return (rings - 1,) positions between rings on an axis of actuators numbered ring by ring."""
    return np.asarray(np.cumsum(np.bincount(group_of(layout)))[:-1] + 0.5)


def ring_label(layout: Layout) -> str:
    """Return the label of an axis of actuators numbered ring by ring."""
    if layout.segments:
        return "actuator, segment by segment"
    return "actuator, ring by ring from the centre" if ring_edges(layout).size else "actuator"


def ring_radii(layout: Layout) -> list[float]:
    """Return the mean radius of each ring [mm]; empty for segments or without rings."""
    if layout.segments:
        return []
    (x, y), ring = ring_centre(layout), ring_of(layout)
    radius = np.hypot(layout.x - x, layout.y - y) / MILLIMETRE
    return [float(radius[ring == k].mean()) for k in range(ring.max() + 1) if ring.any()]


def mark_rings(ax: Axes, layout: Layout) -> None:
    """Label an axis of actuators and its ticks, and draw lines between the rings."""
    if names := names_by_ring(layout):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda place, _: names.get(round(place), "")))
    for edge in ring_edges(layout):
        ax.axvline(edge, color=FAINT, linewidth=0.5, linestyle=":", zorder=0)
    ax.set_xlabel(ring_label(layout))


def ring_names(layout: Layout) -> dict[float, str]:
    """Return the names of rings or segments by their middle on an axis, if there is room."""
    counts, kind = np.bincount(group_of(layout)), group_name(layout)
    names = layout.segments or tuple(range(1, counts.size + 1))
    middles = np.cumsum(counts) - 0.5 * (counts - 1)
    return {
        float(middle): f"{kind} {ring}" if count >= WIDE_RING * layout.n else str(ring)
        for ring, count, middle in zip(names, counts, middles, strict=True)
        if counts.size > 1 and count >= MIN_RING * layout.n
    }


def name_rings(ax: Axes, layout: Layout) -> None:
    """Write the names of the rings above an axis of actuators."""
    for middle, name in ring_names(layout).items():
        ax.text(middle, 0.985, name, transform=ax.get_xaxis_transform(),
                ha="center", va="top", fontsize=6.0, color=INK)  # fmt: skip


def name_point(ax: Axes, name: object, x: float, y: float, points: int = 3, **looks: Any) -> None:
    """Write a name a number of points to the right of a mark."""
    ax.annotate(str(name), (x, y), xytext=(points, 0), textcoords="offset points", fontsize=6.0,
                va="center", **looks)  # fmt: skip


def plot_layout(layout: Layout, ax: Axes | None = None, edges: Sequence[Array] = ()) -> Axes:
    """Draw the actuators with their names, rings and axes (paper, fig. 2).

    Edges of the glass, (vertices, 2) polygons [m], are drawn if they are given.
    """
    with styled_axes(ax, 1.0) as ax:
        _frame(layout, ax, max((np.hypot(*edge.T).max() for edge in edges), default=0.0))
        for edge in edges:
            ax.add_patch(Polygon(edge / MILLIMETRE, fill=False, color=INK, linewidth=0.8, zorder=0))
        _mark_view(ax)
        ax.add_collection(
            PatchCollection(_circles(layout), facecolor="white", edgecolor=INK, linewidth=0.6)
        )
        if bears_names(layout):
            for name, x, y in zip(layout.id, layout.x, layout.y, strict=True):
                ax.text(x / MILLIMETRE, y / MILLIMETRE, str(name), ha="center", va="center",
                        fontsize=5.5)  # fmt: skip
        _name_segments(ax, layout)
    return ax


def plot_map(
    layout: Layout,
    values: Array,
    ax: Axes | None = None,
    *,
    label: str = ALPHA_LABEL,
    colours: str = COLOURS,
    limits: tuple[float, float] | None = None,
    numbers: bool = False,
) -> Axes:
    """Draw (n,) values on the map of the actuators, rings and axes as in fig. 2 (paper, fig. 6).

    Up to a hundred actuators have their names, if dots have room; with ``numbers`` also their
    values. An actuator without a value (disabled) is an open circle. With many actuators the
    colours end at the 1st and 99th percentiles, otherwise at the extremes or at ``limits``.
    """
    with styled_axes(ax, 1.02) as ax:
        _frame(layout, ax)
        known = np.isfinite(values)
        patches = np.array(_circles(layout), dtype=object)
        ax.add_collection(
            PatchCollection(patches[~known], facecolor="none", edgecolor=FAINT, linewidth=0.6)
        )
        rim = 0.3 if layout.n <= CROWDED else 0.0
        dots = PatchCollection(patches[known], cmap=colours, edgecolor=INK, linewidth=rim)
        dots.set_array(values[known])
        clipped = layout.n > NAMED or limits is not None
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
        if bears_names(layout) or (numbers and layout.n <= NAMED):
            for name, x, y, value in zip(layout.id, layout.x, layout.y, values, strict=True):
                light = np.dot(dots.to_rgba(value)[:3], [0.299, 0.587, 0.114])
                colour = INK if light > 0.5 else "white"
                text = (
                    f"{name}\n{significant(value, 3)}"
                    if numbers and np.isfinite(value)
                    else str(name)
                )
                ax.text(x / MILLIMETRE, y / MILLIMETRE, text, ha="center", va="center",
                        fontsize=4.0 if numbers else 5.0, linespacing=1.0,
                        color=colour if np.isfinite(value) else FAINT)  # fmt: skip
        _name_segments(ax, layout)
    return ax


def _frame(layout: Layout, ax: Axes, glass: float = 0.0) -> None:
    """Draw rings and axes [mm], seen along -z, with room for a glass of a radius [m]."""
    x, y = ring_centre(layout)
    for radius in ring_radii(layout):
        ax.add_patch(
            Circle(
                (x / MILLIMETRE, y / MILLIMETRE),
                radius,
                fill=False,
                color=FAINT,
                linewidth=0.4,
                zorder=0,
            )
        )
    farthest = np.hypot(layout.x, layout.y).max() / MILLIMETRE
    named = 1.1 * max((np.hypot(x, y) for _, x, y in segment_places(layout)), default=0.0)
    reach = 1.08 * max(farthest + dot_radius(layout), glass / MILLIMETRE, named)
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    for name, (x, y), ha, va in (("$x$", (reach, 0.0), "right", "bottom"),
                                 ("$y$", (0.0, reach), "left", "top")):  # fmt: skip
        ax.annotate("", (x, y), (-x, -y), arrowprops=arrow, zorder=0)
        ax.annotate(name, (x, y), xytext=(2, 2), textcoords="offset points", ha=ha, va=va)
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_axis_off()
    bar = _round_length(farthest / 2)
    ax.plot([reach - bar, reach], [-0.97 * reach] * 2, color=INK, linewidth=1.0,
            solid_capstyle="butt")  # fmt: skip
    ax.text(reach - bar / 2, -0.95 * reach, f"{bar:g} mm", ha="center", va="bottom", fontsize=6.5)


def segment_places(layout: Layout) -> list[tuple[int, float, float]]:
    """Return number, x and y [mm] for the name of each segment.

    It is outside the segment, away from the middle of the mirror, or at its centre if there is no
    room.
    """
    x, y, dot = layout.x / MILLIMETRE, layout.y / MILLIMETRE, dot_radius(layout)
    away = dot + max(2.0 * dot, NUMBER * float(np.hypot(x, y).max()))
    places = []
    for number in layout.segments:
        own = np.asarray(layout.segment) == number
        at = middle_x, middle_y = float(x[own].mean()), float(y[own].mean())
        first = np.arctan2(middle_y - y.mean(), middle_x - x.mean())
        for angle in first + np.radians(45.0) * np.arange(8):
            along = np.array([np.cos(angle), np.sin(angle)])
            reach = float((along @ [x[own] - middle_x, y[own] - middle_y]).max()) + away
            beyond_x, beyond_y = middle_x + reach * along[0], middle_y + reach * along[1]
            if np.hypot(x - beyond_x, y - beyond_y).min() > 0.9 * away:
                at = float(beyond_x), float(beyond_y)
                break
        places.append((number, *at))
    return places


def _name_segments(ax: Axes, layout: Layout) -> None:
    """Write the number of each segment, over dots with a rim of white."""
    from matplotlib.patheffects import withStroke

    rim = [withStroke(linewidth=2.0, foreground="white")]
    for number, x, y in segment_places(layout):
        ax.text(x, y, str(number), ha="center", va="center", fontsize=9.0, fontweight="bold",
                color=INK, path_effects=rim)  # fmt: skip


def _mark_view(ax: Axes) -> None:
    """Draw z, towards the reader, in the lower left corner, and label the direction of view."""
    looks: Any = {"transform": ax.transAxes, "color": INK, "linestyle": "none"}
    for size in (6.0, 1.2):  # the point of an arrow
        ax.plot([0.03], [0.03], "o", markersize=size, markeredgewidth=0.6,
                markerfacecolor="none", **looks)  # fmt: skip
    ax.text(0.06, 0.03, r"$z$, seen along $-z$", fontsize=6.5, va="center",
            transform=ax.transAxes)  # fmt: skip


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten below a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(k for k in (1, 2, 5) if k * power <= length))


def bears_names(layout: Layout) -> bool:
    """Return whether dots are few and large enough for the names of their actuators."""
    across = max(np.ptp(layout.x), np.ptp(layout.y)) / MILLIMETRE
    return layout.n <= NAMED and bool(dot_radius(layout) >= MIN_DOT * across)


def dot_radius(layout: Layout) -> float:
    """Return the radius of a dot that does not touch its neighbours [mm]."""
    from scipy.spatial import cKDTree

    if layout.n == 1:
        return 1.0
    points = np.stack([layout.x, layout.y], axis=1) / MILLIMETRE
    distance = np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1]
    return float(0.42 * np.median(distance))


def _circles(layout: Layout) -> list[Circle]:
    """Return a dot for each actuator, in millimetres."""
    radius = dot_radius(layout)
    return [
        Circle((x / MILLIMETRE, y / MILLIMETRE), radius)
        for x, y in zip(layout.x, layout.y, strict=True)
    ]
