"""Whether gains hold the loop: the spectral radius of everything that goes round in it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from truenewton.arrays import Array
from truenewton.bench.simulated.control import Control
from truenewton.bench.simulated.loop import Loop
from truenewton.bench.simulated.plant import advance
from truenewton.errors import LoopUnstable

DENSE = 100  # actuators, up to which the whole matrix is taken


def state_matrix(step: Array, alpha: Array, sensor_gain: Array, control: Control) -> Array:
    """Return what takes the closed loop, at rest commands, from one sample to the next.

    (..., m, m) of m = (5 + delay) n states: z, period z', both filters of the derivative, the
    pseudo-integrator, the forces on their way. Coils' gradient, steps and limits are left out: they
    are not linear.

    Parameters
    ----------
    step
        (..., 2n, 3n) of the glass, from `plant.advance`.
    alpha, sensor_gain
        (..., n) true / commanded force, true displacement / reading.
    control
        The gains.
    """
    n, delay = step.shape[-2] // 2, control.delay
    size = (5 + delay) * n
    z, once, twice, slow_error = (slice(k * n, (k + 1) * n) for k in (0, 2, 3, 4))
    swift, slow = control.swift, control.slow
    now = np.broadcast_to(np.eye(size), (*step.shape[:-2], size, size))
    # Rows: what each quantity is, in terms of the state before.
    y = now[..., z, :] / sensor_gain[..., None]
    once_after = (1 - swift) * now[..., once, :] + swift * y
    change = swift * (once_after - now[..., twice, :])
    slow_after = (1 - slow) * now[..., slow_error, :] - slow * y
    force = (
        control.proportional * (-y + (control.slow_gain - 1) * slow_after)
        - control.derivative * control.rate * change
    )
    queue = [now[..., (5 + k) * n : (6 + k) * n, :] for k in range(delay)] + [force]
    pushed = alpha[..., None] * queue[0]
    glass = step @ np.concatenate([now[..., : 2 * n, :], pushed], axis=-2)
    twice_after = now[..., twice, :] + change
    return np.concatenate([glass, once_after, twice_after, slow_after, *queue[1:]], axis=-2)


def roots(loop: Loop) -> Array:
    """Return the roots of a closed loop in z; it is stable while all are within the unit circle.

    Of up to `DENSE` actuators these are the (m,) eigenvalues of `state_matrix`. Of more,
    each mode of the glass is taken alone, with the lowest and with the highest alpha / sensor gain
    of all actuators and with its own part of damping: exact where mass, damping, alpha and gain are
    even, an approximation otherwise.
    """
    alpha, sensor_gain, control = loop.coils.alpha, loop.sensors.gain, loop.control
    stiffness, mass, n = loop.stiffness, loop.mass, len(loop.stiffness)
    if n <= DENSE:
        return np.asarray(np.linalg.eigvals(state_matrix(loop.step, alpha, sensor_gain, control)))
    # Sensors beside pucks leave both a little unlike their transposes, of which eigh would see one
    # triangle; the symmetric part has the same roots to second order. Modes' M modes = 1.
    values, modes = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
    own_damping = np.einsum("ik,ij,jk->k", modes, loop.damping, modes, optimize=True)
    step = advance(
        values[:, None, None], np.ones((n, 1, 1)), own_damping[:, None, None], control.period
    )
    reach = np.sum(modes**2, axis=0)[:, None]
    strength = alpha / sensor_gain
    return np.concatenate(
        [
            np.linalg.eigvals(state_matrix(step, extreme * reach, np.ones((n, 1)), control))
            for extreme in (strength.min(), strength.max())
        ],
        axis=None,
    )


def check_stability(loop: Loop) -> None:
    """Refuse a loop that the gains do not hold.

    Raises
    ------
    LoopUnstable
        A root on or outside the unit circle.
    """
    every = roots(loop)
    worst = every[np.abs(every).argmax()]
    radius = float(np.abs(worst))
    frequency = abs(np.angle(worst)) * loop.control.rate / (2 * np.pi)
    if not radius < 1:
        raise LoopUnstable(
            f"the loop does not hold: a motion at {frequency:.0f} Hz grows by a factor of"
            f" {radius:.4g} a sample",
            remedy="lower the gains, shorten the delay or damp the glass more"
            if frequency > 0
            else "raise the proportional gain",
            got=radius,
            want=1.0,
        )
