"""Coils and magnets: forces, their signs, steps and limits."""

from dataclasses import replace

import numpy as np
import pytest

from truenewton.bench.simulated.coils import Coils, dac, saturated, true_force

COILS = Coils(alpha=np.array([0.7, 0.9, 1.1]))


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
