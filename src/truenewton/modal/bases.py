"""Modal bases on the actuators: Zernike's and Karhunen and Loeve's, beside the stiffness modes."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
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
    for lot in range(LOTS):
        candidates = zernike((lot + 1) * n, x, y)[:, lot * n :]
        for start in range(0, n, BLOCK):
            block = _less(candidates[:, start : start + BLOCK], modes[:, :count])
            first = count
            for candidate in block.T:
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
    n = len(covariance)
    # Piston moves from the eigenvalue 0 to the far end, and keeps off the faintest modes.
    values, vectors = np.linalg.eigh(covariance - np.trace(covariance) / n)
    values, vectors = values[:0:-1], vectors[:, :0:-1]
    return np.column_stack([np.full(n, n**-0.5), settled(vectors, values)])
