"""Effects by which rows of one group differ, judged against noise that the readings of a row share.

Such noise pushes the rows of a file one way by chance, and looks like zeros by file. Along the
direction d of an effect that all actuators share, 1 of zeros, the forces at rest of gains, repeats
scatter kappa times as much as independent readings would; less what the effect itself explains,

    T / k against F(k, M - k),        T -> T (M - k) / max(M kappa - T, M - k),

M the rows less the groups. Parameters of each actuator by themselves are as many as are
independent, (tr C)^2 / tr C^2 in place of n, C the correlations of the readings (`structure`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.chance import f_logsf
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.effects.score_test import EffectTest, log_chance, there
from truenewton.estimation.findings.code import Code
from truenewton.estimation.structure import independent_readings


def beside_shared_noise(
    found: Sequence[EffectTest], fit: FittedRows, samples: Sequence[Array]
) -> list[EffectTest]:
    """Return those by which rows of one group differ, and that are there beside such noise.

    In their order: which is the likeliest, noise that is independent tells.

    ``samples`` as in `structure.structure_of`, (m, n) [N].
    """
    some = [test for test in found if test.effect.within]
    judged = [_judged(test, fit, np.concatenate(samples)) for test in some]
    codes = {test.effect.code for test in there(judged)}
    return [test for test in some if test.effect.code in codes]


def _judged(test: EffectTest, fit: FittedRows, samples: Array) -> EffectTest:
    n, variance = fit.problem.n, fit.problem.noise.variance
    statistic, freedom = test.statistic, test.degrees_of_freedom
    if test.derivative.count >= n or test.derivative.actuators is not None:
        share = independent_readings([samples], n) / n
        chance = log_chance(share * statistic, share * freedom)
        return replace(test, log_probability=chance)
    gain = test.effect.code in (Code.GAIN_BY_HOUR, Code.GAIN_BY_FILE)
    weights = (fit.fitted().mean(axis=0) if gain else np.ones(n)) / variance
    kappa = float(np.mean((samples @ weights) ** 2) / np.sum(weights**2 * variance))
    left = fit.moments.repeats - freedom
    rest = max(kappa * fit.moments.repeats - statistic, left)
    ratio = statistic / freedom * left / rest
    return replace(test, log_probability=float(f_logsf(ratio, freedom, left)))
