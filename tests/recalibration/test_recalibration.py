"""After a part was replaced: a short run gives the new alpha, and tells who else has moved."""

import dataclasses
import json
from functools import cache

import numpy as np
import pytest

import truenewton as tn
from helpers.tracked import NOISE, campaign_at, drawn, pattern, quiet_cycles, scaled
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, UnknownName
from truenewton.statics.load import Load
from truenewton.tracking.days import covariances

NEW = 16  # place of actuator 17


def replaced(*pairs):
    factor = np.ones(45)
    for place, value in pairs or ((NEW, 0.8),):
        factor[place] = value
    return factor


def earlier(random, scale=0.0):
    """Return an earlier calibration with errors of its own."""
    reading_covariance = covariances(pattern(), np.ones(45, dtype=bool))[0]
    off = np.linalg.cholesky(reading_covariance) @ random.standard_normal(45)
    return scaled(pattern(), (quiet_cycles()[1] + off) * (1 + scale), temperature=20.0)


def wrong_ring():
    """Return by how much too large alpha comes out with the ring of the bench, as declared."""
    from helpers.balanced import p45_bench

    bench = p45_bench()
    return bench.loads[1].added / bench.truth.added[1] - 1


def short(factor, random, **options):
    return campaign_at(factor, random, **{"cycles": 1, "loads": 1, **options})


@cache
def bound(factor=0.8):
    """Return the Cramer-Rao bound of the new alpha: every shape written out, and the prior."""
    [cycle] = [c for c in quiet_cycles(1)[0] if c.load.name == "bare"]
    layout, alpha = cycle.layout, quiet_cycles()[1] * replaced((NEW, factor))
    a = np.array([layout.nz, layout.x, layout.y])
    inverse = np.linalg.inv((a * alpha) @ (a * alpha).T * NOISE**2)
    information = np.zeros((48, 48))
    for c in cycle.force / replaced((NEW, factor)):
        j = np.hstack([a * c, np.diag([1.0, 1.0, -1.0])])
        information += j.T @ inverse @ j
    others = np.flatnonzero(np.arange(45) != NEW)
    at = np.ix_(others, others)
    information[at] += np.linalg.inv(covariances(pattern(), np.ones(45, dtype=bool))[0][at])
    return np.sqrt(np.linalg.inv(information)[NEW, NEW])


def test_one_cycle_under_one_load_gives_the_new_alpha_at_the_bound():
    off, alarms = [], 0
    for seed in range(25):
        random = np.random.default_rng(seed)
        made = tn.recalibrate(short(replaced(), random), earlier(random), [17])
        c = made.calibration
        off.append((c.alpha[NEW] - 0.8 * quiet_cycles()[1][NEW]) / bound())
        assert c.statistical_error[NEW] == pytest.approx(bound(), rel=0.1)
        alarms += bool(made.moved)
        assert (c.scale, made.asked) == ("given", (17,))
        assert made.probability > 1e-4
    assert 10.5 < np.sum(np.square(off)) < 46.9  # chi2 of 25 degrees, 99.5 % each way
    assert alarms <= 1


def test_the_error_of_the_earlier_scale_stays_common():
    random = np.random.default_rng(3)
    before = earlier(random)
    after = tn.recalibrate(short(replaced(), random), before, [17]).calibration
    relative = before.systematic_error / before.alpha
    assert after.systematic_error / after.alpha == pytest.approx(relative, rel=1e-6)
    share = after.systematic_covariance[:45, :45] / np.outer(after.alpha, after.alpha)
    assert share == pytest.approx(np.full((45, 45), relative[0] ** 2), rel=1e-6)
    # P + B is in proportion to alpha; the weight P itself comes besides.
    p, b = after.weight, after.bias_force
    error = np.hypot(relative[0] * (p + b), after.weight_error)
    assert np.sqrt(after.systematic_covariance[45, 45]) == pytest.approx(error, rel=1e-6)
    assert np.hypot(after.statistical_error, after.systematic_error) == pytest.approx(
        np.sqrt(np.diag(after.covariance)[:45]), rel=1e-9
    )


