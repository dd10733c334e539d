"""Arms and signs: the only place that defines how forces balance weight, bias and torques.

z points up along the optical axis, gravity along -z, forces on the mirror are positive upward;
weight P and added weight Q are negative. At rest every shape obeys, with f = alpha * c,

    A f + k = 0,    k = (W + B, M_y, -M_x),    W = (P + Q) cos(tilt)         (paper, eqs. 1-4)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array
from truenewton.statics.layout import Layout


def arms(layout: Layout) -> Array:
    """Return A, (3, n): rows nz, x, y; ``A @ f`` is total force [N], sums of x f and y f [N m]."""
    return np.stack([layout.nz, layout.x, layout.y])


def effective_weight(weight: ArrayLike, added: ArrayLike, tilt: ArrayLike) -> Array:
    """Return W = (P + Q) cos(tilt) [N], for a tilt [deg] of the optical axis from the vertical."""
    total = np.asarray(weight, dtype=float) + np.asarray(added, dtype=float)
    return np.asarray(total * np.cos(np.radians(tilt)))


def external_load(
    weight: ArrayLike, bias_force: ArrayLike, torque_y: ArrayLike, torque_x: ArrayLike
) -> Array:
    """Return k, (..., 3): what the actuators balance, from W, B [N] and M_y, M_x [N m]."""
    k = np.broadcast_arrays(np.add(weight, bias_force), np.asarray(torque_y), np.negative(torque_x))
    return np.stack(k, axis=-1).astype(float)


def resultants(layout: Layout, true_force: ArrayLike) -> Array:
    """Return A f, (..., 3): total force [N], sums of x f and y f [N m], of (..., n) true forces."""
    return np.asarray(true_force, dtype=float) @ arms(layout).T


def enabled_arms(layout: Layout) -> Array:
    """Return the (3, n_enabled) arms of the enabled actuators."""
    return np.asarray(arms(layout)[:, layout.enabled])


def comparable_arms(layout: Layout) -> Array:
    """Return the (3, n_enabled) arms with lengths in units of the RMS distance from the axis."""
    a = enabled_arms(layout)
    length = np.sqrt(np.mean(a[1] ** 2 + a[2] ** 2))
    return np.asarray(a / np.array([[1.0], [length], [length]]))


def arms_in_units_of_rms(layout: Layout) -> Array:
    """Return the (3, n_enabled) arms, each coordinate in units of its RMS over the actuators."""
    a = enabled_arms(layout)
    unit = np.sqrt(np.mean(a[1:] ** 2, axis=1, keepdims=True))
    return np.concatenate([a[:1], a[1:] / unit])
