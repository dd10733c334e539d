"""Sensors and coils: their laws, signs, steps, noise and limits."""

from dataclasses import replace

import numpy as np
import pytest

from truenewton.bench.simulated.loop import (
    Coils,
    Sensors,
    counts,
    dac,
    draw_sensors,
    out_of_range,
    reading,
    saturated,
    true_force,
)

GAP = 68e-6
COILS = Coils(alpha=np.array([0.7, 0.9, 1.1]))
IDEAL = Sensors(gain=np.ones(1), offset=np.zeros(1), gap=GAP)


def law(count):
    """Distance [m] as published: d0 / (v ADC / 65536 - c)."""
    return 65e-6 / (2 * count / 65536 - 0.1364)


def count_step(distance):
    """Change of distance that one count means [m]: the slope of the law."""
    return distance**2 * 2 / (65e-6 * 65536)


def test_the_law_gives_back_the_distance_within_half_a_count():
    distance = np.linspace(36e-6, 120e-6, 5001)[None, :]
    counted = counts(IDEAL, GAP - distance)
    assert np.array_equal(counted, np.rint(counted))
    assert law(counted) == pytest.approx(GAP - reading(IDEAL, counted), rel=1e-12)
    error = np.abs(law(counted) - distance)
    assert np.all(error <= 0.501 * distance**2 * 2 / (65e-6 * 65536))
    assert error.max() > 0.4 * count_step(120e-6)


def test_true_displacement_is_gain_times_what_the_reading_changes_by():
    sensors = Sensors(gain=np.array([0.98, 1.03]), offset=np.array([1e-6, -2e-6]), gap=GAP)
    flat = reading(sensors, counts(sensors, np.zeros((2, 1))))
    moved = reading(sensors, counts(sensors, np.full((2, 1), 10e-6)))
    assert flat[:, 0] == pytest.approx([1e-6, -2e-6], abs=2e-9)
    assert sensors.gain * (moved - flat)[:, 0] == pytest.approx(10e-6, abs=4e-9)


def test_a_sample_scatters_by_noise_and_rounding():
    noise = np.random.default_rng(2).standard_normal((1, 100_000))
    read = reading(IDEAL, counts(IDEAL, np.zeros((1, 100_000)), noise))
    expected = np.hypot(3e-9, count_step(GAP) / np.sqrt(12))
    assert read.std() == pytest.approx(expected, rel=0.01)
    assert abs(read.mean()) < 4 * expected / np.sqrt(100_000)


def test_too_near_is_out_of_range_and_so_is_a_closed_gap():
    nearest = law(65535)
    assert nearest == pytest.approx(34.9e-6, abs=0.1e-6)
    distance = np.array([[nearest + 5e-9, nearest - 5e-9, 0.0, -1e-6, np.nan, GAP]])
    counted = counts(IDEAL, GAP - distance)
    assert np.array_equal(out_of_range(IDEAL, counted), [[False, True, True, True, True, False]])
    assert np.all(np.isinf(counted[0, 2:5]))


def test_sensors_are_drawn_as_calibrated_ones_scatter():
    sensors = draw_sensors(10_000, GAP, np.random.default_rng(3))
    assert 0.0025 < sensors.gain.std() < 0.005
    assert sensors.gain.mean() == pytest.approx(1.0, abs=2e-4)
    assert sensors.offset.std() == pytest.approx(0.5e-6, rel=0.05)


def test_true_force_is_alpha_times_command_less_with_gap_and_temperature():
    """-0.6 % for 10 um of gap; the plate is above, so that +z narrows the gap."""
    command = np.array([[0.1, -0.2], [0.3, 0.0], [-0.4, 0.5]])
    expected = np.array([[0.07, -0.14], [0.27, 0.0], [-0.44, 0.55]])
    flat = np.zeros((3, 2))
    assert true_force(COILS, command, flat) == pytest.approx(expected)
    assert true_force(COILS, command, flat - 10e-6) == pytest.approx(0.994 * expected, rel=1e-12)
    warm = true_force(replace(COILS, temperature=np.array([30.0, 10.0])), command, flat)
    assert warm == pytest.approx(expected * [0.989, 1.011], rel=1e-12)


def test_the_dac_takes_whole_steps_and_errs_evenly_by_less_than_half_a_step():
    wanted = np.random.default_rng(1).uniform(-0.7, 0.7, (3, 20_000))
    told = dac(COILS, wanted)
    steps = told / 41.6e-6
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)
    error = told - wanted
    assert np.abs(error).max() <= 0.5 * 41.6e-6 * (1 + 1e-9)
    assert error.std() == pytest.approx(41.6e-6 / np.sqrt(12), rel=0.02)


def test_more_than_0_8_newton_is_flagged_and_clipped_either_sign():
    wanted = np.array([[0.79, 0.81], [-0.79, -5.0], [0.8, np.nan]])
    expected = np.array([[False, True], [False, True], [False, True]])
    assert np.array_equal(saturated(COILS, wanted), expected)
    told = dac(COILS, wanted)
    assert told[:2, 1] == pytest.approx([0.8, -0.8], abs=41.6e-6)
    assert np.nanmax(np.abs(told)) <= 0.8
