"""The paper's equations: unknowns, systems C, D and E, and the imbalance of a reading.

The linear systems of the paper (section 3): C alpha = p, D alpha = q and E alpha' = r.

With f = alpha c (eq. 2) put into the balance (eq. 1), C alpha = p (eq. 3) balances the bare mirror
where B and its torques are known, D alpha = q the mirror with the added weight Q; E alpha' = r
(eq. 4) puts both together, or any number of loads, B and all torques among the unknowns.

Forces have one row per shape and one column per actuator; each block of N equations balances the
weight force, the moments of x and the moments of y, in this order, as the paper writes them.

The imbalance rho = A diag(alpha) c + k of readings c, in terms of its noise.

What noise of covariance Sigma in the readings makes of it is S = A diag(alpha) Sigma diag(alpha) A'
(docs/likelihood.md). Its three numbers are in N, N m and N m; A diag(alpha) are the scaled arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import chi2_ppf
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import effective_weight, external_load
from truenewton.statics.load import Load


@dataclass(frozen=True)
class Unknowns:
    """Where every unknown stands: of E alpha' = r (paper, eq. 4), of the likelihood, of results.

    Attributes
    ----------
    actuators, loads
        n, those that are enabled; L.
    weight_errors
        How many errors of the weights are unknowns as well; none in E.
    """

    actuators: int
    loads: int
    weight_errors: int = 0

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

    @property
    def count(self) -> int:
        """Number without the errors of the weights: 50 for P45 without and with the ring."""
        return self.actuators + 1 + 2 * self.loads

    @property
    def total(self) -> int:
        """Number of all."""
        return self.count + self.weight_errors

    def external_load_derivative(self, weight_changes: Sequence[Array] = ()) -> Array:
        """Return (L, 3, total - n): k of each load (eq. 1) by the unknowns beside alpha.

        Parameters
        ----------
        weight_changes
            For each error of the weights, (L,) change of W by its standard uncertainty [N].
        """
        derivative = np.zeros((self.loads, 3, self.total - self.actuators))
        by_bias, *by_torques = external_load(0.0, *np.eye(3))
        derivative[:, :, 0] = by_bias
        for load_index in range(self.loads):
            first = 1 + 2 * load_index
            derivative[load_index, :, first : first + 2] = np.transpose(by_torques)
        for column, change in enumerate(weight_changes, self.count - self.actuators):
            derivative[:, :, column] = external_load(change, 0.0, 0.0, 0.0)
        return derivative


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
        each load (`Unknowns`). Loads follow each other; in each, the shapes of its cycles
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


MEDIAN_CHI2 = chi2_ppf(0.5, 3)  # of the squared distance of an imbalance


def imbalance_covariance(scaled_arms: Array, variance: Array) -> Array:
    """Return (3, 3) S, from (3, n) scaled arms and the (n,) variance of one reading [N^2]."""
    return np.asarray((scaled_arms * variance) @ scaled_arms.T)


def squared_distances(rho: Array, weight: Array, s: Array) -> Array:
    """Return (g,) r rho' S^-1 rho of (g, 3) imbalances with (g,) weights r."""
    return np.asarray(weight * np.einsum("gk,gk->g", rho, np.linalg.solve(s, rho.T).T))


def standing_out(rho: Array, scaled_arms: Array, s: Array) -> NDArray[np.int64]:
    """Return (g,) whose reading, of the n actuators, would best explain each imbalance alone."""
    weighed = np.linalg.solve(s, scaled_arms)
    pull = (rho @ weighed) ** 2 / np.einsum("kn,kn->n", scaled_arms, weighed)
    return np.asarray(pull.argmax(axis=1))
