"""Stiffness from cycle files, in true Newtons, condensed, slaved; and how modes are compared."""

import datetime
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg

from helpers.balanced import p45_bench, ungraded
from studies.simulated_matrices import by_glass, drawn
from truenewton.bench.simulated.static import loop_of, rows_of_cycle, run_cycles, static_bench
from truenewton.calibration.methods import calibrate
from truenewton.errors import CampaignMismatch, FormatError, RankDeficient, UnknownName
from truenewton.estimation.findings.estimate import Sensor
from truenewton.estimation.matrix.misfits import condensed
from truenewton.estimation.reciprocity.sensor_model import Values, places_of, sensors_at
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.mirrors.known import lbt672, p45
from truenewton.mirrors.sensor_model import model_sensors, puck_motion
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.modal.findings import compare_modes
from truenewton.modal.measured_stiffness import measured_stiffness, motion_sums
from truenewton.modal.true_stiffness import true_stiffness
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms
from truenewton.statics.layout import Layout, rings
from truenewton.statics.modes import stiffness_modes

DATE = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)


def expected(bench):
    """Return diag(1/alpha) (K - BIASGRAD) diag(gain) of a bench's truth."""
    truth = bench.truth
    k = truth.stiffness - bench.coils.bias_gradient * np.eye(truth.layout.n)
    return k / truth.alpha[:, None] * truth.sensor_gain


def apart(found, bench):
    """Return the relative error of a measured stiffness."""
    k = expected(bench)
    return np.linalg.norm(found.matrix.stiffness - k) / np.linalg.norm(k)


def with_readings(cycles, readings):
    return Campaign(tuple(replace(cycle, position=readings) for cycle in cycles))


@cache
def quiet():
    """Return a P45 without noise or gradients, and a cycle a load with its exact readings."""
    bench = ungraded(static_bench(p45(), 3, force_noise=0.0))
    readings = rows_of_cycle(bench)[2] + bench.sensors.offset
    return bench, with_readings(run_cycles(bench, 1), readings)


# --- the measured stiffness ------------------------------------------------------------------


def test_without_noise_the_measured_stiffness_is_exact():
    bench, campaign = quiet()
    found = measured_stiffness(campaign)
    assert apart(found, bench) < 1e-11
    assert found.relative_error < 1e-6  # residuals come from sums of squares, which round
    assert (found.shapes, found.rows, found.rigid_assumed, found.rejected) == (90, 180, 0, ())
    assert np.isnan(found.misfit)  # nothing repeats
    assert found.matrix.instrument == "P45"


def test_the_bias_magnets_stay_inside_and_the_coils_law_is_taken_out():
    bench = static_bench(p45(), 3, force_noise=0.0)
    readings = rows_of_cycle(bench)[2]
    campaign = with_readings(run_cycles(bench, 1), readings)
    found = measured_stiffness(campaign)
    # Sensor gains of 0.4 % enter COILGRAD z, which is 0.06 % of the force.
    assert apart(found, bench) < 1e-6
    k, rigid = expected(bench), 1e-3 * np.linalg.norm(bench.truth.stiffness)
    assert np.linalg.norm(k + 31 * np.diag(1 / bench.truth.alpha)) > rigid
    r = 1 / bench.truth.sensor_gain
    piston = bench.truth.alpha @ found.matrix.stiffness @ r / 45
    assert piston == pytest.approx(-31.0, abs=3.0)


@pytest.mark.study
def test_the_stated_error_is_that_over_seeds():
    ratios, misfits = [], []
    for seed in range(15):
        bench = static_bench(p45(), seed)
        found = measured_stiffness(Campaign(tuple(run_cycles(bench, 2))))
        ratios.append((found.matrix.stiffness - expected(bench)) / found.error)
        misfits.append(found.misfit)
        assert apart(found, bench) == pytest.approx(found.relative_error, rel=0.25)
    # One matrix has some 300 independent errors, those of its softly held directions.
    assert np.std(ratios) == pytest.approx(1.0, abs=0.05)
    assert np.abs(ratios).max() < 6
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.05)
    # 0.1 mN of force, and 66 pm through the stiffness.
    of_position = 3e-9 / np.sqrt(2048) * np.linalg.norm(expected(bench)) / np.sqrt(45)
    assert found.residual == pytest.approx(np.hypot(1e-4, of_position), rel=0.05)


