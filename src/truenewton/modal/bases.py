"""Modal bases on the actuators: Zernike's and Karhunen and Loeve's, beside the stiffness modes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.linalg import eigenvectors, rearranged
from truenewton.modal.zernikes import zernike
from truenewton.statics.modes import settled

NEWNESS = 0.1  # rms that a Zernike must add; with less, rounding grows from mode to mode
BLOCK = 64  # columns orthogonalised together
LOTS = 8  # Zernikes tried, in units of the number of actuators


def zernike_modes(x: Array, y: Array) -> Array:
    """Return (n, n) orthonormal modes, a column each, that Noll's Zernikes span in their order.

    Each mode is what a Zernike adds to those before it, of unit length and with the sign of its
    Zernike; the first is piston. On n points only n Zernikes are independent, and hardly ever the
    first n: over a ring of six, cos 6 theta is a constant. So one that adds less than NEWNESS root
    mean square (a whole Zernike has 1) is passed over, and a later one takes its place.

    Parameters
    ----------
    x, y
        (n,) actuators in units of the pupil's radius.

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
    for block in _zernikes(x, y):
        left, first = _less(block, modes[:, :count]), count
        for candidate in left.T:
            new = _less(candidate, modes[:, first:count])
            length = np.linalg.norm(new)
            if length > NEWNESS * np.sqrt(n):
                modes[:, count] = new / length
                count += 1
                if count == n:
                    return modes
    raise GeometryError(
        f"Zernikes span only {count} of {n} actuators",
        remedy="give each actuator a place of its own, in units of the pupil's radius",
        got=count,
        want=n,
    )


def _zernikes(x: Array, y: Array) -> Iterator[Array]:
    """Yield Zernikes in their order, (n, BLOCK) at a time; few more are in memory."""
    most = LOTS * len(x)
    lot = BLOCK * max(len(x) // (4 * BLOCK), 1)
    for tried in range(0, most, lot):
        candidates = zernike(min(tried + lot, most), x, y, without=tried)
        for start in range(0, candidates.shape[1], BLOCK):
            yield candidates[:, start : start + BLOCK]


def _less(vectors: Array, modes: Array) -> Array:
    """Return vectors less their parts along orthonormal modes; twice, for what rounding leaves."""
    for _ in range(2):
        vectors = vectors - modes @ (modes.T @ vectors)
    return vectors


def karhunen_loeve_modes(covariance: Array) -> Array:
    """Return (n, n) orthonormal modes, one a column: piston, then by falling variance.

    These are the eigenvectors of an (n, n) covariance whose rows have no mean, as
    `wavefront_covariance` gives it; in equals, and in sign, the same on every machine.

    Parameters
    ----------
    covariance
        (n, n) [m^2], the mean of each row 0.

    Examples
    --------
    >>> covariance = tn.wavefront_covariance(layout.x, layout.y, tn.Atmosphere(seeing=0.8))
    >>> modes = tn.karhunen_loeve_modes(covariance)
    >>> np.allclose(modes.T @ modes, np.eye(45))
    True
    """
    return overwritten_by_modes(np.array(covariance, dtype=float))


def overwritten_by_modes(covariance: Array) -> Array:
    """Return the same (n, n) modes; the covariance, which is theirs to overwrite, is spoilt."""
    n = len(covariance)
    # Piston moves from the eigenvalue 0 to the far end, and keeps off the faintest modes.
    covariance -= np.trace(covariance) / n
    values, vectors = eigenvectors(covariance)
    modes = rearranged(vectors, np.append(0, np.arange(n - 1, 0, -1)))
    modes[:, 0] = n**-0.5
    settled(modes[:, 1:], values[:0:-1])
    return modes
