"""Scatter from day to day: estimated, allowed for, and nobody's fault."""

import dataclasses
import json

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.stats

import truenewton as tn
from helpers.tracked import (
    MEAN_K,
    SPREAD_K,
    TEMPERATURES,
    campaign_at,
    drawn,
    pattern,
    quiet_cycles,
)
from truenewton.errors import RankDeficient
from truenewton.recalibration.summary import lines as lines_of_run
from truenewton.tracking.days import covariances, gather_days, named
from truenewton.tracking.lines import Scatter, estimate_scatter, expanded, relative_days
from truenewton.tracking.summary import lines

K = np.random.default_rng(11).normal(MEAN_K, SPREAD_K, 45)
ALL = np.ones(45, dtype=bool)
NOISE = 1e-4


def scattered(seed, own=0.0, common=0.0):
    """Return days that scatter: each actuator in its own way, and all alike."""
    random = np.random.default_rng([7, seed])
    days = drawn(seed, K, 0.0, gap=30.0, noise=NOISE)
    made = []
    for day in days:
        factor = (1 + own * random.standard_normal(45)) * (1 + common * random.standard_normal())
        made.append(dataclasses.replace(day, alpha=day.alpha * factor))
    return made


# The estimate


@pytest.mark.parametrize("common", [True, False])
def test_equal_days_have_no_scatter(common):
    found = estimate_scatter(
        np.zeros((2, 10)), np.array([1e-8 * np.eye(10)] * 2), np.eye(10), ALL[:10], common=common
    )
    assert (found.own, found.common) == (0.0, 0.0)


def test_scatter_is_where_the_restricted_likelihood_of_all_days_is_largest():
    """Against the density of contrasts of all days in one matrix, turned at random."""
    days = gather_days(map(named, scattered(3, own=3e-4, common=5e-4)))
    settings = np.column_stack([np.array(TEMPERATURES) - 18.0, 0.1 * np.arange(6) - 0.25])
    found = estimate_scatter(
        *relative_days(days, ALL, settings).contrasts(), np.eye(45), ALL, common=True
    )

    alpha = np.array([day.calibration.alpha for day in days])
    mean = alpha.mean(axis=0)
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    off = scipy.linalg.null_space(np.column_stack([np.ones(6), settings]).T) @ turn
    y = (off.T @ (alpha / mean)).ravel()
    readings = [covariances(d.calibration, ALL)[0] / np.outer(mean, mean) for d in days]
    known = np.kron(off.T, np.eye(45)) @ scipy.linalg.block_diag(*readings)
    known = known @ np.kron(off, np.eye(45))

    def less_likely(variances):
        of_days = variances[0] * np.eye(45) + variances[1] * np.ones((45, 45))
        whole = known + np.kron(np.eye(3), 1e-7 * of_days)
        factor = np.linalg.cholesky(whole)
        return np.log(np.diag(factor)).sum() + 0.5 * np.sum(np.linalg.solve(factor, y) ** 2)

    best = scipy.optimize.minimize(less_likely, [1.0, 2.0], method="Nelder-Mead",
                                   bounds=[(0, None), (0, None)])  # fmt: skip
    assert [found.own**2, found.common**2] == pytest.approx(1e-7 * best.x, rel=1e-2)
    assert found.degrees == 3


def test_actuators_that_changed_are_no_scatter():
    y = np.random.default_rng(2).normal(0.0, 1e-3, (3, 60))
    covariance = np.array([1e-8 * np.eye(60)] * 3)
    everyone = np.ones(60, dtype=bool)
    clean = estimate_scatter(y, covariance, np.eye(60), everyone, common=False)
    y[:, :9] += 0.02
    found = estimate_scatter(y, covariance, np.eye(60), everyone, common=False)
    assert clean.own == pytest.approx(1e-3, rel=0.15)
    assert found.own == pytest.approx(clean.own, rel=0.15)
    # 51 actuators and 3 contrasts, of a variance that is nearly all scatter.
    assert found.degrees_of(found.own**2) == pytest.approx(3 * 51, rel=0.05)


