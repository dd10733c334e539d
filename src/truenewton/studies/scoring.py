"""A calibration of simulated data beside the truth that made them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.bench.simulated.truth import Truth
from truenewton.calibration.result import Calibration


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
