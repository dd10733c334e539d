"""Stated errors of gains and places of sensors, from a matrix alone, are those of its noise."""

import datetime

import numpy as np
import pytest

from helpers.balanced import p45_bench
from truenewton.calibration.methods import calibrate
from truenewton.calibration.words import summary_rows
from truenewton.estimation.reciprocity.matrix import examined, modes_of
from truenewton.estimation.reciprocity.unknowns import Kind
from truenewton.mirrors.known import ring
from truenewton.mirrors.shell.held_glass import held_glass
from truenewton.records.stiffness_matrix import StiffnessMatrix

DATE = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)
N, SEEDS = 36, 5


@pytest.mark.parametrize("law", ["proportional", "equal", "by sensor"])
@pytest.mark.parametrize("gains", [pytest.param(0.0, marks=pytest.mark.study), 0.004])
def test_errors_of_sensors_hold_whatever_noise_of_elements_follows(law, gains):
    """By the fit's own covariance they were too small, and too large for equal noise."""
    mirror = ring(N)
    true = held_glass(mirror).stiffness
    true = 0.5 * (true + true.T)
    squares = []
    for seed in range(SEEDS):
        random = np.random.default_rng([seed, 12])
        log_alpha, log_gain = random.normal(0.0, 0.05, N), random.normal(0.0, gains, N)
        exact = true * np.exp(log_gain) / np.exp(log_alpha)[:, None]
        error = 2e-4 * random.standard_normal(exact.shape)
        error *= exact if law == "proportional" else np.sqrt(np.mean(exact**2))
        if law == "by sensor":
            error *= np.exp(0.7 * random.standard_normal(N))
        found = examined(modes_of(StiffnessMatrix("RING", DATE, mirror.layout, exact + error)))
        values, stated = found.joint.values, found.sensor_errors
        of_alpha = values.log_alpha - log_alpha
        errors = (
            (of_alpha - of_alpha.mean()) / np.sqrt(np.diag(found.covariance)),
            (values.log_gain - log_gain) / stated[Kind.GAIN],
            values.offset[0] / stated[Kind.X],
            values.offset[1] / stated[Kind.Y],
        )
        squares.append([np.mean(each**2) for each in errors])
    rms = np.sqrt(np.mean(squares, axis=0))
    assert (rms > 0.5).all(), rms
    assert (rms < 1.35).all(), rms


def test_where_reciprocity_does_not_hold_it_is_said_that_sensors_are_not_known():
    truth, random = p45_bench().truth, np.random.default_rng(1)
    k = truth.stiffness / truth.alpha[:, None] * (1.0 + 1e-4 * random.standard_normal((45, 45)))
    made = calibrate(StiffnessMatrix("P45", DATE, truth.layout, k))
    assert made.sensors == ()
    assert made.verdict.notes[0].code == "reciprocity-not-used"
    assert [value for name, value, _ in summary_rows(made) if name == "sensors"] == ["unknown"]
