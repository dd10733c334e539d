"""A command on data of several segments takes each in turn, with its own outputs."""

import datetime
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import truenewton as tn
from helpers.json_output import checked
from helpers.segmented import in_one, pieces
from truenewton.calibration import figures
from truenewton.cli import segments
from truenewton.cli.segments import numbered_path
from truenewton.records.file import write_campaign

K = -1e-3  # [1/K] of all actuators


def day(number, temperature, factor=1.0):
    """Return cycles of three segments on a day; (42,) factors of alpha, in the order of ID."""
    made = []
    for k, campaign in enumerate(pieces(3)[0]):
        change = (1 + K * (temperature - 14.0)) * np.broadcast_to(factor, 42)[14 * k : 14 * k + 14]
        random = np.random.default_rng([number, k])
        cycles = [
            replace(
                c,
                date=c.date + datetime.timedelta(days=number),
                force=np.asarray(c.force) / change + 1e-5 * random.standard_normal(c.force.shape),
                temperature=np.full(len(c.time), temperature),
            )
            for c in campaign
        ]
        made.append(replace(campaign, cycles=tuple(cycles)))
    return in_one(made)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("segments") / "day"
    write_campaign(day(0, 14.0), path)
    return path


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory):
    """A campaign in which segment 2 has no forces."""
    path = tmp_path_factory.mktemp("segments") / "spoilt"
    write_campaign(
        [replace(c, force=np.where(c.layout.segment == 2, 0.0, c.force)) for c in day(0, 14.0)],
        path,
    )
    return path


@pytest.mark.parametrize(
    ("name", "numbered"),
    [
        ("alpha.fits", "alpha-3.fits"), ("a/alpha.new.fits.gz", "a/alpha.new-3.fits.gz"),
        ("page.html", "page-3.html"), ("out", "out-3"), ("2026.05.06", "2026.05.06-3"),
    ],
)  # fmt: skip
def test_names_have_the_number_before_their_ending(name, numbered):
    assert numbered_path(Path(name), 3) == Path(numbered)


def test_each_segment_has_its_calibration_and_its_report(folder, inside, tmp_path, monkeypatch):
    alpha, page = tmp_path / "alpha.fits", tmp_path / "page.html"
    some = tmp_path / "some.fits"
    assert inside("calibrate", folder, "-o", some, "--exclude", "103,201")[0] == 0
    said = inside.prints("calibrate", folder, "-o", alpha)
    assert [line for line in said.splitlines() if line.startswith("segment")] == [
        "segment 1", "segment 2", "segment 3",
    ]  # fmt: skip
    off = {1: [103], 2: [201], 3: []}
    for number, ids in off.items():
        made = tn.read_calibration(tmp_path / f"some-{number}.fits")
        data = tn.read(folder, segment=number)
        assert np.array_equal(made.alpha, tn.calibrate(data, exclude=ids).alpha, equal_nan=True)
        assert made.layout.id[np.isnan(made.alpha)].tolist() == ids
    then = f"truenewton report {folder} --segment 3 --calibration {tmp_path / 'alpha-3.fits'}"
    assert f"next: {then} -o report.html" in said
    assert inside("report", folder, "--calibration", alpha, "-o", page)[0] == 0
    assert "TEST segment 2" in (tmp_path / "page-2.html").read_text()
    assert inside("report", folder, "--segment", 2, "-o", page, "-q")[1] == f"written: {page}\n"
    monkeypatch.setattr(figures, "write_figures", lambda _, path, **__: [path])
    assert inside("figures", folder, "-q", "-o", tmp_path / "f")[1].splitlines() == [
        f"written: {tmp_path / f'f-{number}'}" for number in (1, 2, 3)
    ]


def test_an_output_of_all_segments_may_exist_if_that_of_each_does_not(folder, inside, tmp_path):
    alpha = tmp_path / "alpha.fits"
    assert inside("calibrate", folder, "-q", "--segment", 2, "-o", alpha)[0] == 0
    assert inside("calibrate", folder, "-q", "--segment", 2, "-o", alpha)[0] == 2
    written = "".join(f"written: {tmp_path / f'alpha-{k}.fits'}\n" for k in (1, 2, 3))
    assert inside("calibrate", folder, "-q", "-o", alpha) == (0, written, "")
    code, _, wrong = inside("calibrate", folder, "-q", "-o", alpha)
    assert (code, wrong.count("exists already")) == (2, 3)


