"""A point force on an endless shallow sphere, and means over circles.

The shallow sphere under a unit force (Reissner, J. Math. Phys. 25, 1946; Timoshenko and
Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., chapter 15) obeys

    lap lap w + lambda^4 w = delta,    lap Phi = -lambda^4 w,    lambda^4 = E t b^4 / (D R^2)

with Phi the stress function of the membrane. It is solved by

    w = -kei(lambda rho) / (2 pi lambda^2),    Phi = lap w - ln(rho) / (2 pi)

The regular solution that is added below `SERIES_BELOW` changes nothing once the edges are free; it
makes w run into rho^2 ln(rho) / (8 pi), the kernel of the flat plate, as lambda goes to 0.

Every w of a shell that is unloaded within a circle of radius a is the sum of three parts with
lap w = 0, +i lambda^2 w and -i lambda^2 w. Their means over the circle are 1, I_0(sqrt(i) lambda a)
and its conjugate times the value at the centre, so that on the whole

    mean w = w + first lap w + second lap lap w

exactly, which in the flat limit is the mean value theorem of biharmonic functions, first = a^2 / 4.

Lengths are in units of b, displacements in units of b^2 / D per newton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.special import factorial, kv

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.mirrors.glass import Annulus

SERIES_BELOW = 2.0  # lambda; kei is used above, its series in lambda rho below
EULER_ROOT = np.exp(0.25j * np.pi)  # sqrt(i)
CIRCLES = 12  # Gauss points in the radius of an annulus
CIRCLE_TOLERANCE = 1e-9  # of a circle within another, in units of b


@dataclass(frozen=True)
class Mean:
    """Mean of w over circles round a point, from w and its Laplacians there."""

    first: Array
    second: Array


def mean_over_circle(radius: Array | float, shallowness: float) -> Mean:
    """Return the mean over a circle of each radius [b], the series of I_0(sqrt(i) lambda a)."""
    quarter = np.asarray(0.25 * np.square(radius))
    j = np.arange(24)
    powers = (-((shallowness**2 * quarter[..., None]) ** 2)) ** j
    return Mean(
        quarter * (powers @ factorial(2 * j + 1) ** -2.0),
        quarter**2 * (powers @ factorial(2 * j + 2) ** -2.0),
    )


class Circles:
    """An annulus, as circles in units of b."""

    def __init__(self, sensor: Annulus, b: float) -> None:
        self.inner, self.outer = sensor.inner_radius / b, sensor.outer_radius / b
        xi, gauss = legendre.leggauss(CIRCLES)
        # Radii of the circles, Gauss points, and their shares of the area.
        self.radii: Array = self.inner + 0.5 * (self.outer - self.inner) * (1 + xi)
        self.shares: Array = gauss * self.radii / (gauss @ self.radii)

    def mean(self, shallowness: float) -> Mean:
        """Return the mean over the annulus of a w that is regular inside."""
        over = mean_over_circle(self.radii, shallowness)
        return Mean(over.first @ self.shares, over.second @ self.shares)


@dataclass(frozen=True, eq=False)
class Kernel:
    """The field of a unit force that enters the shell through the rim of a puck."""

    shallowness: float  # lambda = b / sqrt(R t) * (12 (1 - nu^2))^(1/4); 0 on a flat plate
    puck_radius: float = 0.0  # radius of the circle on which the force acts [b]; 0 for a point

    def fields(self, rho: Array) -> tuple[Array, Array]:
        """Return w and lap w at distances from a point force, (..., n) each, in units of b."""
        rho = np.maximum(rho, 1e-100)  # w(0) is finite; lap w(0) is not, and is not used
        if self.shallowness >= SERIES_BELOW:
            k = kv(0, EULER_ROOT * self.shallowness * rho)
            return -k.imag / (2 * np.pi * self.shallowness**2), -k.real / (2 * np.pi)
        w, lap = (self._series(rho, kind, 0) for kind in (1, 0))
        return w, lap

    def slopes(self, rho: Array) -> tuple[Array, Array]:
        """Return dw/drho and dPhi/drho at (..., n) distances from a point force."""
        if self.shallowness >= SERIES_BELOW:
            z = EULER_ROOT * self.shallowness
            k = -z * kv(1, z * rho)
            w = -k.imag / (2 * np.pi * self.shallowness**2)
            return w, -(k.real + 1 / rho) / (2 * np.pi)
        return self._series(rho, 1, 1), self._series(rho, 0, 1)

    def _series(self, rho: Array, kind: int, derivative: int) -> Array:
        """Sum w (kind 1) or lap w (kind 0): the parts of -K_0, but for regular solutions, in rho.

        The first term of the slope of lap w, 1 / (2 pi rho), is omitted, which makes it Phi's.
        """
        log = np.log(rho) + 1
        total = np.zeros_like(rho)
        first = 1 - kind if derivative else 0
        for j in range(first, 10 if self.shallowness else 1):
            k = 2 * j + kind
            share = (-(self.shallowness**4)) ** j / (factorial(k) ** 2 * 4.0**k * 2 * np.pi)
            bracket = log - sum(1 / i for i in range(1, k + 1))
            if derivative:
                total += share * rho ** (2 * k - 1) * (2 * k * bracket + 1)
            else:
                total += share * rho ** (2 * k) * bracket
        return total

    def spread(self, w: Array, lap: Array, mean: Mean) -> tuple[Array, Array]:
        """Return means of (..., n) w and lap w where lap lap w = -lambda^4 w, off all forces."""
        fourth = self.shallowness**4
        kept = 1 - fourth * mean.second
        return kept * w + mean.first * lap, kept * lap - fourth * mean.first * w

    def displacement(self, rho: Array, sensor: Circles | None) -> Array:
        """Return w at (n_at, n_of) distances from forces, or its mean over a sensor there."""
        puck = mean_over_circle(self.puck_radius, self.shallowness)
        w, lap = self.spread(*self.fields(rho), puck)
        if sensor is None:
            inside = rho < self.puck_radius
            if inside.any():  # the circles round the force and round the point change roles
                round_force = mean_over_circle(rho[inside], self.shallowness)
                w[inside] = self.spread(*self.fields(np.array(self.puck_radius)), round_force)[0]
            return w
        mean = self.spread(w, lap, sensor.mean(self.shallowness))[0]
        near = rho < self.puck_radius + sensor.outer
        # Round a puck, centred or not, each circle changes roles with that round the force.
        own = rho + self.puck_radius < sensor.inner + CIRCLE_TOLERANCE
        if (near & ~own).any():
            raise GeometryError(
                "a sensor lies over the place where a force acts",
                remedy="sensors may only encircle the puck of their own actuator",
            )
        if own.any():
            fields = self.spread(*self.fields(sensor.radii), puck)
            off = mean_over_circle(rho[own][:, None], self.shallowness)
            mean[own] = self.spread(*fields, off)[0] @ sensor.shares
        return mean

    def edge_tractions(self, s: Array, edge: float, nu: float, samples: int) -> Array:
        """Return (samples // 2 + 1, 2 or 4, forces) harmonics of the tractions on an edge.

        On the circle of radius ``edge`` [m], for forces at radii s [m] and angle 0: the moment
        k_r + nu k_t and Kirchhoff's shear d(lap)/dr + (1 - nu) d(k_rt)/(r dt), and on a curved
        shell the membrane's N_r and N_rt divided by the root of its stiffness,
        `radial_elements.stretch`. N_rt goes with sines, the rest with cosines.
        """
        theta = 2 * np.pi * np.arange(samples)[:, None] / samples
        radial, across = edge - s * np.cos(theta), s * np.sin(theta)
        rho = np.hypot(radial, across)
        radial, across = radial / rho, across / rho
        puck = mean_over_circle(self.puck_radius, self.shallowness)
        fourth = self.shallowness**4
        # Phi and lap w differ by the field of ln(rho), whose Laplacian is 0.
        w, lap = self.spread(*self.fields(rho), puck)
        dw, dphi = self.slopes(rho)
        dw, dphi = (
            (1 - fourth * puck.second) * dw + puck.first * (dphi + 1 / (2 * np.pi * rho)),
            (1 - fourth * puck.second) * dphi
            - fourth * (puck.second / (2 * np.pi * rho) + puck.first * dw),
        )
        bend = lap - 2 * dw / rho  # w'' - w' / rho
        moment = (1 + nu) * dw / rho + bend * (radial**2 + nu * across**2)
        shear = (dphi + 1 / (2 * np.pi * rho)) * radial
        twist = (1 - nu) * bend * radial * across
        forces = [moment, shear, twist]
        if self.shallowness:
            stress = (-fourth * w - 2 * dphi / rho) * np.sqrt(1 - nu**2) / self.shallowness**2
            hoop = dphi / rho * np.sqrt(1 - nu**2) / self.shallowness**2
            forces += [hoop + stress * across**2, -stress * radial * across]
        harmonics = np.fft.rfft(np.array(forces), axis=1) / samples
        harmonics[1] += 1j * np.arange(harmonics.shape[1])[:, None] * harmonics[2] / edge
        tractions = [harmonics[0].real, harmonics[1].real]
        if self.shallowness:
            tractions += [harmonics[3].real, -harmonics[4].imag]
        return np.stack(tractions, axis=1)
