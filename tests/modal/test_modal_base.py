"""The modal basis whole: found from P45's campaign, written, asked for on the command line."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from studies.modal_truth import score_modes
from truenewton.bench.simulated.static import START, run_cycles, static_bench
from truenewton.calibration.methods import calibrate
from truenewton.errors import FormatError, OutputExists
from truenewton.estimation.findings.estimate import Sensor
from truenewton.modal import findings, summary
from truenewton.modal.figures import modes_figures
from truenewton.modal.file import modes_paths, write_modes
from truenewton.modal.findings import find_modes
from truenewton.modal.modal_base import Budget
from truenewton.modal.turbulence import Atmosphere, Pupil, pupil_of, seen_turbulence
from truenewton.records.campaign import Campaign

PUPIL = {"diameter": 2.13, "efficiency": 0.51}


@pytest.fixture(scope="module")
def p45():
    bench = static_bench(tn.mirrors.p45(), 5, force_noise=2e-5)
    campaign = Campaign(tuple(run_cycles(bench, 2)))
    return bench, campaign, find_modes(campaign, calibrate(campaign), **PUPIL)


def test_calibrated_modes_and_their_number_are_nearer_to_the_truth(p45):
    bench, campaign, found = p45
    score = score_modes(campaign, found, bench.truth)
    # What is left is the scatter of the sensor gains, 0.35 %, against that of alpha, 12 %.
    symmetric, singular, calibrated = score.distance
    assert calibrated < min(symmetric / 25, singular / 12)
    assert score.power_number[2] < 0.6 * min(score.power_number[:2])
    assert score.force_number[2] < min(score.force_number[:2]) / 4


def test_static_force_carries_the_mirror(p45):
    bench, campaign, found = p45
    static, layout = found.after.static, campaign.layout
    truth = bench.truth
    assert layout.nz @ static == pytest.approx(-(truth.weight + truth.bias_force), rel=0.02)
    from_file = find_modes(found.measured.matrix, found.calibration).after.static
    assert layout.nz @ from_file == pytest.approx(layout.nz @ static, rel=1e-3)
    assert np.linalg.norm(from_file) < np.linalg.norm(static)  # least force: flat by nothing else


def test_what_is_off_is_borne_by_the_others(p45):
    _, campaign, found = p45
    some = find_modes(campaign, found.calibration, off=[3, 17], slaved=[40], **PUPIL)
    base = some.after
    assert base.modes.stiffness.size == 42
    assert base.stiffness.enabled.n == 45
    static = base.static
    assert static[2] == static[16] == 0.0
    arms = np.stack([campaign.layout.nz, campaign.layout.x, campaign.layout.y])
    np.testing.assert_allclose(arms @ static, arms @ found.after.static, rtol=1e-9)
    assert not base.costs[0].force[2].any()
    assert base.costs[0].force[39].any()  # the slave pulls too
    # What they do not hit stays, whatever the number of modes.
    assert base.costs[0].residual[-1] > 0.2 * found.after.costs[0].residual[20]


def test_errors_of_alpha_move_the_number_by_force_alone(p45):
    _, _, found = p45
    cost = found.after.costs[0]
    at_the_edge = Budget(force=1.001 * cost.reach[:, :30].max())  # alpha is known to 1.7 %
    fewest, most = found.modes_between(cost, at_the_edge)
    assert fewest < 30 <= cost.modes_within(at_the_edge) <= most
    by_power = Budget(power=np.median(cost.power.max(axis=0)))
    assert found.modes_between(cost, by_power) == (cost.modes_within(by_power),) * 2


def test_turbulence_is_left_out_without_a_pupil(p45, inside, tmp_path):
    _, campaign, whole = p45
    found = find_modes(campaign, whole.calibration)
    np.testing.assert_array_equal(found.after.modes.stiffness, whole.after.modes.stiffness)
    assert "turbulence" not in modes_figures(found, Budget())
    assert set(modes_figures(found, Budget())) == {"modes", "modes-comparison"}
    told = summary.values(found, Budget())
    assert (told["diameter"], told["fitting_error"], told["bases"]) == (None, None, [])
    with fits.open(write_modes(found, tmp_path / "m.fits")[0]) as hdus:
        assert not {"SEEING", "DIAMETER", "NMODES"} & set(hdus[0].header)
        assert not {"KL", "ZERNIKE"} & {hdu.name for hdu in hdus}
        assert hdus["BUDGET"].data.names == ["N", "STIFFNESS"]
    with pytest.raises(FormatError, match=r"limits need turbulence.*diameter"):
        write_modes(found, tmp_path / "n.fits", Budget(force=0.1))
    with pytest.raises(FormatError, match="need the pupil"):
        find_modes(campaign, whole.calibration, Atmosphere(0.8))
    forces = find_modes(campaign, whole.calibration, diameter=2.13)
    assert "power" not in " ".join(summary.lines(forces, Budget())).split("--power")[0]
    with pytest.raises(FormatError, match="efficiency of the coils"):
        forces.after.costs[0].modes_within(Budget(power=0.1))
    for option, words in {"--seeing": "--diameter", "--power": "--efficiency"}.items():
        err = inside.refuses("modes", "m4.fits", option, "0.8")
        assert words in err


def test_the_radius_of_the_mirror_is_half_a_spacing_beyond_its_actuators():
    layout = tn.mirrors.lbt672().layout
    pupil = pupil_of(layout, 8.0)
    assert pupil.radius == pytest.approx(0.4483, abs=2e-4)  # the glass ends at 0.4555
    assert pupil.diameter == 8.0
    with pytest.raises(FormatError):
        Pupil(0.1, -1.0)


def test_what_lies_between_actuators_is_told():
    """0.28 (d/r0)^(5/3): an 8 m pupil on 30 x 30 cm and r0 30 cm leave 0.53 rad."""
    r0 = 2 * 4.0 * np.sqrt(np.pi / 672) / 2
    seeing = 0.98 * 500e-9 / r0 / np.radians(1 / 3600)
    layout = tn.mirrors.lbt672().layout
    seen = seen_turbulence(layout, layout.enabled, Atmosphere(seeing), Pupil(0.455, 8.0))
    assert seen.fitting_error == pytest.approx(np.sqrt(0.28) * 500e-9 / 2 / np.pi, rel=1e-9)


def test_files_hold_what_was_found(p45, tmp_path):
    _, _, found = p45
    base, stiffness = found.after, found.after.stiffness
    written = write_modes(found, tmp_path / "m.fits", Budget(power=0.1))
    assert written == list(modes_paths(tmp_path / "m.fits"))
    with fits.open(written[0], checksum=True) as hdus:
        assert hdus[0].header["NMODES"] == base.costs[0].modes_within(Budget(power=0.1))
        assert "MAXFORCE" not in hdus[0].header
        assert set(hdus["ACTUATORS"].data["STATE"]) == {"commanded"}
        np.testing.assert_array_equal(hdus["MODES"].data, base.modes.modes)
        np.testing.assert_allclose(
            hdus["COMMANDED"].data * found.calibration.alpha[:, None], hdus["FORCE"].data
        )
        np.testing.assert_array_equal(hdus["BUDGET_KL"].data["RESIDUAL"], base.costs[2].residual)
    true, commanded = (tn.read(path) for path in written[1:3])
    np.testing.assert_allclose(true.stiffness, stiffness.stiffness, rtol=1e-12)
    np.testing.assert_allclose(
        commanded.stiffness * found.calibration.alpha[:, None], stiffness.stiffness, rtol=1e-12
    )
    assert np.ptp(calibrate(true).alpha) < 1e-5  # asks for no correction
    for path, wanted in zip(
        written[3:], (base.modes.modes, commanded.stiffness, true.stiffness), strict=True
    ):
        with fits.open(path, checksum=True) as hdus:
            assert len(hdus) == 1
            assert hdus[0].header["CTYPE2"] == "ACTUATOR"
            np.testing.assert_array_equal(hdus[0].data, wanted)
    with pytest.raises(OutputExists):
        write_modes(found, tmp_path / "m.fits")
    with pytest.raises(FormatError, match="modal basis"):
        tn.read(written[0])


def test_rows_of_actuators_disabled_off_or_slaved_keep_their_place(p45, tmp_path):
    """Where slaves are to go is told by MODES; what that takes, by the matrix as of any."""
    _, _, whole = p45
    matrix = whole.measured.matrix
    layout = matrix.layout
    enabled = layout.id != 7
    known = tn.layout(layout.x, layout.y, id=layout.id, nz=layout.nz, enabled=enabled)
    some = tn.StiffnessMatrix("P45", matrix.date, known, matrix.stiffness)
    found = find_modes(some, whole.calibration, off=[9], slaved=[12, 30])
    written = write_modes(found, tmp_path / "m.fits")
    commanded = tn.read(written[2])
    assert list(layout.id[~commanded.layout.enabled]) == [7, 9]
    modes = fits.getdata(written[3])
    assert modes.shape == (45, 41)
    assert not modes[6].any()
    assert modes[8].any()  # it floats along
    states = fits.getdata(written[0], "ACTUATORS")["STATE"]
    assert [states[6], states[8], states[9]] == ["disabled", "off", "commanded"]
    assert list(states).count("slaved") == 2
    held = tn.read(written[1]).stiffness @ modes
    acting = np.flatnonzero(~np.isin(layout.id, (7, 9)))
    expected = found.after.stiffness.forces @ found.after.modes.modes
    enabled = np.flatnonzero(enabled)
    np.testing.assert_allclose(held[acting], expected[np.isin(enabled, acting)], atol=1e-6)


def test_the_command_tells_how_many_modes_a_power_allows(p45, inside, tmp_path):
    _, campaign, found = p45
    tn.write_campaign(campaign.cycles, tmp_path / "c")
    found.calibration.write(tmp_path / "alpha.fits")
    asked = ("modes", tmp_path / "c", "--calibration", tmp_path / "alpha.fits", "--power", "0.05")
    asked += ("--diameter", "2.13", "--efficiency", "0.51")
    asked += ("-o", tmp_path / "m.fits", "--figures", tmp_path / "figures")
    out = inside.prints(*asked, "--json")
    assert len(list((tmp_path / "figures").iterdir())) == 8
    number = found.after.costs[0].modes_within(Budget(power=0.05))
    told = json.loads(out)
    assert told["bases"][0]["modes_within"] == number
    np.testing.assert_allclose(told["bases"][0]["residual"], found.after.costs[0].residual)
    said = summary.lines(found, Budget(power=0.05))
    assert said[0].endswith("(alpha: method ml, common scale from the weights)")
    assert any(f"stiffness             {number} of 45" in line for line in said)
    assert "exists already" in inside.refuses(*asked)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--off", "3,x", "IDs"),
        ("--off", "99", "99"),
        ("--diameter", "8200", "diameter"),
        ("--efficiency", "0", "efficiency"),
    ],
)
def test_the_command_refuses_in_one_line(p45, inside, tmp_path, option, value, words):
    _, _, found = p45
    tn.write_stiffness(found.measured.matrix, tmp_path / "s.fits")
    found.calibration.write(tmp_path / "alpha.fits")
    asked = ("modes", tmp_path / "s.fits", "--calibration", tmp_path / "alpha.fits")
    err = inside.refuses(*asked, "--diameter", "2.13", option, value)
    assert words in err


def test_what_sensors_see_counts_once_in_files_written_and_read_again(p45, tmp_path):
    bench, _, found = p45
    random, gain = np.random.default_rng(2), bench.truth.sensor_gain
    places = 5e-4 * random.standard_normal((45, 2))
    sensors = tuple(
        Sensor(k + 1, g, 1e-3, x, 1e-5, y, 1e-5, "fitted")
        for k, (g, (x, y)) in enumerate(zip(gain, places, strict=True))
    )
    calibration = replace(found.calibration, sensors=sensors)
    once = find_modes(found.measured.matrix, calibration)
    _, _, commanded, *_ = write_modes(once, tmp_path / "m.fits")
    matrix = tn.read(commanded)
    assert (found.measured.matrix.displaced, matrix.displaced) == ("read", "true")
    again = find_modes(matrix, calibration)
    stiffness = once.after.stiffness.stiffness
    np.testing.assert_allclose(
        again.after.stiffness.stiffness, stiffness, atol=1e-9 * np.abs(stiffness).max()
    )
    assert (again.after.stiffness.enabled_gain == 1.0).all()
    twice = find_modes(replace(matrix, displaced="read"), calibration)
    assert np.abs(twice.after.stiffness.stiffness - stiffness).max() > 1e-3 * stiffness.max()
    # What the sensors read of a mode: of a tilt exactly what they see where they are.
    with fits.open(tmp_path / "m.fits") as hdus:
        reading, modes = hdus["READING"].data, hdus["MODES"].data
    np.testing.assert_allclose(once.after.stiffness.read(modes), reading, atol=1e-12)
    layout = found.measured.matrix.layout
    tilts = np.stack([layout.x, layout.y], axis=1)
    seen = (tilts - places) / gain[:, None]
    by_modes = np.linalg.lstsq(modes[:, :3], tilts, rcond=None)[0]
    np.testing.assert_allclose(reading[:, :3] @ by_modes, seen, atol=1e-9)


def test_a_stiffness_file_says_whose_displacements_it_takes(p45, tmp_path):
    matrix = p45[2].measured.matrix
    with pytest.raises(FormatError, match="DISPLACE is 'ture'"):
        replace(matrix, displaced="ture")
    tn.write_stiffness(matrix, tmp_path / "s.fits")
    fits.delval(tmp_path / "s.fits", "DISPLACE")  # as in files written before
    assert tn.read(tmp_path / "s.fits").displaced == "read"


def test_alpha_of_another_mirror_is_warned_of(p45, inside, tmp_path):
    _, _, found = p45
    tn.write_stiffness(found.measured.matrix, tmp_path / "s.fits")
    other = replace(found.calibration, alpha=np.roll(found.calibration.alpha, 11))
    other.write(tmp_path / "alpha.fits")
    out = inside.prints("modes", tmp_path / "s.fits", "--calibration", tmp_path / "alpha.fits")
    assert "warning: With alpha the stiffness is less symmetric" in out
    assert not found.warnings


def test_the_command_asks_the_glass_what_annular_sensors_see(p45, inside, tmp_path):
    _, _, found = p45
    matrix = found.measured.matrix
    tn.write_stiffness(matrix, tmp_path / "s.fits")
    found.calibration.write(tmp_path / "alpha.fits")
    asked = ("modes", tmp_path / "s.fits", "--calibration", tmp_path / "alpha.fits", "--json")
    code, out, _ = inside(*asked, "--mirror", "p45")
    motion = tn.sensor_model(tn.mirrors.p45(), matrix.layout)
    again = find_modes(matrix, found.calibration, motion=motion)
    assert code == 0
    assert json.loads(out)["stiffness"] == pytest.approx(again.after.modes.stiffness.tolist())
    # A puck moves more than the annulus round it sees, which calls stiff modes too stiff.
    assert again.after.modes.stiffness[-1] < 0.9 * found.after.modes.stiffness[-1]
    assert "are not those of the data" in inside.refuses(*asked, "--mirror", "mmt336")


def test_static_force_comes_of_all_cycles_but_no_row_that_stands_off(p45):
    _, campaign, found = p45
    first, *others = campaign.cycles
    static = found.after.static
    without = find_modes(Campaign((replace(first, position=None), *others)), found.calibration)
    assert without.measured.rows == found.measured.rows - 90
    np.testing.assert_allclose(without.after.static, static, atol=3e-5)
    # A stiffness file among cycles is the stiffness.
    blind = tuple(replace(cycle, position=None) for cycle in campaign.cycles)
    given = find_modes(Campaign(blind, found.measured.matrix), found.calibration)
    assert given.measured is None
    np.testing.assert_allclose(given.after.modes.stiffness, found.after.modes.stiffness)
    np.testing.assert_allclose(given.after.static, static, atol=3e-5)
    force = np.array(first.force)
    force[10, 4] += 1.0
    spoilt = find_modes(Campaign((replace(first, force=force), *others)), found.calibration)
    assert {row.row for row in spoilt.measured.rejected} == {10}  # of either cycle: who knows
    np.testing.assert_allclose(spoilt.after.static, static, atol=3e-5)


def test_an_actuator_that_acts_though_it_is_disabled_is_warned_of(p45):
    _, campaign, _ = p45
    old = campaign.layout
    layout = tn.layout(old.x, old.y, id=old.id, nz=old.nz, enabled=old.id != 12)
    cycles = tuple(replace(cycle, layout=layout) for cycle in campaign.cycles)
    stiffness = find_modes(campaign).calibration
    found = find_modes(Campaign(cycles), stiffness)
    assert any("no stiffness explains" in each.fault for each in found.warnings)


def test_the_set_is_written_whole_or_not_at_all(p45, tmp_path):
    _, _, found = p45
    (tmp_path / "m.ff_matrix.fits").mkdir()
    with pytest.raises(OutputExists):
        write_modes(found, tmp_path / "m.fits", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["m.ff_matrix.fits"]
    with pytest.raises(FormatError, match="plain matrix"):
        tn.read(write_modes(found, tmp_path / "n.fits")[3])


def random_mirror(n):
    """Return a stiffness that lets rigid motions go free, in a spiral, and alpha of it."""
    random, turn = np.random.default_rng(1), 2.4 * np.arange(n)
    x, y = 0.1 * np.sqrt(np.arange(1, n + 1) / n) * np.stack([np.cos(turn), np.sin(turn)])
    layout = tn.layout(x, y)
    rigid = np.linalg.qr(np.stack([np.ones(n), x, y], axis=1))[0]
    root = random.standard_normal((n, n))
    root -= (root @ rigid) @ rigid.T
    alpha = random.uniform(0.9, 1.1, n)
    matrix = tn.StiffnessMatrix("ANY", START, layout, 1e3 / n * root.T @ root / alpha[:, None])
    return matrix, replace(calibrate(matrix, "svd"), alpha=alpha)


def test_a_large_mirror_takes_six_matrices_and_is_not_compared(monkeypatch):
    """Those that are given not counted; of a still larger one blocks take a smaller share."""
    n = 300
    find_modes(
        *random_mirror(30), accept_rejected=True
    )  # what is imported on the way does not count
    matrix, calibration = random_mirror(n)
    monkeypatch.setattr(findings, "MAX_COMPARED", n - 1)
    tracemalloc.start()
    found = find_modes(matrix, calibration, accept_rejected=True, **PUPIL)
    peak = tracemalloc.get_traced_memory()[1] / (8 * n * n)
    told = summary.values(found, Budget(power=0.1))
    tracemalloc.stop()
    assert 3.0 < peak < 6.5
    assert told["uncalibrated_modes"] is None
    assert {base["modes_within_uncalibrated"] for base in told["bases"]} == {None}
    assert not any("alpha = 1:" in line for line in summary.lines(found, Budget(power=0.1)))
    assert "modes-comparison" not in modes_figures(found, Budget())
    assert "before" not in vars(found)
