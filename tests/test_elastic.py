"""Relative alpha from a stiffness matrix: made by hand, and measured on a real mirror."""

import datetime
import os
from pathlib import Path

import numpy as np
import pytest
from balanced import p45_bench

from truenewton.actuators import Layout
from truenewton.errors import RankDeficient
from truenewton.estimators import calibrate
from truenewton.estimators.elastic import (
    balance_modes,
    comparable_arms,
    elastic_modes,
    imbalances,
    rms_imbalance,
)
from truenewton.measurements import StiffnessMatrix
from truenewton.reading import read_data

DATE = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)
REAL = os.environ.get("TRUENEWTON_REAL_DATA")
needs_real_data = pytest.mark.skipif(
    REAL is None, reason="TRUENEWTON_REAL_DATA, the folder of measured matrices, is not set"
)


def commanded_stiffness(noise=0.0, disabled=()):
    """Return P45's stiffness as measured in commanded Newtons, and the true alpha."""
    truth = p45_bench().truth
    random = np.random.default_rng(0)
    k = truth.stiffness / truth.alpha[:, None]
    k = k * (1 + noise * random.standard_normal(k.shape))
    layout = truth.layout
    on = ~np.isin(np.arange(layout.n), disabled)
    layout = Layout(layout.id, layout.x, layout.y, layout.nz, on)
    return StiffnessMatrix("P45", DATE, layout, k), truth.alpha


def test_noiseless_stiffness_gives_alpha_up_to_its_mean():
    matrix, alpha = commanded_stiffness()
    calibration = calibrate(matrix)
    assert calibration.alpha == pytest.approx(alpha / alpha.mean(), rel=1e-9)
    assert calibration.scale == "mean 1"
    assert calibration.alpha.mean() == pytest.approx(1.0, rel=1e-14)
    assert np.isnan(calibration.bias_force)
    assert calibration.loads == ()


def test_imbalance_vanishes_on_noiseless_modes_and_on_held_out_ones():
    matrix, _ = commanded_stiffness()
    for line in imbalances(matrix):
        assert line.before > 0.05
        assert line.after < 1e-9


def test_stated_error_is_the_scatter():
    """A thousand sets of modes with equal noise in all elements, seeded."""
    matrix, _ = commanded_stiffness()
    modes, a = elastic_modes(matrix), comparable_arms(matrix)
    alphas, stated = [], []
    for seed in range(1000):
        noise = np.random.default_rng([1, seed]).standard_normal(modes.shape)
        found = balance_modes(modes + 3e-3 * noise, a)
        alphas.append(found.alpha)
        stated.append(np.diag(found.covariance))
    ratio = np.sqrt(np.mean(stated, axis=0)) / np.std(alphas, axis=0, ddof=1)
    assert ratio.mean() == pytest.approx(1.0, abs=0.04)
    assert np.all(np.abs(ratio - 1.0) < 0.11)  # each: 1 / root(2000) = 2.2 %, five sigma


def test_a_matrix_of_noise_is_refused():
    truth = p45_bench().truth
    noise = 1e6 * np.random.default_rng(1).standard_normal((45, 45))
    with pytest.raises(RankDeficient):
        calibrate(StiffnessMatrix("P45", DATE, truth.layout, noise))


def test_a_matrix_that_is_too_soft_is_refused():
    matrix, _ = commanded_stiffness()
    soft = StiffnessMatrix("P45", DATE, matrix.layout, 1e-6 * matrix.stiffness)
    with pytest.raises(RankDeficient, match="only 0 modes are stiffer than 1000 N/m"):
        calibrate(soft)


def test_a_transposed_matrix_is_warned_of():
    matrix, _ = commanded_stiffness()
    turned = StiffnessMatrix("P45", DATE, matrix.layout, matrix.stiffness.T)
    assert calibrate(matrix).diagnosis.warnings == ()
    [(fault, remedy)] = calibrate(turned).diagnosis.warnings
    assert "looks transposed" in fault
    assert "[i, j], the force of actuator i per displacement of sensor j" in remedy


def test_imbalance_is_the_rms_over_modes_and_equations():
    a = np.array([[1.0, 1.0], [2.0, -1.0], [0.0, 3.0]])
    modes = np.array([[0.6, 0.8]])
    # nz: 1.4; x: 1.2 - 0.8 = 0.4; y: 2.4
    expected = np.sqrt((1.4**2 + 0.4**2 + 2.4**2) / 3)
    assert rms_imbalance(modes, np.ones(2), a) == pytest.approx(expected, rel=1e-15)


@needs_real_data
def test_on_a_real_lbt672_alpha_restores_balance():
    matrix = read_data(Path(REAL) / "lbt672" / "lbt672-feedforward.fits")
    all_modes, odd, even = imbalances(matrix)
    assert all_modes.before == pytest.approx(0.057, abs=1e-3)
    assert all_modes.after <= 0.0095
    # Held out, without any prior: a real gain, and far from the noise-free zero.
    assert odd.after < 0.72 * odd.before
    assert even.after < 0.45 * even.before
    modes, a = elastic_modes(matrix), comparable_arms(matrix)
    assert len(modes) == 641
    values = balance_modes(modes, a).singular_values
    assert values[1] / values[0] > 10  # alpha is determined
    calibration = calibrate(matrix)
    assert calibration.diagnosis.warnings == ()
    assert calibration.alpha.min() > 0.8
    assert calibration.alpha.max() < 1.35
