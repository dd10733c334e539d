"""The proof code of the paper (section 4): without noise, the systems give alpha back.

A force pattern F_s is built whose first n - 3 columns are independent (the identity, or random
numbers) and whose last three balance each row by eq. 1. Divided by random alpha_s it is what the
electronics would record; solving C alpha = p and E alpha' = r must return alpha_s to machine
precision, that is to a few units of eps times the condition number. D alpha = q differs from
C alpha = p by the weight in q alone (`system_d`), so the result for C applies to D, too (paper).
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import GeometryError
from truenewton.estimation.paper.equations import system_c, system_e
from truenewton.estimation.paper.svd import solve
from truenewton.mirrors.known import Mirror
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.rounding import counted
from truenewton.statics.arms import enabled_arms, external_load
from truenewton.statics.load import Load

MIN_ACTUATORS = 5  # actuators, for which n - 3 patterns give as many equations as unknowns
LIMIT = 20.0  # error / (eps cond) that a backward-stable solution stays below


@dataclass(frozen=True, eq=False)
class Proof:
    """One system solved."""

    seed: int  # of alpha and of the random patterns
    # 'C' or 'E'; 'identity' or 'random'
    system: str
    matrix: str
    loaded: bool  # whether B, M and N were other than zero
    # numerical rank; number of unknowns
    rank: int
    unknowns: int
    singular_values: Array  # descending
    condition: float  # largest over smallest
    error: float  # largest error of the solution, relative to its largest component

    @property
    def ratio(self) -> float:
        """Error / (eps cond)."""
        return self.error / (np.finfo(float).eps * self.condition)

    @property
    def passed(self) -> bool:
        """Full rank, and an error that rounding explains."""
        return self.rank == self.unknowns and self.ratio <= LIMIT


def balanced_forces(independent: Array, a: Array, k: Array) -> Array:
    """Return F_s, (N, n) [N]: (N, n - 3) forces and three more that solve A f + k = 0 in each row.

    A is (3, n), the arms; k is (3,), what the actuators balance: W + B, M_y, -M_x.
    """
    missing = -(k[:, None] + a[:, :-3] @ independent.T)
    return np.hstack([independent, np.linalg.solve(a[:, -3:], missing).T])


def prove(mirror: Mirror, seed: int) -> list[Proof]:
    """Run the proof code on a mirror.

    C then E, with the identity and with random numbers, with B, M, N zero as in the paper and
    then with random B, off-axis M and N. A layout on which balance cannot fix alpha (one ring)
    has a system of short rank, and does not pass.
    """
    a = enabled_arms(mirror.layout)
    n = a.shape[1]
    if n < MIN_ACTUATORS:
        raise GeometryError(
            f"only {counted(n, 'actuator')} enabled",
            remedy="enable at least five: three fix the rigid motions, and two patterns are needed",
        )
    if np.linalg.cond(a[:, -3:] / np.abs(a).max(axis=1)[:, None]) > 1e8:
        raise GeometryError(
            "the last three actuators are collinear",
            remedy="reorder the layout so that the last three span a triangle",
        )
    random, added = np.random.default_rng(seed), [0.0, mirror.added_weight]
    alpha = random.normal(1.0, 0.1, n)
    unknown = random.normal(0.0, 1.0, 5) * [1.0, 0.1, 0.1, 0.1, 0.1]
    proofs = []
    for loaded in (False, True):
        bias, *torques = unknown if loaded else np.zeros(5)
        truth = np.concatenate([alpha, [bias], torques])
        k = external_load(np.add(mirror.weight, added), bias, torques[::2], torques[1::2])
        for matrix in ("identity", "random"):
            patterns = np.array([np.eye(n - 3)] * 2)
            if matrix == "random":
                patterns = random.standard_normal(patterns.shape)
            pairs = zip(patterns, k, strict=True)
            c = [balanced_forces(pattern, a, each) / alpha for pattern, each in pairs]
            cycles = [_cycle(mirror, weight, each) for weight, each in zip(added, c, strict=True)]
            for system, equations, true in (
                ("C", system_c(c[0], a, mirror.weight, bias, *torques[:2]), truth[:n]),
                ("E", system_e(Campaign(tuple(cycles)), a), truth),
            ):
                solution = solve(*equations, any_rank=True)
                error = np.abs(solution.solution - true).max() / np.abs(true).max()
                proof = Proof(
                    seed, system, matrix, loaded, solution.rank, len(true),
                    solution.singular_values, solution.condition, float(error),
                )  # fmt: skip
                proofs.append(proof)
    return proofs


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


def proof_values(name: str, proofs: Sequence[Proof]) -> dict[str, Any]:
    """Return the proofs on a mirror for a script."""
    return {
        "mirror": name,
        "limit": LIMIT,
        "passed": all(one.passed for one in proofs),
        "worst": max(one.ratio for one in proofs),
        "proofs": [{**dataclasses.asdict(one), "ratio": one.ratio} for one in proofs],
    }


def proof_rows(proofs: Sequence[Proof]) -> Iterator[tuple[str, ...]]:
    """Yield the proofs as rows of a table, its head first."""
    yield ("seed", "system", "F", "B, M, N", "rank", "singular values", "cond", "error",
           "error/(eps cond)")  # fmt: skip
    for one in proofs:
        yield (
            str(one.seed),
            one.system,
            one.matrix,
            "random" if one.loaded else "0",
            f"{one.rank} of {one.unknowns}",
            f"{one.singular_values[0]:.3g} .. {one.singular_values[-1]:.3g}",
            f"{one.condition:.3g}",
            f"{one.error:.1e}",
            f"{one.ratio:.3f}",
        )


def proof_verdict(proofs: Sequence[Proof]) -> str:
    """Return what the proofs come to, one line."""
    passed = all(one.passed for one in proofs)
    verdict = "alpha is recovered to machine precision" if passed else "PROOF FAILED"
    return f"{verdict}: at most {max(one.ratio for one in proofs):.2f} eps cond (limit {LIMIT:g})"
