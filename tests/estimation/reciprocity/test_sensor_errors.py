"""Sensors from a matrix alone: stated errors are those of its noise, and the fit is settled."""

import numpy as np
import pytest

from helpers.balanced import p45_matrix
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.reciprocity.matrix import examined, fit_jointly, fit_roughly, modes_of
from truenewton.estimation.reciprocity.sensor_model import START_REQUEST, Kind
from truenewton.mirrors.known import ring
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.statics.arms import comparable_arms

LAWS = ("equal", "proportional", "by sensor")
CASES = [("equal", 3), *(pytest.param(law, 5, marks=pytest.mark.study) for law in LAWS)]


@pytest.mark.parametrize(("law", "seeds"), CASES)
def test_errors_of_alpha_and_sensors_are_valid_for_all_noise_models(law, seeds):
    """By the fit's own covariance they were too small, and too large for equal noise."""
    mirror, n = ring(36), 36
    true = model_shell(mirror).stiffness
    true = 0.5 * (true + true.T)
    squares = []
    for seed in range(seeds):
        random = np.random.default_rng([seed, 12])
        log_alpha, log_gain = random.normal(0.0, 0.05, n), random.normal(0.0, 0.004, n)
        exact = true * np.exp(log_gain) / np.exp(log_alpha)[:, None]
        error = 2e-4 * random.standard_normal(exact.shape)
        error *= exact if law == "proportional" else np.sqrt(np.mean(exact**2))
        if law == "by sensor":
            error *= np.exp(0.7 * random.standard_normal(n))
        facts = MatrixFacts(exact + error, comparable_arms(mirror.layout))
        modes = modes_of(mirror.layout, facts)
        found = examined(modes, *fit_jointly(modes, fit_roughly(modes)))
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


def test_a_fit_converges_if_sensors_scatter_less_than_the_noise():
    """Each spread was then only slightly less than the one before, and the fit stopped too soon."""
    matrix, _ = p45_matrix(noise=5e-4)
    modes = modes_of(matrix.layout, MatrixFacts.of(matrix))
    exact = modes.fit(START_REQUEST, until=1e-4)
    error = np.sqrt(np.diag(exact.covariance_of(Kind.ALPHA)))
    for found in (modes.fit(START_REQUEST), fit_jointly(modes, fit_roughly(modes))[0]):
        apart = found.values.log_alpha - exact.values.log_alpha
        assert np.abs(apart / error).max() < 0.05
