"""The probability of the fit where the noise mostly balances, and is known from repeats alone."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import truenewton as tn
from helpers.balanced import p45_bench
from truenewton.bench.simulated.static import run_cycles
from truenewton.records.campaign import Campaign

SIGMA, SHARE, CAMPAIGNS = 1e-4, 0.1, 150


def with_motion(quiet, alpha, seed):
    """Return a campaign in which the mirror's own motion makes nine tenths of the noise."""
    random = np.random.default_rng(seed)
    layout = quiet.layout
    balanced = scipy.linalg.null_space(np.stack([layout.nz, layout.x, layout.y]) * alpha)
    made = []
    for cycle in quiet.cycles:
        shape = np.shape(cycle.force)
        moves = random.standard_normal((shape[0], 42)) @ balanced.T
        noise = np.sqrt(1 - SHARE) * moves + np.sqrt(SHARE) * random.standard_normal(shape)
        made.append(replace(cycle, force=cycle.force + SIGMA * noise, force_error=None))
    return Campaign(tuple(made))


@pytest.mark.parametrize("cycles", [2, pytest.param(4, marks=pytest.mark.study)])
def test_sound_campaigns_are_improbable_as_often_as_chance_has_it(cycles):
    bench = replace(p45_bench(), force_noise=0.0)
    quiet, alpha = Campaign(tuple(run_cycles(bench, cycles))), bench.truth.alpha
    found = [tn.calibrate(with_motion(quiet, alpha, seed)).goodness for seed in range(CAMPAIGNS)]
    reduced = np.array([one.reduced for one in found])
    assert reduced.mean() == pytest.approx(1.0, abs=0.03)
    probability = np.array([one.probability for one in found])
    for level in (0.05, 0.5, 0.95):
        sampling = np.sqrt(level * (1 - level) / CAMPAIGNS)
        assert np.mean(probability < level) == pytest.approx(level, abs=0.01 + 3 * sampling)