def test_few_degrees_of_freedom_widen_as_student_does():
    assert 1.959964 * expanded(1.0, 3) == pytest.approx(scipy.stats.t.isf(0.025, 3))
    assert expanded(1.0, 0) == 1.0
    assert Scatter(own=1.0).degrees_of(2.0) == np.inf


# In track


def test_scatter_of_days_names_nobody_and_is_told():
    own, common = 3e-4, 3e-3
    found = [tn.track(*scattered(seed, own, common)) for seed in range(8)]
    assert sum(bool(one.outliers) for one in found) == 0  # 8 of 8 without the estimate
    each = np.sqrt(np.mean([one.scatter[0] ** 2 for one in found]))
    assert each == pytest.approx(own, rel=0.1)
    together = np.sqrt(np.mean([one.common_scatter**2 for one in found]))
    # 24 degrees of freedom, beside 0.02 % by the readings
    assert together == pytest.approx(common, rel=0.4, abs=3e-4)
    said = " ".join(lines(found[0], None))
    assert "scatter of days" in said
    assert "(3 degrees of freedom)" in said
    assert "limit: " not in said


@pytest.mark.study
def test_a_prediction_covers_a_new_day_with_its_scatter():
    inside, truth = [], quiet_cycles()[1]
    for seed in range(12):
        random = np.random.default_rng([8, seed])
        law = tn.track(*scattered(seed, own=1e-3, common=1e-3))
        for temperature in (13.0, 22.0):
            day = (1 + 1e-3 * random.standard_normal(45)) * (1 + 1e-3 * random.standard_normal())
            at = law.alpha_at(temperature)
            error = np.sqrt(np.diag(at.covariance - at.systematic_covariance))
            off = at.alpha - truth * (1 + K * (temperature - 18.0)) * day
            inside.append(np.mean(np.abs(off) < 1.96 * error))
    # Of one law all hang together: 24 draws of its common part at 95 %.
    assert 0.90 < np.mean(inside) < 0.99


def test_two_replaced_actuators_do_not_hide_each_other():
    days = scattered(4, own=5e-4)
    factor = np.where(np.isin(np.arange(45), [3, 29]), 0.97, 1.0)
    days[2:4] = [dataclasses.replace(day, alpha=day.alpha * factor) for day in days[2:4]]
    found = tn.track(*days)
    assert {one.actuator for one in found.outliers} == {4, 30}
    assert found.scatter[[3, 29]].min() > 10 * found.scatter[0]  # each has its own
    assert found.scatter[0] == pytest.approx(5e-4, rel=0.25)


def test_days_that_leave_nothing_over_say_that_scatter_is_not_told():
    found = tn.track(*scattered(5, own=1e-3)[:2])
    assert found.scatter_degrees == 0
    assert found.outliers == ()
    assert "2 calibrations determine only the 2 unknowns of each line" in found.limits[-1]
    assert "assumed to be zero" in found.limits[-1]
    found = tn.track(*scattered(5, own=1e-3)[:4])
    assert "has only 1 degree of freedom" in found.limits[-1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (0.01 * np.random.default_rng(3).standard_normal(45), "each actuator differently"),
        (np.array(0.03), "all actuators alike: check its weights"),
    ],
)
def test_a_day_off_the_law_of_the_others_is_named(change, said):
    days = scattered(6, own=1e-4)
    days[4] = dataclasses.replace(days[4], alpha=days[4].alpha * (1 + change))
    found = tn.track(*days)
    [limit] = found.limits
    assert limit.startswith(
        f"P45 of {days[4].date:%Y-%m-%d} differs from the law of the other days"
    )
    assert said in limit
    size = float(limit.split(" by ")[1].split(" %")[0])
    assert size == pytest.approx(100 * np.sqrt(np.mean(change**2)), rel=0.3)
    assert found.outliers == ()
    quiet = tn.track(*days[:4], days[5])
    assert np.median(found.errors[1] / quiet.errors[1]) == pytest.approx(1, rel=0.3)
    assert tn.track(*days[:4], days[5]).limits[1:] == ()


