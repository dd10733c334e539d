"""Shapes of a mirror: its stiffness modes, as large as its limits allow."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array


def scaled_modes(modes: Array, stiffness: Array, stroke: float, force: Array | float) -> Array:
    """Return modes as large as stroke and force allow.

    Parameters
    ----------
    modes
        (m, n) displacements, one a row.
    stiffness
        (n, n) force per displacement [N/m].
    stroke
        Largest displacement of an actuator [m].
    force
        Largest force, one or (n,) [N].

    Returns
    -------
    numpy.ndarray
        (m, n) [m].
    """
    taken = np.maximum(np.abs(modes @ stiffness.T), 1e-12 * np.max(force))
    largest = np.abs(modes).max(axis=1)
    amplitude = np.minimum(stroke / largest, (force / taken).min(axis=1))
    return np.asarray(modes * amplitude[:, None])
