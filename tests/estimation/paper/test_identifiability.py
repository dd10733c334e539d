"""Insufficient data are refused with the reason, also if noise fills the null space."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import LAYOUT, RING, WEIGHT, campaign_of, p45_bench, p45_shapes, ungraded
from truenewton.bench.simulated.static import static_bench
from truenewton.calibration.methods import calibrate
from truenewton.errors import RankDeficient
from truenewton.estimation.paper.identifiability import geometry_fault
from truenewton.mirrors.known import p45
from truenewton.records.campaign import Campaign
from truenewton.statics.layout import layout
from truenewton.statics.load import Load

NOISES = [0.0, 1e-4, 1e-3]


def refusal(campaign):
    """Return the reason for which both methods refuse a campaign."""
    faults = set()
    for method in ("svd", "ml"):
        with pytest.raises(RankDeficient) as refused:
            calibrate(campaign, method)
        faults.add(refused.value.fault)
    [fault] = faults
    return fault


CANCELLED = replace(RING, tilt=float(np.degrees(np.arccos(WEIGHT / (WEIGHT + RING.added)))))
LINE = layout(np.linspace(-0.1, 0.1, 9), 0.02 + 0.3 * np.linspace(-0.1, 0.1, 9))
INSUFFICIENT = {
    "only one load, 'bare'": lambda noise: Campaign(
        p45_shapes(p45_bench().shapes, noise).cycles[:2]
    ),
    "the 2 loads have the same weight": lambda noise: campaign_of(
        2, noise, loads=(Load("bare"), CANCELLED)
    )[0],
    "too few shapes: 10 for 45 actuators": lambda noise: p45_shapes(
        p45_bench().shapes[3:13], noise
    ),
    "the actuators are collinear": lambda noise: campaign_of(3, noise, layout=LINE)[0],
    "only 3 actuators enabled": lambda noise: campaign_of(4, noise, disabled=range(3, 14))[0],
}


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("fault", INSUFFICIENT)
def test_insufficient_data_are_refused_with_the_reason(fault, noise):
    assert fault in refusal(INSUFFICIENT[fault](noise))


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("cycles", [1, 2])
def test_forty_five_shapes_from_ten_modes_are_insufficient(noise, cycles):
    mixture = np.random.default_rng(0).standard_normal((45, 10)) / 5
    shapes = mixture @ p45_bench().shapes[3:13]
    said = refusal(p45_shapes(shapes, noise, cycles))
    assert "stand above the noise in 10 of the 42 elastic directions" in said
    assert "patterns of alpha left to noise" in said


def test_two_thirds_of_the_modes_suffice():
    """A shape has three equations, so that n / 3 shapes can suffice; here 30 of 42 modes do."""
    bench = ungraded(static_bench(p45(), seed=1, force_noise=0.0))
    campaign = p45_shapes(bench.shapes[3:33], 0.0)
    scale = bench.loads[1].added / bench.truth.added[1]
    assert calibrate(campaign, "svd").alpha == pytest.approx(scale * bench.truth.alpha, rel=1e-7)


def test_a_line_and_one_actuator_beside_it_are_a_degenerate_conic():
    """v = x is 0 on the line x = 0 and 1 at the last actuator: v, x v, y v are x, x, x / 2."""
    y = np.array([-1.0, 0.0, 1.0, 0.5])
    x = np.array([0.0, 0.0, 0.0, 1.0])
    a = np.array([np.ones(4), x, y])
    assert geometry_fault(a).fault.startswith("the actuators are on a conic")
    assert geometry_fault(np.array([np.ones(14), LAYOUT.x, LAYOUT.y])) is None


def test_a_refusal_for_noise_names_the_order_of_columns_as_a_possible_cause():
    """X and Y of another order than FORCE look like too few shapes, too."""
    mixture = np.random.default_rng(0).standard_normal((45, 10)) / 5
    with pytest.raises(RankDeficient) as refused:
        calibrate(p45_shapes(mixture @ p45_bench().shapes[3:13], 1e-4), "ml")
    assert "too few" not in refused.value.fault
    assert "check that X and Y are in the order of FORCE" in refused.value.remedy