def test_scatter_comes_back_from_the_file_and_from_files_without_it(inside, tmp_path):
    from astropy.io import fits

    found = tn.track(*scattered(1, own=1e-3, common=1e-3))
    found.write(tmp_path / "t.fits")
    back = tn.read_tracking(tmp_path / "t.fits")
    assert np.array_equal(back.scatter, found.scatter)
    assert (back.common_scatter, back.scatter_degrees) == (found.common_scatter, 3)
    assert np.array_equal(back.alpha_at(15.0).error, found.alpha_at(15.0).error)
    with fits.open(tmp_path / "t.fits") as hdus:
        columns = [c for c in hdus["TRACKING"].columns if c.name != "SCATTER"]
        hdus["TRACKING"] = fits.BinTableHDU.from_columns(columns, name="TRACKING")
        del hdus[0].header["SCATTER"], hdus[0].header["SCATDOF"]
        hdus.writeto(tmp_path / "old.fits", checksum=True)
    old = tn.read_tracking(tmp_path / "old.fits")
    assert old.scatter.max() == old.common_scatter == old.scatter_degrees == 0
    assert (old.alpha_at(15.0).error < found.alpha_at(15.0).error).all()


# In recalibrate


def run_and_known(seed, drift):
    """Return a run after 17 was replaced, the calibration before, and what the others changed."""
    random = np.random.default_rng([9, seed])
    factor = 1 + drift * random.standard_normal(45)
    factor[16] = 0.8
    root = np.linalg.cholesky(covariances(pattern(NOISE), ALL)[0])
    known = dataclasses.replace(
        pattern(NOISE), alpha=quiet_cycles()[1] + root @ random.standard_normal(45),
        temperature=20.0,
    )  # fmt: skip
    run = campaign_at(factor, random, cycles=1, loads=1, noise=NOISE)
    return run, known, factor


@pytest.mark.study
def test_others_that_drifted_a_little_name_nobody_and_the_new_alpha_is_covered():
    off, scatter, named = [], [], 0
    for seed in range(12):
        run, known, factor = run_and_known(seed, 1e-3)
        made = tn.recalibrate(run, known, [17])
        error = made.calibration.statistical_error[16]
        off.append((made.calibration.alpha[16] - quiet_cycles()[1][16] * factor[16]) / error)
        scatter.append(made.scatter)
        named += bool(made.moved)
    assert named <= 1
    assert np.sqrt(np.mean(np.square(scatter))) == pytest.approx(1e-3, rel=0.15)
    assert 3.1 < np.sum(np.square(off)) < 28.3  # chi2 of 12 degrees, 99.5 % each way
    assert "each of the other actuators has changed by 0." in made.limits[0]
    assert "each changed by" in " ".join(lines_of_run(made))


def test_a_verdict_of_a_short_run_tells_that_the_others_changed(inside, tmp_path):
    run, known, _ = run_and_known(1, 1e-3)
    known.write(tmp_path / "known.fits")
    tn.write_campaign(run.cycles, tmp_path / "run")
    code, out, err = inside("recalibrate", tmp_path / "run", "--known", tmp_path / "known.fits",
                            "--actuators", "17", "-o", tmp_path / "new.fits", "--json")  # fmt: skip
    assert (code, err) == (0, "")
    assert json.loads(out)["others"]["scatter"] == pytest.approx(1e-3, rel=0.3)
    verdict = tn.read(tmp_path / "new.fits").verdict
    assert verdict.level == "usable"
    assert any("other actuators has changed by" in each.fault for each in verdict.faults)


def test_others_that_all_changed_by_much_are_no_prior():
    run, known, _ = run_and_known(3, 0.08)
    with pytest.raises(RankDeficient, match=r"each has changed by \S+ %.* calibrate all again"):
        tn.recalibrate(run, known, [17])
