"""A population shrinks what is not smooth in log alpha, and nothing else."""

import numpy as np
import pytest

from helpers.balanced import START, p45_bench
from truenewton.estimation.likelihood.minimum import (
    Prior,
    likeliest_spread,
    smooth_patterns,
    with_population,
)
from truenewton.estimation.matrix.ml import column_fit
from truenewton.estimation.matrix.modes import columns_of
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms


def places(n):
    """Return (3, n) arms of actuators scattered over a disc."""
    random = np.random.default_rng(1)
    radius, angle = np.sqrt(random.random(n)), 2 * np.pi * random.random(n)
    return np.stack([np.ones(n), radius * np.cos(angle), radius * np.sin(angle)])


def test_the_spread_is_found_beside_any_smooth_pattern():
    a, random = places(400), np.random.default_rng(2)
    covariance = np.diag(random.uniform(0.01, 0.03, 400) ** 2)
    found = []
    for _ in range(20):
        log_alpha = 0.5 * (a[1] ** 4 - a[2] ** 2 * a[1]) + 0.02 * random.standard_normal(400)
        alpha = np.exp(log_alpha)
        noise = alpha * (np.linalg.cholesky(covariance) @ random.standard_normal(400))
        scaled = covariance * np.outer(alpha, alpha)
        found.append(likeliest_spread(smooth_patterns(a), alpha + noise, scaled))
    assert np.mean(found) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("n", [45, 400])
def test_a_population_leaves_a_smooth_alpha_alone(n):
    """Neither its scale nor a factor that is smooth: quadratic, on many actuators of degree 4."""
    a = places(n)
    rise = 0.3 * (a[1] ** 2 + a[2]) + (0.2 * a[1] ** 3 * a[2] if n > 100 else 0.0)
    alpha = 1.7 * np.exp(rise)
    before = Prior(np.ones(n), np.zeros((n, n)))
    prior = with_population(before, smooth_patterns(a), alpha, 0.02)
    gradient = prior.information @ (alpha - prior.mean)
    assert np.abs(gradient).max() < 1e-8 * np.abs(prior.information).max()
    assert prior.mean.mean() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.study
def test_errors_cover_alpha_that_rises_to_the_rim():
    """P45, 10 % to the rim beside 2 % of scatter, 300 N/m of noise in each element."""
    truth, covered = p45_bench().truth, []
    radius = np.hypot(*arms(truth.layout)[1:])
    for seed in range(60):
        random = np.random.default_rng([3, seed])
        alpha = (
            1.0 + 0.1 * (radius / radius.max()) ** 2 + 0.02 * random.standard_normal(radius.size)
        )
        k = truth.stiffness / alpha[:, None] + 300 * random.standard_normal(truth.stiffness.shape)
        matrix = StiffnessMatrix("P45", START, truth.layout, k)
        fit = column_fit(columns_of(screen_matrix(matrix)), population=True)
        error = np.abs(fit.alpha - alpha / alpha.mean())
        covered.append(np.mean(error < 1.96 * np.sqrt(np.diag(fit.covariance))))
    assert 0.91 < np.mean(covered) < 0.98
