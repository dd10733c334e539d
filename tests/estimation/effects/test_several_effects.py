"""Several effects in one campaign: their errors add up, and no good shape is left out for them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import truenewton as tn
from helpers.balanced import changed
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.chance import normal_isf
from truenewton.estimation.effects.joint import excess_of_t
from truenewton.mirrors.known import p45
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load

MIRROR = replace(p45(), weight_error=0.0)
LOADS = (Load("bare"), Load("ring", -0.289, 0.0, tool="ring"))


def with_zeros(seed, *, common=0.0, each=0.0, noise=5e-5, cycles=4, **fields):
    """Return a campaign whose zeros change from file to file [N], and its alpha."""
    bench = static_bench(MIRROR, seed, loads=LOADS, force_noise=noise)
    random = np.random.default_rng([seed, 1])
    zeros = common * random.standard_normal((2 * cycles, 1))
    zeros = zeros + each * random.standard_normal((2 * cycles, 45))
    campaign = Campaign(tuple(run_cycles(bench, cycles)))
    return changed(campaign, force=lambda k, c: c.force + zeros[k], **fields), bench.truth.alpha


def typical(error):
    return float(np.sqrt(np.mean(error**2)))


def test_the_error_of_an_earlier_correction_remains_after_the_next():
    """Zeros by file move the scale; a coil gradient that is corrected after them costs nothing."""
    alone, _ = with_zeros(1, common=1e-4)
    both, alpha = with_zeros(1, common=1e-4, coil_gradient=None)
    one, two = tn.calibrate(alone), tn.calibrate(both)
    assert [str(effect.code) for effect in one.effects] == ["zero-by-file"]
    assert {str(effect.code) for effect in two.effects} >= {"zero-by-file", "coil-gradient"}
    assert typical(two.statistical_error) == pytest.approx(typical(one.statistical_error), rel=0.5)
    assert typical(two.alpha - alpha) < 2 * typical(two.statistical_error)
    pulled = tn.calibrate(both, population=True)  # this fits once more
    assert typical(pulled.statistical_error) > 0.8 * typical(two.statistical_error)


def test_zeros_of_each_actuator_beside_zeros_of_all():
    """Their sum moves the scale more than zeros of each alone would."""
    pull = []
    for seed in range(1, 5):
        campaign, alpha = with_zeros(seed, common=1e-4, each=1e-4, cycles=3)
        found = tn.calibrate(campaign)
        pull.append(typical(found.alpha - alpha) / typical(found.statistical_error))
    assert typical(np.array(pull)) < 1.5
    assert max(pull) < 3.0


def test_a_spread_that_few_parameters_determine_is_uncertain():
    """Of seven normal numbers six give the spread: the limits of 95 % contain the seventh."""
    drawn = np.random.default_rng(3).standard_normal((40_000, 7))
    spread = np.sqrt(np.mean(drawn[:, :6] ** 2, axis=1) * excess_of_t(np.array(6.0)))
    within = np.mean(np.abs(drawn[:, 6]) < normal_isf(0.025) * spread)
    assert within == pytest.approx(0.95, abs=0.004)
    student, normal = scipy.stats.t(np.array([1.0, 2.0, 30.0])), scipy.stats.norm
    expected = (student.ppf(0.975) / normal.ppf(0.975)) ** 2
    np.testing.assert_allclose(excess_of_t(np.array([0.3, 2.0, 30.0])), expected, rtol=1e-9)


@pytest.mark.parametrize(("noise", "stroke"), [(2e-4, 20e-6), (5e-5, 5e-6)])
def test_no_shape_is_left_out_for_an_effect_that_is_corrected(noise, stroke):
    """Rigid-body shapes move most, so gradients that are not declared unbalance them most."""
    bench = static_bench(p45(), 2, force_noise=noise)
    layout = bench.truth.layout
    rigid = np.array([np.ones(45), layout.x / layout.x.max(), layout.y / layout.y.max()])
    bench = replace(bench, shapes=np.vstack([bench.shapes, stroke * rigid]))
    campaign = Campaign(tuple(run_cycles(bench, 4)))
    found = tn.calibrate(changed(campaign, coil_gradient=None, bias_gradient=None))
    assert found.rejected == 0
    assert {str(effect.code) for effect in found.effects} == {"coil-gradient", "bias-gradient"}


def test_a_shape_that_is_an_accident_is_left_out_beside_an_effect():
    bench = static_bench(p45(), 2, force_noise=5e-5)
    campaign = Campaign(tuple(run_cycles(bench, 1)))
    force = campaign.cycles[0].force.copy()
    force[7, 3] += 20e-3
    spiked = changed(
        campaign,
        force=lambda k, c: force if k == 0 else c.force,
        coil_gradient=None,
        bias_gradient=None,
    )
    assert tn.calibrate(spiked).rejected == 1
