"""What the film of air between glass and reference plate does to motion: Reynolds' equation.

Air is squeezed out of a film as thin as this one against its viscosity mu alone (W. E. Langlois,
Quarterly of Applied Mathematics 20, 1962). With the gap h even, w along +z, p the pressure above
that of the room, which it has at the edges of the glass and at open bores:

    div grad p = -(12 mu / h^3) dw/dt        in the film,  p = 0 at its edges

With w = sum of phi_j z_j over the influence functions and G the inverse of -div grad, the film
takes the forces C dz/dt, as work on the readings,

    C = (12 mu / h^3) integral of phi_i G phi_j

Round each actuator the plate may have a bore of radius v, open to the room. It lets out what makes
the mean pressure on its rim zero: with Phi_kj that mean of G phi_j without bores, and Gamma_kl that
of the Green's function of a source on the rim of bore l,

    C <- C - (12 mu / h^3) [Phi' Gamma^-1 Phi + (pi v^4 / 8) S' S]

where S is the displacement over the bores; the last term is the film that the bore is not. Bores
are small beside their distances; the air's inertia and compression are left out, as
`breathing_frequency` allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.shell.finite_elements.film import MeshedFilm
from truenewton.mirrors.shell.finite_elements.meshed_shell import MeshedShell
from truenewton.mirrors.shell.moving_mass import StaticShapes, shapes_at
from truenewton.mirrors.shell.places import Points
from truenewton.mirrors.shell.shell_model import ShellModel

VISCOSITY = 1.82e-5  # of air at 20 degC [Pa s, lit]
ROOM_PRESSURE = 1.013e5  # [Pa, lit]
FINER = 3.0  # functions of pressure for each actuator along a line


class Film(Protocol):
    """The space of pressures in a film, zero at its edges."""

    def values(self, at: Points) -> Array:
        """Return (points, functions)."""

    def work(self, at: Points, shapes: Array) -> Array:
        """Return (functions, k) sums of each over places, times (places, k) area times shape."""

    def solve(self, work: Array) -> Array:
        """Return (functions, k) that G gives for the (functions, k) integrals of each by phi."""

    def smooth_green(self, at: Points) -> Array:
        """Return (n, n) Green's function between places plus ln(distance) / 2 pi."""


def film_damping(glass: ShellModel, shapes: StaticShapes) -> Array:
    """Return C, (n, n), the force of the air film per velocity of the readings [N s/m].

    Symmetric; as work on the readings, like the mass of `moving_mass`. At the nominal gap: that it
    goes as gap^-3 within a stroke is left out.

    Raises
    ------
    GeometryError
        Bores that touch, or reach over an edge; what `model_shell` raises.
    """
    mirror, film = glass.mirror, film_of(glass)
    work = film.work(shapes.at, shapes.area[:, None] * shapes.shape)
    pressure = film.solve(work)
    damping = work.T @ pressure
    if mirror.vent_radius:
        over = shapes_at(glass, glass.places)
        # over a rim: the mean value, with div grad p = -phi within
        mean = film.values(glass.places) @ pressure - mirror.vent_radius**2 / 4 * over
        damping -= mean.T @ np.linalg.solve(_between_bores(film, glass), mean)
        damping -= np.pi / 8 * mirror.vent_radius**4 * over.T @ over
    return np.asarray(6 * VISCOSITY / mirror.gap**3 * (damping + damping.T))


def breathing_frequency(glass: ShellModel) -> float:
    """Return the frequency [Hz] at which the film is as much of a spring as of a damper.

    p_0 h^2 k^2 / 24 pi mu, with k^2 the least eigenvalue of -div grad in the film: well below it
    air is squeezed out, well above it is compressed (Langlois 1962).
    """
    film = film_of(glass)
    at, area = glass.free.quadrature(16 * glass.mirror.layout.n)
    inverse = film.solve(film.work(at, area[:, None] * film.values(at)))
    k2 = 1 / float(np.linalg.eigvals(inverse).real.max())
    return ROOM_PRESSURE * glass.mirror.gap**2 * k2 / (24 * np.pi * VISCOSITY)


def film_of(glass: ShellModel) -> Film:
    """Return the film under a ring of glass, or under any outline."""
    if isinstance(glass.free, MeshedShell):
        return MeshedFilm(glass.free.mesh)
    shell = glass.mirror.shell
    return RoundFilm(shell.inner_radius, shell.outer_radius, FINER * glass.mirror.layout.n**0.5)


def _between_bores(film: Film, glass: ShellModel) -> Array:
    """Return Gamma, (n, n), once bores are known not to touch."""
    vent = glass.mirror.vent_radius
    x, y = glass.places
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(distance, vent)
    green = film.smooth_green(glass.places) - np.log(distance) / (2 * np.pi)
    touching = distance < 2 * vent
    np.fill_diagonal(touching, np.diag(green) <= 0)
    if touching.any():
        raise GeometryError(
            f"bores of {vent:g} m touch each other, or an edge of the glass",
            remedy="give a smaller vent_radius",
            got=vent,
        )
    return np.asarray(green)