@pytest.mark.parametrize("asked", [(17,), ()])
def test_who_changed_unannounced_is_found_and_given_anew(asked):
    random = np.random.default_rng(5)
    factor = replaced((NEW, 0.8), (30, 1 + 8 * bound()))
    made = tn.recalibrate(short(factor, random), earlier(random), asked)
    found = {one.actuator for one in made.moved}
    assert found == ({31} if asked else {17, 31})
    assert all(one.probability < 0.01 for one in made.moved)
    assert {one.actuator: one.sigmas > 0 for one in made.moved}[31]
    c, truth = made.calibration, quiet_cycles()[1] * factor
    for place in (NEW, 30):
        assert abs(c.alpha[place] - truth[place]) < 4 * c.statistical_error[place]
    assert made.probability > 1e-3  # of those who stayed


def test_a_bad_row_is_no_moved_actuator():
    random = np.random.default_rng(7)
    run = short(replaced(), random)
    force = run.cycles[0].force.copy()
    force[10, 4] += 0.05
    run = tn.Campaign((dataclasses.replace(run.cycles[0], force=force),))
    made = tn.recalibrate(run, earlier(random))
    assert {one.actuator for one in made.moved} == {17}
    assert [row.row for row in made.calibration.rejected_rows] == [10]


@pytest.mark.parametrize("declared", [True, False])
def test_noise_comes_from_the_fit_where_nothing_declares_it(declared):
    random = np.random.default_rng(8)
    run = short(replaced(), random)
    if not declared:
        run = tn.Campaign((dataclasses.replace(run.cycles[0], force_error=None),))
    c = tn.recalibrate(run, earlier(random), [17]).calibration
    assert c.noise == pytest.approx(NOISE, rel=0.1)
    # 3 equations a shape less B, two torques, the new alpha, and what the prior leaves open.
    # 90 groups; 45 shapes and the statics, half of which no shape tells, where noise is known.
    rows = 46 if declared else 90
    assert 3 * rows - 4 - 20 < c.goodness.degrees_of_freedom <= 3 * rows - 4


def test_two_loads_with_the_same_ring_fix_no_new_scale():
    random = np.random.default_rng(9)
    before = earlier(random, scale=wrong_ring())
    made = tn.recalibrate(short(replaced(), random, loads=2), before, [17])
    assert abs(wrong_ring()) > 2e-3
    assert made.probability > 0.01
    assert made.calibration.scale == "weights"
    assert made.moved == ()
    assert made.calibration.statistical_error[NEW] < bound()
    relative = made.calibration.systematic_error / made.calibration.alpha
    assert relative == pytest.approx(before.systematic_error / before.alpha, rel=1e-6)


def test_another_ring_that_disagrees_within_its_error_moves_nobody():
    random = np.random.default_rng(10)
    run = short(replaced(), random, loads=2)
    other = [
        dataclasses.replace(c, load=Load("ring B", -0.289, 0.005, tool="ring B"))
        if c.load.added
        else c
        for c in run.cycles
    ]
    scale = wrong_ring() + 0.017
    made = tn.recalibrate(tn.Campaign(tuple(other)), earlier(random, scale=scale), [17])
    assert made.moved == ()
    assert made.probability > 1e-3
    ratio = made.calibration.alpha / (quiet_cycles()[1] * replaced())
    assert ratio.mean() == pytest.approx(1 + scale, abs=2e-3)


def test_a_warm_run_beside_a_cold_calibration():
    """All alphas change alike: two loads need to know; and a law takes it into account."""
    random = np.random.default_rng(11)
    k = np.full(45, -1.1e-3)
    warm = short(replaced() * (1 + 8 * k), random, loads=2, temperature=28.0)
    made = tn.recalibrate(warm, earlier(random, scale=wrong_ring()), [17])
    assert made.moved == ()
    assert "was taken at 20.0 deg C and the run at 28.0" in made.limits[0]
    assert made.calibration.temperature == 20.0
    ratio = made.calibration.alpha / (quiet_cycles()[1] * replaced())
    # Not 8.8e-3 off, as 8 K would put it.
    assert ratio.mean() == pytest.approx(1 + wrong_ring(), abs=4e-3)

    law = tn.track(*drawn(2, np.random.default_rng(1).normal(-1.1e-3, 2e-4, 45)))
    for temperature in (23.0, 28.0):
        truth = law.alpha_at(temperature).alpha * replaced() / quiet_cycles()[1]
        warm = short(truth, random, temperature=temperature, days=40.0)
        made = tn.recalibrate(warm, law, [17])
        assert made.moved == ()
        assert made.calibration.temperature == pytest.approx(temperature)
        assert len(made.limits) == (temperature > 25.0)
        assert all("the tracking file covers only 12.0 to 24.0" in one for one in made.limits)


