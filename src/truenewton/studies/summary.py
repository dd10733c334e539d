"""The proof and the truth in words and numbers: terminal, script."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

from truenewton.bench.simulated.truth import Truth
from truenewton.calibration.result import Calibration
from truenewton.rounding import percent
from truenewton.statics.load import Load
from truenewton.studies.proof import LIMIT, Proof
from truenewton.studies.scoring import Score


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
    verdict = "alpha comes back to machine precision" if passed else "PROOF FAILED"
    return f"{verdict}: at most {max(one.ratio for one in proofs):.2f} eps cond (limit {LIMIT:g})"


def truth_lines(
    calibration: Calibration, truth: Truth, loads: Sequence[Load], score: Score, by_svd: Score
) -> Iterator[str]:
    """Yield an estimate beside the truth; loads as declared, scores of the estimate and by svd."""
    yield f"{'':<22}{'estimate':>10} {'truth':>10}"
    rows = [("B [N]", calibration.bias_force, truth.bias_force)]
    for name in ("y", "x"):
        estimated, true = (getattr(each, f"torque_{name}") for each in (calibration, truth))
        rows += [
            (f"M_{name} {load} [mN m]", 1e3 * a, 1e3 * b)
            for load, a, b in zip(truth.loads, estimated, true, strict=True)
        ]
    alphas = zip(truth.layout.id[:3], calibration.alpha, truth.alpha, strict=False)
    rows += [(f"alpha {ident}", a, b) for ident, a, b in alphas]
    for name, estimate, true in rows:
        yield f"{name:<22}{estimate:10.4f} {true:10.4f}"
    yield (
        f"all {truth.layout.n} alphas: common scale off by {percent(score.scale_error)} (the ring"
        f" weighs {1e3 * abs(truth.added[1]):.1f} mN, not the {1e3 * abs(loads[1].added):.0f} mN"
        " declared);"
    )
    yield (
        f"that aside, rms error {percent(score.pattern_error)}, and"
        f" {percent(by_svd.pattern_error)} by the paper's svd on the same data"
    )
