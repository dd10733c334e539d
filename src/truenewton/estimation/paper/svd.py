"""The paper's method: E alpha' = r by singular value decomposition, and each cycle alone.

It assumes noise in the right-hand side, where there is none, and none in the matrix, where it is:
with noisy readings it is biased, and its errors here are scatter and weights, without that bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpocon, dpotrf

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import LIMITS, Code
from truenewton.estimation.findings.estimate import (
    Estimate,
    Scale,
    WeightErrors,
    scale_errors,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.paper.equations import Unknowns, system_c, system_e
from truenewton.estimation.paper.identifiability import diagnose, refuse
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.readings.rows import row_groups
from truenewton.linalg import singular_values_and_vectors
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import arms_in_units_of_rms, enabled_arms, external_load


@dataclass(frozen=True, eq=False)
class SingularSolution:
    """Least squares of a linear system of m equations with u unknowns."""

    # (m, u) and (m,).
    matrix: Array
    right_side: Array
    # (u,); (u,) descending.
    solution: Array
    singular_values: Array
    rank: int  # number of singular values above rounding: without meaning for noisy data
    inverse: Array  # (u, u) of E' E

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; infinite if that is 0."""
        largest, *_, least = self.singular_values
        return float(largest / least) if least else float("inf")


def solve(matrix: Array, right_side: Array, *, any_rank: bool = False) -> SingularSolution:
    """Solve an overdetermined system, (m, u) and (m,), by singular value decomposition.

    A QR factorisation comes first, which keeps the singular values and makes tall systems cheap.
    Raises RankDeficient if there are fewer equations than unknowns, or the matrix is singular; with
    ``any_rank`` the shortest of all solutions is returned for a singular matrix.
    """
    unknowns = matrix.shape[1]
    if len(matrix) < unknowns:
        raise RankDeficient(
            f"{len(matrix)} equations for {unknowns} unknowns",
            remedy="apply more shapes",
        )
    triangle = scipy.linalg.qr(np.column_stack([matrix, right_side]), mode="r")[0][:unknowns]
    left, values, right = singular_values_and_vectors(triangle[:, :-1])
    rank = int(np.count_nonzero(values > values[0] * np.finfo(float).eps * unknowns))
    if rank < unknowns and not any_rank:
        raise RankDeficient(
            f"the system has rank {rank} of {unknowns}",
            remedy="apply more independent shapes, or a load that differs",
        )
    pseudo_inverse = right[:rank].T / values[:rank]
    return SingularSolution(
        matrix=matrix,
        right_side=right_side,
        solution=pseudo_inverse @ (left[:, :rank].T @ triangle[:, -1]),
        singular_values=values,
        rank=rank,
        inverse=pseudo_inverse @ pseudo_inverse.T,
    )


def fit(campaign: Campaign) -> SingularSolution:
    """Solve E alpha' = r, rows unweighted and torques in N m, as in the paper."""
    return solve(*system_e(campaign, enabled_arms(campaign.layout)))


def _by_load(campaign: Campaign, equations: Array) -> list[Array]:
    """Split (equations, ...) of E or r into loads, each (3, rows, ...)."""
    counts = [np.count_nonzero(cycle.valid) for cycle in campaign.cycles]
    ends = 3 * np.cumsum(np.bincount(campaign.load_index, counts).astype(int))
    parts = np.split(equations, ends[:-1])
    return [part.reshape(3, -1, *part.shape[1:]) for part in parts]


def scatter_covariance(campaign: Campaign, solved: SingularSolution) -> Array:
    """Return the (u, u) covariance of the solution about its mean, from the scatter of the rows.

    The three equations of a row share its noise, and that noise is in the matrix: residuals are
    neither independent nor identical. The pull of each row, e' (r - e alpha'), scatters among its
    repeats, whatever the form of the noise (the sandwich of Huber and White); a row without a
    repeat counts with all of its pull.
    """
    residual = solved.right_side - solved.matrix @ solved.solution
    loads = zip(_by_load(campaign, solved.matrix), _by_load(campaign, residual), strict=True)
    pull = np.concatenate([np.einsum("krp,kr->rp", e, remainder) for e, remainder in loads])
    member = np.concatenate(row_groups(campaign)[1])  # campaigns stand in the order of E
    count = np.bincount(member)
    mean = np.zeros((len(count), pull.shape[1]))
    np.add.at(mean, member, pull)
    mean /= count[:, None]
    pull -= np.where((count > 1)[:, None], mean, 0.0)[member]
    pull *= np.sqrt(count / np.maximum(count - 1, 1))[member, None]
    return np.asarray(solved.inverse @ (pull.T @ pull) @ solved.inverse)


def weight_changes(campaign: Campaign, solved: SingularSolution, errors: WeightErrors) -> Array:
    """Return (errors, u) the change of the solution by each error of the weights."""
    by_load = np.stack(  # d solution / d W of each load
        [solved.inverse @ e[0].sum(axis=0) for e in _by_load(campaign, solved.matrix)]
    )
    changes = [change @ by_load for change in errors.values()]
    return np.array(changes).reshape(-1, len(solved.solution))


