"""Modal bases on the actuators: Zernike polynomials, and the modes of Karhunen and Loeve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import eval_jacobi

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.linalg import ROWS_AT_ONCE, eigenvectors, rearranged
from truenewton.statics.modes import settled

MIN_NEW_RMS = 0.1  # that a Zernike must add; with less, rounding grows from mode to mode
BLOCK = 64  # columns orthogonalised together
MAX_TRIED = 8  # Zernikes, in units of the number of actuators


def noll_orders(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (count,) radial orders n and azimuthal orders m of Noll's j = 1 .. count."""
    j = np.arange(1, count + 1)
    n = (np.sqrt(8 * j - 7).astype(np.int64) - 1) // 2
    within = j - 1 - n * (n + 1) // 2  # the radial order
    odd = n % 2
    return n, 2 * ((within + 1 - odd) // 2) + odd


def zernike(count: int, x: Array, y: Array, *, without: int = 0) -> Array:
    """Return the (p, count) values of Noll's Zernike polynomials j = 1 .. count, one a column.

    They are orthonormal over the unit disc, to whose radius the (p,) points x, y refer; the first
    ``without`` are omitted. Noll 1976 (JOSA 66, 207), eqs. 1 and 2: even j is a cosine, odd j a
    sine. The radial polynomial is rho^m P_k^(0, m)(2 rho^2 - 1), k = (n - m) / 2, so that

        Z_j = sqrt(2 (n + 1)) P_k^(0, m)(2 rho^2 - 1) Re or Im (x + i y)^m,

    without the factor sqrt(2) for m = 0. The recurrence of Jacobi's P in scipy is stable: it has no
    large terms of alternating sign.
    """
    n, m = (orders[without:] for orders in noll_orders(count))
    sine = (m > 0) & (np.arange(without + 1, count + 1) % 2 == 1)
    scale = np.sqrt((n + 1) * np.where(m > 0, 2, 1))
    points = np.asarray(x) + 1j * np.asarray(y)
    Z = np.empty((len(points), count - without))
    for start in range(0, len(points), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        waves = np.vander(points[some], int(m.max()) + 1, increasing=True)[:, m]
        t = 2 * np.abs(points[some, None]) ** 2 - 1
        Z[some] = eval_jacobi((n - m) // 2, 0, m, t) * np.where(sine, waves.imag, waves.real)
    Z *= scale
    return Z


def zernike_modes(x: Array, y: Array) -> Array:
    """Return (n, n) orthonormal modes, one a column, from Noll's Zernikes in their order.

    Each mode is the part of a Zernike orthogonal to those before it, of unit length and with the
    sign of its Zernike; the first is piston. On n points only n Zernikes are independent, usually
    not the first n: over a ring of six, cos 6 theta is a constant. So a Zernike that adds less than
    `MIN_NEW_RMS` (a whole one has 1) is omitted.

    Parameters
    ----------
    x, y
        (n,) actuators in units of the radius of the pupil.

    Raises
    ------
    GeometryError
        The first 8 n Zernikes do not span the actuators: two of them (nearly) coincide.

    Examples
    --------
    >>> modes = tn.zernike_modes(layout.x / 0.12, layout.y / 0.12)
    >>> np.allclose(modes[:, 0], 45**-0.5)  # piston
    True
    """
    n = len(x)
    modes, count = np.empty((n, n)), 0
    for tried in range(0, MAX_TRIED * n, BLOCK):
        block = zernike(min(tried + BLOCK, MAX_TRIED * n), x, y, without=tried)
        left, first = _less(block, modes[:, :count]), count
        for candidate in left.T:
            new = _less(candidate, modes[:, first:count])
            length = np.linalg.norm(new)
            if length > MIN_NEW_RMS * np.sqrt(n):
                modes[:, count] = new / length
                count += 1
                if count == n:
                    return modes
    raise GeometryError(
        f"Zernikes span only {count} of {n} actuators",
        remedy="give each actuator a place of its own, in units of the pupil's radius",
    )


def _less(vectors: Array, modes: Array) -> Array:
    """Return vectors less their parts along orthonormal modes, twice because of rounding."""
    for _ in range(2):
        vectors = vectors - modes @ (modes.T @ vectors)
    return vectors


def karhunen_loeve_modes(covariance: Array, *, overwrite: bool = False) -> Array:
    """Return (n, n) orthonormal modes, one a column: piston, then by decreasing variance.

    They are the eigenvectors of the covariance; signs, and bases of equal eigenvalues, do not
    depend on rounding.

    Parameters
    ----------
    covariance
        (n, n) `wavefront_covariance` [m^2], the mean of each row 0.
    overwrite
        Compute in the memory of the covariance, for large mirrors.

    Examples
    --------
    >>> covariance = tn.wavefront_covariance(layout.x, layout.y, tn.Atmosphere(seeing=0.8))
    >>> modes = tn.karhunen_loeve_modes(covariance)
    >>> np.allclose(modes.T @ modes, np.eye(45))
    True
    """
    n = len(covariance)
    covariance = covariance if overwrite else np.array(covariance, dtype=float)
    # Moves piston from the eigenvalue 0, where the weakest modes are, to the other end.
    covariance -= np.trace(covariance) / n
    values, vectors = eigenvectors(covariance)
    modes = rearranged(vectors, np.append(0, np.arange(n - 1, 0, -1)))
    modes[:, 0] = n**-0.5
    settled(modes[:, 1:], values[:0:-1])
    return modes
