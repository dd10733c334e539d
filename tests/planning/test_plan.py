"""What `truenewton plan` predicts, against closed forms, explicit Jacobians and calibrations."""

import datetime
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.acquisition_plans import write_shapes
from helpers.balanced import arms_of, campaign_of, noisy, three_loads
from studies.accuracy import information_of
from studies.joint_bound import BruteForce
from truenewton.acquisition.plan import (
    AssumedSensors,
    CampaignPlan,
    PlannedShapes,
    model_glass,
    read_plan,
    shapes_and_forces,
    template,
)
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.estimate import FROM_READINGS, tilt_as_load, typical
from truenewton.estimation.reciprocity.sensor_model import Kind, Request, at_nominal, places_of
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.mirrors.known import p45
from truenewton.mirrors.sensor_model import sensor_model
from truenewton.planning.figures import plot_plan
from truenewton.planning.forces import holding, noiseless, prepared_bodies, strain
from truenewton.planning.plan_prediction import (
    predict_errors,
    predict_prepared,
    suggest_changes,
    with_sensors,
)
from truenewton.planning.prediction import predict
from truenewton.planning.summary import detail_lines, lines
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

LOADS = (Load("bare"), Load("ring", -0.289, 0.005, tool="ring"))
PLAN = CampaignPlan("p45", LOADS)


@pytest.fixture(scope="module")
def ready():
    return prepared_bodies(PLAN)[0]


def declared(campaign, noise):
    """Return the first cycle of each load, with its noise declared."""
    first = {c.load.key: c for c in campaign.cycles[::-1]}
    return Campaign(tuple(replace(c, force_error=noise) for c in first.values()))


def fisher(campaign, truth, noise, cycles):
    """Return the information on alpha, B and torques, from explicit Jacobians."""
    a = arms_of(campaign.layout)
    n, loads = a.shape[1], len(campaign.loads)
    beside = np.zeros((len(campaign.cycles), 3, 1 + 2 * loads))
    for derivative, place in zip(beside, campaign.load_index, strict=True):
        derivative[[0, 1, 2], [0, 1 + 2 * place, 2 + 2 * place]] = 1.0, 1.0, -1.0
    forces = [cycle.force for cycle in campaign.cycles]
    return cycles * information_of(a, truth[:n], noise, forces, beside)


def test_against_little_noise_the_errors_are_the_bound_of_cramer_and_rao():
    quiet, truth = campaign_of(3, 0.0, cycles=1)
    noise, n = 1e-6, quiet.layout.n
    one = declared(quiet, noise)
    found = predict(one, campaign_moments(one), 5, truth[:n])
    bound = np.linalg.inv(fisher(one, truth, noise, 5))[:n, :n]
    assert found.reading_covariance == pytest.approx(
        bound, rel=1e-5, abs=1e-6 * np.abs(bound).max()
    )
    assert found.diagnosis.undetermined == 0
    assert found.diagnosis.warnings == ()


@pytest.mark.study
def test_what_is_stated_and_what_scatters_is_what_was_predicted():
    """At a noise so large that what it feigns counts, and the plain bound is too small."""
    bench = static_bench(
        replace(p45(), weight_error=0.0), 1, loads=(Load("bare"), Load("ring", -0.289)),
        force_noise=0.0,
    )  # fmt: skip
    quiet, alpha, noise = Campaign(tuple(run_cycles(bench, 4))), bench.truth.alpha, 1.2e-2
    one = declared(quiet, noise)
    # Pooled over loads and signs, as its rows will be: what noise feigns is less by half.
    found = predict(one, replace(campaign_moments(one), pooled=True), 4, alpha)
    truth = np.concatenate([alpha, np.zeros(5)])
    bound = np.sqrt(np.diag(np.linalg.inv(fisher(one, truth, noise, 4)))[:45])
    answers = [tn.calibrate(noisy(quiet, noise, seed)) for seed in range(60)]
    stated = np.mean([c.statistical_error for c in answers], axis=0)
    scatter = np.sqrt(np.mean([(c.alpha - alpha) ** 2 for c in answers], axis=0))
    assert stated == pytest.approx(found.statistical_error, rel=0.03)
    assert np.median(scatter / found.statistical_error) == pytest.approx(1.0, abs=0.1)
    assert np.median(found.statistical_error / bound) > 1.01
    unpooled = predict(one, campaign_moments(one), 4, alpha)
    assert np.median(unpooled.statistical_error / bound) > 1.05


