"""Reciprocity against a likelihood written out with all of K, and against statistics."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import START, changed, p45_bench, p45_campaign
from helpers.json_output import checked
from helpers.reciprocal import measured, random_stiffness, random_values, small_places
from studies.joint_bound import BruteForce, shifted
from studies.simulated_matrices import by_glass, by_plate, drawn
from studies.simulated_matrices import measured as with_noise
from truenewton.bench.simulated.static import static_bench
from truenewton.calibration.methods import calibrate
from truenewton.calibration.summary import detail_lines
from truenewton.errors import (
    CampaignMismatch,
    NotConverged,
    RankDeficient,
    TrueNewtonWarning,
    UnknownName,
)
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.reciprocity import campaign as reciprocity_of_campaign
from truenewton.estimation.reciprocity import iteration
from truenewton.estimation.reciprocity.information import information, score
from truenewton.estimation.reciprocity.iteration import fit, point_at
from truenewton.estimation.reciprocity.matrix import modes_of
from truenewton.estimation.reciprocity.regression import (
    Regressed,
    condensed_regression,
    kept_places,
    odd_actuators,
)
from truenewton.estimation.reciprocity.sensor_model import (
    Kind,
    Request,
    Values,
    places_of,
    sensors_at,
)
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.mirrors.known import mmt336, p45, ring
from truenewton.mirrors.sensor_model import puck_motion, sensor_model
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.records.file import write_campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import comparable_arms
from truenewton.statics.layout import rings

ALL = Request(1.0, 1.0)  # asked for: alpha, gains and offsets


def noisy_stiffness(seed, level, *, flat=False, gain=0.02, offset=5e-4):
    """Return places, what is true, a regressed stiffness with noise, and the true one."""
    random = np.random.default_rng(seed)
    places = small_places(flat=flat)
    n = places.n
    true = random_stiffness(random, places)
    values = random_values(random, n, offset)
    values = replace(values, log_gain=gain * values.log_gain / 0.02)
    exact = measured(places, values, true)
    readings = random.standard_normal((n, 40))
    square = readings @ readings.T
    noise = level**2 * (np.diag(random.uniform(0.5, 1.5, n)) + 0.1 * exact @ exact.T)
    half = np.linalg.inv(np.linalg.cholesky(square))
    error = np.linalg.cholesky(noise) @ random.standard_normal((n, n)) @ half
    return places, values, Regressed(exact + error, square, noise), true


@cache
def p45_motion():
    return sensor_model(p45(), p45().layout)


def by_a_glass(places):
    """Return places with some model of the glass that has nothing of a plate."""
    random, n = np.random.default_rng(6), places.n
    motion = np.eye(n) + 0.1 * random.standard_normal((n, n))
    changes = random.standard_normal((5, n, n)) * np.array([1, 1, 30, 30, 30])[:, None, None]
    return replace(places, motion=motion, changes=changes)


@pytest.mark.parametrize("model", [replace, by_a_glass])
def test_slopes_are_derivatives_of_displacements_by_offsets(model):
    places = model(small_places())
    values = random_values(np.random.default_rng(0), places.n)
    z = np.random.default_rng(1).standard_normal(places.n)
    seen = sensors_at(places, values, slopes=True)
    for kind, slopes in zip((Kind.X, Kind.Y), seen.slopes, strict=True):
        for j in (0, 7):
            step = 1e-7 * (np.arange(places.n) == j)
            up, down = (
                sensors_at(places, shifted(values, s * step, [kind]), slopes=True).motion @ z
                for s in (1, -1)
            )
            expected = seen.motion[:, j] * (slopes @ z)[j]
            np.testing.assert_allclose((up - down) / 2e-7, expected, rtol=1e-5, atol=1e-5)


def test_readings_of_a_rigid_plate_are_exact():
    places = small_places()
    values = random_values(np.random.default_rng(0), places.n)
    dx, dy = values.offset
    seen = sensors_at(places, values, slopes=True)
    read = 1.0 + 2.0 * (places.x - dx) - 3.0 * (places.y - dy)
    np.testing.assert_allclose(seen.motion @ read, 1 + 2 * places.x - 3 * places.y, rtol=1e-10)
    np.testing.assert_allclose(seen.slopes[0] @ read, 2.0, rtol=1e-9)


@pytest.mark.parametrize("every_block", [False, True])
def test_score_and_information_are_those_of_the_full_likelihood(every_block):
    # At any noise without the block of rigid motions, whose terms in t itself are left out, and the
    # nine numbers that bias magnets may change; with it at little.
    level = 1e-4 if every_block else 3e-2
    places, values, stiffness, _ = noisy_stiffness(1, level, flat=True)
    n, kinds = places.n, list(ALL.kinds)
    unit = np.concatenate([np.ones(2 * n), np.full(2 * n, 1e-2)])
    random = np.random.default_rng(2)
    here = shifted(values, 0.3 * level * unit * random.standard_normal(4 * n), kinds)
    point = point_at(places, here, ALL, stiffness.states)
    columns = np.linalg.cholesky(stiffness.square)
    if not every_block:
        columns = point.states.readings
        point.weights.rigid[:] = 0.0
    rows = np.linalg.inv(np.linalg.cholesky(stiffness.noise))
    brute = BruteForce(places, stiffness.stiffness, rows, columns, slopes=True)
    gradient = brute.gradient(here, kinds, 1e-2 * level * unit)
    wanted = brute.information(here, kinds, 1e-4 * unit)
    got = information(point)[0]
    both = unit[:, None] * unit
    assert np.abs(unit * (score(point) - gradient)).max() < 1e-4 * np.abs(unit * gradient).max()
    assert np.abs(both * (got - wanted)).max() < 1e-6 * np.abs(both * wanted).max()


@pytest.mark.parametrize(("spread", "offset"), [(np.inf, 0.0), (0.02, 5e-4)])
def test_errors_reach_the_bound_and_intervals_cover(spread, offset):
    asked, squares, bounds, inside = Request(spread, offset), [], [], []
    for seed in range(30):
        gain = 0.02 if spread else 0.0
        places, values, stiffness, true = noisy_stiffness(
            seed, 1e-3, flat=True, gain=gain, offset=offset
        )
        n, found = places.n, fit(places, asked, stiffness.states)
        error = found.values.log_alpha - values.log_alpha
        error -= error.mean()
        stated = np.sqrt(np.diag(found.covariance_of(Kind.ALPHA)))
        squares.append(np.mean(error**2))
        inside.append(np.mean(np.abs(error) < 1.96 * stated))
        if seed < 4:
            kinds = list(asked.kinds)
            step = np.concatenate(
                [np.full(n, 1e-4 if k in "log alpha log g" else 1e-6) for k in kinds]
            )
            rows = np.linalg.inv(np.linalg.cholesky(stiffness.noise))
            columns = np.linalg.cholesky(stiffness.square)
            brute = BruteForce(places, measured(places, values, true), rows, columns, bool(offset))
            known = brute.information(values, kinds, step) + np.diag(asked.information(n))
            mean = np.eye(n) - 1.0 / n
            bound = mean @ np.linalg.pinv(known, rcond=1e-13, hermitian=True)[:n, :n] @ mean
            bounds.append(np.trace(bound) / n)
            np.testing.assert_allclose(np.mean(stated**2), bounds[-1], rtol=0.1)
    # 30 x 13 numbers: their rms is known to 4 %, the bound scatters from mirror to mirror.
    assert np.sqrt(np.mean(squares) / np.mean(bounds)) == pytest.approx(1.0, abs=0.25)
    assert 0.92 < np.mean(inside) < 0.98


def relative_error(calibration, truth):
    error = np.log(calibration.alpha / truth)
    return float(np.std(error))


def test_a_campaign_with_position_gives_better_alpha_and_sensors(tmp_path):
    campaign, truth = p45_campaign(), p45_bench().truth
    by_balance, made = calibrate(campaign), calibrate(campaign, "reciprocity")
    assert relative_error(made, truth.alpha) < 0.6 * relative_error(by_balance, truth.alpha)
    assert made.method == "reciprocity"
    # The weights fix the scale as ever.
    np.testing.assert_allclose(
        np.median(made.systematic_error / made.alpha),
        np.median(by_balance.systematic_error / by_balance.alpha),
        rtol=1e-3,
    )
    assert np.median(made.statistical_error) < 0.6 * np.median(by_balance.statistical_error)
    gain = np.log([sensor.gain for sensor in made.sensors])
    stated = np.array([sensor.gain_error for sensor in made.sensors])
    assert np.std(gain - np.log(truth.sensor_gain)) < 2.0 * np.sqrt(np.mean(stated**2))
    made.write(tmp_path / "alpha.fits")
    again = tn.read(tmp_path / "alpha.fits")
    assert again.sensors == made.sensors
    assert again.verdict == made.verdict
    assert any(row.startswith("  sensors") for row in detail_lines(made))


def test_readings_of_annuli_fit_with_a_model_of_the_glass():
    bench = p45_bench()
    motion = puck_motion(bench.glass)
    work = motion.T @ bench.glass.stiffness
    assert np.abs(work - work.T).max() < 1e-9 * np.abs(work).max()
    screened = screen_campaign(p45_campaign())
    with_model, without = (
        reciprocity_of_campaign.fit_campaign(screened, motion),
        reciprocity_of_campaign.fit_campaign(screened),
    )
    assert with_model.goodness.probability > 1e-3
    assert with_model.goodness.chi2 < without.goodness.chi2


def asymmetry_of_work(places, values, stiffness):
    """Return |T - T'| / |T + T'| of all readings, at the values."""
    moved = sensors_at(places, values, slopes=True).motion * values.gain
    work = moved.T @ (values.alpha[:, None] * stiffness)
    return np.linalg.norm(work - work.T) / np.linalg.norm(work + work.T)


def test_offset_annuli_are_exact_with_a_model_of_the_glass():
    """To first order also where the sensors of some actuators that are left free go with them."""
    glass, layout = p45_bench().glass, p45_bench().mirror.layout
    motion, keep = p45_motion(), ~np.isin(np.arange(layout.n), [3, 20])
    values = drawn(np.random.default_rng(3), layout.n, offset=5e-4)
    exact = by_glass(glass, values)
    less = condensed(exact, keep)[0]
    others = Values(values.log_alpha[keep], values.log_gain[keep], values.offset[:, keep])
    (by_model, of_kept), (by_plate_alone, of_kept_by_plate) = (
        (
            asymmetry_of_work(places, values, exact),
            asymmetry_of_work(kept_places(places, keep, exact), others, less),
        )
        for places in (places_of(layout, motion), places_of(layout, motion[0]))
    )
    assert by_model < 3e-5 < 3e-3 < by_plate_alone
    assert of_kept < 5e-4 < 3e-3 < of_kept_by_plate
    # A sensor as wide as its puck touches it when it moves: then the plate tells of places.
    alike = replace(p45(), puck_radius=8e-3)
    assert sensor_model(alike, layout).shape == (1, layout.n, layout.n)


@pytest.mark.study
def test_errors_cover_offset_annuli_only_with_a_model_of_the_glass():
    glass, layout = p45_bench().glass, p45_bench().mirror.layout
    rows = []
    for seed in range(3):
        random = np.random.default_rng([seed, 11])
        values = drawn(random, layout.n, offset=5e-4)
        made = with_noise(random, by_glass(glass, values), values, 1e-3, np.inf)
        square = (made.readings / made.level**2) @ made.readings.T
        known = Regressed(made.stiffness, square, np.eye(layout.n))
        for seen in (p45_motion(), p45_motion()[0]):
            found = fit(places_of(layout, seen), Request(0.004, 5e-4), known.states, start=values)
            error = found.values.log_alpha - values.log_alpha
            error -= error.mean()
            stated = np.sqrt(np.diag(found.covariance_of(Kind.ALPHA)))
            rows.append([np.mean(error**2 / stated**2), np.mean(np.abs(error) < 1.96 * stated)])
    by_model, by_plate_alone = np.mean(np.reshape(rows, (3, 2, 2)), axis=0)
    assert by_model[0] < 1.4 < 3.0 < by_plate_alone[0]
    assert by_plate_alone[1] < 0.75 < 0.9 < by_model[1]


def test_auto_uses_ml_if_positions_are_missing_or_exchanged():
    campaign = p45_campaign(cycles=2)
    bare = changed(campaign, position=None)
    with pytest.raises(RankDeficient, match="POSITION"):
        calibrate(bare, "reciprocity")
    order = np.arange(45)
    order[5:25] = order[5:25].reshape(-1, 2)[:, ::-1].ravel()  # ten pairs exchanged
    wrong = changed(campaign, position=lambda _, c: c.position[:, order])
    made = calibrate(wrong, "auto")
    assert made.method == "ml"
    assert any("reciprocity" in each.fault for each in made.verdict.notes)
    np.testing.assert_array_equal(made.alpha, calibrate(wrong).alpha)
    np.testing.assert_array_equal(calibrate(bare, "auto").alpha, calibrate(bare).alpha)


def plate_matrix(seed, *, gain=0.004, noise=30.0, offset=5e-4):
    """Return a matrix as P45 may measure it, and its alpha; the glass bends as a plate here."""
    random, bench = np.random.default_rng(seed), p45_bench()
    layout, n = bench.mirror.layout, bench.mirror.layout.n
    values = Values(
        random.normal(0.0, 0.05, n), random.normal(0.0, gain, n), random.normal(0, offset, (2, n))
    )
    stiffness = bench.glass.stiffness
    kc = measured(places_of(layout), values, 0.5 * (stiffness + stiffness.T))
    left, size, right = np.linalg.svd(kc)
    error = noise * random.standard_normal((n, n)) * np.sqrt(size / size[-4])
    matrix = StiffnessMatrix("P45", START, layout, kc + left @ error @ right)
    return matrix, values.alpha


def test_errors_cover_if_soft_modes_are_below_the_noise():
    # Were it shared by halves, the error would be half as large again and a fifth left uncovered.
    mirror, errors, stated, inside = ring(114), [], [], []
    stiffness = model_shell(mirror).stiffness
    for seed in range(3):
        random = np.random.default_rng([seed, 3])
        values = drawn(random, 114)
        exact = by_plate(mirror.layout, stiffness, values, offsets=False)
        k = with_noise(random, exact, values, 0.02).stiffness
        modes = modes_of(mirror.layout, MatrixFacts(k, comparable_arms(mirror.layout)))
        found = modes.fit(Request(0.004, estimated=True))
        error = found.values.log_alpha - values.log_alpha
        error -= error.mean()
        errors.append(np.mean(error**2))
        stated.append(np.diag(found.covariance_of(Kind.ALPHA)))
        inside.append(np.mean(np.abs(error) < 1.96 * np.sqrt(stated[-1])))
    assert np.sqrt(np.mean(errors) / np.mean(stated)) == pytest.approx(1.0, abs=0.2)
    assert 0.9 < np.mean(inside) < 0.99


def test_a_matrix_with_a_block_of_dead_sensors_is_refused_as_by_ml():
    matrix, _ = plate_matrix(0)
    stiffness, random = matrix.stiffness.copy(), np.random.default_rng(5)
    stiffness[:, 10:20] = stiffness[:, 10:20] @ random.standard_normal((10, 10))
    for method in ("ml", "auto", "reciprocity"):
        with pytest.raises(RankDeficient, match="10 of 45 actuators do not fit the others"):
            calibrate(replace(matrix, stiffness=stiffness), method)


def test_a_sensor_that_reads_a_mixture_is_free_and_its_actuator_kept():
    matrix, alpha = plate_matrix(1)
    mixture = np.eye(45)
    mixture[7] = 0.3 * np.random.default_rng(1).standard_normal(45)
    wrong = matrix.stiffness @ np.linalg.inv(mixture)
    np.testing.assert_array_equal(odd_actuators(matrix.stiffness), [])
    np.testing.assert_array_equal(odd_actuators(wrong), [7])
    made = calibrate(replace(matrix, stiffness=wrong), "reciprocity")
    assert [sensor.state for sensor in made.sensors].count("free") == 1
    assert made.sensors[7].state == "free"
    assert (8,) in [each.actuators for each in made.verdict.faults]
    others = np.arange(45) != 7
    assert np.std(np.log(made.alpha / alpha)[others]) < 0.5 * np.std(alpha)


@pytest.mark.study
def test_nearly_all_sensors_that_read_mixtures_are_found():
    found = 0
    for seed in range(30):
        mixture = np.eye(45)
        mixture[7] = 0.3 * np.random.default_rng(seed).standard_normal(45)
        wrong = plate_matrix(seed)[0].stiffness @ np.linalg.inv(mixture)
        found += odd_actuators(wrong).tolist() == [7]
    assert found >= 27


def test_no_false_positives_among_hundreds_of_actuators():
    """Factors of neighbours add up over many of them: they must have settled."""
    stiffness = static_bench(mmt336(), 1).truth.stiffness
    random, n = np.random.default_rng(0), len(stiffness)
    alpha = np.exp(0.1 * random.standard_normal(n))
    measured = stiffness / alpha[:, None] * (1.0 + 1e-4 * random.standard_normal((n, n)))
    assert odd_actuators(measured).tolist() == []


def test_noise_of_a_condensed_stiffness_is_that_of_its_elements():
    random = np.random.default_rng(4)
    places, _, stiffness, _ = noisy_stiffness(5, 1e-3)
    keep = ~np.isin(np.arange(places.n), [3, 9])
    less = condensed_regression(stiffness, keep)
    half = np.linalg.inv(np.linalg.cholesky(stiffness.square))
    size, drawn = 1e-3 * np.linalg.cholesky(stiffness.noise), []
    for _ in range(2000):
        error = size @ random.standard_normal((places.n, places.n)) @ half
        drawn.append(condensed(stiffness.stiffness + error, keep)[0] - less.stiffness)
    scatter = np.var(drawn, axis=0)
    wanted = 1e-6 * np.outer(np.diag(less.noise), np.diag(np.linalg.inv(less.square)))
    np.testing.assert_allclose(scatter, wanted, rtol=0.25)


def test_options_of_other_methods_are_refused():
    with pytest.raises(UnknownName, match="ml does not use"):
        calibrate(p45_campaign(), "ml", motion=np.eye(45))
    with pytest.raises(CampaignMismatch, match="actuators of P45"):
        sensor_model(p45_bench().mirror, rings([0.06, 0.1], [5, 9]))
    with pytest.raises(UnknownName, match="population"):
        calibrate(p45_campaign(), "reciprocity", population=True)


def test_auto_uses_ml_if_ml_corrects_a_drift():
    """All alphas fall by 1 % from one load to the other: 1 % or more of the common scale."""
    campaign = p45_campaign()
    hours = np.array([(c.date - campaign.cycles[0].date).total_seconds() for c in campaign.cycles])
    slower = 1.0 + 0.01 * hours / hours.max()
    drifting = changed(campaign, force=lambda k, c: c.force * slower[k])
    by_balance, auto = calibrate(drifting), calibrate(drifting, "auto")
    assert by_balance.effects[0].corrected
    assert auto.method == "ml"
    np.testing.assert_array_equal(auto.alpha, by_balance.alpha)
    [note] = auto.verdict.notes
    assert note.cause.values["effect"].startswith(by_balance.effects[0].name)
    assert auto.verdict.faults == by_balance.verdict.faults
    with pytest.warns(TrueNewtonWarning, match="doubtful: Found: gain by"):
        forced = calibrate(drifting, "reciprocity")
    assert not any(effect.corrected for effect in forced.effects)


def test_auto_uses_ml_if_noise_is_shared_by_many_actuators():
    campaign, random = p45_campaign(), np.random.default_rng(1)
    noise = 1e-3 * campaign.layout.nz
    shared = changed(
        campaign,
        force=lambda _, c: c.force + np.outer(random.standard_normal(len(c.force)), noise),
    )
    made = calibrate(shared, "auto")
    assert made.method == "ml"
    assert any(each.cause.code == "shared-noise" for each in made.verdict.notes)


def test_every_command_uses_reciprocity_with_a_model_of_the_glass(inside, tmp_path):
    campaign = p45_campaign()
    assert calibrate(campaign).method == "ml"
    write_campaign(campaign.cycles, tmp_path / "day")
    asked = (tmp_path / "day", "--mirror", "p45")
    assert checked(inside("calibrate", *asked, "--json")[1])["method"] == "reciprocity"
    page = tmp_path / "page.html"
    assert inside("report", *asked, "-o", page)[0] == 0
    text = page.read_text()
    assert "--mirror p45" in text
    assert "Sensor gains" in text or "sensor gain" in text
    err = inside.refuses("info", *asked, "--method", "ml")
    assert "ml does not use what the sensors read" in err


def test_ml_is_advised_only_if_it_was_not_used(monkeypatch):
    campaign = p45_campaign(cycles=2)
    monkeypatch.setattr(iteration, "MAX_STEPS", 1)
    with pytest.raises(NotConverged, match="or use ml"):
        calibrate(campaign, "reciprocity")
    made = calibrate(campaign, "auto")
    assert made.method == "ml"
    assert "reciprocity has not settled" in str(made.verdict.notes)
    assert "use ml" not in str(made.verdict.notes)
