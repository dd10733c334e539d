"""The views of the actuators, which share one selection: on the map, and ring by ring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from bokeh.models import ColumnDataSource

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.estimation.findings.estimate import Scale
from truenewton.estimation.findings.scale_budget import typical
from truenewton.records.parts import Parts
from truenewton.report.change import Change
from truenewton.report.investigate import Findings
from truenewton.report.layers import Layer, calibration_layers, segment_layers
from truenewton.report.page.actuator_plots import (
    Plot,
    actuator_source,
    alpha_by_ring,
    change_by_ring,
    mirror_map,
)
from truenewton.rounding import counted, percent, to_digits
from truenewton.statics.layout import Layout, group_name, ring_of


@dataclass(frozen=True)
class View:
    """An interactive figure of the actuators: for links, for people, of Bokeh, and in words."""

    key: str
    title: str
    plot: Plot
    caption: str


@dataclass(frozen=True)
class Actuators:
    """What the page shows of the actuators.

    Attributes
    ----------
    layout
        The actuators.
    layers
        What is known of them.
    views
        The map first, then a figure by ring.
    """

    layout: Layout
    layers: tuple[Layer, ...]
    views: tuple[View, View]

    @property
    def group(self) -> str:
        """By what the second figure and the table group them: 'ring' or 'segment'."""
        return group_name(self.layout)


def calibration_views(findings: Findings, c: Calibration, edges: Sequence[Array] = ()) -> Actuators:
    """Return the views of alpha; edges of the glass are (vertices, 2) polygons [m]."""
    layers = calibration_layers(c, findings.evidence)
    source = actuator_source(c.layout, layers)
    views = (
        _map("Map of the mirror", source, c.layout, layers, edges, _extremes(c)),
        View("rings", "Alpha by ring" if ring_of(c.layout).any() else "Alpha by actuator",
             alpha_by_ring(source, c, layers), _ring_caption(c)),
    )  # fmt: skip
    return Actuators(c.layout, layers, views)


def segment_views(c: Parts[Calibration], edges: Sequence[Array] = ()) -> Actuators:
    """Return the views of alpha of all segments; edges (vertices, 2) [m]."""
    layers = segment_layers(c)
    source = actuator_source(c.layout, layers)
    means = ", ".join(f"{n}: {np.nanmean(one.alpha):.3f}" for n, one in c.found.items())
    caption = (
        "Alpha of each actuator, segment by segment. Bars: three standard uncertainties from the"
        f" readings (3 E_STAT). Means of the segments: {means}."
    )
    views = (
        _map("Map of the mirror", source, c.layout, layers, edges),
        View("rings", "Alpha by segment", alpha_by_ring(source, c, layers), caption),
    )  # fmt: skip
    return Actuators(c.layout, layers, views)


def change_views(change: Change, edges: Sequence[Array] = ()) -> Actuators:
    """Return the views of what changed; edges (vertices, 2) [m]."""
    layers, layout = change.layers, change.one.layout
    source = actuator_source(layout, layers)
    kind, title = "ring by ring from the centre", "Change by ring"
    if layout.segments:
        kind, title = "segment by segment", "Change by segment"
    ring_caption = (
        f"Change of each actuator in sigmas, {kind}. Between the dashed lines"
        f" ({change.limit:.1f} sigma) chance alone explains it."
    )
    views = (
        _map("Map of the change", source, layout, layers, edges),
        View("rings", title, change_by_ring(source, change, layers), ring_caption),
    )
    return Actuators(layout, layers, views)


def _map(
    title: str,
    source: ColumnDataSource,
    layout: Layout,
    layers: tuple[Layer, ...],
    edges: Sequence[Array],
    extremes: str = "",
) -> View:
    glass = " Lines are the edges of the glass." if edges else ""
    caption = (
        f"Map of {counted(layout.n, 'actuator')}, seen along -z, each dot coloured by the layer"
        f" chosen below.{glass}{extremes} The table of actuators holds every value."
    )
    return View("map", title, mirror_map(source, layout, layers, edges), caption)


def _extremes(c: Calibration) -> str:
    low, high = int(np.nanargmin(c.alpha)), int(np.nanargmax(c.alpha))
    ring = ring_of(c.layout)
    lowest, highest = (
        f"actuator {c.layout.id[k]}{f' on ring {ring[k] + 1}' if ring.any() else ''}"
        f" ({to_digits(float(c.alpha[k]), float(c.error[k]))})"
        for k in (low, high)
    )
    return f" Alpha is lowest at {lowest} and highest at {highest}."


def _ring_caption(c: Calibration) -> str:
    """Say in words what alpha by ring shows."""
    ring = ring_of(c.layout)
    means = [float(np.nanmean(c.alpha[ring == k])) if np.isfinite(c.alpha[ring == k]).any()
             else float("nan") for k in range(ring.max() + 1)]  # fmt: skip
    order = ", ring by ring from the centre" if ring.any() else ""
    words = f"Alpha of each actuator{order}. Bars: three standard"
    words += " uncertainties from the readings (3 E_STAT)"
    if c.scale != Scale.MEAN_ONE:
        scale = percent(typical(c.systematic_error, c.alpha))
        words += f"; the error of the common scale, {scale}, moves all points together"
    words += ". "
    if len(means) == 1:
        return words + f"The mean is {means[0]:.3g}."
    return words + "Means of the rings: " + ", ".join(f"{mean:.3f}" for mean in means) + "."
