"""Places on a mirror: rings on an axis and on a map, names, and the actuators (paper, fig. 2)."""

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
from truenewton.figures.style import ALARM, BY_RING, FAINT, INK, MILLIMETRE, NAMED, styled_axes
from truenewton.statics.layout import Layout, ring_centre, ring_of

NUMBER = 0.045  # half the height of a segment's number, over the mirror's radius
MIN_DOT = 0.02  # radius of a dot with room for three digits, over the width of the mirror
MIN_RING, WIDE_RING = 0.03, 0.15  # of all actuators: room for a ring's number, for its name


def numbers_by_ring(layout: Layout) -> NDArray[np.int64]:
    """Return (n,) numbers of the actuators from 1, ring by ring outward."""
    return np.argsort(np.argsort(ring_of(layout), kind="stable")) + 1


def names_by_ring(layout: Layout) -> dict[int, str]:
    """Return the IDs by number ring by ring; empty if they are equal."""
    numbers = numbers_by_ring(layout)
    if np.array_equal(numbers, layout.id):
        return {}
    return {int(k): str(name) for k, name in zip(numbers, layout.id, strict=True)}


def ring_edges(layout: Layout) -> Array:
    """Return (rings - 1,) positions between rings on an axis of actuators numbered ring by ring."""
    return np.asarray(np.cumsum(np.bincount(ring_of(layout)))[:-1] + 0.5)


def ring_label(layout: Layout) -> str:
    """Return the label of an axis of actuators numbered ring by ring."""
    return "actuator, ring by ring from the centre" if ring_edges(layout).size else "actuator"


def ring_radii(layout: Layout) -> list[float]:
    """Return the mean radius of each ring [mm]; empty for segments or without rings."""
    if layout.segments:
        return []
    (x, y), ring = ring_centre(layout), ring_of(layout)
    radius = np.hypot(layout.x - x, layout.y - y) / MILLIMETRE
    return [float(radius[ring == k].mean()) for k in range(ring.max() + 1) if ring.any()]


def mark_rings(ax: Axes, layout: Layout) -> None:
    """Label an axis of actuators, and draw lines between the rings; ticks of many are rings."""
    for edge in ring_edges(layout):
        ax.axvline(edge, color=FAINT, linewidth=0.5, linestyle=":", zorder=0)
    rings = ring_names(layout) if layout.n >= BY_RING else {}
    if rings:
        ax.set_xticks(list(rings), [name.removeprefix("ring ") for name in rings.values()])
        ax.tick_params(axis="x", length=0)
    elif names := names_by_ring(layout):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda place, _: names.get(round(place), "")))
    ax.set_xlabel("ring, one point for each actuator" if rings else ring_label(layout))


def ring_names(layout: Layout) -> dict[float, str]:
    """Return the names of rings by their middle on an axis, if there is room."""
    counts = np.bincount(ring_of(layout))
    middles = np.cumsum(counts) - 0.5 * (counts - 1)
    return {
        float(middle): f"ring {ring}" if count >= WIDE_RING * layout.n else str(ring)
        for ring, (count, middle) in enumerate(zip(counts, middles, strict=True), 1)
        if counts.size > 1 and count >= MIN_RING * layout.n
    }


def name_rings(ax: Axes, layout: Layout) -> None:
    """Write the names of the rings above an axis of actuators, if they are not its ticks."""
    for middle, name in ring_names(layout).items() if layout.n < BY_RING else ():
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
    with styled_axes(ax, 1.07) as ax:
        draw_frame(layout, ax, max((np.hypot(*edge.T).max() for edge in edges), default=0.0))
        for edge in edges:
            ax.add_patch(Polygon(edge / MILLIMETRE, fill=False, color=INK, linewidth=0.8, zorder=0))
        every = np.ones(layout.n, dtype=bool)
        draw_dots(ax, layout, every, facecolor="white", edgecolor=INK, linewidth=0.6)
        if bears_names(layout):
            for name, x, y in zip(layout.id, layout.x, layout.y, strict=True):
                ax.text(x / MILLIMETRE, y / MILLIMETRE, str(name), ha="center", va="center",
                        fontsize=5.5)  # fmt: skip
        name_segments(ax, layout)
    return ax


def draw_dots(ax: Axes, layout: Layout, some: NDArray[np.bool_], **looks: Any) -> PatchCollection:
    """Draw the dots of (n,) some actuators; return them."""
    radius = dot_radius(layout)
    places = zip(layout.x[some] / MILLIMETRE, layout.y[some] / MILLIMETRE, strict=True)
    dots = PatchCollection([Circle(place, radius) for place in places], **looks)
    ax.add_collection(dots)
    return dots


