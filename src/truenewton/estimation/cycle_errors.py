"""The paper's error (section 5): each cycle solved alone, C alpha = p with B and torques held."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpocon, dpotrf

from truenewton.arrays import Array
from truenewton.estimation.row_readers import RowBlock
from truenewton.estimation.systems import system_c
from truenewton.estimation.unknowns import Unknowns
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import enabled_arms, external_load


class CycleErrors:
    """The paper's error: each file alone, B and torques held, three sigma of the mean.

    C alpha = p (eq. 3) is solved for each cycle as soon as its rows have been read, from
    C' C = (A' A) o (sum of c c') where that is far from singular, which costs a tenth; else by
    singular values. Either way a block of rows after the other, so that C is never whole.

    Parameters
    ----------
    campaign
        Whose rows are going to be read.
    solution
        (n + 1 + 2 L,) alpha, B, then M_y, M_x of each load.
    """

    def __init__(self, campaign: Campaign, solution: Array) -> None:
        self._campaign, self._a = campaign, enabled_arms(campaign.layout)
        unknowns = Unknowns(self._n, len(campaign.loads))
        self._bias_force = float(solution[unknowns.bias])
        self._torques = solution[unknowns.torques].reshape(-1, 2)
        self._alphas: list[Array] = []
        self._begin_cycle()

    @property
    def _n(self) -> int:
        return int(self._a.shape[1])

    def _begin_cycle(self) -> None:
        self._square, self._total = np.zeros((self._n, self._n), order="F"), np.zeros(self._n)

    def take(self, block: RowBlock) -> None:
        """Add rows to sum c c' (its upper triangle) and sum c."""
        force = block.force
        self._square = dsyrk(1.0, force.T, beta=1.0, c=self._square, overwrite_c=True)
        self._total += force.sum(axis=0)

    def end_cycle(self, cycle_index: int) -> None:
        """Solve the cycle; one that was broken off says nothing of alpha alone."""
        campaign = self._campaign
        load_index = campaign.load_index[cycle_index]
        weight = float(campaign.effective_weights[load_index])
        external = (weight, self._bias_force, *self._torques[load_index].tolist())
        alpha = self._from_square(external)
        if alpha is None:
            self._square = np.empty((0, 0))
            alpha = from_rows(campaign.cycles[cycle_index], self._a, external)
        if alpha is not None:
            self._alphas.append(alpha)
        self._begin_cycle()

    def _from_square(self, external: tuple[float, float, float, float]) -> Array | None:
        """Solve C' C alpha = C' p; None where it is close to singular."""
        a, square = self._a, self._square
        square *= a.T @ a
        right = -np.sum(a * external_load(*external)[:, None], axis=0) * self._total
        norm = float(scipy.linalg.norm(square, 1, check_finite=False))  # of half of it
        factor, failed = dpotrf(square, clean=False, overwrite_a=True)
        if failed or dpocon(factor, norm)[0] <= 1e-10:
            return None
        return np.asarray(scipy.linalg.cho_solve((factor, False), right, check_finite=False))

    @property
    def errors(self) -> Array:
        """(n,) three times the standard deviation over the cycles over the root of their number."""
        if len(self._alphas) < 2:
            return np.full(self._n, np.nan)
        return np.asarray(3.0 * np.std(self._alphas, axis=0, ddof=1) / np.sqrt(len(self._alphas)))


def from_rows(cycle: Cycle, a: Array, external: tuple[float, float, float, float]) -> Array | None:
    """Solve C alpha = p of one cycle by singular values; None where its rank is short.

    Parameters
    ----------
    cycle, a
        The cycle, whose rows are read anew; (3, n) arms of its enabled actuators.
    external
        W, B [N], M_y and M_x [N m].
    """
    n = a.shape[1]
    triangle = np.empty((0, n + 1))
    for rows in cycle.used_blocks():
        block = np.column_stack(system_c(cycle.used(cycle.force, rows), a, *external))
        triangle = scipy.linalg.qr(np.vstack([triangle, block]), mode="r")[0][: n + 1]
    alpha, _, rank, _ = scipy.linalg.lstsq(triangle[:, :-1], triangle[:, -1])
    return np.asarray(alpha) if rank == n else None
