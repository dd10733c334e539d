"""What moves with the glass: its mass, and the film of air between glass and reference plate.

Air is squeezed out of a thin film against its viscosity mu (Reynolds' equation; W. E. Langlois,
Quarterly of Applied Mathematics 20, 1962). With an even gap h, w along +z, and p the pressure above
that of the room, which it has at the edges of the glass and at open bores:

    div grad p = -(12 mu / h^3) dw/dt        in the film,  p = 0 at its edges

With w = sum of phi_j z_j over the influence functions and G the inverse of -div grad, the film
takes the forces C dz/dt, as work on the readings,

    C = (12 mu / h^3) integral of phi_i G phi_j

The plate may have a bore of radius v round each actuator, open to the room. Its sources make the
mean pressure on its rim zero: with Phi_kj that mean of G phi_j without bores, and Gamma_kl that
of the Green's function of a source on the rim of bore l,

    C <- C - (12 mu / h^3) [Phi' Gamma^-1 Phi + (pi v^4 / 8) S' S]

where S is the displacement over the bores; the last term is the missing film of the bore. Bores
are small compared with their distances. Inertia and compression of the air are neglected: the film
of P45 is compressed, not squeezed out, above p_0 h^2 k^2 / 24 pi mu = 375 Hz, with p_0 the pressure
of the room and k^2 the smallest eigenvalue of -div grad (Langlois 1962).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Points, rim
from truenewton.mirrors.shell.mesh import Indices, Mesh
from truenewton.mirrors.shell.meshed_shell import MeshedShell
from truenewton.mirrors.shell.shell_model import ShellModel, StaticShapes, shapes_at

VISCOSITY = 1.82e-5  # of air at 20 degC [Pa s, lit]
FUNCTIONS_PER_ACTUATOR = 3.0  # of pressure, along a line


def moving_mass(glass: ShellModel, shapes: StaticShapes) -> tuple[Array, Array]:
    """Return M [kg] and S, (n, n) each, in M z'' + K~ z = S' f, z the readings and f the forces.

    M = rho t integral of phi_i phi_j + magnet_mass S' S (Guyan's reduction), with phi the influence
    functions and S the displacement of the pucks with their magnets per reading, 1 if actuators are
    read at the points of their forces. S transforms the forces to the readings by virtual work; K~
    = S' K. Motion along the glass and the inertia of rotation are neglected. M is symmetric; for
    rigid motions it is that of the whole.
    """
    mirror = glass.mirror
    mass = shapes.shape.T @ (shapes.area[:, None] * shapes.shape)
    mass *= mirror.shell.density * mirror.shell.thickness
    pucks, on_puck = np.eye(mirror.layout.n), rim(mirror.puck_radius)
    if mirror.sensor != on_puck:
        pucks = shapes_at(glass, glass.places, on_puck)
    mass += mirror.magnet_mass * pucks.T @ pucks
    return 0.5 * (mass + mass.T), pucks


def film_damping(glass: ShellModel, shapes: StaticShapes) -> Array:
    """Return C, (n, n), the force of the air film per velocity of the readings [N s/m].

    Symmetric; as work on the readings, like the mass of `moving_mass`; at the nominal gap.
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


def film_of(glass: ShellModel) -> RoundFilm | MeshedFilm:
    """Return the pressures in the film under a shell, zero at its edges."""
    if isinstance(glass.free, MeshedShell):
        return MeshedFilm(glass.free.mesh)
    shell = glass.mirror.shell
    return RoundFilm(
        shell.inner_radius, shell.outer_radius, FUNCTIONS_PER_ACTUATOR * glass.mirror.layout.n**0.5
    )


def _between_bores(film: RoundFilm | MeshedFilm, glass: ShellModel) -> Array:
    """Return Gamma, (n, n), and refuse bores that touch."""
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
        )
    return np.asarray(green)


@dataclass(frozen=True)
class RoundFilm:
    """Pressures in a ring: cos and sin of m theta times polynomials of radius, 0 at the edges."""

    # [m]
    inner_radius: float
    outer_radius: float
    fineness: float  # functions along a line across the glass

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
        """Return the (points, functions) values, those of one wave together."""
        radial, waves = self._radial(np.hypot(*at), 0), self._waves(np.arctan2(at[1], at[0]))
        return (waves[:, :, None] * radial[:, None, :]).reshape(at[0].size, -1)

    def work(self, at: Points, shapes: Array) -> Array:
        """Return (functions, k) sums of each over places, times (places, k) area times shape.

        Circle by circle, since places lie on few.
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
        """Return the (functions, k) pressure G of such sums: Galerkin's method, wave by wave."""
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


@dataclass(frozen=True, eq=False)
class MeshedFilm:
    """Pressures under a glass of any outline: linear elements on its mesh."""

    mesh: Mesh  # its first vertices are the actuators

    @cached_property
    def _energy(self) -> csc_array:
        """(vertices, vertices) integral of grad s . grad s' of the linear functions."""
        corners = self.mesh.corners
        opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        local = opposite @ np.swapaxes(opposite, 1, 2) / (4 * self.mesh.areas[:, None, None])
        rows, columns = np.broadcast_arrays(
            self.mesh.triangles[:, :, None], self.mesh.triangles[:, None, :]
        )
        return csc_array((local.ravel(), (rows.ravel(), columns.ravel())))

    @cached_property
    def _inner_and_edge(self) -> tuple[Indices, Indices]:
        """Vertices within the film, and those on an edge of it."""
        sides = np.bincount(self.mesh.edge_of.ravel())
        edge = np.unique(self.mesh.edges[sides == 1])
        return np.setdiff1d(np.arange(len(self.mesh.points)), edge), edge

    def values(self, at: Points) -> csr_array:
        """Return the (points, functions) values, a function for each inner vertex."""
        places = np.stack(at, axis=1)
        triangle = self.mesh.triangle_at(places)
        corners = self.mesh.corners[triangle]
        ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
        sides = np.stack([ahead - places[:, None], behind - places[:, None]], axis=2)
        shares = np.linalg.det(sides) / (2 * self.mesh.areas[triangle, None])
        rows = np.repeat(np.arange(len(places)), 3)
        columns = self.mesh.triangles[triangle].ravel()
        shape = (len(places), len(self.mesh.points))
        return csr_array((shares.ravel(), (rows, columns)), shape=shape)[:, self._inner_and_edge[0]]

    def work(self, at: Points, shapes: Array) -> Array:
        """Return (functions, k) sums of each over places, times (places, k) area times shape."""
        return np.asarray(self.values(at).T @ shapes)

    def solve(self, work: Array) -> Array:
        """Return the (functions, k) pressure G of such sums."""
        inner, _ = self._inner_and_edge
        return np.asarray(splu(csc_array(self._energy[inner][:, inner])).solve(np.asarray(work)))

    def smooth_green(self, at: Points) -> Array:
        """Return (n, n) Green's function between actuators plus ln(distance) / 2 pi.

        It is harmonic, and ln(distance) / 2 pi at the edges.
        """
        inner, edge = self._inner_and_edge
        places = self.mesh.points[edge, None] - np.stack(at, axis=1)
        at_edge = np.log(np.linalg.norm(places, axis=2)) / (2 * np.pi)
        within = np.zeros((len(self.mesh.points), at[0].size))
        within[inner] = self.solve(-(self._energy[inner][:, edge] @ at_edge))
        return within[: at[0].size]