def test_an_actuator_without_an_earlier_calibration_is_new():
    random = np.random.default_rng(12)
    before = earlier(random)
    alpha = np.where(np.arange(45) == NEW, np.nan, before.alpha)
    layout = dataclasses.replace(before.layout, enabled=np.isfinite(alpha))
    before = dataclasses.replace(before, alpha=alpha, layout=layout)
    made = tn.recalibrate(short(replaced(), random), before)
    assert made.asked == (17,)
    assert made.moved == ()


def test_what_came_out_is_the_prior_of_the_next_run(tmp_path):
    random = np.random.default_rng(13)
    first = tn.recalibrate(short(replaced(), random), earlier(random), [17]).calibration
    first.write(tmp_path / "first.fits")
    factor = replaced((NEW, 0.8), (3, 0.9))
    made = tn.recalibrate(short(factor, random), tmp_path / "first.fits", [4])
    assert made.moved == ()
    c = made.calibration
    assert abs(c.alpha[3] - 0.9 * quiet_cycles()[1][3]) < 4 * c.statistical_error[3]
    assert c.systematic_error / c.alpha == pytest.approx(
        first.systematic_error / first.alpha, rel=1e-6
    )


def test_what_cannot_be_recalibrated_is_refused():
    random = np.random.default_rng(14)
    run, before = short(replaced(), random), pattern()

    def refused(error, words, *given):
        with pytest.raises(error, match=words):
            tn.recalibrate(*given)

    refused(UnknownName, "no actuator 99", run, before, [99])
    refused(CampaignMismatch, "of OTHER", run, dataclasses.replace(before, instrument="OTHER"))
    elsewhere = dataclasses.replace(before.layout, x=before.layout.x + 1e-3)
    refused(CampaignMismatch, "other actuators", run,
            dataclasses.replace(before, layout=elsewhere))  # fmt: skip
    refused(FormatError, "contains no scale", run, dataclasses.replace(before, scale="mean 1"))
    refused(RankDeficient, "23 of 45 actuators are new", run, before, range(1, 24))
    few = np.arange(90) < 2
    less = tn.Campaign((dataclasses.replace(run.cycles[0], valid=few),))
    refused(RankDeficient, "too few shapes", less, before, [17, 18, 19])
    matrix = tn.StiffnessMatrix("P45", run.cycles[0].date, before.layout, np.eye(45))
    refused(FormatError, "stiffness matrix", tn.Campaign(run.cycles, matrix), before, [17])
    everyone = short(random.uniform(0.7, 1.1, 45), random)
    refused(RankDeficient, "disagree with", everyone, before)


@pytest.fixture
def files(tmp_path):
    random = np.random.default_rng(15)
    earlier(random).write(tmp_path / "alpha.fits")
    tn.write_campaign(short(replaced((NEW, 0.8), (30, 1.05)), random).cycles, tmp_path / "after")
    return tmp_path / "after", tmp_path / "alpha.fits"


def test_the_command_writes_an_ordinary_calibration(inside, files, tmp_path):
    after, alpha = files
    code, out, err = inside("recalibrate", after, "--known", alpha, "--actuators", "17", "-o",
                            tmp_path / "new.fits")  # fmt: skip
    assert (code, err) == (0, "")
    for words in ("-20.", "replaced", "CHANGED", "31 ", "the earlier calibration",
                  "they agree", "written"):  # fmt: skip
        assert words in out, words
    made = tn.read(tmp_path / "new.fits")
    assert (made.method, made.scale) == ("ml, recalibrated", "given")
    assert inside("info", tmp_path / "new.fits")[0] == 0
    code, out, _ = inside("recalibrate", after, "--known", alpha, "--actuators", "auto", "--json")
    values = json.loads(out)
    assert {one["actuator"] for one in values["moved"]} == {17, 31}
    assert values["asked"] == []
    assert len(values["earlier"]) == 45
    for known, named, said in (
        (alpha, "x", "there is no actuator x; IDs run"),
        (after / "bare-001.fits", "17", "is not a calibration"),
    ):
        assert said in inside.refuses("recalibrate", after, "--known", known, "--actuators", named)
