"""Actuators that a user excludes: the others are as right as without them."""

import re
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import campaign_of, rms_z
from studies.matrices import measured_or_made, noisy, true_stiffness
from truenewton.errors import UnknownName
from truenewton.estimation.reciprocity import matrix as reciprocity_of_matrix

BAD = np.array([3, 7, 8, 12, 18, 19, 25, 30, 31, 36, 40, 44])


@pytest.fixture(scope="module")
def spoilt():
    """Return a matrix whose twelve excluded actuators have rows that are wrong; true alpha."""
    made = measured_or_made("p45")
    alpha, matrix = noisy(made, true_stiffness(made), 5, "equal", 1e-4)
    k, random = np.array(matrix.stiffness), np.random.default_rng(2)
    k[BAD] *= random.uniform(0.3, 3.0, (12, 1))
    return replace(matrix, stiffness=k), alpha


def check(found, alpha, out):
    assert np.flatnonzero(np.isnan(found.alpha)).tolist() == out.tolist()
    left = np.delete(np.arange(len(alpha)), out)
    scale = alpha[left].mean() if found.scale == "mean 1" else 1.0
    off = found.alpha[left] - alpha[left] / scale
    chi2 = off @ np.linalg.pinv(found.covariance[np.ix_(left, left)], rcond=1e-9) @ off
    assert chi2 / left.size < 1.8
    assert np.median(found.error[left] / alpha[left]) < 0.03


def test_of_a_matrix_those_excluded_push_nothing_and_the_others_are_right(spoilt):
    matrix, alpha = spoilt
    ids = matrix.layout.id[BAD]
    check(tn.calibrate(matrix, "ml", exclude=ids), alpha, BAD)
    off = replace(matrix.layout, enabled=~np.isin(np.arange(45), BAD))
    excluded = tn.calibrate(matrix, "svd", exclude=ids)
    disabled = tn.calibrate(replace(matrix, layout=off), "svd")
    np.testing.assert_array_equal(excluded.alpha, disabled.alpha)


def test_without_noise_those_left_are_exact(spoilt):
    """States in which the excluded push nothing are states of the mirror (Guyan)."""
    made = measured_or_made("p45")
    exact, alpha = true_stiffness(made), spoilt[1]
    matrix = replace(made, stiffness=exact / alpha[:, None])
    found = tn.calibrate(matrix, "svd", exclude=matrix.layout.id[BAD])
    left = np.delete(np.arange(45), BAD)
    assert found.alpha[left] == pytest.approx(alpha[left] / alpha[left].mean(), rel=1e-7)


def test_of_a_campaign_its_force_stays_in_the_balance():
    campaign, truth = campaign_of(seed=5, noise=1e-4)
    alpha = truth[: campaign.layout.n]
    whole, found = tn.calibrate(campaign), tn.calibrate(campaign, exclude=[3, 7])
    out = np.flatnonzero(np.isin(campaign.layout.id, [3, 7]))
    check(found, alpha, out)
    left = ~np.isin(np.arange(len(alpha)), out)
    np.testing.assert_array_equal(found.alpha[left], whole.alpha[left])
    assert rms_z(whole, alpha) < 1.6


def test_an_actuator_that_is_stuck_can_be_excluded_and_an_unknown_one_is_refused():
    campaign, _ = campaign_of(seed=5, noise=1e-4)
    dead = np.arange(campaign.layout.n) == 4
    cycles = tuple(replace(c, force=np.where(dead, 0.0, c.force)) for c in campaign.cycles)
    found = tn.calibrate(tn.Campaign(cycles), exclude=[int(campaign.layout.id[4])])
    assert np.isnan(found.alpha[4])
    with pytest.raises(UnknownName, match="actuator 99; IDs run from 1"):
        tn.calibrate(campaign, exclude=[99])


def test_excluded_are_kept_and_so_is_an_interrupted_answer(inside, spoilt, tmp_path, monkeypatch):
    matrix, _ = spoilt
    tn.write_stiffness(matrix, tmp_path / "k.fits")
    ids = ",".join(map(str, matrix.layout.id[BAD]))
    words = ("calibrate", tmp_path / "k.fits", "--method", "svd", "--exclude", ids)
    assert "(12 disabled)" in inside.prints(*words, "-o", tmp_path / "alpha.fits")
    back = tn.read(tmp_path / "alpha.fits")
    assert np.flatnonzero(~back.layout.enabled).tolist() == BAD.tolist()
    monkeypatch.setattr(reciprocity_of_matrix, "fit_matrix", Mock(side_effect=KeyboardInterrupt))
    out = inside("calibrate", tmp_path / "k.fits", "--exclude", ids)[1]
    assert re.search(r"\(12 disabled\)(?s:.*)not from reciprocity: the fit was interrupted", out)