@pytest.mark.study
def test_a_closed_loop_measures_it_as_well():
    bench = static_bench(p45(), 1)
    found = measured_stiffness(Campaign(tuple(run_cycles(bench, 2, loop_of(bench)))))
    assert apart(found, bench) < 6e-4
    assert apart(found, bench) == pytest.approx(found.relative_error, rel=0.25)
    assert 0.7 < found.misfit < 1.4


@pytest.mark.study
def test_noise_of_the_sensors_does_not_soften():
    """3 nm a reading would soften it by 0.1 %, seven times what the mean of 40 seeds scatters."""
    bench = static_bench(p45(), 3)
    cycles, exact, k = tuple(run_cycles(bench, 4)), rows_of_cycle(bench)[2], expected(bench)
    softer, naive = [], []
    for seed in range(40):
        random = np.random.default_rng([8, seed])
        read = [exact + 3e-9 * random.standard_normal(exact.shape) for _ in cycles]
        campaign = Campaign(
            tuple(replace(c, position=z) for c, z in zip(cycles, read, strict=True))
        )
        softer.append(np.sum(measured_stiffness(campaign).matrix.stiffness * k) / np.sum(k * k) - 1)
        sums = motion_sums(screen_campaign(campaign))
        alike = sums.between()[0]
        plain = alike.cz @ np.linalg.inv(alike.zz)
        naive.append(np.sum(plain * k) / np.sum(k * k) - 1)
    error = np.std(naive) / np.sqrt(40)
    assert np.mean(naive) < -3 * error
    assert abs(np.mean(softer)) < 2 * error
    assert np.mean(softer) - np.mean(naive) > 2.5 * error


def test_rigid_motions_that_no_shape_holds_cost_no_force():
    """Whatever of them the other shapes hold."""
    bench, _ = quiet()
    ones = np.ones(45)
    bench = replace(
        bench,
        sensors=replace(bench.sensors, gain=ones),
        truth=replace(bench.truth, sensor_gain=ones),
    )
    random = np.random.default_rng(4)
    shape, sign, readings = rows_of_cycle(bench)
    rigid = np.linalg.qr(arms(p45().layout).T)[0]
    leak = 0.05 * np.linalg.norm(readings, axis=1).mean() * random.standard_normal((45, 3))
    readings = readings + sign[:, None] * (leak @ rigid.T)[shape - 1]
    # Rigid motions take no force here, so the same forces hold the tilted shapes.
    campaign = Campaign(
        tuple(
            replace(
                cycle,
                position=readings + 66e-12 * random.standard_normal(readings.shape),
                valid=shape > 3,
            )
            for cycle in run_cycles(bench, 1)
        )
    )
    found = measured_stiffness(campaign)
    assert found.rigid_assumed == 3
    assert np.abs(found.matrix.stiffness @ rigid).max() < 1e-6
    assert apart(found, bench) < 2e-3
    assert apart(found, bench) == pytest.approx(found.relative_error, rel=0.25)


def test_elastic_motions_that_no_shape_holds_are_refused():
    _, campaign = quiet()
    fewer = tuple(replace(c, valid=~np.isin(c.shape, (2, 10, 40))) for c in campaign.cycles)
    with pytest.raises(RankDeficient, match="2 of 42 elastic motions are missing"):
        measured_stiffness(Campaign(fewer))
    single = tuple(replace(c, valid=(c.sign > 0) & (c.shape != 20)) for c in campaign.cycles)
    with pytest.raises(RankDeficient, match="both signs"):
        measured_stiffness(Campaign(single))


def test_without_readings_there_is_no_stiffness():
    bench, campaign = quiet()
    without = tuple(replace(c, position=None) for c in campaign.cycles)
    with pytest.raises(RankDeficient, match="no cycle contains POSITION"):
        measured_stiffness(Campaign(without))
    zeros = with_readings(campaign.cycles, np.zeros((90, 45)))
    with pytest.raises(RankDeficient, match="no cycle contains POSITION"):
        measured_stiffness(zeros)
    one = measured_stiffness(Campaign((campaign.cycles[0], without[1])))
    assert one.shapes == 45
    assert apart(one, bench) < 1e-11
    assert np.isnan(one.relative_error)  # every row is needed


