"""Where forces and sensors may stand on a glass, and how many harmonics they take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Shell, check_shell

Points = tuple[Array, Array]
SMALLEST_HOLE = 1e-4  # in outer radii; in a finer one rounding eats more than eight digits
MOST_HARMONICS = 5000  # more are wanted only where a force all but touches an edge


def shallowness(shell: Shell) -> float:
    """Return lambda, b in units of the length over which bending decays; 0 on a flat plate."""
    stiffness_ratio = 12 * (1 - shell.poisson_ratio**2)
    length = np.sqrt(shell.thickness * abs(shell.radius_of_curvature))
    return float(shell.outer_radius / length * stiffness_ratio**0.25)


def on_glass(
    shell: Shell, places: Points, what: str, extent: float = 0.0
) -> NDArray[np.complex128]:
    """Return (n,) places as x + i y in units of the outer radius, once known to be on the glass."""
    a, b = shell.inner_radius, shell.outer_radius
    if shell.outline is not None:
        raise GeometryError(
            "a glass with an outline is no ring", remedy="take finite elements for it"
        )
    check_shell(shell, SMALLEST_HOLE)
    if not extent >= 0:
        raise GeometryError(f"a puck radius of {extent:.6g} m", remedy="give 0 m for a point")
    x, y = (np.asarray(coordinate, dtype=float) for coordinate in places)
    radius = np.hypot(x, y)
    slack = 1e-12 * b - extent  # a point computed to lie on an edge does
    off = np.flatnonzero(~((radius >= a - slack) & (radius <= b + slack)))
    if off.size:
        i = off[0]
        wide = f" and {extent:.6g} m round it" if extent else ""
        raise GeometryError(
            f"{what} {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m{wide} is off the glass",
            remedy=f"bring it between the edges at {a:.6g} m and {b:.6g} m from the axis",
        )
    return np.asarray((x + 1j * y) / b)


def harmonics(fading: float, digits: int, shell: Shell) -> int:
    """Return how many harmonics it takes until ``fading`` ** m falls below 10 ** -digits."""
    if fading >= 10.0 ** (-digits / MOST_HARMONICS):
        nearest = shell.outer_radius * digits * np.log(10) / MOST_HARMONICS
        raise GeometryError(
            "a force acts on an edge of the glass, or so near that its series hardly converges",
            remedy=f"keep forces {nearest:.2g} m away from the edges",
        )
    return max(3, int(np.ceil(-digits * np.log(10) / np.log(fading))))
