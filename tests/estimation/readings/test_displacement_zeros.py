"""Reference of displacements: one reading per sensor for a campaign, unless zeros are reset."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import BIAS, LAYOUT, arms_of, changed, gradients
from truenewton.calibration.methods import calibrate
from truenewton.errors import TrueNewtonWarning
from truenewton.estimation.findings.code import Code
from truenewton.estimation.readings.rows import balanced, common_reference
from truenewton.estimation.screening.screen import campaign_moments, screen_campaign
from truenewton.records.campaign import Campaign
from truenewton.report.findings import investigate
from truenewton.statics.arms import enabled_arms

MOVED = 3e-8  # between cycles [m]; changes alpha by 2e-5 at 600 /m


def shifted(campaign, zeros):
    """Return the campaign with sensor zeros changed by (cycles, n) or (n,)."""
    zeros = np.broadcast_to(zeros, (len(campaign.cycles), 14))
    return changed(campaign, position=lambda k, c: c.position + zeros[k])


def test_rest_position_is_the_mean_and_stroke_the_rms():
    campaign, _ = gradients(seed=1, noise=0.0, offset=1.0)
    cycle = replace(campaign.cycles[0], valid=np.arange(28) != 5)  # shape 6 has no opposite
    rest = np.delete(cycle.position, [5, 19], 0).mean(axis=0)
    assert cycle.rest_position == pytest.approx(rest, abs=1e-15)
    apart = np.delete(cycle.position, 5, 0) - cycle.rest_position
    assert cycle.stroke == pytest.approx(np.sqrt(np.mean(apart**2, axis=0)), rel=1e-9)
    assert cycle.has_opposites
    alone = replace(cycle, valid=cycle.sign > 0)
    assert not alone.has_opposites
    assert alone.rest_position == pytest.approx(alone.position[:14].mean(axis=0), abs=1e-15)


def test_alpha_is_exact_if_the_rest_position_depends_on_the_load():
    """Forces follow the equations of the file contract. The mean position of cycles is z = 0."""
    campaign, alpha = gradients(seed=10, noise=0.0, offset=1e-4, moved=MOVED)
    found = calibrate(campaign)
    assert found.alpha == pytest.approx(alpha, abs=1e-9)
    assert found.bias_force == pytest.approx(BIAS, abs=1e-8)
    assert np.abs(calibrate(changed(campaign, position=None)).alpha - alpha).max() > 1e-5
    own = calibrate(shifted(campaign, [-c.rest_position for c in campaign.cycles]))
    assert np.abs(own.alpha - alpha).max() > 1e-6  # if each cycle had its own reference


@pytest.mark.parametrize("which", [slice(0, 4), slice(2, 6)])
def test_alpha_and_bias_refer_to_the_mean_position(which):
    """There they are alpha (1 + 600 z) and B + 31 N/m z, except for terms of second order."""
    campaign, alpha = gradients(seed=9, noise=0.0, offset=0.0, moved=MOVED)
    some = Campaign(campaign.cycles[which])  # three cycles of one load, one of the other
    z = np.mean([c.rest_position for c in some.cycles], axis=0)
    more = 31.0 * arms_of(LAYOUT)[0] @ z
    assert np.abs(600 * z).max() > 1e-5
    assert abs(more) > 1e-7
    found = calibrate(some)
    assert found.alpha == pytest.approx(alpha * (1 + 600 * z), abs=1e-7)
    assert found.bias_force == pytest.approx(BIAS + more, abs=0.1 * abs(more))


def test_constant_sensor_offsets_do_not_change_alpha():
    campaign, _ = gradients(seed=9, noise=1e-5, offset=0.0, moved=MOVED)
    far = shifted(campaign, np.random.default_rng(1).standard_normal(14))
    assert calibrate(far).alpha == pytest.approx(calibrate(campaign).alpha, abs=1e-11)


def test_zeros_reset_with_each_file_are_corrected():
    """Each cycle is then referred to its own mean, and a warning is issued."""
    campaign, alpha = gradients(seed=9, noise=0.0, offset=1e-5, zeros=1e-2)
    assert np.isnan(common_reference(campaign)).all()
    found = calibrate(campaign)
    assert found.alpha == pytest.approx(alpha, abs=1e-9)
    [warning] = found.diagnosis.warnings
    assert (warning.code, warning.values) == (Code.ZEROS_RESET, {"sensors": 14})
    restless, _ = gradients(seed=9, noise=1e-5, offset=0.0, moved=MOVED, zeros=1e-2)
    centred = shifted(restless, [-c.rest_position for c in restless.cycles])
    assert calibrate(restless).alpha == pytest.approx(calibrate(centred).alpha, abs=1e-11)


def test_a_reset_sensor_does_not_change_the_others():
    campaign, alpha = gradients(seed=9, noise=0.0, offset=1e-5, moved=MOVED)
    zeros = np.zeros((6, 14))
    zeros[4:, 3] = 5e-6
    one = shifted(campaign, zeros)
    assert np.flatnonzero(np.isnan(common_reference(one))).tolist() == [3]
    found = calibrate(one)
    assert np.abs(np.delete(found.alpha - alpha, 3)).max() < 1e-5
    assert abs(found.alpha[3] - alpha[3]) < 600 * 3 * MOVED
    assert found.diagnosis.warnings[0].values == {"sensors": 1}


@pytest.mark.parametrize("anew", [0.0, 1e-5])
def test_a_frozen_sensor_is_not_reported_as_reset(anew):
    """The frozen value may differ by file. Only the alpha of this actuator is wrong, by 600 z."""
    campaign, alpha = gradients(seed=9, noise=0.0, offset=1e-5, moved=MOVED)
    third = np.arange(14) == 3
    stuck = changed(campaign, position=lambda k, c: np.where(third, anew * k, c.position))
    with pytest.warns(TrueNewtonWarning, match=r"frozen sensor \(POSITION of actuator 4 is"):
        found = calibrate(stuck)
    assert not any(each.code is Code.ZEROS_RESET for each in found.diagnosis.warnings)
    assert np.abs(found.alpha - alpha).max() < 600 * MOVED


def test_an_interrupted_cycle_is_not_taken_for_a_reset_zero():
    """If no shape has its opposite, the mean of a cycle is a displacement."""
    campaign, _ = gradients(seed=9, noise=0.0, offset=1e-5, moved=MOVED)
    last = campaign.cycles[-1]
    for valid in (np.arange(28) == 2, last.sign > 0):
        rest = common_reference(Campaign((*campaign.cycles[:-1], replace(last, valid=valid))))
        assert rest == pytest.approx(common_reference(Campaign(campaign.cycles[:-1])), abs=1e-15)


def test_without_gradients_there_is_no_common_reference():
    campaign, _ = gradients(seed=9, noise=1e-4, offset=1e-5, zeros=1e-5)
    for left_out in ({"position": None}, {"coil_gradient": None, "bias_gradient": None}):
        bare = changed(campaign, **left_out)
        assert np.isnan(common_reference(bare)).all()
        faults = [each.fault for each in calibrate(bare).diagnosis.warnings]
        assert not any("zeros of" in fault for fault in faults)


def test_repeats_and_residuals_have_the_same_reference():
    """The mean of a cycle with one sign is not a rest position; it still agrees and balances."""
    campaign, _ = gradients(seed=9, noise=0.0, offset=1e-5, moved=MOVED)
    half = replace(campaign.cycles[-1], valid=campaign.cycles[-1].sign > 0)
    campaign = Campaign((*campaign.cycles[:-1], half))
    moments, a = campaign_moments(campaign), enabled_arms(campaign.layout)
    assert np.abs(screen_campaign(campaign).samples).max() < 1e-11
    by_rest, by_all = (
        balanced(half, a, zero)[0] for zero in (half.rest_position, moments.reference)
    )
    assert np.abs(by_all - by_rest).max() > 1e-5
    evidence = investigate(campaign).evidence
    lines = {line.what: line for line in evidence.balance}
    assert lines["force, ring"].before > 10.0  # mN
    assert lines["force, ring"].after < 1e-5
