"""Wrong sensors are named, and a stiffness of the wrong size gets no modes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import p45_bench
from truenewton.bench.simulated.static import run_cycles
from truenewton.errors import NotToBeUsed
from truenewton.modal.plausibility import unlike_others
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.records.campaign import Campaign


@cache
def measured():
    bench = p45_bench()
    campaign = Campaign(tuple(run_cycles(bench, 1)))
    return bench, campaign, tn.calibrate(campaign)


def reading(factor):
    """Return the campaign with the readings of sensors times (45,) factors."""
    cycles = measured()[1].cycles
    return Campaign(tuple(replace(c, position=np.asarray(c.position) * factor) for c in cycles))


def one(factor, at=20):
    return np.where(np.arange(45) == at, factor, 1.0)


def test_the_gain_of_each_sensor_follows_from_symmetry():
    """Relative to their median: true displacement over reading, for wrong ones too."""
    bench, campaign, calibration = measured()
    factor = np.where(np.arange(45) == 3, -1.0, 1.0) * one(1.5) * one(0.2, at=21)
    matrix = tn.measured_stiffness(reading(factor)).matrix
    found = true_stiffness(matrix, calibration).column_factor
    wanted = bench.truth.sensor_gain / factor
    # Errors of alpha add to the gains.
    np.testing.assert_allclose(found, wanted / np.median(wanted), rtol=0.03)
    wrong, scatter = unlike_others(found)
    assert np.flatnonzero(wrong).tolist() == [3, 20, 21]
    assert 0.002 < scatter < 0.02
    sound = true_stiffness(tn.measured_stiffness(campaign).matrix, calibration)
    assert not unlike_others(sound.column_factor)[0].any()
    assert np.isnan(true_stiffness(matrix, None).column_factor).all()


def test_a_sound_population_is_accused_in_one_of_a_hundred():
    random = np.random.default_rng(1)
    for n in (20, 45, 672):
        alarms = [unlike_others(random.lognormal(0.0, 0.02, n))[0].any() for _ in range(2000)]
        assert np.mean(alarms) < 0.015


def test_a_reversed_sensor_gets_no_modes_and_a_wrong_gain_is_named():
    _, campaign, calibration = measured()
    with pytest.raises(NotToBeUsed, match=r"sensors with reversed sign: 21\. .*reverse the sign"):
        tn.find_modes(reading(one(-1.0)), calibration)
    found = tn.find_modes(reading(one(-1.0)), calibration, accept_rejected=True)
    assert "reversed sign: 21" in found.warnings[0].fault
    found = tn.find_modes(reading(one(1 / 1.5)), calibration)
    [warning] = found.warnings
    assert warning.fault.startswith("sensors with a wrong gain: 21 (1.")
    assert tn.find_modes(campaign, calibration).warnings == ()
    # The calibration that knows the gain corrects it, and there is nothing to name.
    gain = one(1.5)
    again = tn.find_modes(reading(one(1 / 1.5)), calibration, sensor_gain=gain)
    assert again.warnings == ()


@pytest.mark.parametrize("factor", [1e-3, 0.4, 1e3])
def test_a_stiffness_of_another_size_than_the_model_gets_no_modes(factor, tmp_path, inside):
    _, _, calibration = measured()
    tn.write_campaign(reading(np.full(45, factor)), tmp_path / "day")
    calibration.write(tmp_path / "alpha.fits")
    command = "modes", tmp_path / "day", "--calibration", tmp_path / "alpha.fits"
    err = inside.refuses(*command)
    times = {1e-3: "1000", 0.4: "2.5", 1e3: "0.0010"}[factor]
    assert f"the stiffness is {times} times that of the mirror model" in err
    assert "warning: The stiffness is" in inside.prints(*command, "--anyway")


def test_without_a_model_only_an_absurd_size_is_warned_of():
    _, campaign, calibration = measured()
    assert tn.find_modes(campaign, calibration).warnings == ()
    [warning] = tn.find_modes(reading(np.full(45, 1e-3)), calibration).warnings
    assert "1.67e+09 N/m is implausible" in warning.fault


def test_negative_modes_are_judged_by_their_size():
    """Those of bias magnets and noise are as soft as rigid motions; a larger one is an error."""
    bench, _, calibration = measured()
    layout = bench.truth.layout
    k = 0.5 * (bench.truth.stiffness + bench.truth.stiffness.T)
    modes = np.linalg.eigh(k)[1]
    for shift, warned in ((0.0, False), (-4650.0, False), (-2e4, True)):
        soft = modes[:, 3:5]
        changed = k - 31.0 * np.eye(45) + shift * soft @ soft.T
        matrix = tn.StiffnessMatrix("P45", calibration.date, layout, changed)
        same = replace(calibration, alpha=np.ones(45))
        found = tn.find_modes(matrix, same)
        told = [each.fault for each in found.warnings if "softest elastic mode" in each.fault]
        assert bool(told) == warned
    assert "-1.54e+04 N/m; bias magnets explain at most -31 N/m" in told[0]
