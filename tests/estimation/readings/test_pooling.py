"""Rows pooled over loads and signs: the basis U, sums computed with U, and fits."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from helpers.balanced import changed, rms_z
from helpers.small_bench import SmallBench
from truenewton.calibration.methods import calibrate
from truenewton.estimation.problem import problem_of
from truenewton.estimation.readings.moments import (
    chosen_groups,
    independent_readings,
    over_loads_and_signs,
    reading_noise,
    structure_of,
)
from truenewton.estimation.screening.screen import campaign_moments, screen_campaign

KINDS = ["plain", "three loads", "one sign", "missing", "unbalanced", "one sign under a load",
         "left out", "sizes"]  # fmt: skip


def noiseless(kind):
    """Return a small noiseless campaign of some kind, and its bench."""
    bench = SmallBench(3, 0.0, order=(0, 0, 1, 1, 2, 2) if kind == "three loads" else (0, 0, 1, 1))
    if kind == "sizes":
        bench.size = np.where(bench.load == 1, 1.04, 1.0)
    lost = {
        "one sign": lambda c: c.sign < 0,
        "missing": lambda c: (c.shape % 4 == 1) & (c.load.name == "bare"),
        "unbalanced": lambda c: (c.shape > 2) & (c.load.name != "bare"),
        "one sign under a load": lambda c: (c.sign < 0) & (c.load.name != "bare"),
    }.get(kind, lambda c: c.shape < 0)
    return changed(bench.campaign(), valid=lambda _, c: ~lost(c)), bench


def groups_of(kind, random):
    """Return labels, uneven weights and sizes of the groups of such a campaign."""
    moments = campaign_moments(noiseless(kind)[0])
    weight = random.uniform(1.0, 5.0, moments.groups)
    if kind == "left out":
        weight[[2, 9, 17]] = 0.0
    return moments.labels, weight, moments.size_of_groups


def columns(labels, size):
    """Return X: one column for each load and sign, one for each SHAPE times its SIGN."""
    x = []
    for load in np.unique(labels[:, 0]):
        for sign in (-1, 1):
            x.append((labels[:, 0] == load) & (labels[:, 2] == sign))
    for shape in np.unique(labels[:, 1]):
        x.append(np.where(labels[:, 1] == shape, labels[:, 2] * size, 0.0))
    return np.array(x, dtype=float).T


@pytest.mark.parametrize("kind", KINDS)
def test_the_basis_is_orthonormal_and_spans_the_columns_of_x(kind):
    random = np.random.default_rng([KINDS.index(kind), 1])
    labels, weight, size = groups_of(kind, random)
    pooling = over_loads_and_signs(labels, weight, size)
    u, on = pooling.basis.toarray(), weight > 0
    x = columns(labels, size) * on[:, None]
    assert u.T @ (weight[:, None] * u) == pytest.approx(np.eye(pooling.count), abs=1e-12)
    assert pooling.count == np.linalg.matrix_rank(x)
    # U spans X, and only X, because their ranks are equal.
    assert u @ (u.T @ (weight[:, None] * x)) == pytest.approx(x, abs=1e-12)
    assert not u[~on].any()
    assert pooling.squared_lengths == pytest.approx(np.sum(u**2, axis=1), abs=1e-12)
    values = random.standard_normal((len(labels), 4))
    assert pooling.rows(values) == pytest.approx((u.T * weight) @ values, abs=1e-12)
    rows = random.standard_normal((pooling.count, 4))
    assert pooling.groups(rows) == pytest.approx(u @ rows, abs=1e-12)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("left out", "plain")])
def test_pooled_rows_contain_all_information_of_noiseless_campaigns(kind):
    campaign, bench = noiseless(kind)
    moments = replace(screen_campaign(campaign).moments, pooled=True)
    pooling = moments.pooling
    assert pooling.count < moments.groups or kind == "one sign"
    back = pooling.groups(pooling.rows(moments.mean))
    assert back == pytest.approx(moments.mean, abs=1e-12)
    problem = problem_of(campaign, reading_noise(campaign, moments))
    assert problem.fitted(moments).values[:14] == pytest.approx(bench.alpha, rel=1e-9)


@pytest.mark.parametrize("pooled", [False, True])
def test_sums_equal_those_of_rows(pooled):
    bench = SmallBench(4, 1e-3, order=(0, 0, 0, 1, 2))
    campaign = changed(bench.campaign(), bias_gradient=31.0)
    moments = replace(campaign_moments(campaign), pooled=pooled)
    chosen = np.random.default_rng(5).random(len(moments.rows)) > 0.1
    moments = chosen_groups(moments, chosen)
    u, r = moments.pooling.basis.toarray(), moments.weight
    y, q = (u.T * r) @ moments.mean, (u.T * r) @ moments.known
    load = (u.T * r) @ (moments.labels[:, :1] == np.arange(3))
    assert moments.known.any()
    sums = moments.sums
    assert sums.shapes == len(y) == (14 + 6 - 1 if pooled else np.count_nonzero(chosen))
    assert sums.weight == pytest.approx(np.sum(load**2, axis=0), rel=1e-12)
    if not pooled:
        assert sums.weight == pytest.approx([r[moments.labels[:, 0] == k].sum() for k in range(3)])
    assert sums.force == pytest.approx(load.T @ y, rel=1e-10, abs=1e-10)
    assert sums.square == pytest.approx(y.T @ y, rel=1e-10, abs=1e-10)
    assert sums.known == pytest.approx(load.T @ q, rel=1e-9, abs=1e-15)
    assert sums.known_force == pytest.approx(q.T @ y, rel=1e-9, abs=1e-15)
    assert sums.known_square == pytest.approx(q.T @ q, rel=1e-9, abs=1e-20)


@pytest.mark.study
@pytest.mark.parametrize("kind", ["plain", "one sign under a load", "unbalanced"])
def test_errors_from_pooled_rows_are_valid_and_smaller_than_without(kind):
    """Groups of 14 shapes, with two signs and two loads, are four-fold redundant."""
    z, ratio = [], []
    for seed in range(30):
        bench = SmallBench([seed, 7], 1e-2, order=(0, 0, 0, 1) if kind == "unbalanced" else (0, 1))
        lost = 1 if kind == "one sign under a load" else None
        campaign = changed(
            bench.campaign(),
            force_error=1e-2,
            valid=lambda k, c, lost=lost: c.sign > 0 if k == lost else c.valid,
        )
        alone = campaign_moments(campaign)
        problem = problem_of(campaign, reading_noise(campaign, alone))
        one, other = (problem.fitted(replace(alone, pooled=pooled)) for pooled in (True, False))
        error = np.sqrt(np.diag(one.reading_covariance)[:14])
        z.append((one.values[:14] - bench.alpha) / error)
        ratio.append(np.mean(error**2) / np.mean(np.diag(other.reading_covariance)[:14]))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)
    assert np.mean(ratio) <= 1.0
    assert max(ratio) < 1.02


def resized(has_position):
    """Return a bench whose shapes are 3 % larger under the load."""
    bench = SmallBench(8, 1e-4)
    bench.size = np.where(bench.load == 1, 1.03, 1.0)
    bench.has_position = has_position
    return bench


def test_amplitudes_of_shapes_are_estimated_from_displacements():
    bench = resized(has_position=True)
    campaign = bench.campaign()
    # Sensor zeros are removed with the mean over the shapes.
    zeros = changed(campaign, position=lambda _, c: c.position + 1e-5 * np.arange(14))
    for data in (campaign, zeros):
        moments = screen_campaign(data).moments
        assert moments.pooled
        size, variance = moments.sizes
        assert size == pytest.approx([1.0, 1.03], abs=1e-9)
        assert variance[1] < 1e-12
    calibration = calibrate(campaign)
    assert not calibration.effects
    assert np.mean(np.abs(calibration.alpha - bench.alpha) < 2.5 * calibration.error) > 0.9


def test_shapes_of_unequal_amplitude_are_not_pooled_without_position():
    bench = resized(has_position=False)
    screened = screen_campaign(bench.campaign())
    assert not screened.moments.pooled
    assert screened.structure.probability < 1e-10
    found = calibrate(bench.campaign())
    # Gain and amplitude are degenerate: the effect is reported, but alpha is not corrected.
    assert [(effect.name, effect.corrected) for effect in found.effects] == [
        ("gain by load", False)
    ]
    error = np.abs(found.alpha - bench.alpha) / found.error
    assert np.mean(error < 1.96) > 0.9


def test_the_chi2_of_structure_is_the_sum_of_squared_residuals():
    campaign = SmallBench(11, 1e-3).campaign()
    moments = campaign_moments(campaign)
    noise = reading_noise(campaign, moments)
    x = columns(moments.labels, np.ones(56))
    root = np.sqrt(moments.weight)[:, None]
    basis = scipy.linalg.orth(x * root)
    residual = moments.mean * root - basis @ (basis.T @ (moments.mean * root))
    structure = structure_of(
        moments, noise, np.empty((0, 14))
    )  # no samples: all readings are independent
    assert structure.degrees_of_freedom == (56 - 17) * 14
    bias = 1 - 2 / moments.repeats
    assert structure.chi2 == pytest.approx(bias * np.sum(residual**2 / noise.variance), rel=1e-9)


def test_the_effective_number_of_correlated_readings_is_smaller():
    random = np.random.default_rng(12)
    alone = random.standard_normal((900, 40))
    together = random.standard_normal((900, 3)) @ random.standard_normal((3, 40))
    assert independent_readings(alone, 40) == pytest.approx(40, rel=0.05)
    assert independent_readings(alone[:20], 40) > 30  # corrected for few rows
    scaled = together / np.sqrt(np.mean(together**2, axis=0))
    expected = 40**2 / np.sum((scaled.T @ scaled / 900) ** 2)
    assert independent_readings(together, 40) == pytest.approx(expected, rel=0.1)
    assert expected < 4
    assert independent_readings(np.empty((0, 40)), 40) == 40


@pytest.mark.parametrize("seed", range(3))
def test_sizes_of_single_shapes_that_position_shows_are_no_effect(seed):
    """Shapes that differ between loads, each by itself, were 'gain by hour of each'."""
    bench, random = SmallBench([seed, 7], 1e-4), np.random.default_rng(seed)
    sizes = random.normal(1.0, 0.1, 14)
    bench.size = np.where(bench.load == 1, sizes[bench.shape - 1], 1.0)
    noise = 1e-10 * random.standard_normal((8, 28, 14))
    campaign = changed(bench.campaign(), position=lambda k, c: c.position + noise[k])
    found = calibrate(campaign)
    assert not found.effects
    assert found.verdict.level == "usable"
    assert rms_z(found, bench.alpha) < 2.0
    moments = screen_campaign(campaign).moments
    expected = np.where(moments.labels[:, 0] == 1, sizes[moments.labels[:, 1] - 1], 1.0)
    assert moments.size_of_groups == pytest.approx(expected, abs=1e-3)
