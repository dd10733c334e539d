"""A calibration of simulated data beside the truth that made them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truenewton.bench.simulated.truth import Truth
from truenewton.calibration.result import Calibration
from truenewton.rounding import percent, table_lines
from truenewton.statics.load import Load


@dataclass(frozen=True)
class Score:
    """How far an estimate lies from the truth."""

    scale_error: float  # common relative error: weighted mean of alpha / true alpha, less one
    # root mean square of what is left when the common scale is taken out, relative
    pattern_error: float


def score(calibration: Calibration, truth: Truth) -> Score:
    """Compare a calibration with the truth: alpha of the mirror at its nominal gap.

    That is where static campaigns rest; a loop holds the glass elsewhere, by what comes to some
    3e-5 of alpha (`bench.simulated.static.rest_displacement`).
    """
    on = calibration.layout.enabled
    alpha, true = calibration.alpha[on], truth.alpha[on]
    scale = float(alpha @ true / (true @ true))
    return Score(
        scale_error=scale - 1.0,
        pattern_error=float(np.sqrt(np.mean((alpha / (scale * true) - 1.0) ** 2))),
    )


def truth_lines(
    calibration: Calibration, truth: Truth, loads: Sequence[Load], score: Score, by_svd: Score
) -> Iterator[str]:
    """Yield an estimate beside the truth; loads as declared, scores of the estimate and by svd."""
    rows = [("B [N]", calibration.bias_force, truth.bias_force)]
    for name in ("x", "y"):
        estimated, true = (getattr(each, f"torque_{name}") for each in (calibration, truth))
        rows += [
            (f"M_{name} {load} [mN m]", 1e3 * a, 1e3 * b)
            for load, a, b in zip(truth.loads, estimated, true, strict=True)
        ]
    alphas = zip(truth.layout.id[:3], calibration.alpha, truth.alpha, strict=False)
    rows += [(f"alpha {ident}", a, b) for ident, a, b in alphas]
    texts = ((name, f"{estimate:.4f}", f"{true:.4f}") for name, estimate, true in rows)
    yield from table_lines("estimate and truth:", ("", "estimate", "truth"), *texts)
    yield (
        f"error of the common scale: {percent(score.scale_error)} (the ring weighs"
        f" {1e3 * abs(truth.added[1]):.1f} mN, declared: {1e3 * abs(loads[1].added):.0f} mN)"
    )
    yield (
        f"rms error of alpha relative to the scale: {percent(score.pattern_error)}; with the svd"
        f" of the paper: {percent(by_svd.pattern_error)}"
    )
