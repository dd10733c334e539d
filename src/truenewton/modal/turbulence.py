"""The wavefront of the atmosphere: its covariance in the pupil, and on the mirror."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform
from scipy.special import gamma, kv

from truenewton.arrays import Array, freeze
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.modal.bases import karhunen_loeve_modes, zernike_modes
from truenewton.quantities import Quantity, check_quantities, convert_quantities
from truenewton.statics.layout import Layout

WAVELENGTH = 500e-9  # at which seeing and r0 are stated [m]
MIN_SEEING, MAX_SEEING = 1e-3, 30.0  # beyond them the unit is wrong [arcsec]
MIN_OUTER_SCALE = 1e-2  # [m]
ARCSECOND = np.pi / 180 / 3600
# Fried's definition of r0 fixes the structure function 6.88 (r / r0)^(5/3) [rad^2], and that the
# spectrum 0.0229 r0^(-5/3) f^(-11/3). One constant for both: they agree in all digits.
FRIED = 2 * (24 / 5 * gamma(6 / 5)) ** (5 / 6)
SPECTRUM = 5 / 12 * gamma(11 / 6) / gamma(1 / 6) * np.pi ** (-8 / 3) * FRIED
ORDER = 5 / 6  # of the Bessel function K in the closed form
SERIES_BELOW = 2.0  # 2 pi r / L0 up to which the power series is used
SERIES_TERMS = 14  # the next is below 1e-17 of the sum
DISTANCES_AT_ONCE = 1 << 14
MAX_DIAMETER = 100.0  # beyond it the unit is wrong [m]
MIN_DIAMETER = 1e-3  # and radius [m]


@dataclass(frozen=True)
class Atmosphere:
    """Turbulence of the von Karman spectrum.

    Attributes
    ----------
    seeing
        Width of the long exposure without outer scale at 500 nm [arcsec].
    outer_scale
        L0 of the spectrum [m]; infinite for Kolmogorov's.

    Raises
    ------
    FormatError
        Invalid seeing or outer scale.

    Examples
    --------
    >>> tn.Atmosphere(seeing=0.8, outer_scale=25.0)
    Atmosphere(seeing=0.8, outer_scale=25.0)
    """

    QUANTITIES: ClassVar = {
        "seeing": Quantity(
            "arcsec", MIN_SEEING, MAX_SEEING, "give the width at 500 nm, as 0.8",
            "a seeing of {:g} arcsec",
        ),
        "outer_scale": Quantity(
            "m", MIN_OUTER_SCALE, np.inf,
            "give some tens of metres, or inf for Kolmogorov's spectrum",
            "an outer scale of {:g} m",
        ),
    }  # fmt: skip

    seeing: float = 0.8
    outer_scale: float = 40.0

    def __post_init__(self) -> None:
        convert_quantities(self)
        check_quantities(self)

    @property
    def fried_parameter(self) -> float:
        """r0 = 0.98 lambda / seeing at 500 nm [m]."""
        return 0.98 * WAVELENGTH / (self.seeing * ARCSECOND)


def structure_function(distance: Array, atmosphere: Atmosphere) -> Array:
    """Return D(r), the mean square difference of the optical path between two points [m^2].

    It is (lambda / 2 pi)^2 times that of the phase; distances r [m] have any shape (...).

    Notes
    -----
    The Hankel transform of the von Karman spectrum SPECTRUM r0^(-5/3) (f^2 + L0^-2)^(-11/6) gives
    (Conan 2000; Takato and Yamaguchi 1995, JOSA A 12, 958)

        D = 2 B(0) (1 - g(2 pi r / L0)),  g(z) = 2 / Gamma(5/6) (z/2)^(5/6) K_5/6(z),

    B(0) = 6/5 pi SPECTRUM (L0 / r0)^(5/3) [rad^2], the variance. With t = (z/2)^2, K in terms of
    I_5/6 and I_-5/6 (DLMF 10.27.4, 10.25.2) makes 1 - g a power series, without cancellation,
    whose first term is Kolmogorov's structure function FRIED (r / r0)^(5/3).
    """
    phase = (WAVELENGTH / (2 * np.pi)) ** 2
    r0, L0 = atmosphere.fried_parameter, atmosphere.outer_scale
    r = np.asarray(distance, dtype=float)
    kolmogorov = phase * FRIED * (r / r0) ** (5 / 3)
    if np.isinf(L0):
        return kolmogorov
    z = 2 * np.pi * r / L0
    near = z < SERIES_BELOW
    D = np.empty_like(z)
    D[near] = kolmogorov[near] * _departure(0.25 * z[near] ** 2)
    far = z[~near]
    g = 2 / gamma(ORDER) * (0.5 * far) ** ORDER * kv(ORDER, far)
    D[~near] = phase * 2.4 * np.pi * SPECTRUM * (L0 / r0) ** (5 / 3) * (1 - g)
    return D


def _departure(t: Array) -> Array:
    """Return D over Kolmogorov's, with t = (pi r / L0)^2 below 1.

    Sum over k of Gamma(11/6) t^k / k! [1 / Gamma(k + 11/6) - t^(1/6) / ((k + 1) Gamma(k + 7/6))].
    """
    k = np.arange(SERIES_TERMS)
    factorial = gamma(k + 1.0)
    own = gamma(1 + ORDER) / (factorial * gamma(k + 1 + ORDER))
    other = gamma(1 + ORDER) / (factorial * (k + 1) * gamma(k + 2 - ORDER))
    polynomial = np.polynomial.polynomial.polyval
    return np.asarray(polynomial(t, own) - t ** (1 - ORDER) * polynomial(t, other))


def wavefront_covariance(x: Array, y: Array, atmosphere: Atmosphere) -> Array:
    """Return the (n, n) covariance of the wavefront between points of the pupil, less piston [m^2].

    It is that of the optical path, P C P with P = I - 1 1'/n: the mean over the points, which a
    loop does not correct and which is infinite in Kolmogorov's spectrum, is removed. Constants drop
    out of P C P, so that C = -D / 2 for any outer scale.

    Parameters
    ----------
    x, y
        (n,) points in the entrance pupil [m].
    atmosphere
        The turbulence.

    Examples
    --------
    >>> x, y = 2.1 * layout.x / 0.24, 2.1 * layout.y / 0.24  # on a pupil of 2.1 m
    >>> covariance = tn.wavefront_covariance(x, y, tn.Atmosphere(seeing=0.8))
    >>> f"{1e6 * np.sqrt(np.diag(covariance).mean()):.1f} um rms"
    '0.6 um rms'
    """
    D = pdist(np.column_stack([x, y]))
    for start in range(0, D.size, DISTANCES_AT_ONCE):
        some = slice(start, start + DISTANCES_AT_ONCE)
        D[some] = structure_function(D[some], atmosphere)
    D *= -0.5
    C = squareform(D)
    mean = C.mean(axis=0)
    return less_mean(C, mean, float(mean.mean()))


def less_mean(C: Array, with_mean: Array, of_mean: float) -> Array:
    """Subtract a mean from a wavefront with (n, n) covariance, in place; return the matrix.

    ``with_mean`` is its (n,) covariance with the mean, and ``of_mean`` the variance of the mean.
    """
    for start in range(0, len(C), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        C[some] -= np.add.outer(with_mean[some], with_mean) - of_mean
    return C


@dataclass(frozen=True)
class Pupil:
    """The size of the mirror and of the entrance pupil that it fills."""

    QUANTITIES: ClassVar = {
        name: Quantity(
            "m", MIN_DIAMETER, MAX_DIAMETER, "give it in metres",
            f"the {name} of the pupil is {{:g}} m",
        )
        for name in ("radius", "diameter")
    }  # fmt: skip

    radius: float  # of the optical surface of the mirror in the plane of x and y [m]
    diameter: float  # of the entrance pupil [m]

    def __post_init__(self) -> None:
        check_quantities(self)


def centred(layout: Layout) -> tuple[Array, Array]:
    """Return (n,) x and y [m]; those of a single segment relative to its centre."""
    if layout.segment is None or layout.segments:
        return layout.x, layout.y
    x, y = (each - 0.5 * (each.min() + each.max()) for each in (layout.x, layout.y))
    return x, y


def pupil_of(layout: Layout, diameter: float, radius: float | None = None) -> Pupil:
    """Return the pupil of a diameter [m] that a mirror fills.

    The default radius [m] of the mirror is that of the outermost actuator plus half a spacing.
    """
    if radius is None:
        outermost = float(np.hypot(*centred(layout)).max())
        radius = outermost * (1.0 + 0.5 * np.sqrt(np.pi / layout.n))
    return Pupil(radius, diameter)


@dataclass(frozen=True, eq=False, repr=False)
class SeenTurbulence:
    """Turbulence at n actuators of which m are commanded, and two modal bases."""

    # the turbulence, and the pupil that the mirror fills
    atmosphere: Atmosphere
    pupil: Pupil
    # (n, n) covariance of the wavefront relative to its mean over the commanded [m^2]
    wavefront: Array
    # (m, m) modes, orthonormal on the commanded, one a column
    zernike: Array
    karhunen_loeve: Array

    def __post_init__(self) -> None:
        freeze(self, "wavefront", "zernike", "karhunen_loeve")

    def __repr__(self) -> str:
        return f"<SeenTurbulence at {len(self.wavefront)} actuators, {self.atmosphere}>"

    @property
    def fitting_error(self) -> float:
        """Rms wavefront between the actuators, which no modes correct [m].

        0.28 (d / r0)^(5/3) rad^2 of a continuous face sheet at 500 nm (Hudgin 1977, JOSA 67, 393),
        with d the spacing of all actuators in the pupil, from the area of each.
        """
        spacing = 0.5 * self.pupil.diameter * np.sqrt(np.pi / len(self.wavefront))
        variance = 0.28 * (spacing / self.atmosphere.fried_parameter) ** (5 / 3)
        return float(WAVELENGTH / (2 * np.pi) * np.sqrt(variance))


def seen_turbulence(
    layout: Layout, commanded: NDArray[np.bool_], atmosphere: Atmosphere, pupil: Pupil
) -> SeenTurbulence:
    """Return the turbulence at n actuators; (n,) ``commanded`` is true for those with commands."""
    x, y = (each / pupil.radius for each in centred(layout))
    half = 0.5 * pupil.diameter
    wavefront = wavefront_covariance(half * x, half * y, atmosphere)
    mean = wavefront @ commanded / np.count_nonzero(commanded)
    less_mean(wavefront, mean, float(mean[commanded].mean()))
    karhunen_loeve = karhunen_loeve_modes(
        wavefront[np.ix_(commanded, commanded)],
        overwrite=True,  # held nowhere else
    )
    zernike = zernike_modes(x[commanded], y[commanded])
    for values in (wavefront, karhunen_loeve, zernike):
        values.setflags(write=False)  # so that the record need not copy them
    return SeenTurbulence(atmosphere, pupil, wavefront, zernike, karhunen_loeve)
