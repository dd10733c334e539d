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
from truenewton.estimation.effects.joint import Spreads
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
        monkeypatch.setattr(catalogue, "CATALOGUE", order)
        found.append(calibrate(campaign))
    first = found[0]
    for other in found[1:]:
        assert {e.code for e in other.effects} == {e.code for e in first.effects}
        assert (np.abs(other.alpha - first.alpha) < 1e-3 * first.error).all()
        np.testing.assert_allclose(other.error, first.error, rtol=1e-3)
