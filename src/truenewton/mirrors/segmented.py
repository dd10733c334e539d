"""Mirrors of several segments: each a mirror in one piece, at its place.

Standing of a number as in `known`: [lit] publications, [derived] computed, [assumed] an engineering
value without a source.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Outline, Shell, polygon_of
from truenewton.mirrors.known import Mirror, standard_mirror
from truenewton.mirrors.shell.mesh import depth_inside
from truenewton.quantities import Quantity, convert_quantities
from truenewton.rounding import counted
from truenewton.statics.layout import Layout, layout, rings

MAX_OVERLAP = 1e-3  # in radii of a segment: rounded corners of neighbours overlap by less
PETAL_INNER, PETAL_OUTER, PETAL_AT = 0.27, 1.2, 0.8  # [m]
PETAL_LATTICE, PETAL_SHIFT = 29.8e-3, 0.3  # [m], and in units of it
GMT_SPACING = 35.1e-3  # [m]


@dataclass(frozen=True)
class Place:
    """The frame of a segment in that of the mirror."""

    QUANTITIES: ClassVar = {"x": Quantity("m"), "y": Quantity("m"), "turned": Quantity("deg")}

    # its origin [m]
    x: float
    y: float
    turned: float = 0.0  # its rotation, counter-clockwise [deg]

    def __post_init__(self) -> None:
        convert_quantities(self)

    @property
    def motion(self) -> Array:
        """(3, 3) T, from 1, x, y of the segment to those of the mirror, also for moments."""
        c, s = np.cos(np.radians(self.turned)), np.sin(np.radians(self.turned))
        return np.array([[1.0, 0.0, 0.0], [self.x, c, -s], [self.y, s, c]])


@dataclass(frozen=True, kw_only=True)
class SegmentedMirror:
    """A mirror whose segments are separate bodies, numbered from 1."""

    name: str  # the keyword INSTRUME
    segments: tuple[Mirror, ...]  # mirrors in one piece, each in its own frame
    places: tuple[Place, ...]  # the frames

    def __post_init__(self) -> None:
        if len(self.segments) < 2:
            raise GeometryError(
                f"{self.name} has {counted(self.segments, 'segment')}",
                remedy="give two or more; a mirror in one piece has a file of its own",
            )
        for segment in self.segments:
            if (segment.layout.nz != 1.0).any():
                # Moments about another point would mix with the total force, which nz scales.
                raise GeometryError(
                    f"segment {segment.name} has NZ other than 1",
                    remedy="leave NZ out: the forces of a segment are taken as vertical",
                )
            for name in ("gap", "coil_gradient", "bias_gradient"):
                if getattr(segment, name) != getattr(self.segments[0], name):
                    raise GeometryError(
                        f"{name} of {segment.name} is not that of {self.segments[0].name}",
                        remedy="give all segments the same value: a cycle file contains one",
                    )
        self.layout  # noqa: B018  checks the places
        self._refuse_overlaps()

    def _refuse_overlaps(self) -> None:
        """Refuse segments whose glass overlaps, by the width of what they share."""
        import shapely

        loops = [self.seen_edges([k]) for k in range(1, len(self.segments) + 1)]
        tree = shapely.STRtree([polygon_of(edges) for edges in loops])
        reach = [np.hypot(*(np.concatenate(edges) - (place.x, place.y)).T).max()
                 for edges, place in zip(loops, self.places, strict=True)]  # fmt: skip
        for i, j in tree.query(tree.geometries, predicate="intersects").T.tolist():
            if i >= j:
                continue
            shared = shapely.intersection(*tree.geometries[[i, j]])
            width = 2 * shapely.maximum_inscribed_circle(shared).length if shared.area else 0.0
            if width > MAX_OVERLAP * min(reach[i], reach[j]):
                raise GeometryError(
                    f"segments {i + 1} ({self.segments[i].name}) and {j + 1}"
                    f" ({self.segments[j].name}) overlap, by {1e3 * width:.3g} mm",
                    remedy="correct x, y (of the origin of each, in m) or turned (degrees)",
                )

    @property
    def kinds(self) -> list[tuple[Mirror, list[int]]]:
        """The different segments, each with the numbers of all that are the same object."""
        numbers: dict[int, list[int]] = {}
        for k, segment in enumerate(self.segments, 1):
            numbers.setdefault(id(segment), []).append(k)
        return [(self.segments[alike[0] - 1], alike) for alike in numbers.values()]

    @property
    def layout(self) -> Layout:
        """All actuators in the frame of the mirror, named from 1 in the order of the segments."""
        parts = [segment.layout for segment in self.segments]
        counts = [part.n for part in parts]
        at = [
            place.motion @ np.stack([np.ones(part.n), part.x, part.y])
            for place, part in zip(self.places, parts, strict=True)
        ]
        _, x, y = np.concatenate(at, axis=1)
        return layout(
            x,
            y,
            enabled=np.concatenate([part.enabled for part in parts]),
            segment=np.repeat(np.arange(1, len(parts) + 1), counts),
        )

    def seen_edges(self, numbers: Iterable[int] = ()) -> list[Array]:
        """Return the edges of some segments, or of all, seen along the axis, (vertices, 2) [m]."""
        wanted = [k - 1 for k in numbers] or range(len(self.segments))
        return [
            _moved(edge, self.places[k])
            for k in wanted
            for edge in self.segments[k].shell.seen_edges()
        ]


def _moved(points: Array, place: Place) -> Array:
    """Return (n, 2) points of a segment in the frame of the mirror."""
    return np.asarray((np.insert(points, 0, 1.0, axis=1) @ place.motion.T)[:, 1:])


def m4() -> SegmentedMirror:
    """Return a mirror like M4 of the Extremely Large Telescope: six petals of 892 actuators.

    - [lit] 6 x 892 actuators; flat shell of 2.4 m in six petals of 60 degrees, 1.95 mm thick
    - [derived] hole of 0.54 m; no gaps between the petals; triangular lattice of 29.8 mm, which
      gives 892 actuators on a petal; weight of shell and magnets
    - [assumed] Zerodur; magnets, coils, sensors, bias forces and gap of LBT672; added weight of
      0.5 N on a circle of 0.1 m around a point of each petal; all uncertainties
    """
    petal = _petal()
    turns = [60.0 * k for k in range(6)]
    places = tuple(
        Place(float(PETAL_AT * np.cos(turn)), float(PETAL_AT * np.sin(turn)), angle)
        for angle, turn in zip(turns, np.radians(turns), strict=True)
    )
    return SegmentedMirror(name="M4", segments=(petal,) * 6, places=places)


def gmt() -> SegmentedMirror:
    """Return a mirror like the adaptive secondary of the Giant Magellan Telescope: seven segments.

    - [lit] circular segments of 1.05 m, 2 mm thick; 672 actuators on the middle segment, which has
      a hole, and 675 on each other segment
    - [derived] rings of 9 + 6k as on LBT672, 35.1 mm apart; three more actuators on segments
      without a hole; segments 1.09 m apart; weight of shell and magnets
    - [assumed] radius of curvature 4.2 m; forces along +z; Zerodur; magnets, coils, sensors, bias
      forces and gap of LBT672; added weight of 0.5 N on a circle of 0.1 m; all uncertainties
    """
    counts = [9 + 6 * k for k in range(14)]
    radii = [GMT_SPACING * (1.42 + k) for k in range(14)]
    ring = Shell(27.5e-3, 0.525, 2e-3, radius_of_curvature=4.2)
    middle = standard_mirror("GMT-MIDDLE", rings(radii, counts), ring, tool_radius=0.1)
    more = rings([0.48 * GMT_SPACING, *radii], [3, *counts])
    outer = standard_mirror("GMT-OUTER", more, replace(ring, inner_radius=0.0), tool_radius=0.1)
    angles = np.radians(30.0 + 60.0 * np.arange(6))
    around = (Place(float(x), float(y)) for x, y in zip(*_circle(1.09, angles), strict=True))
    return SegmentedMirror(
        name="GMT", segments=(middle, *(outer,) * 6), places=(Place(0.0, 0.0), *around)
    )


SEGMENTED = {make.__name__: make for make in (m4, gmt)}


@cache
def _petal() -> Mirror:
    """Return a petal of M4, its frame 0.8 m from the axis, x outward."""
    outer = np.stack(_circle(PETAL_OUTER, np.radians(np.linspace(-30.0, 30.0, 37))), axis=1)
    inner = np.stack(_circle(PETAL_INNER, np.radians(np.linspace(30.0, -30.0, 10))), axis=1)
    edge = np.concatenate([outer, inner]) - [PETAL_AT, 0.0]
    i, j = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61))
    lattice = np.stack([np.sqrt(0.75) * i + PETAL_SHIFT, j + 0.5 * (i % 2)], axis=-1)
    places = PETAL_LATTICE * lattice.reshape(-1, 2)
    x, y = places[depth_inside([edge], places) >= 14e-3].T
    outline = Outline(tuple((float(x), float(y)) for x, y in edge))
    shell = Shell(0.0, 0.8, 1.95e-3, outline=outline)
    return standard_mirror("M4-PETAL", layout(x, y), shell, tool_radius=0.1)


def _circle(radius: float, angle: Array) -> tuple[Array, Array]:
    return radius * np.cos(angle), radius * np.sin(angle)
