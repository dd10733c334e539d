"""Effects that are fitted together: what is free, at which price, and what the data support."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from helpers.small_bench import SmallBench
from truenewton.calibration.methods import calibrate
from truenewton.estimation.effects import catalogue, joint
from truenewton.estimation.effects.catalogue import CATALOGUE
from truenewton.estimation.effects.derivative import FittedRows
from truenewton.estimation.effects.joint import Spreads, free_effects, joined
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import reading_noise
from truenewton.estimation.screening.screen import screen_campaign

OF = {effect.code: effect for effect in CATALOGUE}
IN_TURN, IN_A_ROW = (0, 1, 1, 0, 0, 1, 1, 0), (0, 0, 0, 0, 1, 1, 1, 1)


def fit_of(bench):
    """Return the fit to pooled rows without effects, with the noise of the bench."""
    campaign = bench.campaign()
    moments = replace(screen_campaign(campaign).moments, pooled=True)
    variance = np.full(bench.n, bench.noise**2)
    noise = replace(
        reading_noise(campaign, moments), variance=variance, source=NoiseSource.DECLARED
    )
    problem = problem_of(campaign, noise)
    return FittedRows(problem, moments, problem.fitted(moments), independent=True)


# -- the price of what is free ---------------------------------------------------------------------


def variance_of_alpha(bench, columns):
    """Return the sum of the variances of alpha, in units of that of a reading.

    Least squares of all readings with (N, n) ``columns`` of effects: the readings of each shape,
    those at rest under each load, alpha, B and the torques are unknown, and the balance is exact.
    """
    n, loads, shapes = bench.n, bench.load.max() + 1, bench.shape.max()
    at_rest = np.eye(loads)[bench.load]
    shaped = bench.sign[:, None] * np.eye(shapes)[bench.shape - 1]
    design = np.hstack([at_rest, shaped])  # (N, p)
    p, k = design.shape[1], len(columns)
    mean = np.linalg.lstsq(design, bench.readings, rcond=None)[0]
    own = n * p + k
    whole = np.zeros((own + n + 1 + 2 * loads,) * 2)
    whole[: n * p, : n * p] = np.kron(np.eye(n), design.T @ design)
    flat = np.array([column.T.ravel() for column in columns]).reshape(k, bench.readings.size)
    cross = np.array([(design.T @ column).T.ravel() for column in columns]).reshape(k, n * p)
    whole[n * p : own, : n * p], whole[: n * p, n * p : own] = cross, cross.T
    whole[n * p : own, n * p : own] = flat @ flat.T
    constraints = np.zeros((3 * p, len(whole)))
    for row in range(p):
        some = slice(3 * row, 3 * row + 3)
        constraints[some, row : n * p : p] = bench.arms * bench.alpha
        constraints[some, own : own + n] = bench.arms * mean[row]
        if row < loads:
            constraints[3 * row, own + n] = 1.0
            torque = own + n + 1 + 2 * row
            constraints[3 * row + 1 : 3 * row + 3, torque : torque + 2] = np.eye(2)
    equations = np.block([[whole, constraints.T], [constraints, np.zeros((3 * p,) * 2)]])
    scale = 1.0 / np.sqrt(np.maximum(np.abs(equations).max(axis=0), 1e-300))
    inverse = np.linalg.inv(equations * scale * scale[:, None]) * scale * scale[:, None]
    return float(np.trace(inverse[own : own + n, own : own + n]))


def hours(bench):
    """Return (N, 1) hours from their mean: alpha is that of the whole campaign."""
    return (bench.hours - bench.hours.mean())[:, None]


HOUR = {
    Code.ZERO_BY_HOUR: lambda bench: np.tile(hours(bench), bench.n),
    Code.GAIN_BY_HOUR: lambda bench: hours(bench) * bench.readings,
}


@pytest.mark.parametrize("codes", [list(HOUR), *([code] for code in HOUR)])
@pytest.mark.parametrize("order", [IN_TURN, IN_A_ROW])
def test_the_price_is_that_of_more_unknowns_in_least_squares(order, codes, monkeypatch):
    bench = SmallBench(4, 1e-5, order=order)
    columns = [HOUR[code](bench) for code in codes]
    expected = np.sqrt(variance_of_alpha(bench, columns) / variance_of_alpha(bench, []))
    fit, n = fit_of(bench), bench.n
    monkeypatch.setattr(joint, "CATALOGUE", tuple(OF[code] for code in codes))
    monkeypatch.setattr(joint, "MAX_PRICE", 1e9)
    free = free_effects(fit)
    assert {part.effect.code for part in free} == set(codes)
    with_them = joined(fit, free).minimum.reading_covariance[:n, :n]
    price = np.sqrt(np.trace(with_them) / np.trace(fit.minimum.reading_covariance[:n, :n]))
    assert price == pytest.approx(expected, rel=1e-3)
    if len(codes) == 1 and expected > 1.0001:
        assert price - 1 == pytest.approx(expected - 1, rel=0.1)
        for share, count in ((0.8, 0), (1.2, 1)):
            monkeypatch.setattr(joint, "MAX_PRICE", 1 + share * (expected - 1))
            assert len(free_effects(fit)) == count


def test_a_drift_of_the_zero_is_free_with_loads_in_turn_and_not_in_a_row():
    free = [
        {part.effect.code for part in free_effects(fit_of(SmallBench(4, 1e-4, order=order)))}
        for order in (IN_TURN, IN_A_ROW)
    ]
    assert Code.ZERO_BY_HOUR in free[0] - free[1]


# -- the gain --------------------------------------------------------------------------------------


@pytest.mark.parametrize("spreads", [1, 2])
def test_the_gain_is_the_ratio_of_marginal_likelihoods(spreads):
    """Of y = X theta + e, e of variance 1: y has the covariance 1 + X T X' with the effect."""
    random = np.random.default_rng(7)
    k, unit = 6, np.array([0.6, 0.0, 0.8])
    x = random.standard_normal((40, k))
    of = Spreads(k, unit if spreads == 2 else None)
    variances = np.array([0.3, 2.0])[:spreads]
    prior = 0.3 * np.eye(k)
    if spreads == 2:
        prior += np.kron(np.eye(2), (2.0 - 0.3) * np.outer(unit, unit))
    np.testing.assert_allclose(of.precision(variances), np.linalg.inv(prior), rtol=1e-9, atol=1e-12)
    y = x @ random.multivariate_normal(np.zeros(k), prior) + random.standard_normal(40)
    covariance = np.linalg.inv(x.T @ x + np.linalg.inv(prior))
    part = SimpleNamespace(theta=covariance @ x.T @ y, spreads=of, variances=variances)
    both = [np.eye(40) + x @ prior @ x.T, np.eye(40)]
    direct = [2 * scipy.stats.multivariate_normal(cov=each).logpdf(y) for each in both]
    assert joint._gain(part, covariance) == pytest.approx(direct[0] - direct[1], rel=1e-9)


# -- the order of the catalogue --------------------------------------------------------------------


def two_effects():
    bench = SmallBench([0, 8], 1e-3, order=IN_TURN)
    bench.gain = 1 + 3e-3 * (bench.hours - bench.hours.mean())[:, None]
    bench.external = bench.external + np.outer(bench.sign > 0, [0.02, 1e-3, -5e-4])
    return bench.campaign()


def test_the_order_of_the_catalogue_does_not_matter(monkeypatch):
    campaign = two_effects()
    found = [calibrate(campaign)]
    for order in (CATALOGUE[::-1], CATALOGUE[7:] + CATALOGUE[:7]):
        for module in (joint, catalogue):
            monkeypatch.setattr(module, "CATALOGUE", order)
        found.append(calibrate(campaign))
    first = found[0]
    for other in found[1:]:
        assert {e.code for e in other.effects} == {e.code for e in first.effects}
        assert (np.abs(other.alpha - first.alpha) < 1e-3 * first.error).all()
        np.testing.assert_allclose(other.error, first.error, rtol=1e-3)