def test_a_planned_day_at_the_simulated_bench_gives_what_was_predicted(ready):
    found = predict_errors(ready)
    bench = replace(static_bench(p45(), 5, loads=LOADS), shapes=ready.shapes)
    calibration = tn.calibrate(Campaign(tuple(run_cycles(bench, PLAN.cycles))))
    assert typical(calibration.statistical_error, calibration.alpha) == pytest.approx(
        typical(found.statistical_error, found.alpha), rel=0.05
    )
    assert typical(calibration.error, calibration.alpha) == pytest.approx(found.typical, rel=0.01)
    each = (calibration.error / calibration.alpha) / (found.error / found.alpha)
    assert each == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(
    "sensors",
    [pytest.param(AssumedSensors(gain=0.0, offset=0.0), marks=pytest.mark.study), AssumedSensors()],
)
def test_of_reciprocity_the_bound_is_predicted(ready, sensors):
    """Relative alpha, all of K unknown; within 3 %: of K the parts that magnets change are left."""
    plan = replace(PLAN, force_noise=1e-3, sensors=sensors)
    found = with_sensors(ready.changed(plan), [plan.cycles]).planned
    n, glass = 45, model_glass(p45())
    places = places_of(p45().layout, sensor_model(p45(), p45().layout))
    stiffness = glass.stiffness / 0.9
    square = 2 * 2 * plan.cycles * ready.shapes.T @ ready.shapes
    rows = 1e-6 * np.eye(n) + sensors.noise**2 * stiffness @ stiffness.T
    brute = BruteForce(places, stiffness, np.linalg.inv(np.linalg.cholesky(rows)),
                       np.linalg.cholesky(square), slopes=bool(sensors.offset))  # fmt: skip
    asked = Request(sensors.gain, sensors.offset)
    step = {Kind.ALPHA: 1e-4, Kind.GAIN: 1e-4, Kind.X: 1e-6, Kind.Y: 1e-6}
    steps = np.repeat([step[kind] for kind in asked.kinds], n)
    known = brute.information(at_nominal(n), list(asked.kinds), steps)
    known += np.diag(asked.information(n))
    known[:n, :n] += np.trace(known[:n, :n]) / n**2
    mean = np.eye(n) - 1.0 / n
    bound, relative = (
        np.sqrt(np.diag(mean @ covariance @ mean))
        for covariance in (np.linalg.inv(known)[:n, :n], found.reading_covariance / 0.9**2)
    )
    assert relative == pytest.approx(bound, rel=0.03)


@pytest.mark.study
def test_reciprocity_states_and_scatters_as_was_predicted(ready):
    plan = replace(PLAN, force_noise=1e-3, sensors=AssumedSensors(offset=0.0))
    said = with_sensors(ready.changed(plan), [plan.cycles])
    found = said.planned
    mean, motion = np.eye(45) - 1.0 / 45, sensor_model(p45(), p45().layout)
    stated, gains, squares = [], [], []
    for seed in range(8):
        bench = static_bench(p45(), seed, loads=LOADS, force_noise=1e-3)
        bench = replace(bench, shapes=ready.shapes)
        campaign = Campaign(tuple(run_cycles(bench, plan.cycles)))
        made = tn.calibrate(campaign, "reciprocity", motion=motion)
        stated.append(made.statistical_error / made.alpha)
        gains.append([sensor.gain_error for sensor in made.sensors])
        squares.append((mean @ np.log(made.alpha / bench.truth.alpha)) ** 2)
    error = found.statistical_error / found.alpha
    assert np.mean(stated) == pytest.approx(np.mean(error), rel=0.03)
    assert np.mean(gains) == pytest.approx(np.mean(said.gain_error), rel=0.03)
    relative = np.diag(mean @ found.reading_covariance @ mean) / found.alpha**2
    # 8 x 44 numbers, but of few patterns that are weak.
    assert np.sqrt(np.mean(squares) / np.mean(relative)) == pytest.approx(1.0, abs=0.12)
    # The weights limit the scale as ever.
    assert found.systematic_error == pytest.approx(predict_errors(ready).systematic_error)


def test_without_all_motions_there_is_no_reciprocity(ready):
    few = prepared_bodies(replace(PLAN, shapes=PlannedShapes(count=30)))[0]
    found = predict_prepared(few)
    assert found.reciprocity.planned is None
    assert found.reciprocity.why_not == "no shape contains 15 of 45 motions of the mirror"
    assert f"  by reciprocity          not possible: {found.reciprocity.why_not}" in [
        *detail_lines(found)
    ]


