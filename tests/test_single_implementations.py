"""What stood twice has one home: many tests, imbalance, spread, temperature, layouts."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.balanced import campaign_of
from truenewton.arrays import spread, spread_square
from truenewton.chance import chance_of_any
from truenewton.estimation.paper.equations import imbalance_covariance
from truenewton.records.campaign import mean_temperature
from truenewton.statics.layout import rings

ON = np.array([True, False, True, True])


def test_chance_of_any_is_one_less_that_of_none():
    assert chance_of_any(0.01, 1) == pytest.approx(0.01, rel=1e-14)
    assert chance_of_any(0.01, 45) == pytest.approx(1 - 0.99**45, rel=1e-12)
    assert chance_of_any(1e-20, 672) == pytest.approx(6.72e-18, rel=1e-12)  # not lost to rounding
    assert chance_of_any(1.0, 3) == pytest.approx(1.0)


def test_noise_of_readings_makes_the_imbalance_scatter_by_s():
    random = np.random.default_rng(1)
    scaled_arms, variance = random.normal(1.0, 0.3, (3, 6)), random.uniform(0.5, 2.0, 6)
    noise = np.sqrt(variance) * random.standard_normal((200_000, 6))
    scatter = np.cov((noise @ scaled_arms.T).T)
    assert scatter == pytest.approx(imbalance_covariance(scaled_arms, variance), rel=0.03, abs=0.03)


def test_spread_keeps_the_order_and_leaves_nan_elsewhere():
    values = np.arange(6.0).reshape(3, 2)
    out = spread(values, ON)
    assert out.shape == (4, 2)
    assert np.array_equal(out[ON], values)
    assert np.isnan(out[~ON]).all()
    matrix = np.arange(9.0).reshape(3, 3)
    square = spread_square(matrix, ON)
    assert np.array_equal(square[np.ix_(ON, ON)], matrix)
    assert np.isnan(square[~ON]).all()
    assert np.isnan(square[:, ~ON]).all()
    assert spread_square(square, np.ones(4, dtype=bool)) is square


def test_temperature_is_the_mean_over_the_rows_that_count():
    one, other = campaign_of(seed=1, noise=0.0, cycles=1)[0].cycles
    warm = np.linspace(10.0, 20.0, len(one.time))
    half = np.arange(len(one.time)) < 10
    one = replace(one, temperature=warm, valid=one.valid & half)
    assert mean_temperature([one]) == pytest.approx(warm[half].mean())
    both = [one, replace(other, temperature=warm + 5.0)]
    expected = np.concatenate([warm[half], warm + 5.0]).mean()  # rows count alike, not cycles
    assert mean_temperature(both) == pytest.approx(expected)
    assert mean_temperature([one, other]) == pytest.approx(warm[half].mean())
    assert np.isnan(mean_temperature([other]))


def test_a_place_is_the_same_to_a_micrometre_and_else_named():
    layout = rings([0.1, 0.2], [5, 9])
    rounded = replace(layout, x=np.round(layout.x, 6), y=layout.y.astype("f4"))
    assert layout.same_as(rounded)
    assert not layout.difference(replace(layout, x=layout.x + 0.9e-6))
    moved = layout.y + 1.5e-6 * (np.arange(14) > 9) + 1e-6 * (np.arange(14) == 11)
    said = layout.other_actuators(replace(layout, y=moved))
    assert said.startswith("Y of actuator 12 (row 12): ")
    assert said.endswith(" m, 2.5 um apart; and 3 more")
    far = replace(layout, x=layout.x + 2e-6 * (layout.id == 1), y=layout.y + 1.0 * (layout.id == 5))
    assert layout.difference(far).startswith("Y of actuator 5 (row 5): ")  # whatever X of 1 is
    assert layout.difference(replace(layout, id=np.arange(14))) == (
        "ID of row 1: 0 and 1; and 13 more"
    )
    apart = layout.other_actuators(rings([0.1], [5]))
    assert apart == "5 and 14 actuators; only one has 6, 7, 8 and 6 more"
    off = replace(layout, enabled=np.arange(14) != 3)
    assert not layout.other_actuators(off)
    assert not layout.same_as(off)
    assert layout.difference(off) == "ENABLED of actuator 4 (row 4): F and T"