def name_outside(ax: Axes, layout: Layout, which: NDArray[np.int64]) -> None:
    """Write the IDs of (k,) actuators around the map, each with a line to its dot."""
    for k, x, y in outside_places(layout, which):
        ax.plot([layout.x[k] / MILLIMETRE, x], [layout.y[k] / MILLIMETRE, y], color=ALARM,
                linewidth=0.5)  # fmt: skip
        ax.text(x, y, str(layout.id[k]), fontsize=6.0, color=ALARM, va="center",
                ha="left" if x > 0 else "right")  # fmt: skip


def outside_places(layout: Layout, which: NDArray[np.int64]) -> list[tuple[int, float, float]]:
    """Return (k,) actuators with x and y [mm] for their IDs around the map, clear of its axes."""
    reach = 1.02 * float(np.hypot(layout.x, layout.y).max()) / MILLIMETRE + dot_radius(layout)
    places: list[tuple[int, float, float]] = []
    angles = np.arctan2(layout.y[which], layout.x[which])
    least = -np.pi
    for k in np.argsort(angles).tolist():
        from_axis = (angles[k] + np.pi / 4) % (np.pi / 2) - np.pi / 4
        text = 0.1 + 0.05 * abs(np.sin(angles[k]))  # angle that a name takes, seen from the centre
        clear = angles[k] - from_axis + np.copysign(max(abs(from_axis), 0.7 * text), from_axis)
        least = max(least, float(clear))
        places.append((int(which[k]), reach * np.cos(least), reach * np.sin(least)))
        least += text
    return places


def draw_frame(layout: Layout, ax: Axes, glass: float = 0.0) -> None:
    """Draw rings with their numbers and axes [mm], seen along -z, about a glass of a radius [m]."""
    farthest = float(np.hypot(layout.x, layout.y).max()) / MILLIMETRE
    named = 1.1 * max((np.hypot(x, y) for _, x, y in segment_places(layout)), default=0.0)
    reach = 1.08 * max(farthest + dot_radius(layout), glass / MILLIMETRE, named)
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    for name, (x, y), ha, va in (("x", (reach, 0.0), "right", "bottom"),
                                 ("y", (0.0, reach), "left", "top")):  # fmt: skip
        ax.annotate("", (x, y), (-x, -y), arrowprops=arrow, zorder=0)
        ax.annotate(name, (x, y), xytext=(2, 2), textcoords="offset points", ha=ha, va=va,
                    style="italic")  # fmt: skip
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-1.16 * reach, reach)
    ax.set_aspect("equal")
    ax.set_axis_off()
    bar, low = _round_length(farthest / 2), -0.93 * reach
    ax.plot([reach - bar, reach], [low, low], color=INK, linewidth=1.0, solid_capstyle="butt")
    ax.text(reach - bar / 2, low + 0.02 * reach, f"{bar:g} mm", ha="center", va="bottom",
            fontsize=6.0)  # fmt: skip
    for size in (6.0, 1.2):  # z, the point of an arrow
        ax.plot([-0.96 * reach], [-1.1 * reach], "o", markersize=size, markeredgewidth=0.6,
                markerfacecolor="none", color=INK)  # fmt: skip
    ax.text(-0.9 * reach, -1.1 * reach, "z, seen along -z", fontsize=6.0, va="center")
    _draw_rings(layout, ax, -1.04 * reach)


def _draw_rings(layout: Layout, ax: Axes, low: float) -> None:
    """Draw the rings, and their numbers on a rule below the map, from the centre to the right."""
    x, y = (value / MILLIMETRE for value in ring_centre(layout))
    radii = ring_radii(layout)
    for radius in radii:
        ax.add_patch(Circle((x, y), radius, fill=False, color=FAINT, linewidth=0.4, zorder=0))
    if len(radii) < 2:
        return
    places = [x, *(x + radius for radius in radii)]
    ax.plot(places, [low] * len(places), "|-", color=FAINT, linewidth=0.4, markersize=3.0)
    ax.text(x, 1.03 * low, "ring ", ha="right", va="top", fontsize=5.5)
    for k, radius in shown_rings(radii):
        ax.text(x + radius, 1.03 * low, str(k), ha="center", va="top", fontsize=5.5)


def shown_rings(radii: Sequence[float]) -> list[tuple[int, float]]:
    """Return numbers and radii of the rings that have room for their number, the last included."""
    shown: list[tuple[int, float]] = []
    for k in range(len(radii), 0, -1):
        room = 0.075 if k < 10 else 0.12  # of two digits
        if not shown or shown[-1][1] - radii[k - 1] > room * radii[-1]:
            shown.append((k, radii[k - 1]))
    return shown[::-1]


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


def name_segments(ax: Axes, layout: Layout) -> None:
    """Write the number of each segment, over dots with a rim of white."""
    from matplotlib.patheffects import withStroke

    rim = [withStroke(linewidth=2.0, foreground="white")]
    for number, x, y in segment_places(layout):
        ax.text(x, y, str(number), ha="center", va="center", fontsize=9.0, fontweight="bold",
                color=INK, path_effects=rim)  # fmt: skip


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