def test_three_loads_whose_weights_can_correct_each_other():
    quiet, noise = three_loads(4, 0.0), 1e-4
    one = declared(quiet, noise)
    alpha = tn.calibrate(quiet).alpha
    found = predict(one, campaign_moments(one), 2, alpha)
    answer = tn.calibrate(noisy(quiet, noise, 1))
    assert found.error == pytest.approx(answer.error, rel=0.02)
    assert found.statistical_error == pytest.approx(answer.statistical_error, rel=0.1)
    for predicted_line, line in zip(found.scale_errors[:3], answer.scale_errors, strict=False):
        assert predicted_line.source == line.source
        assert predicted_line.relative == pytest.approx(line.relative, rel=0.02)


@pytest.mark.parametrize("tilt", [20.0, 60.0])
def test_a_tilt_as_the_load(ready, tilt):
    """With coils known to 5 um: their gains, and the bias magnets, change the scale as well."""
    shift, mirror = {"coil_shift": 3e-6, "coil_shift_error": 5e-6}, p45()
    leaning = (Load("bare"), Load("tilted", tilt=tilt, tilt_error=0.1, **shift))
    found = predict_errors(ready.changed(replace(PLAN, loads=leaning)))
    nz, lost = mirror.layout.nz.sum(), mirror.weight * (1 - np.cos(np.radians(tilt)))
    held = mirror.weight - lost + mirror.bias_force * nz
    by_shift = mirror.coil_gradient * held - mirror.bias_gradient * nz
    expected = np.hypot(
        tilt_as_load(mirror.weight, mirror.weight_error, tilt, 0.1), 5e-6 * by_shift / lost
    )
    weights = [line.relative for line in found.scale_errors if line.source != FROM_READINGS]
    assert np.linalg.norm(weights) == pytest.approx(expected, rel=1e-3)


def test_repeats_make_it_better_as_their_root(ready):
    against = predict_prepared(ready).against_cycles
    assert against.values.tolist() == [1, 2, 4, 8, 16, 32, 64]
    assert against.statistical_error == pytest.approx(
        against.statistical_error[0] / np.sqrt(against.values), rel=1e-3
    )


def test_one_load_or_equal_ones_leave_the_scale_free(ready):
    for loads in ((Load("bare"),), (Load("bare"), Load("again"))):
        found = predict_errors(ready.changed(replace(PLAN, loads=loads)))
        assert found.scale_is_free
        assert found.typical == np.inf
        assert found.diagnosis.warnings[0].code in ("one-load", "equal-loads")
        # Patterns are known all the same: about as well as under two loads.
        assert 0.5 < typical(found.statistical_error, found.alpha) / 3.7e-4 < 2.0


def test_too_few_shapes_are_refused_and_weak_ones_warned_of(ready):
    few = replace(PLAN, shapes=PlannedShapes(count=8))
    with pytest.raises(RankDeficient, match="too few shapes: 8 for 45"):
        predict_errors(prepared_bodies(few)[0])
    loud = predict_errors(ready.changed(replace(PLAN, force_noise=0.15)))
    assert loud.diagnosis.undetermined > 4
    assert loud.diagnosis.warnings[0].code == "planned-refusal"
    # The estimator says the same of such a campaign.
    bench = static_bench(p45(), 5, loads=LOADS, force_noise=1e-4)
    bench = replace(bench, shapes=ready.shapes, force_noise=0.15)
    with pytest.raises(RankDeficient):
        tn.calibrate(Campaign(tuple(run_cycles(bench, PLAN.cycles))))


def test_every_way_that_reaches_the_target_does_when_planned_anew(ready):
    # Weak loads and loud readings, so that every change counts; 'shapes' and 'cycles' too.
    plan = replace(PLAN, force_noise=9e-3, limits=replace(PLAN.limits, force=1.5))
    loud = ready.changed(plan)
    target = 0.025
    assert predict_errors(loud).typical > target
    changes = {change.what: change for change in suggest_changes(loud, target)}
    assert set(changes) == {"cycles", "added weight", "weighing", "tilt", "shapes"}
    reached = [change for change in changes.values() if change.reached]
    assert {change.what for change in reached} >= {"cycles", "shapes"}
    for change in reached:
        again = predict_prepared(prepared_bodies(change.plan)[0])
        assert again.prediction.typical <= target
        assert again.prediction.typical == pytest.approx(change.error, rel=1e-6)
        assert again.duration == pytest.approx(change.duration)
    more = changes["cycles"].plan
    fewer = replace(more, cycles=more.cycles - 1)
    assert predict_errors(loud.changed(fewer)).typical > target
    assert not changes["weighing"].reached
    assert changes["weighing"].error > target


