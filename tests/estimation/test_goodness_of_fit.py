"""The probability of the fit if most of the noise balances and is estimated from repeats."""

import numpy as np
import pytest
import scipy.linalg

import truenewton as tn
from helpers.balanced import changed, p45_bench, p45_shapes

SIGMA, FRACTION = 1e-4, 0.1  # noise [N], unbalanced fraction of its variance


def with_motion(quiet, alpha, seed):
    """Return a campaign in which motion of the mirror causes 90 % of the noise."""
    random = np.random.default_rng(seed)
    layout = quiet.layout
    balanced = scipy.linalg.null_space(np.stack([layout.nz, layout.x, layout.y]) * alpha)

    def moved(_, cycle):
        shape = np.shape(cycle.force)
        moves = random.standard_normal((shape[0], 42)) @ balanced.T
        noise = np.sqrt(1 - FRACTION) * moves + np.sqrt(FRACTION) * random.standard_normal(shape)
        return cycle.force + SIGMA * noise

    return changed(quiet, force=moved, force_error=None)


@pytest.mark.parametrize(
    ("cycles", "campaigns"),
    [(2, 40), *(pytest.param(c, 150, marks=pytest.mark.study) for c in (2, 4))],
)
def test_the_probability_of_sound_campaigns_is_uniform(cycles, campaigns):
    quiet = p45_shapes(p45_bench().shapes, 0.0, cycles)
    alpha = p45_bench().truth.alpha
    found = [tn.calibrate(with_motion(quiet, alpha, seed)).goodness for seed in range(campaigns)]
    reduced = np.array([one.reduced for one in found])
    assert reduced.mean() == pytest.approx(1.0, abs=0.03)
    probability = np.array([one.probability for one in found])
    for level in (0.05, 0.5, 0.95):
        sampling = np.sqrt(level * (1 - level) / campaigns)
        assert np.mean(probability < level) == pytest.approx(level, abs=0.01 + 3 * sampling)
