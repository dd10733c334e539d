"""The paper's equations: unknowns, systems C, D and E, and the imbalance of a reading.

With f = alpha c (eq. 2) in the balance (eq. 1), C alpha = p (eq. 3) balances the bare mirror if B
and its torques are known, D alpha = q the mirror with the added weight Q (section 3). E alpha' = r
(eq. 4) combines both, or any number of loads, with B and all torques unknown. Forces have one row
per shape and one column per actuator; each block of N equations balances the weight force, the
sums of x f and the sums of y f, in this order, as in the paper.

The imbalance of readings c is rho = A diag(alpha) c + k in N, N m and N m. Noise of covariance
Sigma in the readings makes its covariance S = A diag(alpha) Sigma diag(alpha) A'
(docs/likelihood.md). A diag(alpha) are the scaled arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import effective_weight, external_load
from truenewton.statics.load import Load


@dataclass(frozen=True)
class Unknowns:
    """Where each unknown is: of E alpha' = r (paper, eq. 4), of the likelihood, of results."""

    # n, those that are enabled; L.
    actuators: int
    loads: int
    weight_errors: int = 0  # how many errors of the weights are unknowns as well; none in E

    @property
    def alpha(self) -> slice:
        """The n alphas."""
        return slice(0, self.actuators)

    @property
    def bias(self) -> int:
        """B."""
        return self.actuators

    @property
    def torques(self) -> slice:
        """M_y and M_x of the first load, then of the next."""
        return slice(self.actuators + 1, self.count)

    @property
    def weights(self) -> slice:
        """The errors of the weights, in units of their standard uncertainties."""
        return slice(self.count, self.total)

    @cached_property
    def count(self) -> int:
        """Number without the errors of the weights: 50 for P45 without and with the ring."""
        return self.actuators + 1 + 2 * self.loads

    @cached_property
    def total(self) -> int:
        """Number of all, with the errors of the weights."""
        return self.count + self.weight_errors

    def external_load_derivative(self, weight_changes: Sequence[Array] = ()) -> Array:
        """Return (L, 3, total - n) derivative of k of each load (eq. 1) by what is beside alpha.

        ``weight_changes``: for each error of the weights, (L,) change of W by its standard
        uncertainty.
        """
        derivative = np.zeros((self.loads, 3, self.total - self.actuators))
        by_weight, *by_torques = _BY_LOAD
        derivative[:, :, 0] = by_weight  # of B, which acts as a weight does
        for load_index in range(self.loads):
            first = 1 + 2 * load_index
            derivative[load_index, :, first : first + 2] = np.transpose(by_torques)
        if weight_changes:
            changes = np.transpose(weight_changes)[:, None]  # (L, 1, errors)
            derivative[:, :, self.count - self.actuators :] = by_weight[:, None] * changes
        return derivative


_BY_LOAD = external_load(0.0, *np.eye(3))  # k by 1 N of B, and by 1 N m of M_y and M_x


def balance_rows(force: Array, a: Array) -> Array:
    """Return (3 N, n) coefficients of alpha in A f, f = alpha c (eq. 2), for (N, n) forces c."""
    blocks = a[:, None, :] * force[None, :, :]  # nz c | x c | y c
    return np.asarray(blocks.reshape(-1, force.shape[1]))


def system_c(
    force: Array, a: Array, weight: float, bias_force: float, torque_y: float, torque_x: float
) -> tuple[Array, Array]:
    """Return C (3 N, n) and p (3 N,) of the paper's eq. 3, with C alpha = p, B and torques known.

    From (N, n) commanded forces c [N], (3, n) arms, W (P of the bare mirror) and B [N], M_y and M_x
    [N m].
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
    """Return D (3 N, n) and q (3 N,) of the paper's section 3: C and p with the weight of a load.

    W = (P + Q) cos(tilt); the torques are those under this load, the paper's N_y and N_x [N m].
    """
    total = float(effective_weight(weight, load.added, load.tilt))
    return system_c(force, a, total, bias_force, torque_y, torque_x)


def system_e(campaign: Campaign, a: Array) -> tuple[Array, Array]:
    """Return E (3 N, n + 1 + 2 L) and r (3 N,) of the paper's eq. 4, for any number of loads.

    From valid rows and the (3, n) arms of the enabled actuators; torques are in N times the unit of
    length of these. The unknowns are alpha, B, and M_y, M_x of each load (`Unknowns`). Loads follow
    each other; in each, the shapes of its cycles follow each other in every block.
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


def imbalance_covariance(scaled_arms: Array, variance: Array) -> Array:
    """Return (3, 3) S, from (3, n) scaled arms and the (n,) variance of one reading [N^2]."""
    return np.asarray((scaled_arms * variance) @ scaled_arms.T)


def squared_distances(rho: Array, weight: Array, s: Array) -> Array:
    """Return (g,) r rho' S^-1 rho of (g, 3) imbalances with (g,) weights r."""
    return np.asarray(weight * np.einsum("gk,gk->g", rho, np.linalg.solve(s, rho.T).T))


def standing_out(rho: Array, scaled_arms: Array, s: Array) -> NDArray[np.int64]:
    """Return (g,) which of the n readings best explains each imbalance alone."""
    weighed = np.linalg.solve(s, scaled_arms)
    pull = (rho @ weighed) ** 2 / np.einsum("kn,kn->n", scaled_arms, weighed)
    return np.asarray(pull.argmax(axis=1))
