"""The linear systems of the paper (section 3): C alpha = p, D alpha = q and E alpha' = r.

With f = alpha c (eq. 2) put into the balance (eq. 1), C alpha = p (eq. 3) balances the bare mirror
where B and its torques are known, D alpha = q the mirror with the added weight Q; E alpha' = r
(eq. 4) puts both together, or any number of loads, B and all torques among the unknowns.

Forces have one row per shape and one column per actuator; each block of N equations balances the
weight force, the moments of x and the moments of y, in this order, as the paper writes them.
"""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.unknowns import Unknowns
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import effective_weight, external_load
from truenewton.statics.load import Load


def balance_rows(force: Array, a: Array) -> Array:
    """Return (3 N, n) coefficients of alpha in A f, f = alpha c (eq. 2), for (N, n) forces c."""
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
        P [N].
    bias_force, torque_y, torque_x
        B [N], M_y and M_x [N m].

    Returns
    -------
    C, p
        (3 N, n) and (3 N,), with C alpha = p.
    """
    p = np.repeat(external_load(weight, bias_force, torque_y, torque_x), len(force))
    return -balance_rows(force, a), p


def system_d(
    force: Array,
    a: Array,
    weight: float,
    load: Load,
    bias_force: float,
    torque_y: float,
    torque_x: float,
) -> tuple[Array, Array]:
    """Return D and q of the paper's section 3: as C and p, P + Q weighing instead of P.

    Parameters
    ----------
    force, a, weight, bias_force
        As for `system_c`; forces are the paper's d.
    load
        Gives Q and the tilt: W = (P + Q) cos(tilt).
    torque_y, torque_x
        Under this load, the paper's N_y and N_x [N m].

    Returns
    -------
    D, q
        (3 N, n) and (3 N,), with D alpha = q.
    """
    total = float(effective_weight(weight, load.added, load.tilt))
    return system_c(force, a, total, bias_force, torque_y, torque_x)


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
        each load (`unknowns.Unknowns`). Loads follow each other; in each, the shapes of its cycles
        follow each other in every block.
    """
    unknowns = Unknowns(a.shape[1], len(campaign.loads))
    matrices, right_sides = [], []
    others = unknowns.external_load_derivative()  # coefficients of B and the torques
    for load_index, load in enumerate(campaign.loads):
        force = load_force(campaign, load_index)
        d, q = system_d(force, a, campaign.weight, load, 0.0, 0.0, 0.0)
        matrices.append(np.hstack([d, -np.repeat(others[load_index], len(force), axis=0)]))
        right_sides.append(q)
    return np.vstack(matrices), np.concatenate(right_sides)


def load_force(campaign: Campaign, load_index: int) -> Array:
    """Return (N, n_enabled) commanded forces of the valid rows under one load [N]."""
    key = campaign.loads[load_index].key
    return np.vstack([cycle.used_force for cycle in campaign.cycles if cycle.load.key == key])
