"""The paper's method compared with LAPACK, Monte Carlo and finite differences."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from helpers.balanced import RING, campaign_of, changed, noisy, p45_campaign, three_loads
from truenewton.calibration import methods
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.estimate import weight_errors
from truenewton.estimation.paper.equations import system_e
from truenewton.estimation.paper.svd import fit, noise_bias, solve, weight_changes
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import enabled_arms
from truenewton.statics.load import Load

calibrate = partial(methods.calibrate, method="svd")


def solution(calibration):
    """Return alpha, B and torques of a calibration as one vector."""
    torques = np.stack([calibration.torque_y, calibration.torque_x], axis=1).ravel()
    on = calibration.layout.enabled
    return np.concatenate([calibration.alpha[on], [calibration.bias_force], torques])


@pytest.mark.parametrize(
    "campaign",
    [campaign_of(seed=4, noise=1e-3)[0], three_loads(seed=4, noise=1e-3), p45_campaign()],
    ids=["two loads", "three loads", "P45"],
)
def test_svd_equals_lapack_least_squares_on_the_explicit_system(campaign):
    e, r = system_e(campaign, enabled_arms(campaign.layout))
    expected = np.linalg.lstsq(e, r, rcond=None)[0]
    assert solution(calibrate(campaign)) == pytest.approx(expected, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize(("disabled", "invalid"), [((), ()), ((2, 7), ()), ((), (0, 3))])
def test_all_unknowns_are_exact_without_noise(disabled, invalid):
    campaign, truth = campaign_of(seed=5, noise=0.0, disabled=disabled, invalid=invalid)
    calibration = calibrate(campaign)
    assert solution(calibration) == pytest.approx(truth, abs=1e-12)
    assert calibration.invalid == len(invalid) * 4
    assert calibration.shapes_used == 4 * (28 - len(invalid))
    for values in (calibration.alpha, calibration.error, calibration.covariance[0, :14]):
        assert np.flatnonzero(np.isnan(values)).tolist() == list(disabled)


@pytest.mark.study
def test_the_stated_error_is_the_scatter_over_campaigns():
    """E_STAT is compared with the scatter of 300 campaigns with the same truth."""
    alphas, stated = [], []
    quiet, _ = campaign_of(seed=12, noise=0.0, cycles=4)
    for k in range(300):
        campaign = noisy(quiet, 2e-3, [99, k])
        calibration = calibrate(campaign)
        alphas.append(calibration.alpha)
        stated.append(calibration.statistical_error**2)
    scatter = np.std(alphas, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(stated, axis=0)) / scatter
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
    assert np.all(np.abs(ratio - 1.0) < 0.2)  # each: 1 / root(2 * 299) = 4 %, five sigma


def test_errors_of_weights_propagate_as_by_finite_differences():
    campaign = three_loads(seed=13, noise=1e-3)
    expected = 0.0
    base = solution(calibrate(campaign))
    steps = [(None, "weight", 0.005), ("ring", "added", 0.005), ("tilt", "added", 0.002),
             ("tilt", "tilt", 0.1)]  # fmt: skip
    for name, field, sigma in steps:

        def more(_, c, name=name, field=field, step=1e-3 * sigma):
            on = c.load if name == c.load.name else None
            return replace(c.load, **{field: getattr(on, field) + step}) if on else c.load

        heavier = {"weight": campaign.weight + 1e-3 * sigma} if name is None else {"load": more}
        change = (solution(calibrate(changed(campaign, **heavier))) - base) / 1e-3
        expected = expected + np.outer(change, change)
    changes = weight_changes(campaign, fit(campaign), weight_errors(campaign))
    found = changes.T @ changes
    assert found == pytest.approx(expected, rel=2e-5, abs=1e-6 * np.abs(expected).max())


def test_errors_of_loads_with_the_same_tool_are_proportional():
    loads = (Load("bare"), RING, Load("two rings", -0.578, 0.010, tool="ring A"))
    campaign, _ = campaign_of(seed=14, noise=0.0, loads=loads)
    errors = {str(e): change.tolist() for e, change in weight_errors(campaign).items()}
    assert errors == {
        "weight of the mirror": [0.005, 0.005, 0.005],
        "weight of 'ring A'": [0.0, 0.005, 0.010],
    }


def test_the_papers_error_is_three_sigma_of_the_mean_over_cycles():
    campaign, _ = campaign_of(seed=16, noise=1e-3, cycles=3)
    calibration = calibrate(campaign)
    n = campaign.layout.n
    values = solution(calibration)
    alphas = []
    for cycle, place in zip(campaign.cycles, campaign.load_index, strict=True):
        one = Campaign((cycle,))
        e, r = system_e(one, enabled_arms(campaign.layout))
        fixed = np.concatenate([[values[n]], values[n + 1 + 2 * place : n + 3 + 2 * place]])
        alphas.append(np.linalg.lstsq(e[:, :n], r - e[:, n:] @ fixed, rcond=None)[0])
    expected = 3 * np.std(alphas, axis=0, ddof=1) / np.sqrt(6)
    assert calibration.cycle_error == pytest.approx(expected, rel=1e-9)


def test_solve_refuses_a_singular_matrix_and_too_few_equations():
    with pytest.raises(RankDeficient, match="rank 1 of 2"):
        solve(np.ones((5, 2)), np.ones(5))
    with pytest.raises(RankDeficient, match="1 equations for 2 unknowns"):
        solve(np.ones((1, 2)), np.ones(1))


def test_the_first_order_bias_agrees_with_simulations():
    """The bias is the mean of 200 campaigns. If it matters, the result contains a warning."""
    quiet, truth = campaign_of(seed=21, noise=0.0, cycles=4)
    solutions, predicted = [], []
    n = quiet.layout.n
    for k in range(200):
        campaign = noisy(quiet, 2e-3, [98, k])
        fitted = fit(campaign)
        solutions.append(fitted.solution)
        predicted.append(noise_bias(campaign, fitted, np.full(n, 4e-6)))
    measured = (np.mean(solutions, axis=0) - truth)[:n]
    error = (np.std(solutions, axis=0) / np.sqrt(200))[:n]
    expected = np.mean(predicted, axis=0)[:n]
    assert np.abs(expected).max() > 5 * error.max()  # significant
    assert np.all(np.abs(measured - expected) < 5 * error + 0.1 * np.abs(expected).max())
    [warning] = calibrate(campaign).diagnosis.warnings
    assert warning.code in ("svd-bias", "svd-bias-large")
    assert calibrate(campaign_of(seed=21, noise=1e-6)[0]).diagnosis.warnings == ()


def test_an_interrupted_cycle_hardly_changes_the_papers_error():
    campaign, _ = campaign_of(seed=22, noise=1e-3, cycles=3)
    broken = changed(campaign, valid=lambda k, c: c.valid & ((k > 0) | (np.arange(28) < 4)))
    whole, short = calibrate(campaign), calibrate(broken)
    assert short.cycle_error == pytest.approx(whole.cycle_error, rel=0.9)
