"""Turbulence as modal/turbulence.py has it, beside what is published.

    python -m studies.turbulence [--rings 32] [--spokes 80] [--aotools]

Noll's residuals, Sasiela and Shelton's tilt with outer scale, and Karhunen-Loeve spectra, all from
`wavefront_covariance` on a grid of rings x spokes over the disc, with Gauss quadrature in rho^2 and
equal weights in angle. The spectra are compared with the eigenvalues of Zernike covariances in
closed form, which use neither the grid nor Bessel's K. The unit is (D / r0)^(5/3) rad^2.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from scipy.linalg import eigvalsh
from scipy.special import gamma, rgamma

from truenewton.modal.bases import zernike
from truenewton.modal.turbulence import SPECTRUM, WAVELENGTH, Atmosphere, wavefront_covariance

Array = np.ndarray

DIAMETER = 8.0
# Noll 1976 (JOSA 66, 207), Table IV: residual after correction of the first J Zernikes. His
# figures assume 0.02284 in the spectrum, 0.24 % less than follows from the definition of r0.
NOLL = [
    1.0299, 0.582, 0.134, 0.111, 0.0880, 0.0648, 0.0587, 0.0525, 0.0463, 0.0401, 0.0377,
    0.0352, 0.0328, 0.0304, 0.0279, 0.0267, 0.0255, 0.0243, 0.0232, 0.0220, 0.0208,
]  # fmt: skip
NOLL_SPECTRUM = 0.02284


def disc(rings: int, spokes: int) -> tuple[Array, Array, Array]:
    """Return points x, y of the unit disc and their weights, whose sum is 1."""
    t, weight = np.polynomial.legendre.leggauss(rings)
    angle = 2 * np.pi * np.arange(spokes) / spokes
    point = np.outer(np.sqrt((1 + t) / 2), np.exp(1j * angle)).ravel()
    return point.real, point.imag, np.repeat(weight / 2, spokes) / spokes


def on_grid(ratio: float, x: Array, y: Array, weight: Array) -> Array:
    """Return the covariance over the disc for D / L0 = ratio, without the weighted mean."""
    atmosphere = Atmosphere(0.8, DIAMETER / ratio if ratio else np.inf)
    C = wavefront_covariance(x * DIAMETER / 2, y * DIAMETER / 2, atmosphere)
    C /= (WAVELENGTH / (2 * np.pi)) ** 2 * (DIAMETER / atmosphere.fried_parameter) ** (5 / 3)
    mean = C @ weight
    return C - np.add.outer(mean, mean) + weight @ mean


def residuals(C: Array, x: Array, y: Array, weight: Array) -> Array:
    """Return the residual after correction of the first J Zernikes, J = 1 .. 21."""
    Z = weight[:, None] * zernike(len(NOLL), x, y)
    return weight @ np.diag(C) - np.cumsum(np.einsum("pj,pq,qj->j", Z, C, Z, optimize=True))


def spectrum(C: Array, weight: Array) -> Array:
    """Return the Karhunen-Loeve eigenvalues, largest first."""
    return eigvalsh(C * np.sqrt(np.outer(weight, weight)))[::-1]


def zernike_covariance(n: int, other: int, m: int, ratio: float) -> float:
    """Return the covariance of two Zernikes of radial orders n and `other`, both of azimuthal m.

    Noll's integral of J_n+1 J_n'+1 / x (x^2 + a^2)^(-11/6), a = pi D / L0, by residues: one series
    in a^2 from the spectrum's poles and one from those of the Bessel functions (Winker 1991, JOSA
    A 8, 1568; Takato and Yamaguchi 1995, JOSA A 12, 958). For L0 = inf its first term is Noll's
    closed form. Good to nine digits up to D = L0.
    """
    a, p = np.pi * ratio, 11 / 6
    half, apart = (n + other) / 2 + 1, (n - other) / 2
    k = np.arange(24.0 if ratio else 1.0)

    def terms(u: Array, poles: Array) -> Array:
        bessel = gamma(1 + 2 * u) / 2 ** (1 + 2 * u) * rgamma(1 + u + half)
        bessel *= rgamma(1 + u + apart) * rgamma(1 + u - apart)
        return (-1) ** k * rgamma(k + 1) * a ** (2 * (u - p)) * gamma(u) * poles * bessel

    total = terms(p + k, gamma(half - p - k)).sum()
    if ratio:
        total += terms(half + k, gamma(p - half - k)).sum()
    sign = (-1) ** ((n + other) // 2 - m)
    scale = 8 * np.pi ** (8 / 3) * SPECTRUM / gamma(p)
    return float(sign * scale * np.sqrt((n + 1) * (other + 1)) * total)


def closed_spectrum(ratio: float, count: int, size: int = 12) -> Array:
    """Return the Karhunen-Loeve eigenvalues of Zernike covariances, largest first."""

    def values() -> Iterator[float]:
        for m in range(size):
            orders = [n for n in range(m, m + 2 * size, 2) if n]
            C = [[zernike_covariance(n, other, m, ratio) for other in orders] for n in orders]
            for value in np.linalg.eigvalsh(C):
                yield from [value] * (2 if m else 1)

    return np.sort(list(values()))[::-1][:count]


def tilt_attenuation(ratio: float) -> float:
    """Return the variance of tilt relative to Kolmogorov's for D / L0 = ratio.

    Sasiela and Shelton 1993, J. Math. Phys. 34, 2572: a series, its coefficients as printed.
    """
    q = np.cbrt(ratio)
    return float(1 - 1.42 * q + 3.70 * q**6 - 4.01 * q**7 + 4.21 * q**12 - 4.00 * q**13)


def of_aotools(ratio: float, count: int) -> Array:
    """Return the eigenvalues by the published package aotools, after Cannon 1996, JOSA A 13, 862.

    The error of its radial grid is proportional to the step; extrapolation from two grids makes it
    quadratic. Its von Karman structure function is NaN at r = 0 instead of 0.
    """
    from aotools.functions import karhunenLoeve as package  # noqa: N813

    theirs = package.stf_vonKarman
    package.stf_vonKarman = lambda r, L0: np.where(r == 0, 0.0, theirs(np.maximum(r, 1e-9), L0))
    name, outer = ("vonKarman", 1 / ratio) if ratio else ("kolmogorov", None)

    def eigenvalues(steps: int) -> Array:
        kernel = package.gkl_kernel(0.0, steps, package.gkl_radii(0.0, steps), name, outer)
        return package.gkl_fcom(0.0, kernel, count)[0]

    coarse, fine = eigenvalues(80), eigenvalues(160)
    package.stf_vonKarman = theirs
    return np.sort(2 * fine - coarse)[::-1]


def main() -> None:
    """Print the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rings", type=int, default=32)
    parser.add_argument("--spokes", type=int, default=80)
    parser.add_argument("--aotools", action="store_true", help="beside that package, if installed")
    options = parser.parse_args()
    grid = disc(options.rings, options.spokes)
    weight = grid[2]

    kolmogorov = on_grid(0.0, *grid)
    print("Noll's residuals: J, Table IV, here, here with Noll's constant")
    for J, (printed, ours) in enumerate(zip(NOLL, residuals(kolmogorov, *grid), strict=True), 1):
        print(f"{J:4d} {printed:8.4f} {ours:9.5f} {ours * NOLL_SPECTRUM / SPECTRUM:9.5f}")

    print("\ntilt over Kolmogorov's: D / L0, Sasiela and Shelton, here")
    tilt = weight * zernike(2, *grid[:2])[:, 1]
    whole = tilt @ kolmogorov @ tilt
    outer = {ratio: on_grid(ratio, *grid) for ratio in (0.1, 0.2, 0.4, 1.0)}
    for ratio, C in outer.items():
        if ratio < 1:
            print(f"{ratio:6.2f} {tilt_attenuation(ratio):8.4f} {tilt @ C @ tilt / whole:8.4f}")

    for ratio in (0.0, 0.2, 1.0):
        print(f"\nKarhunen-Loeve, D / L0 = {ratio:g}: mode, Zernike covariances, here, apart")
        ours = spectrum(outer.get(ratio, kolmogorov), weight)
        closed = closed_spectrum(ratio, 50)
        for mode in (1, 3, 6, 8, 10, 12, 15, 17, 20, 30, 50):
            a, b = closed[mode - 1], ours[mode - 1]
            print(f"{mode:4d} {a:11.4e} {b:11.4e} {b / a - 1:+.1e}")
        print(f"the worst of 50 modes {np.abs(ours[:50] / closed - 1).max():.1e}")
        if options.aotools:
            other = of_aotools(ratio, 50)
            apart = other / ours[:50] - 1
            print("aotools: " + ", ".join(f"{k}: {other[k - 1]:.4e} ({apart[k - 1]:+.1e})"
                                          for k in (1, 3, 6, 12, 20, 50)))  # fmt: skip
            print(f"aotools, rms over 50 modes {np.sqrt(np.mean(apart**2)):.1e}")


if __name__ == "__main__":
    main()
