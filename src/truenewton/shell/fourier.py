"""Thin free annular plate under point forces: Fourier in angle, p-elements in radius.

Kirchhoff's plate of even thickness, D lap lap w = q, with free inner and outer edges (Timoshenko
and Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., chapters 3, 4, 9). A unit force gives
w = kernel + v. The kernel, rho^2 ln rho / (8 pi D) with rho the distance from the force, holds the
singularity exactly and needs no harmonics; it leaves moments and shears on the edges. The smooth
remainder v takes them away: for every phi

    a(v, phi) = - [ integral of (moment dphi/dr - shear phi) r dtheta ] from r = a to r = b

harmonic by harmonic. Harmonic m of a force at radius s fades as (s/b)^m on the outer edge and as
(a/s)^m on the inner one, and v once more so on its way to the point where it is read: geometry
and the digits wanted set the number of harmonics. The elastic energy is a polynomial in m^2, and
four edge loads are all the right-hand sides of a harmonic, whatever the number of forces; one
matrix product joins forces to points.

Inside, lengths are in units of b and displacements in units of b^2 / D per newton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import xlogy

from truenewton.actuators import Array
from truenewton.errors import GeometryError
from truenewton.mirrors import Shell
from truenewton.shell.condensation import condense

Points = tuple[Array, Array]

MOST_HARMONICS = 5000  # more are wanted only where a force all but touches an edge
POINTS_AT_ONCE = 2048  # bounds the memory where many points are read


def influence(shell: Shell, at: Points, of: Points, *, digits: int = 13) -> Array:
    """Return the displacement at points per unit force at points of a free plate.

    Exact, up to rigid motions, for every combination of forces whose sum and torques vanish. One
    force alone finds no equilibrium on a free plate; its column means something only in such
    sums. In the harmonics 0 and 1, where the operator is singular (constant and r), v stands on a
    spring at the outer edge, which balanced forces leave unloaded.

    Parameters
    ----------
    shell
        The glass, taken as flat.
    at
        x and y, (n_at,) each, of the points where the displacement is read [m]; edges included.
    of
        x and y, (n_of,) each, of the forces [m]; off the edges.
    digits
        Decimal digits to keep of the series in harmonics and in radial polynomials.

    Returns
    -------
    numpy.ndarray
        (n_at, n_of) displacement along z [m/N].

    Raises
    ------
    GeometryError
        A shell that cannot be, a point off the glass, a force on an edge or all but on it.
    """
    forces, points = _on_glass(shell, of, "force"), _on_glass(shell, at, "point")
    if points.size == 0 or forces.size == 0:
        return np.zeros((points.size, forces.size))
    hole = shell.inner_radius / shell.outer_radius
    s, r = np.abs(forces), np.abs(points)
    on_edges = _harmonics(max(s.max(), hole / s.min()), digits, shell)
    count = _harmonics(max(s.max() * r.max(), hole**2 / (s.min() * r.min())), digits, shell)

    elements = _RadialElements(_graded_nodes(hole, s), order=digits + 4)
    responses = _edge_responses(elements, shell.poisson_ratio, count)
    tractions = np.concatenate(
        [_edge_tractions(s, edge, shell.poisson_ratio, 2 * on_edges) for edge in (1.0, hole)],
        axis=1,
    )[:count]
    tractions[1:] *= 2.0  # harmonics m and -m
    m = np.arange(count)[:, None, None]

    def turned(harmonics: Array, places: NDArray[np.complex128]) -> Array:
        phase = m * np.angle(places)
        cosine_and_sine = [harmonics * np.cos(phase), harmonics * np.sin(phase)]
        return np.concatenate(cosine_and_sine).reshape(-1, places.size)

    loads = turned(tractions, forces)
    rows = []
    for some in np.array_split(points, -(-points.size // POINTS_AT_ONCE)):
        displacement, _, _ = elements.at(np.abs(some))
        remainder = turned(np.swapaxes(displacement @ responses, 1, 2), some).T @ loads
        apart = some[:, None] - forces
        squared = apart.real**2 + apart.imag**2
        rows.append(xlogy(squared, squared) / (16 * np.pi) + remainder)  # rho^2 ln rho / 8 pi
    return np.concatenate(rows) * (shell.outer_radius**2 / shell.bending_stiffness)


def uniform_influence(shell: Shell, at: Points, *, digits: int = 13) -> Array:
    """Return the displacement at points per unit force spread evenly over the free plate.

    To be added to ``influence`` in sums whose force and torques vanish, like any of its columns.
    The particular solution is q r^4 / 64 D (Timoshenko and Woinowsky-Krieger, article 16).

    Parameters
    ----------
    shell
        The glass, taken as flat.
    at
        x and y, (n_at,) each, of the points where the displacement is read [m].
    digits
        As in `influence`.

    Returns
    -------
    numpy.ndarray
        (n_at,) displacement along z [m/N].

    Raises
    ------
    GeometryError
        A shell that cannot be, a point off the glass.
    """
    r = np.abs(_on_glass(shell, at, "point"))
    nu, hole = shell.poisson_ratio, shell.inner_radius / shell.outer_radius
    elements = _RadialElements(_graded_nodes(hole, np.array([hole**0.5])), order=digits + 4)
    responses = _edge_responses(elements, nu, 1)[0]
    tractions = np.concatenate([[(12 + 4 * nu) * e**2, 32 * e] for e in (1.0, hole)])
    displacement, _, _ = elements.at(r)
    per_load = (r**4 + displacement @ responses @ tractions) / (64 * np.pi * (1 - hole**2))
    return np.asarray(per_load * shell.outer_radius**2 / shell.bending_stiffness)


def stiffness(shell: Shell, x: Array, y: Array, *, digits: int = 13) -> Array:
    """Return the stiffness between point actuators on a free plate.

    Parameters
    ----------
    shell
        The glass, taken as flat.
    x, y
        (n,) positions of the actuators [m].
    digits
        As in `influence`.

    Returns
    -------
    numpy.ndarray
        (n, n) force per displacement [N/m], symmetric; its null space is {1, x, y}.

    Raises
    ------
    GeometryError
        A shell that cannot be, actuators off the glass, all but on an edge, on one line or
        several at one place.
    """
    compliance = influence(shell, (x, y), (x, y), digits=digits)
    return condense(compliance, np.array([np.ones_like(x), x, y])).stiffness


def _on_glass(shell: Shell, places: Points, what: str) -> NDArray[np.complex128]:
    """Return (n,) places as x + i y in units of the outer radius, once known to be on the glass."""
    a, b, nu = shell.inner_radius, shell.outer_radius, shell.poisson_ratio
    if not 1e-4 * b <= a < b < np.inf:  # in a finer hole rounding eats more than eight digits
        raise GeometryError(
            f"the glass reaches from {a:.6g} m to {b:.6g} m",
            remedy="give an inner radius below the outer one; to a full disc a thousandth of it",
            got=(a, b),
        )
    if not (0 < shell.bending_stiffness < np.inf and -1 < nu < 0.5):
        raise GeometryError(
            f"bending stiffness {shell.bending_stiffness:.6g} N m and Poisson ratio {nu:.6g}",
            remedy="give positive thickness and Young's modulus, and a ratio in (-1, 0.5)",
        )
    x, y = (np.asarray(coordinate, dtype=float) for coordinate in places)
    radius = np.hypot(x, y)
    slack = 1e-12 * b  # a point computed to lie on an edge does
    off = np.flatnonzero(~((radius >= a - slack) & (radius <= b + slack)))
    if off.size:
        i = off[0]
        raise GeometryError(
            f"{what} {i} at x = {x[i]:.6g} m, y = {y[i]:.6g} m is off the glass",
            remedy=f"bring it between the edges at {a:.6g} m and {b:.6g} m from the axis",
        )
    return np.asarray((x + 1j * y) / b)


def _harmonics(fading: float, digits: int, shell: Shell) -> int:
    """Return how many harmonics it takes until ``fading`` ** m falls below 10 ** -digits."""
    if fading >= 10.0 ** (-digits / MOST_HARMONICS):
        nearest = shell.outer_radius * digits * np.log(10) / MOST_HARMONICS
        raise GeometryError(
            "a force acts on an edge of the glass, or so near that its series hardly converges",
            remedy=f"keep forces {nearest:.2g} m away from the edges",
        )
    return max(3, int(np.ceil(-digits * np.log(10) / np.log(fading))))


def _graded_nodes(hole: float, force_radius: Array) -> Array:
    """Return the radii between elements, which double in width away from both edges.

    v is smooth up to the images of the forces in the edges, at hole^2/s and 1/s. Elements no wider
    than their distance from those all converge at one rate, 3 + sqrt(8) per order.
    """
    inner_image, outer_image = hole**2 / force_radius.min(), 1 / force_radius.max()
    nodes = [hole]
    while nodes[-1] < 1:
        width = min(nodes[-1] - inner_image, 0.5 * (outer_image - nodes[-1]))
        last = nodes[-1] + 1.5 * width >= 1
        nodes.append(1.0 if last else nodes[-1] + width)
    return np.array(nodes)


@dataclass(frozen=True, eq=False)
class _RadialElements:
    """Functions of radius with a continuous slope: Hermite cubics and bubbles up to an order.

    The unknowns are the value and the slope at each node, node after node, then the bubbles of
    each element, Legendre polynomials integrated twice.
    """

    nodes: Array
    order: int

    def at(self, r: Array) -> tuple[Array, Array, Array]:
        """Return the functions, their first and second derivatives, (n_r, n_unknowns) each."""
        last, bubbles = self.nodes.size - 2, self.order - 3
        element = np.clip(np.searchsorted(self.nodes, r, side="right") - 1, 0, last)
        half = 0.5 * np.diff(self.nodes)[element, None]
        xi = (r[:, None] - self.nodes[element, None]) / half - 1
        unknown = np.concatenate(
            [2 * element[:, None] + np.arange(4),
             2 * (last + 2) + bubbles * element[:, None] + np.arange(bubbles)], axis=1
        )  # fmt: skip
        per_slope = np.ones((r.size, self.order + 1))
        per_slope[:, [1, 3]] = half
        series = self._series()
        shapes = []
        for derivative in range(3):
            powers = legendre.legvander(xi[:, 0], self.order - derivative)
            local = powers @ legendre.legder(series, derivative) * per_slope / half**derivative
            shape = np.zeros((r.size, 2 * (last + 2) + bubbles * (last + 1)))
            np.put_along_axis(shape, unknown, local, axis=1)
            shapes.append(shape)
        return shapes[0], shapes[1], shapes[2]

    def _series(self) -> Array:
        """Return the Legendre series, in columns, of the shapes of an element on [-1, 1]."""
        series = np.zeros((self.order + 1, self.order + 1))
        series[:4, :4] = np.array([
            [1 / 2, 1 / 6, 1 / 2, -1 / 6],
            [-3 / 5, -1 / 10, 3 / 5, -1 / 10],
            [0, -1 / 6, 0, 1 / 6],
            [1 / 10, 1 / 10, -1 / 10, 1 / 10],
        ])  # fmt: skip
        series[:, 4:] = legendre.legint(np.eye(self.order - 1)[:, 2:], 2, lbnd=-1)
        return series


def _edge_responses(elements: _RadialElements, nu: float, count: int) -> Array:
    """Return (count, n_unknowns, 4): v in each harmonic per edge traction that it takes away.

    The tractions are moment and shear at the outer edge, then at the inner one. Energy from the
    curvatures W'', W'/r - m^2 W/r^2 and m (W/r)' (Timoshenko and Woinowsky-Krieger, chapter 9).
    """
    order, nodes = elements.order, elements.nodes
    xi, gauss = legendre.leggauss(order + 4)
    half = 0.5 * np.diff(nodes)[:, None]
    r = (nodes[:-1, None] + half * (xi + 1)).ravel()
    area = ((half * gauss).ravel() * r)[:, None]
    W, dW, bend = elements.at(r)
    hoop, lobe = dW / r[:, None], W / r[:, None] ** 2
    twist, hoop_moment = hoop - lobe, hoop + nu * bend
    energy_0 = bend.T @ (area * (bend + nu * hoop)) + hoop.T @ (area * hoop_moment)
    mixed = lobe.T @ (area * hoop_moment)
    energy_1 = 2 * (1 - nu) * twist.T @ (area * twist) - mixed - mixed.T
    energy_2 = lobe.T @ (area * lobe)

    hole = nodes[0]
    value, slope, _ = elements.at(np.array([1.0, hole]))
    tested = np.array([-slope[0], value[0], hole * slope[1], -hole * value[1]]).T
    spring = np.outer(value[0], value[0])
    responses = []
    for m in range(count):
        energy = energy_0 + m**2 * energy_1 + m**4 * energy_2 + (spring if m < 2 else 0.0)
        responses.append(cho_solve(cho_factor(energy), tested))
    return np.array(responses)


def _edge_tractions(s: Array, edge: float, nu: float, samples: int) -> Array:
    """Return (samples / 2 + 1, 2, n_of) cosine harmonics of the kernel's moment and shear.

    On the circle of radius ``edge``, for forces at radii s and angle 0: moment k_r + nu k_theta
    and Kirchhoff's shear d(lap)/dr + (1 - nu) d(k_r_theta)/(r dtheta), signs as in a(v, phi).
    """
    theta = 2 * np.pi * np.arange(samples)[:, None] / samples
    radial, across = edge - s * np.cos(theta), s * np.sin(theta)
    squared = radial**2 + across**2
    mean = np.log(squared) + 1  # 8 pi k'/rho; the Hessian adds 2 rho rho' / rho^2
    moment = (1 + nu) * mean + 2 * (radial**2 + nu * across**2) / squared
    shear = 4 * radial / squared
    twist = 2 * (1 - nu) * radial * across / squared
    moment_m, shear_m, twist_m = np.fft.rfft(np.array([moment, shear, twist]), axis=1) / samples
    shear_m += 1j * np.arange(shear_m.shape[0])[:, None] * twist_m / edge
    return np.stack([moment_m.real, shear_m.real], axis=1) / (8 * np.pi)
