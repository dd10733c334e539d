"""The paper's error (section 5): each cycle solved alone, C alpha = p with B and torques held."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpocon, dpotrf

from truenewton.arrays import Array
from truenewton.estimation.systems import system_c
from truenewton.estimation.unknowns import Unknowns
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import enabled_arms, external_load


def cycle_errors(campaign: Campaign, solution: Array) -> Array:
    """Return the paper's error: each file alone, B and torques held, three sigma of the mean.

    C alpha = p (eq. 3) is solved for each cycle; the error is three times the standard deviation
    over the cycles divided by the root of their number (paper, section 5).
    """
    a = enabled_arms(campaign.layout)
    n = a.shape[1]
    unknowns = Unknowns(n, len(campaign.loads))
    bias_force = float(solution[unknowns.bias])
    torques = solution[unknowns.torques].reshape(-1, 2)
    weights = campaign.effective_weights.tolist()
    alphas = []
    for cycle, place in zip(campaign.cycles, campaign.load_index, strict=True):
        external = (weights[place], bias_force, *torques[place].tolist())
        alpha = _from_one_cycle(cycle, a, external)
        if alpha is not None:  # a cycle that was broken off says nothing of alpha alone
            alphas.append(alpha)
    if len(alphas) < 2:
        return np.full(n, np.nan)
    return np.asarray(3.0 * np.std(alphas, axis=0, ddof=1) / np.sqrt(len(alphas)))


def _from_one_cycle(
    cycle: Cycle, a: Array, external: tuple[float, float, float, float]
) -> Array | None:
    """Solve C alpha = p of one cycle; None where its rank is short.

    From C' C = (A' A) o (sum of c c') where that is far from singular, which costs a tenth; else by
    singular values. Either way a block of rows after the other, so that C is never whole.
    """
    n = a.shape[1]
    square, total = np.zeros((n, n), order="F"), np.zeros(n)
    for rows in cycle.used_blocks():
        force = cycle.used(cycle.force, rows)
        square = dsyrk(1.0, force.T, beta=1.0, c=square, overwrite_c=True)  # the upper triangle
        total += force.sum(axis=0)
    square *= a.T @ a
    right = -np.sum(a * external_load(*external)[:, None], axis=0) * total
    norm = float(scipy.linalg.norm(square, 1, check_finite=False))  # of one triangle: half at least
    factor, failed = dpotrf(square, clean=False, overwrite_a=True)
    if not failed and dpocon(factor, norm)[0] > 1e-10:
        return np.asarray(scipy.linalg.cho_solve((factor, False), right, check_finite=False))
    del square, factor
    triangle = np.empty((0, n + 1))
    for rows in cycle.used_blocks():
        block = np.column_stack(system_c(cycle.used(cycle.force, rows), a, *external))
        triangle = scipy.linalg.qr(np.vstack([triangle, block]), mode="r")[0][: n + 1]
    alpha, _, rank, _ = scipy.linalg.lstsq(triangle[:, :-1], triangle[:, -1])
    return np.asarray(alpha) if rank == n else None
