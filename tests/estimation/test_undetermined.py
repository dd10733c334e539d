"""Patterns of alpha below the noise are constrained to zero, and have large errors."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import changed, ungraded
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.calibration.methods import calibrate
from truenewton.estimation import campaign_ml
from truenewton.estimation.campaign_ml import (
    undetermined_patterns,
    with_patterns_held,
    with_undetermined_patterns,
)
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import reading_noise
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.mirrors.known import p45
from truenewton.records.campaign import Campaign
from truenewton.statics.layout import layout


def faint(seed, size=0.04):
    """Return a campaign of a flat P45 with shapes just above the noise, and its alpha.

    Alpha is that for the declared added weight. A flat shell constrains smooth patterns poorly.
    """
    curved = p45()
    flat = replace(
        curved,
        shell=replace(curved.shell, radius_of_curvature=np.inf),
        layout=layout(curved.layout.x, curved.layout.y),
    )
    bench = ungraded(static_bench(flat, seed=seed, force_noise=1e-3))
    campaign = Campaign(tuple(run_cycles(replace(bench, shapes=size * bench.shapes), 4)))
    return campaign, bench.truth.alpha * bench.loads[1].added / bench.truth.added[1]


def test_undetermined_patterns_are_reported_and_errors_remain_valid():
    covered, undetermined, constrained = [], [], []
    for seed in (0, 1, 2, 3, 7):
        campaign, alpha = faint(seed)
        found = calibrate(campaign)
        covered.append(np.mean(np.abs(found.alpha - alpha) < 1.96 * found.statistical_error))
        undetermined.append(found.diagnosis.undetermined)
        codes = {each.code for each in found.diagnosis.warnings}
        constrained.append("constrained-patterns" in codes)
        assert "weak-patterns" in codes
        assert found.rank == 50 - found.diagnosis.undetermined
    assert min(undetermined) >= 2
    assert sum(constrained) >= 2
    assert min(covered) >= 0.9


def test_errors_are_multiplied_by_a_misfit_as_stated(monkeypatch):
    """A force of 6 mN rms at one actuator, the same in all repeats."""
    campaign, _ = faint(0)
    force = np.array([c.force for c in campaign.cycles])
    pushed = np.random.default_rng(5).normal(0.0, 6e-3, (2, force.shape[1])).repeat(4, axis=0)
    force[:, :, 7] += pushed
    found = calibrate(changed(campaign, force=lambda k, _: force[k]))
    stated = {each.code: each.values for each in found.diagnosis.warnings}
    assert "constrained-patterns" in stated
    monkeypatch.setattr(campaign_ml, "_inflated", lambda left, _: left)
    without = calibrate(changed(campaign, force=lambda k, _: force[k]))
    ratio = np.median(found.statistical_error / without.statistical_error)
    assert ratio == pytest.approx(stated["misfit"]["factor"])


def test_the_other_patterns_are_as_accurate_as_stated():
    """Errors along patterns orthogonal to the constrained ones agree with the stated errors."""
    squares = []
    for seed in range(6):
        campaign, alpha = faint(seed, 0.07)
        found = calibrate(campaign)
        covariance = (found.covariance - found.systematic_covariance)[:45, :45]
        size, pattern = np.linalg.eigh(covariance)
        z = pattern.T @ (found.alpha - alpha) / np.sqrt(size)
        squares.append(np.mean(z[:-6] ** 2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)


def test_undetermined_patterns_have_zero_mean_and_are_set_to_zero():
    campaign, _ = faint(0)
    moments = campaign_moments(campaign)
    problem = problem_of(campaign, reading_noise(campaign, moments))
    patterns = undetermined_patterns(problem, moments, 4)
    assert patterns.T @ patterns == pytest.approx(np.eye(4), abs=1e-12)
    assert patterns.mean(axis=0) == pytest.approx(np.zeros(4), abs=1e-12)
    constrained = with_patterns_held(problem, patterns)
    estimate = constrained.fitted(moments)
    assert patterns.T @ estimate.values[:45] == pytest.approx(np.zeros(4), abs=1e-4)
    wider = with_undetermined_patterns(estimate, patterns)
    added = (
        patterns.T @ (wider.reading_covariance - estimate.reading_covariance)[:45, :45] @ patterns
    )
    assert added == pytest.approx(45 * np.var(estimate.values[:45]) * np.eye(4), rel=1e-3, abs=1e-4)