@cache
def spoilt():
    """Return a campaign with a spike of force, one of position and a lost row; and those marked."""
    bench = static_bench(p45(), 5)
    cycles = list(run_cycles(bench, 3))
    bad = {1: ("force", 17, 4, 0.02), 4: ("position", 33, 40, 5e-9)}
    wrong, marked = list(cycles), list(cycles)
    for k, (name, row, actuator, size) in bad.items():
        values, valid = np.array(getattr(cycles[k], name)), cycles[k].valid.copy()
        values[row, actuator] += size
        valid[row] = False
        wrong[k] = replace(cycles[k], **{name: values})
        marked[k] = replace(cycles[k], valid=valid)
    lost = np.arange(90) != 60
    wrong[2], marked[2] = replace(cycles[2], valid=lost), replace(cycles[2], valid=lost)
    return bench, Campaign(tuple(wrong)), Campaign(tuple(marked))


def test_rows_that_stand_off_from_their_repeats_are_left_out():
    bench, wrong, marked = spoilt()
    found = measured_stiffness(wrong)
    assert [(row.cycle, row.row, row.actuator) for row in found.rejected] == [
        (1, 17, 5), (4, 33, 41),
    ]  # fmt: skip
    clean = measured_stiffness(marked)
    assert np.array_equal(found.matrix.stiffness, clean.matrix.stiffness)
    assert (clean.rejected, clean.rows) == ((), 3 * 2 * 90 - 3)
    assert apart(found, bench) == pytest.approx(found.relative_error, rel=0.25)


def test_disabled_actuators_take_no_part_and_quiet_cycles_count_for_more():
    bench, campaign = quiet()
    random = np.random.default_rng(6)
    layout = campaign.layout
    on = ~np.isin(layout.id, (7, 30))
    k = expected(bench)[np.ix_(on, on)]
    layout = Layout(layout.id, layout.x, layout.y, layout.nz, on)
    noises, cycles = (1e-5, 1e-3), []
    for number, noise in enumerate(noises, 1):
        for base in campaign.cycles:
            z = np.where(on, np.asarray(base.position), 9.0)
            force = np.full(z.shape, np.nan)
            force[:, on] = z[:, on] @ k.T + 0.1 + noise * random.standard_normal((90, 43))
            cycles.append(
                replace(
                    base, number=number, layout=layout, position=z, force=force, force_error=noise
                )
            )
    found = measured_stiffness(Campaign(tuple(cycles)))
    assert not found.matrix.stiffness[~on].any()
    assert not found.matrix.stiffness[:, ~on].any()
    assert not found.matrix.layout.enabled[~on].any()
    error = found.matrix.stiffness[np.ix_(on, on)] - k
    assert np.linalg.norm(error) / np.linalg.norm(k) == pytest.approx(found.relative_error, rel=0.2)
    alone = measured_stiffness(Campaign(tuple(c for c in cycles if c.number == 1)))
    assert found.relative_error == pytest.approx(alone.relative_error, rel=0.1)


# --- in true Newtons --------------------------------------------------------------------------


@cache
def known():
    """Return a symmetric true stiffness, the matrix that measures it, gains, a calibration."""
    bench = static_bench(p45(), 2)
    k = 0.5 * (bench.truth.stiffness + bench.truth.stiffness.T) - 31 * np.eye(45)
    gain = bench.truth.sensor_gain
    calibration = calibrate(Campaign(tuple(run_cycles(bench, 2))))
    calibration = replace(calibration, alpha=bench.truth.alpha)
    measured = k / bench.truth.alpha[:, None] * gain
    return k, StiffnessMatrix("P45", DATE, p45().layout, measured), gain, calibration


def with_sensors(calibration, gain, offset=((0, 0),) * 45, state="fitted"):
    """Return a calibration that holds sensors of (45,) gains and (45, 2) offsets, last first."""
    sensors = tuple(
        Sensor(i, g, 1e-3, x, 1e-5, y, 1e-5, state)
        for i, g, (x, y) in zip(calibration.layout.id.tolist(), gain, offset, strict=True)
    )
    return replace(calibration, sensors=sensors[::-1])


def taken(layout, kept):
    return Layout(*(getattr(layout, name)[kept] for name in ("id", "x", "y", "nz", "enabled")))


