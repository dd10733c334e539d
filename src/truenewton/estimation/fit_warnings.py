"""What is weak in a campaign and its fit, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.stats

from truenewton.estimation.diagnosis import NoiseSource
from truenewton.estimation.displaced_rows import is_displaced
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.moments import Moments
from truenewton.estimation.problem import Problem
from truenewton.estimation.repeats import WEIGHED_NOISE
from truenewton.records.fault import Fault

LOUDER = 1.5  # times FORCERR: a scatter of the repeats that is said


def noise_warnings(free: int, weakest: str, held: int, error: float) -> Iterator[Fault]:
    """Warn of patterns hardly above the noise, and of those held, with the error of each."""
    if free:
        patterns = "pattern of alpha stands" if free == 1 else "patterns of alpha stand"
        yield Fault(
            f"{free} {patterns} hardly above the noise, the weakest {weakest}",
            "repeat more often, use larger forces, or add a stiffness matrix",
        )
    if held:
        each = "pattern of alpha drowns" if held == 1 else "patterns of alpha drown"
        yield Fault(
            f"{held} {each} in noise: held even over the mirror, each uncertain by as much as"
            f" alpha varies otherwise, {100 * error:.2g} % of it RMS",
            "trust E_ALPHA, and differences along other patterns by COVARIANCE",
        )


def campaign_warnings(problem: Problem, moments: Moments, minimum: Minimum) -> Iterator[Fault]:
    """Warn of weights that disagree more than their errors allow, and of sensors set anew."""
    loads = len(problem.campaign.loads)  # the common scale and B take up two of them
    size = float(np.sum(minimum.values[problem.unknowns.weights] ** 2))
    if loads > 2 and scipy.stats.chi2.sf(size, loads - 2) <= 1e-3:
        yield Fault(
            f"the weights of the {loads} loads disagree by {np.sqrt(size):.1f} sigma",
            "check ADDED, TILT and their errors",
        )
    declared = all(cycle.force_error for cycle in problem.campaign.cycles)
    louder = float(np.sqrt(problem.noise.variance.mean())) / WEIGHED_NOISE
    if declared and problem.noise.source == NoiseSource.REPEATS and louder > LOUDER:
        noise = 1e3 * moments.noise
        yield Fault(
            f"repeated shapes scatter by {noise:.2g} mN, {louder:.1f} times what FORCERR says",
            "look for what moves the mirror or the readings between repeats, and correct FORCERR",
        )
    anew = int(np.count_nonzero(np.isnan(moments.reference)))
    if anew and any(map(is_displaced, problem.campaign.cycles)):
        yield Fault(
            f"the zeros of {anew} sensors were set anew between files: these count from each"
            " file's own mean, and E_STAT knows nothing of motion between files",
            "keep the zeros of the sensors through a campaign",
        )
