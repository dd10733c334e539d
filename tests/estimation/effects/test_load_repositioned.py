"""A load that was removed and mounted again at another position is reported and corrected."""

from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import changed
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.mirrors.known import p45
from truenewton.mirrors.shell.shell_model import forces_under, weight_on
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load

NAME = "load repositioned between files"
MIRROR = replace(p45(), weight_error=0.0)
LOADS = (Load("bare"), Load("ring", -0.289, 0.0, tool="ring"))


def remounted(seed, noise, scatter=0.3e-3):
    """Return a campaign whose ring is remounted off centre for its last cycle, and its alpha."""
    bench = static_bench(MIRROR, seed, loads=LOADS, force_noise=noise)
    random = np.random.default_rng(seed)
    here, there = (
        forces_under(bench.glass, weight_on(MIRROR, 0.0, -0.289, off_centre=centre))
        for centre in (np.zeros(2), random.normal(0.0, scatter, 2))
    )
    moved = (there - here) / bench.truth.alpha
    campaign = changed(
        Campaign(tuple(run_cycles(bench, 4))),
        force=lambda _, c: c.force + moved * (c.load.added != 0 and c.number == 4),
    )
    return campaign, bench.truth.alpha


@pytest.mark.parametrize(
    ("noise", "seeds"),
    [(1e-4, 2), *(pytest.param(n, 4, marks=pytest.mark.study) for n in (1e-4, 1e-5))],
)
def test_alpha_is_almost_as_accurate_as_with_one_mounting(noise, seeds):
    ratio, pull = [], []
    for seed in range(1, 1 + seeds):
        campaign, alpha = remounted(seed, noise)
        found = tn.calibrate(campaign)
        assert [(effect.name, effect.corrected) for effect in found.effects] == [(NAME, True)]
        once = tn.calibrate(remounted(seed, noise, 0.0)[0])
        assert not once.effects
        ratio.append(np.sum((found.alpha - alpha) ** 2) / np.sum((once.alpha - alpha) ** 2))
        pull.append(np.mean(((found.alpha - alpha) / found.statistical_error) ** 2))
    assert np.sqrt(np.mean(ratio)) < 1.5
    assert np.mean(pull) < 1.5


def test_zeros_with_a_net_force_are_not_taken_for_a_repositioned_load():
    bench = static_bench(MIRROR, 2, loads=LOADS, force_noise=1e-4)
    random = np.random.default_rng(2)
    campaign = Campaign(tuple(run_cycles(bench, 4)))
    anew = changed(campaign, force=lambda _, c: c.force + random.normal(0.0, 2e-4, 45))
    found = tn.calibrate(anew)
    assert [effect.name for effect in found.effects] == ["zero by file of each"]