def test_alpha_and_gains_give_back_the_true_stiffness():
    k, matrix, gain, calibration = known()
    found = true_stiffness(matrix, calibration, sensor_gain=gain)
    assert found.stiffness == pytest.approx(k, abs=1e-9 * np.abs(k).max())
    assert np.array_equal(found.stiffness, found.stiffness.T)
    assert found.asymmetry < 1e-14
    assert found.imbalance < 1e-12
    assert found.feed_forward_commanded == pytest.approx(
        k / calibration.alpha[:, None], abs=1e-9 * np.abs(k).max()
    )
    assert np.array_equal(found.enabled_alpha, calibration.alpha)
    modes = found.modes
    assert modes.stiffness[:3] == pytest.approx([-31.0] * 3, abs=1e-6)
    assert modes.stiffness[3] == pytest.approx(4626.0, rel=1e-3)


def test_places_of_the_sensors_that_the_calibration_knows_are_used_by_id():
    k, matrix, gain, calibration = known()
    offset = 5e-4 * np.random.default_rng(3).standard_normal((2, 45))
    values = Values(np.zeros(45), np.log(gain), offset)
    seen = sensors_at(places_of(matrix.layout), values, slopes=True).motion * gain
    moved = replace(matrix, stiffness=k @ seen / calibration.alpha[:, None])
    sighted = with_sensors(calibration, gain, offset.T)
    found = true_stiffness(moved, sighted)
    assert found.stiffness == pytest.approx(k, abs=1e-9 * np.abs(k).max())
    assert np.array_equal(found.enabled_offset, offset)
    assert found.read(seen) == pytest.approx(np.eye(45), abs=1e-9)
    by_gains = true_stiffness(moved, with_sensors(calibration, gain))
    modes = by_gains.modes.modes, found.modes.modes
    assert compare_modes(*modes, found.modes.stiffness).distance > np.radians(0.5)
    kept = np.arange(45) != 6
    some = replace(moved, layout=replace(matrix.layout, enabled=kept))
    less = true_stiffness(some, sighted)
    assert np.array_equal(less.enabled_offset, offset[:, kept])


@pytest.mark.study
@pytest.mark.parametrize("disabled", [(), (6, 20)])
def test_annuli_off_their_magnets_are_exact_where_the_glass_is_known(disabled):
    glass, calibration = p45_bench().glass, known()[-1]
    random, on = np.random.default_rng(3), ~np.isin(np.arange(45), disabled)
    values = drawn(random, 45, offset=5e-4)
    at_magnets = glass.stiffness @ np.linalg.inv(puck_motion(glass))
    k = condensed(0.5 * (at_magnets + at_magnets.T), on)[0]
    layout = replace(p45().layout, enabled=on)
    measured = np.zeros((45, 45))
    measured[np.ix_(on, on)] = condensed(by_glass(glass, values), on)[0]
    matrix = StiffnessMatrix("P45", DATE, layout, measured)
    calibration = with_sensors(
        replace(calibration, alpha=values.alpha), values.gain, values.offset.T
    )
    seen = model_sensors(glass)
    by_model, by_plate = (
        true_stiffness(matrix, calibration, motion=motion) for motion in (seen, None)
    )

    def apart_by(found):
        return np.linalg.norm(found.stiffness - k) / np.linalg.norm(k)

    # What floats bends as the plate between its neighbours, not as the shell.
    asymmetry, away = (2e-3, 1e-2) if disabled else (3e-5, 3e-5)
    assert by_model.asymmetry < asymmetry < 3e-3 < by_plate.asymmetry
    assert apart_by(by_model) < away < 0.1 < apart_by(by_plate)
    true_already = replace(matrix, displaced="true")
    again = true_stiffness(true_already, calibration, motion=seen)
    assert again.read(np.eye(on.sum())) == pytest.approx(np.eye(on.sum()))


def test_gains_that_the_calibration_knows_are_used_unless_others_are_given():
    k, matrix, gain, calibration = known()
    found = true_stiffness(matrix, with_sensors(calibration, gain))
    assert found.stiffness == pytest.approx(k, abs=1e-9 * np.abs(k).max())
    assert np.array_equal(found.enabled_gain, gain)
    without = true_stiffness(matrix, calibration)
    assert np.abs(without.stiffness - k).max() > 1e-3 * np.abs(k).max()
    said = true_stiffness(matrix, with_sensors(calibration, gain), sensor_gain=np.ones(45))
    assert np.array_equal(said.stiffness, without.stiffness)
    free = true_stiffness(matrix, with_sensors(calibration, np.full(45, np.nan), state="free"))
    assert np.array_equal(free.stiffness, without.stiffness)
    with pytest.raises(FormatError, match="not positive"):
        true_stiffness(matrix, with_sensors(calibration, -gain))


