"""Each constant that decides about data: a case just below, and a case just above."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from unittest import mock

import numpy as np

import truenewton as tn
from helpers.balanced import START
from helpers.thresholds import between, outcome
from truenewton.bench.simulated.static import static_bench
from truenewton.comparison import compare
from truenewton.comparison.compare import _refuse_processed
from truenewton.comparison.fit import fit_pair
from truenewton.comparison.pairing import _common, _order, rough_residual
from truenewton.comparison.result import Comparison
from truenewton.estimation.matrix.couplings import typical_spacing
from truenewton.mirrors.known import ring
from truenewton.statics.arms import arms

N = 20
RANDOM = np.random.default_rng(3).standard_normal((N, N)) * (1 - np.eye(N))


def limits(**figures):
    sound = {
        "alpha_scatter": 0.0, "alpha_ratio_error": np.full(4, 0.02), "pattern": 1.0, "tails": 0.0,
        "resemblance": 0.0, "excess": np.nan, "noise_law": "modes", "converged": True,
    }  # fmt: skip
    return len(Comparison.findings.fget(SimpleNamespace(**sound | figures)))


def across(vector, cosine, *zeros):
    """Return a vector of the same length at a cosine to another one, with zeros."""
    other = np.random.default_rng(5).standard_normal(len(vector))
    other[list(zeros)] = 0.0
    other -= vector * (other @ vector) / (vector @ vector)
    other *= np.linalg.norm(vector) / np.linalg.norm(other)
    return cosine * vector + np.sqrt(1 - cosine**2) * other


def row_is_lost(cosine):
    new = RANDOM.copy()
    new[4] = across(new[4], cosine, 4)
    return bool(_order(RANDOM, new, "rows")[1][4])


def rows_are_exchanged(cosine):
    """Two rows of a cosine, exchanged: each resembles the other by 1."""
    old = RANDOM.copy()
    old[4, [4, 5]] = 0.0
    old[5] = across(old[4], cosine, 4, 5)
    new = old.copy()
    new[[4, 5]] = old[[5, 4]]
    return _order(old, new, "rows")[0][4] == 5


def exchanged_rows(count):
    new = RANDOM.copy()
    new[:count] = np.roll(RANDOM[:count], 1, axis=0)
    return outcome(lambda: _order(RANDOM, new, "rows"))


@cache
def noisy(seed):
    """Return a stiffness of 45 actuators with alpha, and noise of 0.01 %."""
    truth = static_bench(ring(45), 7).truth
    k = truth.stiffness / truth.alpha[:, None]
    noise = 1e-4 * np.random.default_rng(seed).standard_normal(k.shape)
    return truth.layout, k * (1.0 + noise)


def matrix_of(**positions):
    layout, k = noisy(1)
    return tn.StiffnessMatrix("RING", START, replace(layout, **positions), k)


def common(**positions):
    return len(_common(matrix_of(), matrix_of(**positions))[0])


def moved_by(spacings):
    """Return how many actuators of 45 are common if the first is moved."""
    layout, _ = noisy(1)
    x = layout.x.copy()
    x[0] += spacings * typical_spacing(arms(layout))
    return common(x=x)


def common_actuators(count):
    layout, _ = noisy(1)
    x = layout.x.copy()
    x[count:] += 1.0
    return outcome(lambda: common(x=x))


def processed(new):
    layout, old = noisy(1)
    return outcome(lambda: _refuse_processed(SimpleNamespace(old=old, new=new, layout=layout)))


def different_by(residual):
    """Noise, alike for all elements, gives a residual in proportion."""
    _, old = noisy(1)
    noise = np.random.default_rng(4).standard_normal(old.shape) * np.sqrt(np.mean(old**2))
    unit = rough_residual(old, old + 1e-3 * noise) / 1e-3
    return processed(old + residual / unit * noise)


def spread_of_factors(ratio):
    """Relative to the spread with one matrix transposed."""
    factors = np.stack([np.arange(45.0), np.arange(45.0)]), np.ones((2, 45))
    both = [(ratio * factors[0], factors[1]), factors]
    with mock.patch.object(compare, "rough_factors", side_effect=both):
        return processed(noisy(2)[1])


def modes_left_out(count, size):
    """The softest modes have a singular value relative to the noise."""
    _, old = noisy(1)
    _, new = noisy(2)
    left, values, right = np.linalg.svd(new)
    values[-count:] = 0.0
    noise = rough_residual(old, left * values @ right) * np.sqrt(np.mean(old**2))
    values[-count:] = size * noise
    return processed(left * values @ right)


def changed_couplings(count):
    """Whether all of some elements are named that changed by 100 errors."""
    random = np.random.default_rng(8)
    one = 10.0 + random.standard_normal((N, N))
    other = one + 1e-3 * random.standard_normal((N, N))
    at = random.permutation(N)[:count]
    other[np.arange(count), at] += 0.1
    return len(fit_pair(one, other, np.ones((N, N)), np.zeros((N, N))).couplings) == count


CASES = [
    ("MAX_PATTERN", lambda x: limits(pattern=x), 1.14, 0, 1.16, 1),
    ("MAX_SCATTER", lambda x: limits(alpha_scatter=x), 0.059, 0, 0.061, 1),
    ("MAX_TAILS", lambda x: limits(tails=x), 1.4, 0, 1.6, 1),
    ("MAX_RESEMBLANCE", lambda x: limits(resemblance=x), 3.9, 0, 4.1, 1),
    ("MAX_EXCESS", lambda x: limits(excess=x), 1.19, 0, 1.21, 1),
    ("MIN_COSINE", row_is_lost, 0.49, True, 0.51, False),
    ("MIN_COSINE_GAIN", rows_are_exchanged, 0.975, True, 0.985, False),
    ("MAX_EXCHANGED_FRACTION", exchanged_rows, 2, "accepted", 3, "refused"),
    ("POSITION_TOLERANCE", moved_by, 0.19, 45, 0.21, 44),
    ("MIN_COMMON_FRACTION", common_actuators, 22, "refused", 23, "accepted"),
    ("DERIVED_NOISE", different_by, 0.9e-6, "refused", 1.1e-6, "accepted"),
    ("MAX_RESIDUAL", different_by, 0.09, "accepted", 0.11, "refused"),
    ("TRANSPOSED_SPREAD_RATIO", spread_of_factors, 2.9, "accepted", 3.1, "refused"),
    ("MAX_EMPTY_MODE", lambda x: modes_left_out(4, x), 0.9e-3, "refused", 1.1e-3, "accepted"),
    ("MIN_MISSING_MODES", lambda k: modes_left_out(k, 0.0), 3, "accepted", 4, "refused"),
    ("MAX_CHANGED_COUPLINGS", changed_couplings, 4, True, 5, False),
]

test_a_threshold_is_between = between(CASES)
