"""Thin free annular shell, flat or spherical, under point forces: Fourier in angle, p-elements.

Kirchhoff's bending, D lap lap w = q on a flat plate, coupled through the curvature to the membrane
of a shallow sphere; inner and outer edge free of moment, shear and membrane forces. A unit force
gives w = kernel + v (`kernels`). The kernel holds the singularity exactly and needs no harmonics;
it leaves tractions on the edges. The smooth remainder takes them away: for every (phi, psi)

    a((v, u), (phi, psi)) = - [ integral of (moment dphi/dr - shear phi + N_r psi_r + N_rt psi_t)
                                r dtheta ] from r = a to r = b

harmonic by harmonic (`radial_elements`). Harmonic m of a force at radius s fades as (s/b)^m on the
outer edge and as (a/s)^m on the inner one, and v once more so on its way to the point where it is
read: geometry and the digits wanted set the number of harmonics. The tractions of two edges are all
the right-hand sides of a harmonic, whatever the number of forces; one matrix product joins forces
to points. Sensors and pucks add nothing to that: means over circles are exact combinations of w,
lap w and lap lap w at the centre.

x and y are positions along the glass, arcs on a sphere (`Shell.along`). Inside, lengths are in
units of b and displacements in units of b^2 / D per newton.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.arrays import Array
from truenewton.mirrors.glass import Annulus, Shell
from truenewton.mirrors.shell.condensation import condense
from truenewton.mirrors.shell.loaded_shell import LoadedShell, mean_over, read_remainder
from truenewton.mirrors.shell.places import Points, on_glass, shallowness
from truenewton.mirrors.shell.radial_elements import RadialElements, graded_nodes

POINTS_AT_ONCE = 1024  # bounds the memory where many points are read


def influence(
    shell: Shell,
    at: Points,
    of: Points,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Array:
    """Return the displacement at points, or the reading of sensors, per unit force on a free shell.

    Exact, up to rigid motions, for every combination of forces whose sum and torques vanish. One
    force alone finds no equilibrium on a free shell; its column means something only in such
    sums. In the harmonics 0 and 1, where the operator is singular (constant and r), v stands on a
    spring at the outer edge, which balanced forces leave unloaded.

    Where forces and readings share their places this is the compliance of the actuators. It is
    symmetric only where displacements are read just as forces act: at points under point forces,
    or on a circle as wide as the puck.

    Parameters
    ----------
    shell
        The glass; |R| several times its outer radius.
    at
        x and y, (n_at,) each, of the points where the displacement is read, or of the centres of
        the sensors, along the glass [m]; edges included.
    of
        x and y, (n_of,) each, of the forces, along the glass [m]; off the edges.
    sensor
        Over which a reading is the mean; none reads at the points.
    puck_radius
        Radius of the circle on which the force enters the glass [m]; 0 for a point. A stiff puck
        that is glued to the glass presses with its rim, for the glass under it does not bend; that
        it stiffens the glass as well is not modelled. Nobody vouches for a radius [guess].
    digits
        Decimal digits to keep of the series in harmonics and in radial polynomials.

    Returns
    -------
    numpy.ndarray
        (n_at, n_of) displacement along the normal [m/N].

    Raises
    ------
    GeometryError
        A shell that cannot be, a point off the glass, a force on an edge or all but on it, a sensor
        or a puck over an edge, a sensor over the place where a force acts.
    """
    parts = influence_in_parts(shell, at, of, sensor=sensor, puck_radius=puck_radius, digits=digits)
    return np.concatenate([np.zeros((0, np.size(of[0]))), *parts])


def influence_in_parts(
    shell: Shell,
    at: Points,
    of: Points,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Iterator[Array]:
    """Yield the rows of `influence`, some at a time, where all of them would fill the memory."""
    forces = on_glass(shell, of, "force", puck_radius)
    points = on_glass(shell, at, "point", sensor.outer_radius if sensor else 0.0)
    if points.size == 0 or forces.size == 0:
        yield np.zeros((points.size, forces.size))
        return
    loaded = LoadedShell.of(shell, forces, np.abs(points), puck_radius, digits)
    for some in np.array_split(points, -(-points.size // POINTS_AT_ONCE)):
        yield loaded.read(some, sensor)


def uniform_influence(
    shell: Shell, at: Points, *, sensor: Annulus | None = None, digits: int = 13
) -> Array:
    """Return the displacement at points per unit force spread evenly over the free shell.

    To be added to ``influence`` in sums whose force and torques vanish, like any of its columns.
    The force acts along the normals.

    Parameters
    ----------
    shell
        The glass.
    at
        x and y, (n_at,) each, of the points where the displacement is read, or of the centres of
        the sensors, along the glass [m].
    sensor, digits
        As in `influence`.

    Returns
    -------
    numpy.ndarray
        (n_at,) displacement along the normal [m/N].

    Raises
    ------
    GeometryError
        A shell that cannot be, a point off the glass.
    """
    r = np.abs(on_glass(shell, at, "point", sensor.outer_radius if sensor else 0.0))
    hole, curved = shell.inner_radius / shell.outer_radius, shallowness(shell)
    nodes = graded_nodes(hole, np.array([hole**0.5]), curved)
    elements = RadialElements(nodes, digits + 4, shell.poisson_ratio, curved)
    pressure = 1 / (np.pi * (1 - hole**2))
    radii, area = elements.gauss()
    work = [w @ elements.shape(r, 0, 0) for r, w in zip(radii, pressure * area, strict=True)]
    response = elements.responses(np.zeros(1), np.array(work)[:, :, None])
    mean = mean_over(sensor, shell)
    remainder = read_remainder(elements, response, r, mean)[0, :, 0]
    # lap lap w is that of the membrane's forces and the pressure.
    return (remainder + mean.second * pressure) * (shell.outer_radius**2 / shell.bending_stiffness)


def stiffness(
    shell: Shell,
    x: Array,
    y: Array,
    *,
    sensor: Annulus | None = None,
    puck_radius: float = 0.0,
    digits: int = 13,
) -> Array:
    """Return the stiffness between actuators on a free shell: force per displacement as read.

    Read by sensors, this is what a mirror is driven by and what a measured feed-forward matrix is:
    f = K z with z the readings. Forces on the right still balance and rigid motions still cost
    nothing, but K is not symmetric: a sensor sees another mean of the shape than the force does,
    z = S w, and K = K_w S^-1 with K_w, symmetric, the stiffness by the displacement w that the
    forces do work on. That is physics, not an error of the model.

    Parameters
    ----------
    shell
        The glass.
    x, y
        (n,) positions of the actuators along the glass [m].
    sensor, puck_radius, digits
        As in `influence`.

    Returns
    -------
    numpy.ndarray
        (n, n) force per displacement [N/m]; its null space is {1, x, y}. Symmetric without a
        sensor.

    Raises
    ------
    GeometryError
        A shell that cannot be, actuators off the glass, all but on an edge, on one line or
        several at one place; what `influence` raises.
    """
    compliance = influence(
        shell, (x, y), (x, y), sensor=sensor, puck_radius=puck_radius, digits=digits
    )
    tilts = np.array([np.ones_like(x), x, y])
    return condense(compliance, tilts, reciprocal=sensor == rim(puck_radius)).stiffness


def rim(puck_radius: float) -> Annulus | None:
    """Return the sensor that reads displacements just as a puck's force acts."""
    return Annulus(puck_radius, puck_radius) if puck_radius else None
