"""The glass of a mirror and the sensors over it: dimensions and material.

Standing of a number as in `mirrors`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.quantities import Quantity, convert_quantities
from truenewton.statics.layout import MAX_DISTANCE

if TYPE_CHECKING:
    from shapely import Polygon as Surface

MIN_THICKNESS = 1e-6  # [m]
MIN_THICKNESS_RATIO = 1e-4  # to the outer radius; large shells have 1.6e-3


@dataclass(frozen=True)
class Annulus:
    """The electrode of a capacitive sensor, round the magnet of its actuator.

    A reading is the mean displacement over it. 8 to 12.5 mm [conf].

    Attributes
    ----------
    inner_radius, outer_radius
        From the axis of the actuator [m]; a circle if they are equal.

    Raises
    ------
    GeometryError
        Invalid radii.
    """

    QUANTITIES: ClassVar = {"inner_radius": Quantity("m"), "outer_radius": Quantity("m")}

    inner_radius: float = 8e-3
    outer_radius: float = 12.5e-3

    def __post_init__(self) -> None:
        convert_quantities(self)
        if not (0 <= self.inner_radius <= self.outer_radius and 0 < self.outer_radius < np.inf):
            raise GeometryError(
                f"a sensor from {self.inner_radius:.6g} m to {self.outer_radius:.6g} m",
                remedy="give its inner radius, then its outer one",
            )


def rim(puck_radius: float) -> Annulus | None:
    """Return the circle on which a puck presses; None for a point."""
    return Annulus(puck_radius, puck_radius) if puck_radius else None


VERTEX = Quantity(
    "m", -MAX_DISTANCE, MAX_DISTANCE, "x and y are metres; check their unit",
    "the outline has a point at {:.3g} m",
)  # fmt: skip
Polygon = tuple[tuple[float, float], ...]
Points = tuple[Array, Array]  # x and y along the glass [m]


def polygon_of(loops: Sequence[Array]) -> Surface:
    """Return the glass within the first of (n, 2) polygons and outside the others."""
    import shapely  # late: rings do without it

    polygon = shapely.Polygon(loops[0], loops[1:])
    shapely.prepare(polygon)
    return polygon


@dataclass(frozen=True)
class Outline:
    """Polygons around a glass that is not a ring, as seen along the axis.

    Attributes
    ----------
    edge
        x and y of each vertex [m], in either direction, convex or not.
    holes
        Polygons of the holes.
    mesh_size
        Length of the sides of the finite elements [m]; by default a third of the spacing of the
        actuators.
    """

    QUANTITIES: ClassVar = {
        "edge": VERTEX, "holes": VERTEX, "mesh_size": Quantity("m"),
    }  # fmt: skip

    edge: Polygon
    holes: tuple[Polygon, ...] = ()
    mesh_size: float | None = None


@dataclass(frozen=True)
class Shell:
    """The glass: a thin annulus, disc or any outline of even thickness, flat or spherical.

    Attributes
    ----------
    inner_radius, outer_radius, thickness
        Dimensions [m]; radii are arcs on a sphere; an inner radius of 0 makes a full disc. With an
        outline, the weight tool stands just outside the inner radius unless its radius is given,
        and an infinite outer radius becomes that of the outermost vertex.
    young_modulus
        E [Pa]; Zerodur 90.3 GPa [conf].
    poisson_ratio
        nu; Zerodur 0.24 [conf].
    density
        [kg/m3]; Zerodur 2530 [conf].
    radius_of_curvature
        R [m]; positive for a concave optical surface, negative for a convex one, infinite for a
        flat one. On a mirror that hangs under its plate, such as P45, that surface faces down, so
        that a concave glass is hollow toward -z. Normal forces and displacements do not depend on
        the sign.
    outline
        None for an annulus.
    """

    QUANTITIES: ClassVar = {
        "inner_radius": Quantity("m"), "outer_radius": Quantity("m"), "thickness": Quantity("m"),
        "young_modulus": Quantity("Pa"), "poisson_ratio": Quantity(), "density": Quantity("kg/m3"),
        "radius_of_curvature": Quantity("m"),
    }  # fmt: skip

    inner_radius: float
    outer_radius: float
    thickness: float
    young_modulus: float = 90.3e9
    poisson_ratio: float = 0.24
    density: float = 2530.0
    radius_of_curvature: float = np.inf
    outline: Outline | None = None

    def __post_init__(self) -> None:
        convert_quantities(self)
        if self.outline is not None and self.outer_radius == np.inf:
            reach = np.hypot(*self.polygons()[0].T).max(initial=0.0)
            object.__setattr__(self, "outer_radius", float(reach))

    @property
    def bending_stiffness(self) -> float:
        """D = E t^3 / 12 (1 - nu^2) [N m]."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @property
    def mass(self) -> float:
        """Mass of the glass [kg]."""
        area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
        if self.outline is not None:
            area = polygon_of(self.polygons()).area
        return float(area * self.thickness * self.density)

    @property
    def centroid(self) -> tuple[float, float]:
        """Centre of the glass, x and y [m]."""
        if self.outline is None:
            return 0.0, 0.0
        centre = polygon_of(self.polygons()).centroid
        return centre.x, centre.y

    def polygons(self) -> list[Array]:
        """Return the edge and the holes of an outlined glass, (vertices, 2) along the glass [m]."""
        loops = [] if self.outline is None else self.seen_edges()
        return [np.stack(self.along(*loop.T), axis=1) for loop in loops]

    def seen_edges(self) -> list[Array]:
        """Return the edge and the holes as seen along the axis, (vertices, 2) each [m]."""
        if self.outline is not None:
            return [np.reshape(loop, (-1, 2)) for loop in (self.outline.edge, *self.outline.holes)]
        turn = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
        circle, bend = np.stack([np.cos(turn), np.sin(turn)], axis=1), 1 / self.radius_of_curvature
        return [
            r * np.sinc(r * bend / np.pi) * circle
            for r in (self.outer_radius, self.inner_radius)
            if r > 0
        ]

    def along(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return (n,) positions along the glass [m], R asin(r / R) from the axis, of (n,) x and y.

        The balance needs the distance from the axis, as in a layout; the model of the shell needs
        the arc length. On a flat shell they are equal.
        """
        sine = np.hypot(x, y) / abs(self.radius_of_curvature)
        if not (sine <= 1).all():
            raise GeometryError(
                f"a point lies beside the sphere of radius {abs(self.radius_of_curvature):.6g} m",
                remedy="correct the radius of curvature or the position",
            )
        # asin(s) / s, 1 at the axis
        longer = np.divide(np.arcsin(sine), sine, out=np.ones_like(sine), where=sine > 0)
        return x * longer, y * longer


def check_shell(shell: Shell, smallest_hole: float = 0.0) -> None:
    """Refuse invalid radii, thickness, material and curvature.

    The smallest hole is the minimum of the inner radius, in outer radii.
    """
    a, b, curvature = shell.inner_radius, shell.outer_radius, shell.radius_of_curvature
    if not smallest_hole * b <= a < b < np.inf:
        raise GeometryError(
            f"the glass reaches from {a:.6g} m to {b:.6g} m",
            remedy="give an inner radius below the outer one; 0 makes a full disc, a hole has a"
            " thousandth at least",
        )
    if not max(MIN_THICKNESS, MIN_THICKNESS_RATIO * b) <= shell.thickness <= b:
        raise GeometryError(
            f"thickness is {shell.thickness:.6g} m, of a glass that reaches to {b:.6g} m",
            remedy="give metres: 1.6 mm are 1.6e-3",
        )
    nu = shell.poisson_ratio
    if not (0 < shell.bending_stiffness < np.inf and -1 < nu < 0.5):
        raise GeometryError(
            f"Young's modulus {shell.young_modulus:.6g} Pa and Poisson ratio {nu:.6g}",
            remedy="give a positive modulus, and a ratio in (-1, 0.5)",
        )
    if not abs(curvature) > b:
        raise GeometryError(
            f"radius of curvature {curvature:.6g} m cannot carry a shell of {b:.6g} m",
            remedy="it is taken as shallow: give several outer radii, with sign; leave it out for a"
            " plate",
        )
