"""The wavefront that the atmosphere sends: its covariance between points of the pupil."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import pdist, squareform
from scipy.special import gamma, kv

from truenewton.arrays import Array
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.quantities import Quantity, check_quantities, convert_quantities

WAVELENGTH = 500e-9  # at which seeing and r0 are stated [m]
BEST_SEEING, WORST_SEEING = 1e-3, 30.0  # beyond them the unit has slipped [arcsec]
LEAST_SCALE = 1e-2  # [m]
ARCSECOND = np.pi / 180 / 3600
# Fried's definition of r0 fixes the structure function 6.88 (r / r0)^(5/3) [rad^2], and that the
# spectrum 0.0229 r0^(-5/3) f^(-11/3). Both from one constant, lest they differ in the fourth digit.
FRIED = 2 * (24 / 5 * gamma(6 / 5)) ** (5 / 6)
SPECTRUM = 5 / 12 * gamma(11 / 6) / gamma(1 / 6) * np.pi ** (-8 / 3) * FRIED
ORDER = 5 / 6  # of the Bessel function K in the closed form
SERIES_BELOW = 2.0  # 2 pi r / L0 up to which the power series serves
SERIES_TERMS = 14  # the next is below 1e-17 of the sum
AT_ONCE = 1 << 14  # distances


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
        A seeing or an outer scale that cannot be.

    Examples
    --------
    >>> tn.Atmosphere(seeing=0.8, outer_scale=25.0)
    Atmosphere(seeing=0.8, outer_scale=25.0)
    """

    QUANTITIES: ClassVar = {
        "seeing": Quantity(
            "arcsec", BEST_SEEING, WORST_SEEING, "give the width at 500 nm, as 0.8",
            "a seeing of {:g} arcsec",
        ),
        "outer_scale": Quantity(
            "m", LEAST_SCALE, np.inf,
            "give some tens of metres, or inf for Kolmogorov's spectrum",
            "an outer scale of {:g} m",
        ),
    }  # fmt: skip

    seeing: float
    outer_scale: float = 40.0

    def __post_init__(self) -> None:
        convert_quantities(self)
        check_quantities(self)

    @property
    def fried_parameter(self) -> float:
        """r0 = 0.98 lambda / seeing at 500 nm [m]."""
        return 0.98 * WAVELENGTH / (self.seeing * ARCSECOND)


def structure_function(distance: Array, atmosphere: Atmosphere) -> Array:
    """Return D(r), the mean square difference of the wavefront between two points [m^2].

    Of the optical path, so of no wavelength: D = (lambda / 2 pi)^2 times that of the phase.

    Parameters
    ----------
    distance
        r between the points, of any shape [m].

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

    Of the optical path, whatever the wavelength. P C P with P = I - 1 1'/n: the mean over the
    points is out, which the loop leaves alone and which in Kolmogorov's spectrum is infinite. As
    constants drop out of P, C = -D / 2 for any outer scale.

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
    for start in range(0, D.size, AT_ONCE):
        some = slice(start, start + AT_ONCE)
        D[some] = structure_function(D[some], atmosphere)
    D *= -0.5
    C = squareform(D)
    mean = C.mean(axis=0)
    return counted_from(C, mean, float(mean.mean()))


def counted_from(C: Array, with_mean: Array, of_mean: float) -> Array:
    """Count a wavefront with (n, n) covariance from some mean of it, in place; return the matrix.

    ``with_mean``, (n,), is its covariance with the mean, and ``of_mean`` the mean's variance.
    """
    for start in range(0, len(C), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        C[some] -= np.add.outer(with_mean[some], with_mean) - of_mean
    return C
