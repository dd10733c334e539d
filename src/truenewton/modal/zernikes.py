"""Zernike polynomials as Noll orders and scales them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array


def noll_orders(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (count,) radial orders n and azimuthal orders m of Noll's j = 1 .. count."""
    j = np.arange(1, count + 1)
    n = (np.sqrt(8 * j - 7).astype(np.int64) - 1) // 2
    within = j - 1 - n * (n + 1) // 2  # the radial order
    odd = n % 2
    return n, 2 * ((within + 1 - odd) // 2) + odd


def zernike(count: int, x: Array, y: Array) -> Array:
    """Return the (p, count) values of Noll's Zernike polynomials j = 1 .. count, one a column.

    Over the unit disc each has mean square 1, and the product of two mean 0.

    Parameters
    ----------
    count
        How many.
    x, y
        (p,) points in units of the pupil's radius.

    Notes
    -----
    Noll 1976 (JOSA 66, 207), eqs. 1 and 2: even j is a cosine, odd j a sine. The radial polynomial
    is rho^m P_k^(0, m)(2 rho^2 - 1), k = (n - m) / 2, so that

        Z_j = sqrt(2 (n + 1)) P_k^(0, m)(2 rho^2 - 1) Re or Im (x + i y)^m,

    less the factor sqrt(2) where m = 0. Jacobi's P by their recurrence (DLMF 18.9.2), for all m at
    once, is stable: no sum of large terms of alternating sign.
    """
    n, m = noll_orders(count)
    k = (n - m) // 2
    top = int(m.max())
    power = np.vander(np.asarray(x) + 1j * np.asarray(y), top + 1, increasing=True)
    sine = (m > 0) & (np.arange(1, count + 1) % 2 == 1)
    scale = np.sqrt((n + 1) * np.where(m > 0, 2, 1))
    t = (2 * (np.square(x) + np.square(y)) - 1)[:, None]

    Z = np.empty((len(power), count))
    below: Array = np.zeros((len(power), top + 1))
    P: Array = np.ones((len(power), top + 1))
    for degree in range(int(k.max()) + 1):
        if degree:
            b = np.arange(max(int(m[k >= degree].max()), 0) + 1.0)
            P, below = _next(P[:, : len(b)], below[:, : len(b)], degree, b, t), P
        for part, of_part in ((power.real, ~sine), (power.imag, sine)):
            here = np.flatnonzero((k == degree) & of_part)
            Z[:, here] = scale[here] * P[:, m[here]] * part[:, m[here]]
    return Z


def _next(P: Array, below: Array, k: int, b: Array, t: Array) -> Array:
    """Return P_k^(0, b)(t) from those of degrees k - 1 and k - 2, one column for each b."""
    if k == 1:  # where the recurrence divides by zero for b = 0
        return np.asarray(1 + (b + 2) * (t - 1) / 2)
    c = 2 * k + b
    rise = (c - 1) * (c * (c - 2) * t - b**2) * P - 2 * (k - 1) * (k + b - 1) * c * below
    return np.asarray(rise / (2 * k * (k + b) * (c - 2)))