def test_alpha_is_matched_by_id():
    _, matrix, gain, calibration = known()
    turned = np.random.default_rng(1).permutation(45)
    other = replace(
        calibration,
        layout=taken(calibration.layout, turned),
        alpha=calibration.alpha[turned],
        statistical_error=calibration.statistical_error[turned],
        systematic_error=calibration.systematic_error[turned],
    )
    once, again = (true_stiffness(matrix, c, sensor_gain=gain) for c in (calibration, other))
    assert np.array_equal(once.stiffness, again.stiffness)


def test_what_couples_rigid_motions_to_the_rest_is_dropped_and_told():
    k, matrix, gain, calibration = known()
    random = np.random.default_rng(5)
    rigid = np.linalg.qr(arms(matrix.layout).T)[0]
    wrong = 2e4 * rigid @ random.standard_normal((3, 45))
    wrong -= wrong @ rigid @ rigid.T
    spoilt = replace(matrix, stiffness=(k + wrong) / calibration.alpha[:, None] * gain)
    found = true_stiffness(spoilt, calibration, sensor_gain=gain)
    assert found.stiffness == pytest.approx(k, abs=1e-9 * np.abs(k).max())
    share = np.linalg.norm(wrong + wrong.T) / np.linalg.norm(2 * k + wrong + wrong.T)
    assert found.imbalance == pytest.approx(share, rel=1e-6)
    assert found.asymmetry == pytest.approx(
        np.linalg.norm(wrong - wrong.T) / np.linalg.norm(2 * k + wrong + wrong.T), rel=1e-6
    )


def test_an_actuator_whose_row_is_unlike_its_column_is_named():
    k, matrix, gain, calibration = known()
    measured = matrix.stiffness.copy()
    measured[11] *= 1.1
    found = true_stiffness(replace(matrix, stiffness=measured), calibration, sensor_gain=gain)
    *_, other, share = np.sort(found.actuator_asymmetry)
    assert found.actuator_asymmetry.argmax() == 11
    beside = np.linalg.norm(np.delete(k[11], 11))
    assert share == pytest.approx(0.1 * beside / np.hypot(2.1 * beside, 2.2 * k[11, 11]), rel=1e-6)
    assert other < 0.7 * share


def test_actuators_that_are_off_leave_the_stiffness_of_a_mirror_without_them():
    """A shell with fewer actuators, from the shell model; BIASGRAD would be taken from all."""
    whole, kept = model_shell(p45()).stiffness, ~np.isin(np.arange(45), (2, 19, 44))
    layout = p45().layout
    smaller = model_shell(replace(p45(), layout=taken(layout, kept))).stiffness
    smaller = 0.5 * (smaller + smaller.T)
    _, _, _, calibration = known()
    matrix = StiffnessMatrix("P45", DATE, layout, whole / calibration.alpha[:, None])
    off = true_stiffness(matrix, calibration, off=(3, 20, 45))
    difference = np.linalg.norm(off.stiffness - smaller)
    assert difference < 1e-5 * np.linalg.norm(smaller)
    assert np.linalg.norm(whole[np.ix_(kept, kept)] - smaller) > 0.01 * np.linalg.norm(smaller)
    assert off.layout.id.tolist() == layout.id[kept].tolist()
    assert np.array_equal(off.enabled_alpha[off.acts], calibration.alpha[kept])
    assert not off.forces[~kept].any()
    assert off.shapes[kept] == pytest.approx(np.eye(42))
    assert off.feed_forward_commanded[kept] == pytest.approx(
        off.stiffness / calibration.alpha[kept][:, None], abs=1e-6 * np.abs(whole).max()
    )
    # A disabled actuator is not there: what it would feel is left out, not condensed.
    disabled = replace(matrix, layout=Layout(layout.id, layout.x, layout.y, layout.nz, kept))
    left = true_stiffness(disabled, None)
    assert not left.calibrated
    assert (left.enabled_alpha == 1).all()
    raw = matrix.stiffness[np.ix_(kept, kept)]
    assert left.stiffness == pytest.approx(0.5 * (raw + raw.T))


