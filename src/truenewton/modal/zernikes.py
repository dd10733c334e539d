"""Zernike polynomials as Noll orders and scales them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.linalg import ROWS_AT_ONCE


def noll_orders(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (count,) radial orders n and azimuthal orders m of Noll's j = 1 .. count."""
    j = np.arange(1, count + 1)
    n = (np.sqrt(8 * j - 7).astype(np.int64) - 1) // 2
    within = j - 1 - n * (n + 1) // 2  # the radial order
    odd = n % 2
    return n, 2 * ((within + 1 - odd) // 2) + odd


def zernike(count: int, x: Array, y: Array, *, without: int = 0) -> Array:
    """Return the (p, count) values of Noll's Zernike polynomials j = 1 .. count, one a column.

    Over the unit disc each has mean square 1, and the product of two mean 0.

    Parameters
    ----------
    count
        How many.
    x, y
        (p,) points in units of the pupil's radius.
    without
        How many of the first are left out.

    Notes
    -----
    Noll 1976 (JOSA 66, 207), eqs. 1 and 2: even j is a cosine, odd j a sine. The radial polynomial
    is rho^m P_k^(0, m)(2 rho^2 - 1), k = (n - m) / 2, so that

        Z_j = sqrt(2 (n + 1)) P_k^(0, m)(2 rho^2 - 1) Re or Im (x + i y)^m,

    less the factor sqrt(2) where m = 0. Jacobi's P by their recurrence (DLMF 18.9.2), for all m at
    once, is stable: no sum of large terms of alternating sign.
    """
    n, m = (orders[without:] for orders in noll_orders(count))
    sine = (m > 0) & (np.arange(without + 1, count + 1) % 2 == 1)
    scale = np.sqrt((n + 1) * np.where(m > 0, 2, 1))
    points = np.asarray(x) + 1j * np.asarray(y)
    Z = np.empty((len(points), count - without))
    for start in range(0, len(points), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        _fill(Z[some], points[some], m, (n - m) // 2, sine)
    Z *= scale
    return Z


def _fill(
    Z: Array, points: NDArray[np.complex128], m: NDArray[np.int64], k: NDArray[np.int64],
    sine: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Put rho^m P_k^(0, m)(2 rho^2 - 1) times cosine or sine of m theta, at (p,) points, into Z."""
    top = int(m.max())
    power = np.vander(points, top + 1, increasing=True)
    t = (2 * (points.real**2 + points.imag**2) - 1)[:, None]
    below: Array = np.zeros((len(power), top + 1))
    P: Array = np.ones((len(power), top + 1))
    for degree in range(int(k.max()) + 1):
        if degree:
            b = np.arange(max(int(m[k >= degree].max()), 0) + 1.0)
            P, below = _next(P[:, : len(b)], below[:, : len(b)], degree, b, t), P
        for part, of_part in ((power.real, ~sine), (power.imag, sine)):
            here = np.flatnonzero((k == degree) & of_part)
            Z[:, here] = P[:, m[here]] * part[:, m[here]]


def _next(P: Array, below: Array, k: int, b: Array, t: Array) -> Array:
    """Return P_k^(0, b)(t) from those of degrees k - 1 and k - 2, one column for each b."""
    if k == 1:  # where the recurrence divides by zero for b = 0
        return np.asarray(1 + (b + 2) * (t - 1) / 2)
    c = 2 * k + b
    rise = (c - 1) * (c * (c - 2) * t - b**2) * P - 2 * (k - 1) * (k + b - 1) * c * below
    return np.asarray(rise / (2 * k * (k + b) * (c - 2)))