def test_weighing_or_a_tilt_help_and_cycles_do_not(ready):
    changes = {change.what: change for change in suggest_changes(ready, 0.005)}
    assert [name for name, change in changes.items() if change.reached] == ["weighing", "tilt"]
    known = changes["weighing"].plan.loads[1].added_error
    assert 0.9 < known / (0.005 * 0.289) <= 1.0
    assert changes["cycles"].error == pytest.approx(0.005 / 0.289, rel=1e-3)
    # The heaviest weight is what the limit of force allows.
    heavier = replace(changes["added weight"].plan, loads=(LOADS[0], replace(LOADS[1], added=-1.5)))
    assert strain(ready.changed(changes["added weight"].plan)).force <= 0.6
    with pytest.raises(tn.errors.LimitExceeded, match=r"actuator \d+ takes 0.\d+ N under load"):
        strain(ready.changed(heavier))
    bare = suggest_changes(ready.changed(replace(PLAN, loads=LOADS[:1])), 0.005)
    assert [change.reached for change in bare] == [False, False, False, True, False]
    assert bare[1].plan is None


def test_shapes_of_a_measured_matrix_or_given_ones(tmp_path, ready):
    alpha = np.where(np.arange(45) % 2, 0.8, 1.0)
    stiffness = static_bench(p45(), 1).truth.stiffness / alpha[:, None]
    date = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    matrix = StiffnessMatrix("P45", date, p45().layout, stiffness)
    tn.write_stiffness(matrix, tmp_path / "ff.fits")
    plan = replace(PLAN, shapes=PlannedShapes("ff.fits", stroke=0.8e-6))
    modes, force, _ = shapes_and_forces(plan, p45(), tmp_path)
    assert force == pytest.approx(modes @ matrix.stiffness.T)
    assert np.abs(modes).max() == pytest.approx(0.8e-6)
    assert np.abs(force).max() == pytest.approx(0.3)
    by_measured = prepared_bodies(plan, tmp_path)[0]
    assert not by_measured.given
    assert predict_errors(by_measured).typical == pytest.approx(
        predict_errors(ready).typical, rel=0.01
    )

    write_shapes(tmp_path / "given.fits", 0.5 * ready.shapes)
    given = prepared_bodies(replace(PLAN, shapes=PlannedShapes("given.fits")), tmp_path)[0]
    assert given.given
    half, whole = predict_errors(given), predict_errors(ready)
    # Twice, but for what the static forces say of alpha.
    assert half.statistical_error == pytest.approx(1.85 * whole.statistical_error, rel=0.08)
    assert suggest_changes(given, 1e-4)[-1].plan is None
    for wrong, said in (
        (np.zeros((45, 45)), "no more than noise"),
        (ready.shapes[:, 1:], "give shapes x 45 actuators"),
        (np.full((45, 45), np.nan), "SHAPES contains NaN"),
    ):
        write_shapes(tmp_path / "given.fits", wrong)
        with pytest.raises((RankDeficient, tn.errors.FormatError), match=said):
            predict_errors(prepared_bodies(given.plan, tmp_path)[0])


def test_disabled_actuators_take_no_part(ready):
    mirror = p45()
    on = ~np.isin(np.arange(45), (3, 30))
    layout = Layout(mirror.layout.id, mirror.layout.x, mirror.layout.y, mirror.layout.nz, on)
    mirror = replace(mirror, layout=layout)
    shapes, force, _ = shapes_and_forces(PLAN, mirror)
    assert shapes.shape == (43, 45)
    assert (shapes[:, ~on] == 0).all()
    assert (force[:, ~on] == 0).all()
    assert np.abs(force[:, on] @ arms_of(layout)[:, on].T).max() < 1e-9
    glass = model_glass(mirror)
    own, tool = holding(glass)
    some = replace(
        ready, mirror=mirror, glass=glass, shapes=shapes, force=force, own=own, tool=tool
    )
    found = predict_errors(some)
    assert found.error.shape == (43,)
    assert found.typical == pytest.approx(0.005 / 0.289, rel=0.01)
    balance = noiseless(some).cycles[0].used_force @ arms_of(layout)[:, on].T * 0.9
    assert balance[:, 0] == pytest.approx(2.920 - 0.097 * layout.nz[on].sum())


