"""Static shapes of the glass between its actuators, and the mass that moves with them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import legendre

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.condensation import Condensed, condense
from truenewton.mirrors.shell.fourier import POINTS_AT_ONCE, influence, rim
from truenewton.mirrors.shell.loaded_shell import LoadedShell
from truenewton.mirrors.shell.places import Points, on_glass

QUADRATURE = 6  # points per spacing of actuators: masses to 5e-4 of the largest


def influence_functions(
    shell: Shell,
    x: Array,
    y: Array,
    at: Points,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Array:
    """Return the shape of the glass when one actuator reads 1 and the others 0.

    Parameters
    ----------
    shell
        The glass.
    x, y
        (n,) positions of the actuators along the glass [m].
    at
        x and y, (points,) each, along the glass [m]: any points of it.
    sensor, puck_radius, digits
        As in `fourier.influence`; sensors read the actuators, not the points.

    Returns
    -------
    numpy.ndarray
        (points, n) displacement per displacement; each row sums to 1.

    Raises
    ------
    GeometryError
        What `fourier.stiffness` raises; a point off the glass.
    """
    condensed = _condensed(shell, x, y, sensor, puck_radius, digits)
    shapes = _shapes(condensed, shell, (x, y), at, puck_radius, digits)
    return np.concatenate([np.zeros((0, x.size)), *shapes])


def condensed_mass(
    shell: Shell,
    x: Array,
    y: Array,
    magnet_mass: float,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Array:
    """Return the mass matrix by the readings of the actuators, the glass following statically.

    M = rho t integral of phi_i phi_j + magnet_mass * sum of s_ki s_kj (Guyan's reduction), with phi
    the influence functions and s_k the displacement of magnet k, that of its puck: where actuators
    are read at the points of their forces, s = 1 and magnets stand on the diagonal. Motion along
    the glass and the inertia of rotation are left away.

    Parameters
    ----------
    shell
        The glass.
    x, y
        (n,) positions of the actuators along the glass [m].
    magnet_mass
        Magnet with its puck [kg].
    sensor, puck_radius, digits
        As in `fourier.influence`.

    Returns
    -------
    numpy.ndarray
        (n, n) mass [kg], symmetric; a rigid motion finds the mass and moments of the whole.

    Raises
    ------
    GeometryError
        What `fourier.stiffness` raises.
    """
    condensed = _condensed(shell, x, y, sensor, puck_radius, digits)
    at, area = _polar_grid(shell, x.size)
    mass = np.zeros((x.size, x.size))
    first = 0
    for shapes in _shapes(condensed, shell, (x, y), at, puck_radius, digits):
        weighted = area[first : first + shapes.shape[0], None] * shapes
        mass += shapes.T @ weighted
        first += shapes.shape[0]
    mass *= shell.density * shell.thickness
    magnets = _puck_motion(condensed, shell, (x, y), sensor, puck_radius, digits)
    mass += magnet_mass * magnets.T @ magnets
    return 0.5 * (mass + mass.T)


def puck_motion(
    shell: Shell,
    x: Array,
    y: Array,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Array:
    """Return s, (n, n) displacement of each puck for that read at each actuator.

    Parameters and errors as of `condensed_mass`.
    """
    condensed = _condensed(shell, x, y, sensor, puck_radius, digits)
    return _puck_motion(condensed, shell, (x, y), sensor, puck_radius, digits)


def _puck_motion(
    condensed: Condensed,
    shell: Shell,
    of: Points,
    sensor: Annulus | None,
    puck_radius: float,
    digits: int,
) -> Array:
    if sensor == rim(puck_radius):
        return np.eye(of[0].size)
    compliance = influence(
        shell, of, of, sensor=rim(puck_radius), puck_radius=puck_radius, digits=digits
    )
    return compliance @ condensed.stiffness + _tilts(of).T @ condensed.motion


def _tilts(at: Points) -> Array:
    """Return (3, points) the rigid motions of a shallow shell, 1, x, y."""
    return np.array([np.ones_like(at[0]), *at])


def _condensed(
    shell: Shell, x: Array, y: Array, sensor: Annulus | None, puck_radius: float, digits: int
) -> Condensed:
    """Return the stiffness by readings with the rigid motions that go with them."""
    compliance = influence(
        shell, (x, y), (x, y), sensor=sensor, puck_radius=puck_radius, digits=digits
    )
    return condense(compliance, _tilts((x, y)), reciprocal=False)


def _shapes(
    condensed: Condensed, shell: Shell, of: Points, at: Points, puck_radius: float, digits: int
) -> Iterator[Array]:
    """Yield (some points, n) influence functions."""
    forces = on_glass(shell, of, "force", puck_radius)
    points = on_glass(shell, at, "point")
    if points.size == 0:
        return
    loaded = LoadedShell.of(shell, forces, np.abs(points), puck_radius, digits)
    for some in np.array_split(points, -(-points.size // POINTS_AT_ONCE)):
        rigid = _tilts((some.real * shell.outer_radius, some.imag * shell.outer_radius))
        yield loaded.read(some, None) @ condensed.stiffness + rigid.T @ condensed.motion


def _polar_grid(shell: Shell, n: int) -> tuple[Points, Array]:
    """Return x, y [m] and areas [m^2] of a quadrature fine enough for n actuators' shapes.

    Gauss in radius, even steps in angle: exact for rigid motions.
    """
    a, b = shell.inner_radius, shell.outer_radius
    step = np.sqrt(np.pi * (b**2 - a**2) / n) / QUADRATURE
    xi, gauss = legendre.leggauss(max(4, int(np.ceil((b - a) / step))))
    radii = 0.5 * (a + b) + 0.5 * (b - a) * xi
    counts = np.maximum(8, np.ceil(2 * np.pi * radii / step)).astype(int)
    radius = np.repeat(radii, counts)
    area = np.repeat(np.pi * (b - a) * gauss * radii / counts, counts)
    angle = np.concatenate([2 * np.pi * (np.arange(k) + 0.5) / k for k in counts])
    return (radius * np.cos(angle), radius * np.sin(angle)), area
