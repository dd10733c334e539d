"""The force that turbulence does not change: weight, bias, and what holds the mirror flat."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.modal.true_stiffness import TrueStiffness
from truenewton.statics.arms import arms, effective_weight, external_load


def static_force(
    stiffness: TrueStiffness, calibration: Calibration, at_rest: Array | None
) -> Array:
    """Return (n,) the true static force of the enabled actuators [N].

    What those that are off no longer bear, the least forces of the others do.

    Parameters
    ----------
    stiffness
        Tells alpha, and who acts.
    calibration
        Its weight and bias count where nobody knows the forces at rest; if it has none, they are 0.
    at_rest
        (n,) commanded force of the enabled actuators at rest [N], see
        `MotionReader.force_at_rest`.
    """
    layout, on = stiffness.enabled, stiffness.acts
    A, c = arms(layout), calibration
    if at_rest is not None:
        force = stiffness.enabled_alpha * at_rest
    elif c.loads and np.isfinite(c.bias_force):
        first = c.loads[0]
        weight = effective_weight(c.weight, first.added, first.tilt)
        k = external_load(weight, c.bias_force, c.torque_y[0], c.torque_x[0])
        force = -np.linalg.pinv(A) @ k
    else:
        return np.zeros(layout.n)
    borne = np.where(on, force, 0.0)
    borne[on] += np.linalg.pinv(A[:, on]) @ (A @ (force - borne))
    return np.asarray(borne)
