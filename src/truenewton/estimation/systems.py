"""The linear systems of the paper: C alpha = p (eq. 3), D alpha = q, E alpha' = r (eq. 4).

Forces have one row per shape and one column per actuator; each block of N equations balances the
weight force, the moments of x and the moments of y, in this order, as the paper writes them.
"""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import external_load


def balance_rows(force: Array, a: Array) -> Array:
    """Return the (3 N, n) coefficients of alpha in A diag(alpha) c, for N rows of forces c."""
    blocks = a[:, None, :] * force[None, :, :]  # nz c | x c | y c
    return np.asarray(blocks.reshape(-1, force.shape[1]))


def system_c(
    force: Array, a: Array, weight: float, bias_force: float, torque_y: float, torque_x: float
) -> tuple[Array, Array]:
    """Return C and p of the paper's eq. 3: the balance under one load with B and torques known.

    Parameters
    ----------
    force
        (N, n) commanded forces c [N].
    a
        (3, n) arms.
    weight
        W, P or P + Q [N].
    bias_force, torque_y, torque_x
        B [N], M_y and M_x [N m].

    Returns
    -------
    C, p
        (3 N, n) and (3 N,), with C alpha = p.
    """
    p = np.repeat(external_load(weight, bias_force, torque_y, torque_x), len(force))
    return -balance_rows(force, a), p


def system_e(campaign: Campaign, a: Array) -> tuple[Array, Array]:
    """Return E and r of the paper's eq. 4, for any number of loads.

    Parameters
    ----------
    campaign
        Cycles under L loads; rows that are not valid and disabled actuators are left out.
    a
        (3, n) arms of the enabled actuators; torques come out in N times the unit of length.

    Returns
    -------
    E, r
        (3 N, n + 1 + 2 L) and (3 N,), N over all loads. The unknowns are alpha, B, and M_y, M_x of
        each load: 50 for P45 without and with the ring. Loads follow each other; in each, the
        shapes of its cycles follow each other in every block.
    """
    loads = len(campaign.loads)
    matrices, right_sides = [], []
    for place, weight in enumerate(campaign.effective_weights):
        force = load_force(campaign, place)
        rows = len(force)
        unknown = np.zeros((3, rows, 1 + 2 * loads))
        unknown[0, :, 0] = 1.0  # B
        unknown[1, :, 1 + 2 * place] = 1.0  # M_y
        unknown[2, :, 2 + 2 * place] = -1.0  # M_x
        matrices.append(
            -np.hstack([balance_rows(force, a), unknown.reshape(3 * rows, 1 + 2 * loads)])
        )
        right_sides.append(np.repeat([weight, 0.0, 0.0], rows))
    return np.vstack(matrices), np.concatenate(right_sides)


def load_force(campaign: Campaign, index: int) -> Array:
    """Return (N, n_enabled) commanded forces of the valid rows under one load [N]."""
    return np.vstack(
        [c.used_force for c, at in zip(campaign.cycles, campaign.load_index, strict=True)
         if at == index]
    )  # fmt: skip
