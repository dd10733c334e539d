"""The proof code of the paper (section 4): without noise, the systems give alpha back.

A force pattern F_s is built whose first n - 3 columns are independent (the identity, or random
numbers) and whose last three balance each row by eq. 1. Divided by random alpha_s it is what the
electronics would record; solving C alpha = p and E alpha' = r must return alpha_s to machine
precision, that is to a few units of eps times the condition number. D alpha = q differs from
C alpha = p by the weight in q alone (`system_d`): what holds for C holds for D, as the paper says.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.estimation.cycles_svd import SingularSolution, solve
from truenewton.estimation.identifiability import geometry_fault
from truenewton.estimation.systems import system_c, system_e
from truenewton.estimation.unknowns import Unknowns
from truenewton.mirrors.known import Mirror
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import enabled_arms, external_load
from truenewton.statics.load import Load

LIMIT = 20.0  # error / (eps cond) that a backward-stable solution stays below


@dataclass(frozen=True, eq=False)
class Proof:
    """One system solved.

    Attributes
    ----------
    seed
        Of alpha and of the random patterns.
    system, matrix
        'C' or 'E'; 'identity' or 'random'.
    loaded
        Whether B, M and N were other than zero.
    rank, unknowns
        Numerical rank; number of unknowns.
    singular_values
        Descending.
    condition
        Largest over smallest.
    error
        Largest error of the solution, relative to its largest component.
    """

    seed: int
    system: str
    matrix: str
    loaded: bool
    rank: int
    unknowns: int
    singular_values: Array
    condition: float
    error: float

    @property
    def ratio(self) -> float:
        """Error / (eps cond)."""
        return self.error / (np.finfo(float).eps * self.condition)

    @property
    def passed(self) -> bool:
        """Full rank, and an error that rounding explains."""
        return self.rank == self.unknowns and self.ratio <= LIMIT


def balanced_forces(independent: Array, a: Array, k: Array) -> Array:
    """Return F_s: ``independent`` with three more columns that solve A f + k = 0 in every row.

    Parameters
    ----------
    independent
        (N, n - 3) true forces [N].
    a
        (3, n) arms.
    k
        (3,) what the actuators balance: W + B, M_y, -M_x.
    """
    missing = -(k[:, None] + a[:, :-3] @ independent.T)
    return np.hstack([independent, np.linalg.solve(a[:, -3:], missing).T])


def prove(mirror: Mirror, seed: int) -> list[Proof]:
    """Run the proof code on a mirror.

    C then E, with the identity and with random numbers, with B, M, N zero as in the paper and
    then with random B, off-axis M and N.

    Raises
    ------
    GeometryError
        The last three actuators hold no plane, or balance cannot fix alpha on this layout.
    """
    a = enabled_arms(mirror.layout)
    n = a.shape[1]
    if fault := geometry_fault(a):
        raise GeometryError(fault.fault, remedy=fault.remedy)
    if np.linalg.cond(a[:, -3:] / np.abs(a).max(axis=1)[:, None]) > 1e8:
        raise GeometryError(
            "the last three actuators are collinear",
            remedy="reorder the layout so that the last three span a triangle",
        )
    random = np.random.default_rng(seed)
    alpha = random.normal(1.0, 0.1, n)
    unknown = random.normal(0.0, 1.0, 5) * [1.0, 0.1, 0.1, 0.1, 0.1]
    proofs = []
    for loaded in (False, True):
        bias, *torques = unknown if loaded else np.zeros(5)
        truth = np.concatenate([alpha, [bias], torques])
        for matrix in ("identity", "random"):
            patterns = [
                np.eye(n - 3) if matrix == "identity" else random.standard_normal((n - 3, n - 3))
                for _ in range(2)
            ]
            for system, solution, true in (
                ("C", _solved_c(mirror, patterns[0], a, truth), truth[:n]),
                ("E", _solved_e(mirror, patterns, a, truth), truth),
            ):
                error = np.abs(solution.solution - true).max() / np.abs(true).max()
                proof = Proof(
                    seed, system, matrix, loaded, solution.rank, len(true),
                    solution.singular_values, solution.condition, float(error),
                )  # fmt: skip
                proofs.append(proof)
    return proofs


def _solved_c(mirror: Mirror, pattern: Array, a: Array, truth: Array) -> SingularSolution:
    n = a.shape[1]
    bias, torque_y, torque_x = truth[n : n + 3]
    k = external_load(mirror.weight, bias, torque_y, torque_x)
    c = balanced_forces(pattern, a, k) / truth[:n]
    return solve(*system_c(c, a, mirror.weight, bias, torque_y, torque_x))


def _solved_e(mirror: Mirror, patterns: list[Array], a: Array, truth: Array) -> SingularSolution:
    unknowns = Unknowns(a.shape[1], 2)
    bias, torques = truth[unknowns.bias], truth[unknowns.torques].reshape(2, 2)
    cycles = []
    for added, torque, pattern in zip((0.0, mirror.added_weight), torques, patterns, strict=True):
        k = external_load(mirror.weight + added, bias, *torque)
        c = balanced_forces(pattern, a, k) / truth[unknowns.alpha]
        cycles.append(_cycle(mirror, added, c))
    return solve(*system_e(Campaign(tuple(cycles)), a))


def _cycle(mirror: Mirror, added: float, force: Array) -> Cycle:
    """Return a cycle of noiseless commanded forces."""
    on, rows = mirror.layout.enabled, len(force)
    spread = np.zeros((rows, mirror.layout.n))
    spread[:, on] = force
    return Cycle(
        instrument=mirror.name,
        date=datetime.datetime(2008, 1, 1, tzinfo=datetime.UTC),
        number=1,
        load=Load("ring" if added else "bare", added),
        weight=mirror.weight,
        weight_error=0.0,
        layout=mirror.layout,
        time=np.arange(rows, dtype=float),
        shape=np.arange(1, rows + 1),
        sign=np.ones(rows, dtype=np.int64),
        force=spread,
        valid=np.ones(rows, dtype=bool),
    )
