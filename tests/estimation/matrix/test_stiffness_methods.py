"""Relative alpha from simulated stiffness matrices, and from one of a real mirror."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable

from helpers.balanced import START, p45_bench, p45_matrix
from studies.matrices import without_polynomial
from truenewton.calibration.methods import calibrate
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.modes import (
    balance_modes,
    rms_imbalance,
)
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.records.cycle import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix


@pytest.mark.parametrize("method", ["svd", pytest.param("ml", marks=pytest.mark.study)])
def test_noiseless_stiffness_gives_alpha_up_to_its_mean_and_no_imbalance(method):
    matrix, alpha = p45_matrix(0.0)
    calibration = calibrate(matrix, method)
    assert calibration.alpha == pytest.approx(alpha / alpha.mean(), rel=1e-9)
    assert calibration.scale == "mean 1"
    assert calibration.alpha.mean() == pytest.approx(1.0, rel=1e-13)
    assert np.isnan(calibration.bias_force)
    assert calibration.loads == ()
    assert len(calibration.imbalances) == 3
    for line in calibration.imbalances:  # of all modes and of held-out ones
        assert line.before > 0.05
        assert line.after < 1e-9


@pytest.mark.study
@pytest.mark.parametrize("method", ["svd", "ml"])
def test_the_stated_error_is_the_scatter_of_fifty_matrices_or_larger(method):
    """All elements have equal noise: relative to stiffness, soft modes have more, columns equal."""
    truth = p45_bench().truth
    clean = truth.stiffness / truth.alpha[:, None]
    alphas, stated = [], []
    for seed in range(50):
        noise = np.random.default_rng([1, seed]).standard_normal(clean.shape)
        calibration = calibrate(
            StiffnessMatrix("P45", START, truth.layout, clean + 30 * noise), method
        )
        alphas.append(calibration.alpha)
        stated.append(calibration.error)
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / np.std(alphas, axis=0, ddof=1)
    covered = np.abs(alphas - truth.alpha / truth.alpha.mean()) < 1.96 * np.array(stated)
    if method == "ml":  # its noise model is right here
        assert ratio.mean() == pytest.approx(1.0, abs=0.06)
        assert 0.92 < covered.mean() < 0.97
        return
    assert 1.0 < ratio.mean() < 1.5
    assert np.all(ratio > 0.85)
    assert 0.88 < covered.mean() < 0.99


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "N/mm"), (1e-6, "N/um"), (3e5, "counts")])
def test_alpha_does_not_depend_on_the_unit_of_the_matrix(factor, unit):
    matrix, _ = p45_matrix()
    other = replace(matrix, stiffness=factor * matrix.stiffness)
    calibration, before = calibrate(other, "svd"), calibrate(matrix, "svd")
    assert calibration.alpha == pytest.approx(before.alpha, rel=1e-9)
    assert calibration.error == pytest.approx(before.error, rel=1e-6)
    known = [each.fault for each in before.verdict.faults]
    [new] = [each for each in calibration.verdict.faults if each.fault not in known]
    assert f"STIFFNESS seems to be in {unit}" in new.fault
    assert "store STIFFNESS in N/m" in new.remedy


def test_a_matrix_of_low_rank_or_of_noise_is_refused():
    matrix, _ = p45_matrix(0.0)
    left, values, right = np.linalg.svd(matrix.stiffness)
    low = (left[:, :10] * values[:10]) @ right[:10]
    source = Source("/somewhere/low.fits", "0" * 64)
    with pytest.raises(RankDeficient, match=r"^low\.fits: "):
        calibrate(replace(matrix, stiffness=low, source=source))
    noise = 1e6 * np.random.default_rng(1).standard_normal((45, 45))
    with pytest.raises(RankDeficient):
        calibrate(replace(matrix, stiffness=noise))


def test_a_rigid_body_residual_that_gains_explain_is_only_a_warning():
    """If forces are already calibrated, sensor gains scatter more than alpha. This is no fault."""
    noisy, truth = p45_matrix()
    gains = 1.0 + 0.01 * np.random.default_rng(3).standard_normal(len(truth))
    right = replace(noisy, stiffness=truth[:, None] * noisy.stiffness * gains)
    assert screen_matrix(right).effects == ()
    codes = {each.code for each in calibrate(right, "svd").diagnosis.warnings}
    assert "looks-transposed" in codes


def test_imbalance_is_the_rms_over_modes_and_equations():
    a = np.array([[1.0, 1.0], [2.0, -1.0], [0.0, 3.0]])
    modes = np.array([[0.6, 0.8]])
    # nz: 1.4; x: 1.2 - 0.8 = 0.4; y: 2.4
    expected = np.sqrt((1.4**2 + 0.4**2 + 2.4**2) / 3)
    assert rms_imbalance(modes, np.ones(2), a) == pytest.approx(expected, rel=1e-15)


@pytest.mark.study
def test_on_a_real_lbt672_alpha_restores_balance(real_matrix):
    all_modes, odd, even = calibrate(real_matrix, "svd").imbalances
    assert all_modes.before == pytest.approx(0.0564, rel=0.01)
    assert all_modes.after == pytest.approx(0.0091, rel=0.01)
    assert (odd.before, odd.after) == pytest.approx((0.0513, 0.0354), rel=0.02)
    assert (even.before, even.after) == pytest.approx((0.0611, 0.0253), rel=0.02)
    facts = MatrixFacts.of(real_matrix)
    modes, a = facts.elastic_modes.forces.T, facts.arms
    assert len(modes) == 641
    _, values = balance_modes(modes, a)
    assert values[1] / values[0] == pytest.approx(11.7, rel=0.01)  # alpha is determined
    codes = [each.code for each in calibrate(real_matrix, "svd").diagnosis.warnings]
    assert codes == [Code.NEGATIVE_MODES_IN_NOISE]


@pytest.mark.study
def test_on_a_real_lbt672_a_population_prior_predicts_held_out_modes(lbt672_folder, real_matrix):
    """Alpha agrees with the independently measured efficiency of the magnets.

    The population prior shrinks differences between neighbours, which lowers the correlation.
    """
    table = QTable.read(lbt672_folder / "lbt672-tables.ecsv")
    assert np.array_equal(table["ID"], real_matrix.layout.id)
    efficiency = without_polynomial(np.log(table["MAGNET_EFFICIENCY"]), real_matrix.layout)
    plain, pooled = (calibrate(real_matrix, "ml", population=each) for each in (False, True))
    _, odd, even = pooled.imbalances
    assert odd.after <= 0.026
    assert even.after <= 0.022
    for calibration, correlation in ((plain, -0.70), (pooled, -0.69)):
        apart = without_polynomial(calibration.alpha, real_matrix.layout)
        assert np.corrcoef(apart, efficiency)[0, 1] <= correlation
        codes = {each.code for each in calibration.diagnosis.warnings}
        assert codes == {Code.COLUMN_NOISE_NOT_INDEPENDENT, Code.NEGATIVE_MODES_IN_NOISE}
