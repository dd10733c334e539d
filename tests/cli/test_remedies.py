"""What is wrong with data gets a remedy that fits, and the same one from every command."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import WEIGHT, campaign_of, p45_bench, p45_matrix
from helpers.changed import check_alike, p45, said, with_forces
from helpers.small_bench import SmallBench
from truenewton.errors import RankDeficient, TrueNewtonError, TrueNewtonWarning
from truenewton.estimation.readings.moments import hidden_variance, reading_noise, rounding_steps
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.records.campaign import Campaign
from truenewton.records.file import write_campaign, write_stiffness
from truenewton.statics.load import Load

STEP = 41.6e-6


def stuck(at, cycles=(0, 1, 2, 3), rows=slice(None)):
    """Return what holds the reading of an actuator as it is in the first of some rows."""

    def change(k, force):
        if k in cycles:
            force[rows, at] = force[rows, at][0]
        return force

    return change


def hung(k, force):
    """Record one row again and again in the first cycle."""
    return force[:1] + 0 * force if k == 0 else force


def bent(power, size, noise=5e-5):
    """Return cycles whose coils are not linear: so much at 0.4 N."""
    bench = SmallBench(3, noise)
    bench.law = lambda c: 1 + size * (c / 0.4) ** (power - 1)
    return bench.campaign().cycles


def tilted():
    """Return a campaign under the bare mirror and a tilt."""
    loads = (Load("bare"), Load("tilted", tilt=45.0))
    return campaign_of(5, 1e-3, loads=loads)[0]


FAULTS = {
    "stuck": (
        lambda: with_forces(p45(), stuck(7)),
        None, "the reading of actuator 8 is stuck", "set ENABLED to F",
    ),
    "stuck, with noise": (
        lambda: with_forces(
            p45(),
            lambda k, f: stuck(7)(k, f) + 1e-3 * np.random.default_rng(k).normal(size=f.shape),
        ),
        "rejected", "stuck reading (actuator 8)", "check its electronics",
    ),
    "frozen in one file": (
        lambda: with_forces(p45(), stuck(7, (1,))),
        "doubtful", "28 % of the rows do not fit", "find out what happened during the run",
    ),
    "a recorder that hung": (
        lambda: with_forces(p45(), hung),
        None, "SHAPE and SIGN label other rows: bare 1", "or leave it out",
    ),
    "the same in all rows": (
        lambda: with_forces(p45(), lambda _, f: f[:1] + 0 * f),
        None, "FORCE is the same for all shapes", "record the forces commanded for each shape",
    ),
    "cut off": (
        lambda: with_forces(p45(), lambda _, f: np.clip(f, -0.36, 0.36)),
        "doubtful", "unknown effect", "readings that end at a limit",
    ),
    "quadratic coils": (
        lambda: bent(2, 0.01), "usable", "quadratic coil", "at half of which it is half",
    ),
    "cubic coils": (
        lambda: bent(3, 0.05), "usable", "cubic coil", "at half of which it is a quarter",
    ),
    "loads as good as the same": (
        lambda: campaign_of(5, 1e-3, loads=(Load("bare"), Load("ring", 1e-4 * WEIGHT, 5e-5)))[
            0
        ].cycles,
        None, "difference between the loads, 0.00029 N", "use a load that differs",
    ),
    "E_ADDED of 1 ug": (
        lambda: [replace(c, load=replace(c.load, added_error=1e-8)) for c in p45()],
        "usable", "'ring' is 1e-05 mN, less than a tenth of the buoyancy of air", "E_WEIGHT",
    ),
    "E_TILT is 0": (
        lambda: tilted().cycles,
        "usable", "without plausible errors (E_TILT of 'tilted' is 0)", "E_TILT in degrees",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("made", "level", "fault", "remedy"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_said_first_with_what_mends_it(made, level, fault, remedy):
    found = said(made())
    assert found[0] == level
    assert fault in found[1]
    assert remedy in found[2]


def test_an_order_that_balances_as_well_is_told_by_position(tmp_path):
    """Turned by 120 degrees forces balance as before: the displacements alone say otherwise."""
    layout = p45()[0].layout
    place = layout.x + 1j * layout.y
    turned = np.abs(place[:, None] * np.exp(2j * np.pi / 3) - place).argmin(axis=1)
    assert sorted(turned) == list(range(45))
    made = Campaign(tuple(with_forces(p45(), lambda _, force: force[:, turned])))
    with pytest.warns(TrueNewtonWarning, match="rejected"):
        found = tn.calibrate(made)
    assert found.goodness.probability > 1e-3  # nothing is wrong with the balance
    assert found.verdict.level == "rejected"
    assert "order of FORCE is not that of POSITION" in found.verdict.faults[0].fault
    found.write(tmp_path / "alpha.fits")
    with pytest.warns(TrueNewtonWarning, match="order of FORCE"):
        back = tn.read(tmp_path / "alpha.fits")
    assert back.verdict == found.verdict
    with pytest.raises(TrueNewtonError, match="order of FORCE"):
        tn.find_modes(made, back)


# --- an actuator without force ----------------------------------------------------------------


@pytest.mark.parametrize("method", ["ml", "svd"])
def test_an_actuator_with_alpha_0_within_its_error_is_called_dead(method):
    bench = SmallBench(4, 1e-3)
    bench.arms[:, 5] = 0.0  # whatever it is commanded, it does nothing
    verdict = tn.calibrate(bench.campaign(), method).verdict
    assert verdict.level >= (tn.Level.USABLE if method == "ml" else tn.Level.DOUBTFUL)
    dead = [each.fault for each in verdict.faults if 6 in each.actuators]
    assert dead
    assert "dead" in dead[0]


# --- forces in steps --------------------------------------------------------------------------


def rounded(cycles, step=STEP):
    return with_forces(cycles, lambda _, force: np.round(force / step) * step)


@pytest.mark.parametrize(
    "stored",
    [lambda f: f + 0.01, lambda f: 1e-3 * (1e3 * f).astype(np.float32)],
    ids=["with an offset", "in mN in single precision"],
)  # fmt: skip
def test_the_step_of_forces_is_found(stored):
    force = np.random.default_rng(1).normal(0.0, 0.12, (40, 50))
    assert not rounding_steps(list(stored(force))).any()
    found = rounding_steps(list(stored(np.round(force / STEP) * STEP)))
    assert found == pytest.approx(STEP, rel=1e-3)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.3])
def test_what_repeats_do_not_show_of_rounding(sigma):
    """Against 4000 forces all over a step, 400 readings of each."""
    random = np.random.default_rng(2)
    force = (np.arange(4000) + 0.5) / 4000
    read = np.round(force[:, None] + sigma * random.standard_normal((4000, 400)))
    seen = float(read.var(axis=1, ddof=1).mean())
    hidden = float(np.mean((read.mean(axis=1) - force) ** 2)) - seen / 400
    assert hidden_variance(np.ones(1), np.array([seen]))[0] == pytest.approx(hidden, abs=1.5e-3)
    assert seen + hidden == pytest.approx(sigma**2 + 1 / 12, abs=2e-3)


@pytest.mark.parametrize(("noise", "count"), [(0.0, 2), (5e-6, 4), (1e-5, 1)])
def test_rounding_is_noise_and_no_outlier(noise, count):
    """Steps of 41.6 uN: none of the shapes goes, and alpha is covered by what it adds."""
    bench = p45_bench()
    made = Campaign(tuple(rounded(p45(noise, count))))
    found = tn.calibrate(made)
    assert found.rejected == 0
    assert found.effects == ()
    assert found.goodness.probability > 1e-3 or count == 1
    off = found.alpha / bench.truth.alpha
    off = off / off.mean() - 1.0  # the weights are not what they say
    z = off / (found.statistical_error / found.alpha)
    assert np.sqrt(np.mean(z**2)) < 1.6
    text = " | ".join(each.fault for each in found.verdict.faults)
    assert "repeated shapes scatter" not in text
    if count > 1:
        assert "FORCE has steps of 0.0416 mN" in text
        assert "E_STAT includes 0.012 mN, step / sqrt(12)" in text


def test_rounding_is_added_to_a_smaller_declared_force_error():
    made = Campaign(tuple(rounded([replace(c, force_error=1e-5) for c in p45(1e-5, 1)])))
    noise = reading_noise(made, screen_campaign(made).moments)
    each = np.sqrt(noise.variance) * 1e-5 / 1e-3
    assert each == pytest.approx(np.hypot(1e-5, STEP / np.sqrt(12)), rel=1e-3)


# --- one front end ----------------------------------------------------------------------------


def spiked():
    """Return cycles in which a row of each file is off."""
    rows = np.arange(90)[:, None]
    return with_forces(p45(), lambda k, f: f + 0.3 * (rows == 4 + k) * (np.arange(45) == 3))


DATA = {
    "sound": p45,
    "spikes": spiked,
    "one load": lambda: p45()[:2],
    "a copy": lambda: with_forces(p45(), lambda k, f: f if k != 1 else np.array(p45()[0].force)),
    "stuck": FAULTS["stuck"][0],
    "frozen in one file": FAULTS["frozen in one file"][0],
}


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("sound", "ml"), ("a copy", "ml"), ("one load", "ml"), ("spikes", "svd"),
        *(pytest.param(name, "ml", marks=pytest.mark.study)
          for name in DATA if name not in ("sound", "a copy", "one load")),
    ],
)  # fmt: skip
def test_every_command_answers_alike(inside, tmp_path, name, method):
    write_campaign(DATA[name](), tmp_path / "c")
    check_alike(inside, tmp_path / "c", "--method", method)


def test_svd_says_that_it_takes_rows_that_do_not_fit():
    found = tn.calibrate(Campaign(tuple(spiked())), "svd")
    assert any(each.code is tn.Code.SVD_USES_ALL_ROWS for each in found.verdict.faults)


@pytest.mark.parametrize(("change", "options"), [
    (lambda k: np.roll(k, 1, axis=0), ("--population",)),
    (lambda k: np.eye(45), ()),
    (lambda k: k * (1 + 0.1 * np.random.default_rng(3).standard_normal(k.shape)),
     ("--method", "svd")),
    pytest.param(lambda k: k, ("--method", "auto"), marks=pytest.mark.study),
    pytest.param(lambda k: -k, ("--population",), marks=pytest.mark.study),
])  # fmt: skip
def test_every_command_answers_alike_of_a_matrix(inside, tmp_path, change, options):
    matrix = p45_matrix()[0]
    write_stiffness(replace(matrix, stiffness=change(matrix.stiffness)), tmp_path / "k.fits")
    check_alike(inside, tmp_path / "k.fits", *options)


def test_alpha_that_worsens_the_balance_is_the_first_finding():
    made = tn.calibrate(p45_matrix(0.0)[0], "svd")
    line = made.imbalances[0]
    unseen = (replace(line, before=0.02, after=0.03),) * 2
    doubtful = replace(made, imbalances=(line, *unseen), statistical_error=np.ones(45))
    verdict = doubtful.verdict
    assert verdict.level == "rejected"
    assert [each.code for each in verdict.faults[:2]] == [
        tn.Code.HARMFUL_ALPHA,
        tn.Code.ERROR_TOO_LARGE,
    ]
    assert "rows and columns of STIFFNESS" in verdict.faults[1].remedy
    turned = replace(doubtful, alpha=np.where(np.arange(45) < 9, -made.alpha, made.alpha))
    of = {each.code: each.remedy for each in turned.verdict.faults}
    assert "rows and columns of STIFFNESS" in of[tn.Code.MANY_NEGATIVE]


def test_of_a_matrix_no_remedy_is_about_shapes():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TrueNewtonWarning)
        found = tn.calibrate(p45_matrix(0.02, seed=1)[0], "ml")
    of = {each.code: each.remedy for each in found.verdict.faults}
    assert tn.Code.HALVES_INSUFFICIENT in of
    assert not [each for each in of.values() if "shapes" in each]


def test_positions_beyond_the_gap_are_in_another_unit():
    cycles = campaign_of(5, 1e-3)[0].cycles
    millimetres = [
        replace(cycle, gap=68e-6, position=1e3 * np.abs(cycle.force) * 1e-6) for cycle in cycles
    ]
    with pytest.raises(RankDeficient, match=r"POSITION reaches .* beyond the GAP of 6.8e-05 m"):
        tn.calibrate(tn.Campaign(tuple(millimetres)))