@dataclass(frozen=True)
class RoundFilm:
    """Pressures in a ring: cos and sin of m theta, times polynomials of radius that are 0 at edges.

    Attributes
    ----------
    inner_radius, outer_radius
        [m].
    fineness
        Functions along a line across the glass.
    """

    inner_radius: float
    outer_radius: float
    fineness: float

    @property
    def harmonics(self) -> int:
        """Number of m, from 0."""
        return int(np.ceil(self.fineness)) + 4

    @property
    def order(self) -> int:
        """Number of polynomials."""
        across = 1 - self.inner_radius / self.outer_radius
        return int(np.ceil(self.fineness * across)) + 4

    def _radial(self, r: Array, derivative: int) -> Array:
        """Return (n_r, order) of the integrated Legendre polynomials of radius."""
        half = (self.outer_radius - self.inner_radius) / 2
        series = legendre.legint(np.eye(self.order + 1)[:, 1:], lbnd=-1)
        series = legendre.legder(series, derivative) if derivative else series
        xi = (r - self.inner_radius) / half - 1
        return np.asarray(legendre.legvander(xi, len(series) - 1) @ series / half**derivative)

    def _waves(self, theta: Array) -> Array:
        """Return (n, 2 harmonics - 1): 1, then cosines and sines in turn."""
        m = np.arange(1, self.harmonics)
        turned = np.stack([np.cos(theta[:, None] * m), np.sin(theta[:, None] * m)], axis=2)
        return np.concatenate([np.ones((theta.size, 1)), turned.reshape(theta.size, -1)], axis=1)

    def values(self, at: Points) -> Array:
        """Return (points, functions), those of one wave together."""
        radial, waves = self._radial(np.hypot(*at), 0), self._waves(np.arctan2(at[1], at[0]))
        return (waves[:, :, None] * radial[:, None, :]).reshape(at[0].size, -1)

    def work(self, at: Points, shapes: Array) -> Array:
        """Return (functions, k) sums of each over places, times (places, k) area times shape.

        Circle by circle: places lie on few.
        """
        radius = np.hypot(*at)
        circle = np.round(radius / self.outer_radius, 12)
        order = np.argsort(circle, kind="stable")
        starts = np.flatnonzero(np.diff(circle[order], prepend=-1.0))
        waves = self._waves(np.arctan2(at[1], at[0]))
        sums = [waves[some].T @ shapes[some] for some in np.split(order, starts[1:])]
        radial = self._radial(radius[order[starts]], 0)
        work = np.tensordot(np.array(sums), radial, ([0], [0])).swapaxes(1, 2)
        return np.asarray(work.reshape(-1, shapes.shape[1]))

    def solve(self, work: Array) -> Array:
        """Return (functions, k) of pressure: Galerkin's method, wave by wave."""
        xi, gauss = legendre.leggauss(2 * self.order + 16)
        half = (self.outer_radius - self.inner_radius) / 2
        r, weight = self.inner_radius + half * (xi + 1), half * gauss
        slope, value = self._radial(r, 1), self._radial(r, 0)
        along = slope.T @ ((weight * r)[:, None] * slope)
        round_about = value.T @ ((weight / r)[:, None] * value)
        m = np.arange(2 * self.harmonics - 1)
        m = (m + 1) // 2
        energy = np.pi * (along + (m**2)[:, None, None] * round_about)
        energy[0] *= 2
        by_wave = work.reshape(m.size, self.order, -1)
        return np.asarray(np.linalg.solve(energy, by_wave).reshape(work.shape))

    def smooth_green(self, at: Points) -> Array:
        """Return (n, n) Green's function between places plus ln(distance) / 2 pi.

        In units of the outer radius, with r < s and hole a, harmonic m of G is (r^m - (a a/r)^m)
        (s^-m - s^m) / 2m(1 - a^2m), and that of -ln(distance) / 2 pi is (r/s)^m / 2m.
        """
        a = self.inner_radius / self.outer_radius
        radius = np.hypot(*at) / self.outer_radius
        angle = np.arctan2(at[1], at[0])
        r, s = np.minimum.outer(radius, radius), np.maximum.outer(radius, radius)
        between = np.subtract.outer(angle, angle)
        green = np.log(r / a) * np.log(1 / s) / np.log(1 / a) + np.log(s * self.outer_radius)
        fading = max(float(radius.max()) ** 2, (a / float(radius.min())) ** 2)
        inward, outward = a * a * r / s, a * a * s / r
        for m in range(1, 2 + int(np.log(1e-15) / np.log(fading))):
            images = inward**m + outward**m - (r * s) ** m - (a * a / r / s) ** m
            green += images / (m * (1 - a ** (2 * m))) * np.cos(m * between)
        return np.asarray(green / (2 * np.pi))