def test_slaved_actuators_take_the_positions_that_need_least_force():
    k, matrix, gain, calibration = known()
    off, slaved = (5, 31), (9, 14, 40)
    found = true_stiffness(matrix, calibration, sensor_gain=gain, off=off, slaved=slaved)
    ids = matrix.layout.id
    s, o = np.isin(ids, slaved), np.isin(ids, off)
    m = ~(s | o)
    commanded = 1e-6 * np.random.default_rng(2).standard_normal(int(m.sum()))
    held = k - k[:, o] @ np.linalg.solve(k[np.ix_(o, o)], k[o])  # of what is not off
    z = np.zeros(45)
    z[m] = commanded
    z[s] = np.linalg.lstsq(held[:, s], -held[:, m] @ commanded)[0]
    z[o] = -np.linalg.solve(k[np.ix_(o, o)], k[np.ix_(o, ~o)] @ z[~o])
    assert found.shapes @ commanded == pytest.approx(z, abs=1e-15)
    assert found.forces @ commanded == pytest.approx(k @ z, abs=1e-9 * np.abs(k @ z).max())
    assert commanded @ found.stiffness @ commanded == pytest.approx(z @ k @ z, rel=1e-9)
    assert found.layout.id.tolist() == ids[m].tolist()
    assert found.feed_forward_commanded == pytest.approx(
        found.forces / calibration.alpha[:, None], rel=1e-12
    )


def test_what_cannot_be_is_refused():
    _, matrix, _, calibration = known()
    layout = matrix.layout
    loose = replace(matrix, stiffness=matrix.stiffness - 1e8 * np.eye(45))
    moved = replace(matrix, layout=replace(layout, x=layout.x + 1e-6))
    without_7 = np.arange(45) != 6
    fewer = replace(
        calibration,
        alpha=np.where(without_7, calibration.alpha, np.nan),
        layout=replace(layout, enabled=without_7),
    )
    renamed = replace(matrix, layout=replace(layout, id=layout.id + 1))
    for error, said, data, alpha, options in (
        (UnknownName, "no actuator 77 that is enabled", matrix, None, {"off": (77,)}),
        (UnknownName, "no actuator 0 that is enabled; give IDs", matrix, None, {"slaved": (0,)}),
        (UnknownName, "actuator 5 that .* whole numbers", matrix, None, {"off": ("5", "17")}),
        (UnknownName, "actuator 5.5 that .* whole numbers", matrix, None, {"slaved": (5.5,)}),
        (UnknownName, "4 is both off and slaved", matrix, None, {"off": (3, 4), "slaved": (4, 5)}),
        (RankDeficient, "only 3 actuators of 45 left", matrix, None, {"off": range(1, 43)}),
        (RankDeficient, "2 actuators switched off, not stabilised", loose, None, {"off": (1, 2)}),
        (CampaignMismatch, "of P36", replace(matrix, instrument="P36"), calibration, {}),
        (CampaignMismatch, "disagree on X of actuator 1", moved, calibration, {}),
        (CampaignMismatch, "no alpha for actuator 7", matrix, fewer, {}),
        (CampaignMismatch, "no alpha for actuator 46", renamed, calibration, {}),
        (FormatError, r"sensor_gain has shape \(3,\)", matrix, None, {"sensor_gain": np.ones(3)}),
        (FormatError, "not positive", matrix, None, {"sensor_gain": np.zeros(45)}),
    ):
        with pytest.raises(error, match=said):
            true_stiffness(data, alpha, **options)


@pytest.mark.study
def test_on_a_real_lbt672_alpha_and_statics_bring_soft_modes_to_the_model(real_matrix):
    """The model knows nothing of the measured matrix."""
    model = model_shell(replace(lbt672(), layout=real_matrix.layout)).stiffness - 31 * np.eye(650)
    theirs = stiffness_modes(model, arms(real_matrix.layout).T)
    plain = true_stiffness(real_matrix, None)
    found = true_stiffness(real_matrix, calibrate(real_matrix, population=True))
    assert (plain.asymmetry, found.asymmetry) == pytest.approx((0.0311, 0.0214), rel=0.01)
    assert (plain.imbalance, found.imbalance) == pytest.approx((2.2e-3, 2.6e-4), rel=0.05)
    assert found.modes.stiffness[:3] == pytest.approx([-57.5, -20.8, -28.5], rel=0.01)
    before, after = (
        compare_modes(each.modes.modes, theirs.modes, theirs.stiffness) for each in (plain, found)
    )
    nine = 8
    assert before.rms_angle[nine] > 0.3
    assert after.rms_angle[nine] < 0.012
    assert after.rms_angle[4] < 0.045  # 0.065 with rigid motions left coupled