def test_planned_shapes_keep_to_stroke_and_force(ready):
    shapes = shapes_and_forces(PLAN, p45())[0]
    assert shapes == pytest.approx(ready.shapes)
    assert len(shapes_and_forces(replace(PLAN, shapes=PlannedShapes(count=7)), p45())[0]) == 7
    largest = np.maximum(
        np.abs(ready.shapes).max(axis=1) / 1e-6, 0.9 * np.abs(ready.force).max(axis=1) / 0.3
    )
    assert largest == pytest.approx(1.0)


# The command.


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(template())
    return path


def test_the_template_is_a_plan_that_predicts(inside, tmp_path, file):
    plan = read_plan(file)
    # What it shows is what is taken when left out, but for the turns.
    assert plan == replace(PLAN, turns=3)
    code, out, _ = inside("plan", "--new")
    assert (code, out) == (0, template())
    other = tmp_path / "other.toml"
    assert inside("plan", "--new", "-o", other)[:2] == (0, f"written: {other}\n")
    assert other.read_text() == template()
    assert "exists already" in inside.refuses("plan", "--new", "-o", other)
    assert inside("plan", "--new", "-o", other, "--overwrite")[0] == 0
    out = inside.prints("plan", file, "--verbose")
    for words in (
        "P45, predicted: 45 actuators, 4 cycles of 45 shapes and their negatives under 2 loads",
        "typical error of alpha  1.7 %",
        "weight of 'ring' 1.7 %",
        "720 rows, 3 load changes of 30 min",
        "smallest gap            67 um",
        "limit 0.6 N",
    ):
        assert words in out
    assert "warning: " not in out
    assert "smallest stroke" not in out


def test_shapes_below_the_noise_of_sensors_are_predicted(ready):
    """If `acquire` would report noise as an actuator that is not at its place."""
    strokes = np.abs(ready.shapes).max(axis=1)
    for border in (0.99 * strokes.min(), np.median(strokes)):
        sensors = replace(PLAN.sensors, noise=border / 60)  # six times that are a tenth of it
        said = "\n".join(lines(predict_prepared(ready.changed(replace(PLAN, sensors=sensors)))))
        small = np.count_nonzero(strokes < border)
        assert (f"as a fault in {small} of 45 shapes" in said) == (small > 0)
        assert (f"{1e9 * strokes.min():.3g} nm" in said) == (small > 0)


def test_what_the_command_says_a_script_can_read(inside, file, tmp_path):
    figure = tmp_path / "plan.png"
    out = inside.prints("plan", file, "--json", "--target", "0.005", "--plot", figure)
    values = json.loads(out)
    found = predict_errors(prepared_bodies(PLAN)[0])
    assert values["typical_error"] == pytest.approx(found.typical)
    assert values["actuators"]["e_alpha"] == pytest.approx(found.error)
    reciprocity = values["reciprocity"]
    assert reciprocity["cycles"]["cycles"] == [1, 2, 4, 8, 16, 32, 64]
    assert reciprocity["cycles"]["e_stat"][2] == reciprocity["typical_e_stat"]
    assert reciprocity["typical_e_stat"] < 0.75 * values["typical_e_stat"]
    assert len(reciprocity["actuators"]["e_gain"]) == 45
    assert values["largest_force"] < 0.6
    assert values["curves"]["cycles"]["cycles"] == [1, 2, 4, 8, 16, 32, 64]
    assert values["curves"]["added_factor"]["added_factor"][:4] == [0.25, 0.5, 1, 2]
    assert [change["reached"] for change in values["ways"]] == [False, False, True, True, False]
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "exists already" in inside("plan", file, "--plot", figure)[2]


def test_for_a_target_it_says_what_to_change(inside, file):
    out = inside("plan", file, "--target", "0.005")[1]
    assert "to reach 0.50 %, change one of these:" in out
    assert re.search(r"weighing +'ring' ± 1\.\d+ mN: 0\.\d+ %, 92 min", out)
    known = r"coil displacement ± 5 um: 0\.\d+ %, 3\.1 h"
    assert re.search(rf"tilt +a load tilted by \d+ ± 0\.1 deg, {known}", out)
    assert "999 cycles: 1.7 %, not sufficient" in out
    assert "the plan reaches 2.0 %" in inside("plan", file, "--target", "0.02")[1]