@pytest.mark.parametrize("words", [
    ("report", "page.html"), ("figures", "figures"), ("modes", "modes.fits"),
    ("track", "law.fits"), ("recalibrate", "new.fits", "--known", "law.fits", "--actuators", "201"),
    ("compare", "change.fits"),
])  # fmt: skip
def test_segments_are_taken_in_turn_though_the_output_of_all_exists(
    words, folder, inside, tmp_path, monkeypatch
):
    (tmp_path / words[1]).touch()
    command, output, *options = words
    in_turn = mock.Mock(return_value=0)
    monkeypatch.setattr(segments, "_in_turn", in_turn)
    data = (folder, folder) if command == "compare" else (folder,)
    assert inside(command, *data, "-o", tmp_path / output, *options) == (0, "", "")
    assert in_turn.called


def test_a_segment_that_is_refused_does_not_stop_the_others(spoilt, inside, tmp_path):
    code, said, wrong = inside("calibrate", spoilt, "-o", tmp_path / "alpha.fits")
    assert (code, wrong.count("\n")) == (2, 1)
    assert wrong.startswith("truenewton: segment 2: ")
    assert "FORCE is zero throughout" in wrong
    assert [path.name for path in sorted(tmp_path.glob("alpha*"))] == [
        "alpha-1.fits", "alpha-3.fits",
    ]  # fmt: skip
    code, said, _ = inside("calibrate", spoilt, "--json")
    values = checked(said)
    assert (code, values["schema"]) == (2, "truenewton.segments/2")
    assert [one["segment"] for one in values["segments"]] == [1, 2, 3]
    assert "FORCE is zero" in values["segments"][1]["error"]
    assert values["segments"][2]["result"]["schema"] == "truenewton.calibrate/2"
    assert inside("calibrate", spoilt, "--segment", 3)[0] == 0
    wrong = inside.refuses("calibrate", spoilt, "--segment", 4)
    assert "there is no segment 4; choose 1, 2, 3" in wrong


def test_an_actuator_of_no_segment_is_unknown(folder, inside):
    wrong = inside("calibrate", folder, "--exclude", "103,999")[2]
    assert wrong.count("there is no actuator 999; IDs run from") == 3


def test_each_segment_is_tracked_and_recalibrated(folder, inside, tmp_path):
    """By its law, and by its part of a reference of all; one actuator was replaced."""
    later, after = tmp_path / "later", tmp_path / "after"
    write_campaign(day(30, 22.0), later)
    said = inside.prints("track", folder, later, "-o", tmp_path / "law.fits")
    assert said.count(": 2 calibrations, ") == 3
    for number in (1, 2, 3):
        law = tn.read_tracking(tmp_path / f"law-{number}.fits")
        assert law.instrument == f"TEST segment {number}"
        assert np.array_equal(law.alpha, tn.track(folder, later, segment=number).alpha)
        assert np.mean(law.coefficient) == pytest.approx(K, rel=0.1)
    factor = np.ones(42)
    factor[4] = 0.8  # actuator 105
    bare = [c for c in day(20, 17.0, factor) if c.load.key == "bare"]
    write_campaign(bare, after)
    words = ("recalibrate", after, "--known", tmp_path / "law.fits", "--actuators")
    inside.prints(*words, 105, "-o", tmp_path / "new.fits")
    for number in (1, 2, 3):
        run = tn.read(after, segment=number)
        alone = tn.recalibrate(run, tmp_path / f"law-{number}.fits", [105] if number == 1 else [])
        made = tn.read_calibration(tmp_path / f"new-{number}.fits")
        assert made.method == "ml, recalibrated"
        assert np.array_equal(made.alpha, alone.calibration.alpha)
    values = checked(inside(*words, "auto", "--json")[1])
    moved = [[one["actuator"] for one in of["result"]["moved"]] for of in values["segments"]]
    assert moved == [[105], [], []]
    assert "law.fits: cannot be read" in inside.refuses(*words, 105, "--segment", 1)
    known = ("--known", tmp_path / "law-1.fits", "--actuators", 105, "--segment", 1)
    assert inside("recalibrate", after, *known)[0] == 0
