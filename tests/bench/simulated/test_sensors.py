"""Capacitive sensors: the law of the electronics, its steps, its noise and its limits."""

import numpy as np
import pytest

from truenewton.bench.simulated.sensors import (
    Sensors,
    counts,
    draw_sensors,
    out_of_range,
    reading,
)

GAP = 68e-6
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