def test_a_free_scale_is_a_warning(inside, file):
    file.write_text(template().replace("added = -0.289 ", "added = 0.0 "))
    out = inside.prints("plan", file, "--target", "0.01")
    assert "common scale            free" in out
    assert "The 2 loads have the same weight, so the common scale is not determined" in out
    assert "a free scale, not sufficient" in out


def test_the_figure_has_two_panels_with_the_plan_on_its_curve(ready):
    found = predict_prepared(ready)
    first, second = plot_plan(found, 0.005).figure.axes
    assert first.get_xlabel() == "cycles"
    assert second.get_xlabel() == "added weight (N)"
    total, dot = first.lines[0], first.lines[3]
    assert total.get_ydata() == pytest.approx(100 * found.against_cycles.error)
    assert dot.get_xydata().tolist() == [[4, pytest.approx(100 * found.prediction.typical)]]
    assert second.lines[3].get_xdata()[0] == pytest.approx(0.289)
    bare = predict_prepared(ready.changed(replace(PLAN, loads=LOADS[:1])))
    assert len(plot_plan(bare).figure.axes) == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('mirror = "p45"', "", "lacks 'mirror'; add it"),
        ('mirror = "p45"', 'mirror = "nobody"', "no mirror is called 'nobody'; the known ones"),
        ("cycles = 4", "cycles = 0", "cycles is 0; give 1 to 999"),
        ("cycles = 4", "cycles = 4.0", "cycles is 4.0; give an integer"),
        ("cycles = 4", "cyclse = 4", "knows no 'cyclse'; did you mean 'cycles'?"),
        ("cycles = 4", "cycles = ", "is not TOML"),
        ("settling = 0.15", "settling = 1e300", "give zero or more, to 1e+09"),
        ("force_noise = 1e-4 ", "force_noise = 1e-320", "give a positive number, 1e-12 to"),
        ("stroke = 1e-6", "stroke = 6e-6", "shapes.stroke is 6e-06, beyond its limit of 5e-06"),
        ("force = 0.3", "force = 0.59", "N under load 'ring', beyond its limit of 0.6; plan"),
        ("gap = 30e-6", "gap = 67.5e-6", "gap closes to 6.7e-05 m, beyond its limit of 6.75e-05"),
        ("[-10.0, 40.0]", "[40.0, -10.0]", "limits.temperature is [40.0, -10.0]; put the lowest"),
        ('source = "modes"', 'source = "no.fits"', "no.fits: "),
        ('name = "ring"', 'name = "Bare"', "list each load once, with its own name"),
        ('name = "ring"', 'name = " "', "load ' ': LOAD is blank; name the load"),
        ('name = "ring"', 'name = "r\\u001b[31m"', "is not allowed in a FITS header"),
        ("added = -0.289", "added = 0.289", "load 'ring': ADDED is 0.289 N; z points up"),
        ("added_error = 0.005", "added_error = -1", "load 'ring': E_ADDED is -1; give a standard"),
        ('tool = "ring"', "tilt = 90", "load 'ring': TILT is 90 deg; give the angle"),
        ('tool = "ring"', "tilt_error = -1", "load 'ring': E_TILT is -1; give a standard"),
        ('kind = "simulated"', 'kind = "real"', "bench.kind is 'real'; choose simulated"),
    ],
)
def test_what_is_wrong_with_a_plan_is_said_in_one_line(inside, file, old, new, said):
    assert old in template()
    file.write_text(template().replace(old, new, 1))
    err = inside.refuses("plan", file)
    assert err[:-1].isprintable()
    assert said in err
    assert ".toml: " in err or ".fits: " in err
    assert "; " in err


def test_a_plan_without_loads(inside, file):
    head = template().partition("[[loads]]")[0]
    file.write_text("loads = []\n" + head)
    assert "loads is []; list each load once" in inside("plan", file)[2]


def test_words_that_do_not_go_together(inside, file, tmp_path):
    for words in (
        ("plan",),
        ("plan", file, "--new"),
        ("plan", file, "-o", tmp_path / "x"),
        ("plan", file, "--target", "-1"),
        ("plan", file, "--target", "nan"),
        ("plan", file, "--plot", tmp_path / "x.doc"),
        ("plan", tmp_path / "none.toml"),
    ):
        code, out, err = inside(*words)
        assert (code, err.count("\n")) == (2, 1), words
        assert out == ""
