"""One verdict on one set of data: the same from every command, and from the file it stands in."""

import json
import warnings
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.balanced import p45_bench, p45_matrix
from helpers.changed import p45_cycles
from truenewton.calibration import figures
from truenewton.calibration.verdict import Level, verdict_on
from truenewton.errors import NotToBeUsed, TrueNewtonWarning
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    ErrorKind,
    ErrorSource,
    Goodness,
    NoiseSource,
    ScaleError,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.records.campaign import Campaign
from truenewton.records.file import write_campaign


def cycles(noise=1e-3, count=2):
    return p45_cycles(noise, count)


def copied(noise=1e-3):
    """Return cycles of which the second under each load holds the readings of the first."""
    every = cycles(noise, 4)
    return tuple(
        replace(c, force=every[k - 1].force) if k % 4 == 1 else c for k, c in enumerate(every)
    )


def four_times(noise=1e-3):
    """Return one file under each load as if it were cycles 1 to 4."""
    every = cycles(noise, 4)
    return tuple(replace(c, force=every[4 * (k // 4)].force) for k, c in enumerate(every))


@pytest.fixture
def clean(p45_calibration):
    return p45_calibration


def written(tmp_path, made, name="campaign"):
    """Return the folder of a campaign."""
    write_campaign(made, tmp_path / name)
    return tmp_path / name


def faults(verdict):
    """Return the faults of a verdict in one text."""
    return " | ".join(each.fault for each in verdict.faults)


@pytest.mark.parametrize(
    "made",
    [
        copied,
        *(pytest.param(m, marks=pytest.mark.study) for m in (cycles, four_times)),
    ],
)
def test_every_command_gives_the_same_verdict(inside, tmp_path, made, monkeypatch):
    """What check_alike does not ask (tests/cli/test_remedies.py): the file, modes and figures."""
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])
    folder, alpha = written(tmp_path, made()), tmp_path / "alpha.fits"
    out = inside.prints("calibrate", folder, "-o", alpha, "--json", "--anyway")
    verdict = json.loads(out)["verdict"]
    for path in (folder, alpha):
        assert json.loads(inside("info", path, "--json")[1])["verdict"] == verdict
    _, out, _ = inside("modes", folder, "--calibration", alpha, "--anyway", "--json")
    assert json.loads(out)["verdict"] == verdict
    assert fits.getval(alpha, "VERDICT") == verdict["level"]
    _, out, _ = inside("report", alpha, "-o", tmp_path / "page.html")
    assert out.startswith(verdict["level"].capitalize())
    assert verdict["findings"][0]["fault"][1:] in out
    assert verdict["findings"][0]["fault"][1:] in unescape((tmp_path / "page.html").read_text())
    _, out, _ = inside("figures", alpha, "-o", tmp_path / "figures")
    assert out.split()[1].rstrip(":") == verdict["level"]


def test_what_is_not_to_be_used_is_written_only_by_force_and_says_so(inside, tmp_path):
    folder, alpha = written(tmp_path, copied()), tmp_path / "alpha.fits"
    error = inside.refuses("calibrate", folder, "-o", alpha)
    assert "rejected" in error
    assert "copy of another file" in error
    assert "restore the original of the copy" in error
    assert not alpha.exists()
    inside.prints("calibrate", folder, "-o", alpha, "--anyway")
    assert fits.getval(alpha, "VERDICT") == "rejected"
    good = tmp_path / "good.fits"
    inside("calibrate", written(tmp_path, cycles(), "good"), "-o", good)
    for command in (
        ("modes", folder, "--calibration", alpha, "-o", tmp_path / "modes.fits"),
        ("track", good, alpha, "-o", tmp_path / "law.fits"),
        ("recalibrate", tmp_path / "good", "--known", alpha, "--actuators", "3",
         "-o", tmp_path / "again.fits"),
    ):  # fmt: skip
        error = inside.refuses(*command)
        assert "rejected" in error
        assert "alpha.fits" in error or command[0] == "modes"
        assert not command[-1].exists()
    assert inside("modes", folder, "--calibration", alpha, "--anyway")[0] == 0
    code, _, _ = inside(
        "recalibrate", tmp_path / "good", "--known", alpha, "--actuators", "3", "--anyway",
        "-o", tmp_path / "again.fits",
    )  # fmt: skip
    assert code == 0
    assert tn.read(tmp_path / "again.fits").verdict.level == "rejected"


def test_python_warns_of_what_is_not_to_be_used_and_refuses_to_go_on(tmp_path):
    with pytest.warns(TrueNewtonWarning, match="rejected: Found: copy of another"):
        bad = tn.calibrate(Campaign(copied()))
    bad.write(tmp_path / "alpha.fits")
    with pytest.warns(TrueNewtonWarning, match="rejected"):
        tn.read(tmp_path / "alpha.fits")
    with pytest.raises(NotToBeUsed, match="copy"):
        tn.recalibrate(Campaign(cycles()), bad, [3])
    with pytest.raises(NotToBeUsed, match="copy"):
        tn.find_modes(Campaign(cycles()), bad)
    with pytest.raises(NotToBeUsed, match="copy"):
        tn.track(bad, replace(bad, date_end=bad.date_end.replace(year=2030)))


def test_sound_data_are_sound_without_a_word(clean):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tn.calibrate(Campaign(cycles(count=4)))
    assert clean.verdict.level in (Level.SOUND, Level.USABLE)
    assert all("scale" in each.fault for each in clean.verdict.faults)


def with_effect(c, code, **options):
    effect = Finding(code=code, detail="FORCE", where="bare 1", remedy="leave it out")
    return replace(c, effects=(replace(effect, **options),))


def test_wrong_labels_beside_a_misfit_are_rejected_and_said_first(clean):
    doubtful = with_effect(clean, Code.SIGN_REVERSED)
    assert verdict_on(doubtful).level == "doubtful"
    misfit = Goodness(900.0, 100, NoiseSource.REPEATS, 0.0)
    verdict = verdict_on(replace(doubtful, goodness=misfit))
    assert verdict.level == "rejected"
    assert "SIGN reversed" in str(verdict)


@pytest.mark.parametrize(("kind", "remedy"), [
    (ErrorKind.TILT, "if you measure the tilt of 'ring' to 0.01 degrees, the scale error falls"),
    (ErrorKind.BETWEEN_LOADS, "keep the temperature"),
    (ErrorKind.COIL_SHIFT, "measure how far the coils move"),
    (ErrorKind.EARLIER, "repeat the earlier calibration"),
])  # fmt: skip
def test_the_advice_on_the_scale_is_about_its_largest_error(clean, kind, remedy):
    """It was to weigh the loads more accurately, whatever the cause."""
    largest = ScaleError(ErrorSource(kind, "ring"), 0.02)
    tilted = tuple(replace(load, tilt_error=0.1) for load in clean.loads)
    verdict = verdict_on(replace(clean, loads=tilted, scale_errors=(largest,)))
    [finding] = [each for each in verdict.faults if each.code is tn.Code.SCALE_BY_WEIGHTS]
    assert finding.remedy.startswith(remedy)
    assert "weigh" not in finding.remedy


@pytest.mark.filterwarnings("ignore::truenewton.errors.TrueNewtonWarning")
def test_a_gain_of_one_load_leaves_the_scale_in_doubt_if_its_error_is_smaller():
    """FORCE 5 % larger under the ring: alpha is off by half of that, whichever load is right."""
    ring = [replace(c, load=replace(c.load, added_error=1e-5)) for c in cycles(5e-5, 4)]
    wrong = [replace(c, force=1.05 * c.force) if k >= 4 else c for k, c in enumerate(ring)]
    found = tn.calibrate(Campaign(tuple(wrong)))
    [effect] = [each for each in found.findings if each.code is tn.Code.GAIN_BY_LOAD]
    assert effect.corrected
    assert (effect.level, found.verdict.level) == (Level.DOUBTFUL, Level.DOUBTFUL)
    off = np.median(found.alpha / p45_bench().truth.alpha) - 1.0
    assert abs(off) > 5 * np.median(found.error)  # which E_ALPHA does not include
    assert abs(off) < abs(effect.size)


def test_an_effect_that_was_taken_out_condemns_nothing(clean):
    corrected = with_effect(clean, Code.EXCHANGED_COLUMNS, corrected=True)
    assert verdict_on(corrected).level != Level.REJECTED


@pytest.mark.parametrize(("made", "rejected"), [
    (lambda: cycles(noise=0.0), False),
    (four_times, True),
    (lambda: tuple(replace(c, force=np.roll(c.force, 1, axis=1)) for c in cycles()), True),
    (lambda: tuple(replace(c, force=-np.asarray(c.force)) for c in cycles()), True),
], ids=["no noise", "one file four times", "another order", "reversed"])  # fmt: skip
def test_files_that_are_not_what_they_say_are_rejected(made, rejected):
    verdict = tn.calibrate(Campaign(made())).verdict
    assert (verdict.level == Level.REJECTED) == rejected
    if made is four_times:
        assert "copies among the files" in verdict.faults[0].remedy


@pytest.mark.study
def test_a_stiffness_of_the_other_sign_is_said_and_gives_no_modes():
    matrix = p45_matrix()[0]
    other = replace(matrix, stiffness=-matrix.stiffness)
    verdict = tn.calibrate(other).verdict
    assert verdict.level == Level.USABLE
    assert "stiffness of the other sign" in verdict.faults[0].fault
    with pytest.raises(NotToBeUsed, match="42 of 42 elastic modes are negative; reverse the sign"):
        tn.find_modes(other)
    assert tn.find_modes(matrix).after.modes.stiffness[3:].min() > 0


def test_a_calibration_of_a_stiffness_keeps_its_verdict(tmp_path, inside):
    made = tn.calibrate(p45_matrix()[0])
    made.write(tmp_path / "alpha.fits")
    back = tn.read(tmp_path / "alpha.fits")
    assert back.imbalances == made.imbalances != ()
    assert back.verdict == made.verdict
    [note] = back.verdict.notes  # annular sensors, read without the glass
    assert note.cause.code is tn.Code.ERRORS_LARGER
    note = note.fault[1:]
    assert back.verdict.level == Level.SOUND
    assert note in inside("info", tmp_path / "alpha.fits")[1]
    assert note in inside("report", tmp_path / "alpha.fits", "-o", tmp_path / "p.html")[1]


def test_a_file_keeps_goodness_and_budget_and_an_earlier_one_is_judged_without(tmp_path, clean):
    path = tmp_path / "alpha.fits"
    clean.write(path)
    back = tn.read(path)
    assert back.goodness == clean.goodness
    assert back.scale_errors == clean.scale_errors
    assert back.unseen == clean.unseen != ()
    assert back.verdict == clean.verdict
    with fits.open(path, mode="update") as hdus:
        for name in ("FITCHI2", "FITNOISE", "FITPROB", "VERDICT", "CHECKSUM", "DATASUM"):
            hdus[0].header.remove(name, ignore_missing=True)
        del hdus["BUDGET"]
    back = tn.read(path)
    assert back.goodness is None
    assert back.scale_errors == ()
    assert back.verdict.level == clean.verdict.level
    with fits.open(path, mode="update") as hdus:
        hdus[0].header["FITNOISE"], hdus[0].header["FITCHI2"] = "magic", 1.0
    with pytest.raises(tn.errors.FormatError, match="FITNOISE"):
        tn.read(path)