def condition_in_units_of_rms(campaign: Campaign) -> float:
    """Return the condition of E, each coordinate in units of its RMS over the actuators."""
    e, _ = system_e(campaign, arms_in_units_of_rms(campaign.layout))
    values = scipy.linalg.svdvals(scipy.linalg.qr(e, mode="r")[0][: e.shape[1]])
    return float(values[0] / values[-1])


def noise_bias(campaign: Campaign, solved: SingularSolution, variance: Array) -> Array:
    """Return the (u,) bias of the solution to first order: -(E'E)^-1 G alpha.

    Noise of (n,) variances s_i^2 [N^2] in the readings adds G_ii = N s_i^2 (nz_i^2 + x_i^2 + y_i^2)
    to E'E and nothing to E'r.
    """
    a = enabled_arms(campaign.layout)
    n = a.shape[1]
    excess = len(solved.matrix) // 3 * variance * np.sum(a**2, axis=0)
    return np.asarray(-solved.inverse[:, :n] @ (excess * solved.solution[:n]))


def solve_campaign(campaign: Campaign, moments: Moments) -> Estimate:
    """Return the paper's estimate of a campaign; raise RankDeficient if there is none."""
    diagnosis = diagnose(campaign, moments)
    refuse(diagnosis.faults)
    fitted, errors = fit(campaign), weight_errors(campaign)
    solution = fitted.solution
    n = int(campaign.layout.enabled.sum())
    reading_covariance = scatter_covariance(campaign, fitted)
    changes = weight_changes(campaign, fitted, errors)
    if moments.repeats:
        biased = noise_bias(campaign, fitted, moments.noise**2 * np.ones(n))[:n]
        size = np.sqrt(np.mean(biased**2))
        scatter = np.sqrt(np.trace(reading_covariance[:n, :n]) / n)
        if size > 0.2 * scatter:
            code = Code.SVD_BIAS if size < LIMITS.svd_bias * scatter else Code.SVD_BIAS_LARGE
            diagnosis = replace(diagnosis, warnings=(Finding.of(code, bias=size),))
    return Estimate(
        method="svd",
        scale=Scale.WEIGHTS,
        values=solution,
        reading_covariance=reading_covariance,
        systematic_covariance=changes.T @ changes,
        noise=moments.noise,
        condition=condition_in_units_of_rms(campaign),
        solved_condition=fitted.condition,
        rank=len(solution) - diagnosis.undetermined,
        diagnosis=diagnosis,
        scale_errors=scale_errors(solution[:n], reading_covariance[:n, :n], changes[:, :n], errors),
    )


def cycle_errors(campaign: Campaign, solution: Array) -> Array:
    """Return (n,) the paper's error: each cycle alone, B and torques held, three sigma of the mean.

    Section 5. C alpha = p (eq. 3) is solved for each cycle from C' C = (A' A) o (sum of c c') if
    that is far from singular, which takes a tenth of the time; otherwise by singular values. An
    incomplete cycle without alpha of its own is left out. ``solution`` is (n + 1 + 2 L,) alpha, B,
    then M_y, M_x of each load. NaN of fewer than two cycles.
    """
    a, n = enabled_arms(campaign.layout), int(campaign.layout.enabled.sum())
    unknowns = Unknowns(n, len(campaign.loads))
    weights, bias_force = campaign.effective_weights.tolist(), float(solution[unknowns.bias])
    torques, alphas = solution[unknowns.torques].reshape(-1, 2).tolist(), list[Array]()
    for cycle, k in zip(campaign.cycles, campaign.load_index, strict=True):
        external, force = (weights[k], bias_force, *torques[k]), cycle.used_force
        right = (-external_load(*external) @ a) * force.sum(axis=0)
        alpha = _from_square(dsyrk(1.0, force.T), a, right)
        if alpha is None:
            alpha = from_rows(cycle, a, external)
        if alpha is not None:
            alphas.append(alpha)
    if len(alphas) < 2:
        return np.full(n, np.nan)
    return np.asarray(3.0 * np.std(alphas, axis=0, ddof=1) / np.sqrt(len(alphas)))


def _from_square(square: Array, a: Array, right: Array) -> Array | None:
    """Solve C' C alpha = C' p, in place, with the upper (n, n) sum of c c' and (n,) C' p.

    None if it is close to singular.
    """
    square *= a.T @ a
    norm = float(scipy.linalg.norm(square, 1, check_finite=False))  # of half of it
    factor, failed = dpotrf(square, clean=False, overwrite_a=True)
    if failed or dpocon(factor, norm)[0] <= 1e-10:
        return None
    return np.asarray(scipy.linalg.cho_solve((factor, False), right, check_finite=False))


def from_rows(cycle: Cycle, a: Array, external: tuple[float, ...]) -> Array | None:
    """Solve C alpha = p of one cycle by singular values; None if its rank is deficient.

    ``a`` are (3, n) arms; ``external`` W, B [N], M_y and M_x [N m].
    """
    n = a.shape[1]
    triangle = np.empty((0, n + 1))
    for rows in cycle.used_blocks:
        block = np.column_stack(system_c(cycle.used(cycle.force, rows), a, *external))
        triangle = scipy.linalg.qr(np.vstack([triangle, block]), mode="r")[0][: n + 1]
    alpha, _, rank, _ = scipy.linalg.lstsq(triangle[:, :-1], triangle[:, -1])
    return np.asarray(alpha) if rank == n else None
