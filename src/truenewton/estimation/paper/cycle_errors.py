"""The paper's error (section 5): each cycle solved alone, C alpha = p with B and torques held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpocon, dpotrf

from truenewton.arrays import Array
from truenewton.cluster import Client, each
from truenewton.estimation.paper.equations import Unknowns, system_c
from truenewton.estimation.readings.row_readers import RowBlock, RowReader, read_rows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import enabled_arms, external_load


class CycleErrors:
    """The paper's error: each file alone, B and torques held, three sigma of the mean.

    C alpha = p (eq. 3) is solved for each cycle once its rows have been taken in, from
    C' C = (A' A) o (sum of c c') where that is far from singular, which costs a tenth; else by
    singular values. Either way a block of rows after the other, so that C is never whole.

    Parameters
    ----------
    campaign, solution
        Whose rows come; (n + 1 + 2 L,) alpha, B, then M_y, M_x of each load.
    """

    def __init__(self, campaign: Campaign, solution: Array) -> None:
        self._a, n = enabled_arms(campaign.layout), int(campaign.layout.enabled.sum())
        unknowns = Unknowns(n, len(campaign.loads))
        self._campaign, self._solution = campaign, solution
        weights, bias_force = campaign.effective_weights.tolist(), float(solution[unknowns.bias])
        torques = solution[unknowns.torques].reshape(-1, 2).tolist()
        self._external = [(weights[k], bias_force, *torques[k]) for k in campaign.load_index]
        self._square, self._total = np.zeros((n, n), order="F"), np.zeros(n)
        self._alphas: list[Array] = []

    def take(self, block: RowBlock) -> None:
        """Take the next rows in; a cycle that was broken off says nothing of alpha alone."""
        force = block.force
        self._square = dsyrk(1.0, force.T, beta=1.0, c=self._square, overwrite_c=True)  # its upper
        self._total += force.sum(axis=0)
        if block.last:
            external = self._external[block.cycle_index]
            alpha = self._from_square(external)
            if alpha is None:
                alpha = from_rows(block.cycle, self._a, external)
            if alpha is not None:
                self._alphas.append(alpha)
            self._square[:], self._total[:] = 0.0, 0.0

    def read(self, readers: Sequence[RowReader] = (), client: Client | None = None) -> None:
        """Read the rows of all cycles, for more readers as well.

        With a client and no more readers its workers do, a cycle each.
        """
        if client is None or readers:
            read_rows(self._campaign, (self.take, *readers))
            return
        campaign, n = self._campaign, len(self._total)
        unknowns = Unknowns(n, len(campaign.loads))
        torques = self._solution[unknowns.torques].reshape(-1, 2)
        alone = (
            (cycle, np.concatenate([self._solution[: n + 1], torques[k]]))
            for cycle, k in zip(campaign.cycles, campaign.load_index, strict=True)
        )
        for alphas in each(_alphas_of, alone, client):
            self._alphas += alphas

    def _from_square(self, external: tuple[float, ...]) -> Array | None:
        """Solve C' C alpha = C' p in place; None where it is close to singular."""
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
        count = len(self._alphas)
        if count < 2:
            return np.full(len(self._total), np.nan)
        return np.asarray(3.0 * np.std(self._alphas, axis=0, ddof=1) / np.sqrt(count))


def _alphas_of(cycle_and_solution: tuple[Cycle, Array]) -> list[Array]:
    """Read a cycle alone; return its (n,) alpha, if it has one."""
    cycle, solution = cycle_and_solution
    errors = CycleErrors(Campaign((cycle,)), solution)
    errors.read()
    return errors._alphas


def from_rows(cycle: Cycle, a: Array, external: tuple[float, ...]) -> Array | None:
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