# --- modes and their comparison ---------------------------------------------------------------


def test_modes_come_by_magnitude_or_rigid_motions_first():
    layout = rings([0.1], [6])
    rigid = np.linalg.qr(arms(layout).T)[0]
    rest = scipy.linalg.null_space(rigid.T)
    basis, values = np.hstack([rigid, rest]), np.array([-39.0, -9.0, -8.0, 11.5, 20.0, -50.0])
    k = basis * values @ basis.T
    assert stiffness_modes(k).stiffness == pytest.approx([-8.0, -9.0, 11.5, 20.0, -39.0, -50.0])
    found = stiffness_modes(k, arms(layout).T)
    assert found.stiffness == pytest.approx(
        [-39.0, -9.0, -8.0, 11.5, 20.0, -50.0]
    )  # in the order of their names
    assert k @ found.modes == pytest.approx(found.modes * found.stiffness, abs=1e-12)


def turned(n, a, b, angle):
    """Return the unit vectors of which two are turned in their plane."""
    modes = np.eye(n)
    c, s = np.cos(angle), np.sin(angle)
    modes[np.ix_([a, b], [a, b])] = [[c, -s], [s, c]]
    return modes


@pytest.mark.parametrize("angle", [1e-9, 1.2])
def test_two_modes_turned_into_each_other(angle):
    found = compare_modes(turned(7, 2, 4, angle), np.eye(7))
    leak = np.zeros(7)
    leak[2:4] = np.sin(angle) ** 2  # until the fifth mode joins
    sine = np.sqrt(leak / np.arange(1, 8))
    assert np.sin(found.rms_angle) == pytest.approx(sine, rel=1e-9, abs=1e-15)
    assert found.overlap == pytest.approx(1 - leak / np.arange(1, 8), abs=1e-15)
    assert found.largest_angle == pytest.approx([0, 0, angle, angle, 0, 0], rel=1e-7, abs=1e-15)
    mean = np.sin(angle) * np.sqrt((1 / 3 + 1 / 4) / 6)
    assert np.sin(found.distance) == pytest.approx(mean, rel=1e-9)


def test_a_pair_turned_within_itself_is_no_difference():
    values = np.array([1.0, 2.0, 3.0, 3.001, 4.0])
    found = compare_modes(turned(5, 2, 3, 0.8), np.eye(5), values)
    assert found.cuts.tolist() == [False, False, True, False, False]
    assert found.distance < 1e-15
    assert compare_modes(turned(5, 2, 3, 0.8), np.eye(5)).distance > 0.1


def test_angles_are_those_between_subspaces():
    random = np.random.default_rng(9)
    one, other = random.standard_normal((2, 20, 12))  # neither orthogonal nor of unit length
    found = compare_modes(one, other)
    for order in range(1, 13):
        angles = scipy.linalg.subspace_angles(one[:, :order], other[:, :order])
        assert found.overlap[order - 1] == pytest.approx(np.mean(np.cos(angles) ** 2), rel=1e-9)
        assert found.largest_angle[order - 1] == pytest.approx(angles.max(), rel=1e-6)
    assert 0.7 < found.distance < 1.1  # pi/4 on average over all orders of a whole space
    same = compare_modes(one, -3 * one)
    assert same.distance < 1e-14


def moved(cycle, by):
    return replace(cycle, position=np.asarray(cycle.position) + by)


def test_where_a_cycle_rests_and_its_zeros_make_no_outliers():
    """One cycle rests 30 nm elsewhere, others have new zeros; a spike is found all the same."""
    bench = static_bench(p45(), 6, force_noise=1e-4)
    cycles = list(run_cycles(bench, 3))
    random = np.random.default_rng(2)
    plain = measured_stiffness(Campaign(tuple(cycles)))
    cycles[1] = moved(cycles[1], 30e-9 * random.standard_normal(45))
    cycles[4] = moved(cycles[4], 1e-5 * random.standard_normal(45))
    spiked = np.array(cycles[2].position)
    spiked[17, 8] += 200e-9
    cycles[2] = replace(cycles[2], position=spiked)
    found = measured_stiffness(Campaign(tuple(cycles)))
    assert [(row.cycle, row.row) for row in found.rejected] == [(2, 17)]
    assert found.relative_error == pytest.approx(plain.relative_error, rel=0.1)
