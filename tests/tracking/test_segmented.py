"""Segments are tracked and recalibrated as if each were alone; one refused harms no other."""

import datetime
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.json_output import checked
from helpers.segmented import in_one, pieces
from truenewton.errors import CampaignMismatch, Fault, FormatError, RankDeficient, UnknownName
from truenewton.records.file import write_campaign
from truenewton.tracking.figures import tracking_figures

K = -1e-3  # [1/K] of all actuators
SETTINGS = ((0, 14.0), (30, 22.0), (60, 17.0))  # [d], [deg C]


def day(number, temperature, factor=1.0, seed=0):
    """Return the data of three segments on a day; (42,) factors of alpha, in the order of ID."""
    made = []
    for k, campaign in enumerate(pieces(3)[0]):
        change = (1 + K * (temperature - 14.0)) * np.broadcast_to(factor, 42)[14 * k : 14 * k + 14]
        random = np.random.default_rng([seed, number, k])
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
    return tn.SegmentedData(tuple(in_one(made)))


@pytest.fixture(scope="module")
def days():
    return [tn.calibrate(day(*setting)) for setting in SETTINGS]


@pytest.fixture(scope="module")
def law(days):
    return tn.track(*days)


@pytest.fixture(scope="module")
def files(days, tmp_path_factory):
    folder = tmp_path_factory.mktemp("days")
    paths = [folder / f"day{k}.fits" for k in range(len(days))]
    for one, path in zip(days, paths, strict=True):
        one.write(path)
    return paths


def without(day, number):
    """Return a calibration of which one segment was refused."""
    kept = {k: one for k, one in day.found.items() if k != number}
    return replace(day, found=kept, failed={number: (Fault("why", "do"),)})


def test_each_segment_is_tracked_as_if_alone(law, days):
    for number in (1, 2, 3):
        alone = tn.track(*days, segment=number)
        own = law.layout.segment == number
        assert np.array_equal(law.part(number).covariance, alone.covariance)
        assert np.array_equal(law.column("alpha")[own], alone.alpha)
        assert np.array_equal(law.column("coefficient")[own], alone.coefficient)
        assert np.array_equal(law.column("errors.2")[own], alone.errors[2])
    assert np.mean(law.column("coefficient")) == pytest.approx(K, rel=0.1)
    assert len(tracking_figures(law)) == 3 * len(tracking_figures(law.part(1)))


def test_a_segment_that_cannot_be_tracked_takes_no_other_down(days, law):
    made = tn.track(without(days[0], 2), *days[1:])
    assert set(made.failed) == {2}
    fault, remedy = made.failed[2][0]
    assert fault.endswith("segment 2 gave no alpha: why")
    assert fault.startswith(f"{days[0].instrument} of ")  # which day it is
    assert remedy == "do"
    own = law.layout.segment == 2
    assert np.isnan(made.column("alpha")[own]).all()
    assert np.array_equal(made.column("alpha")[~own], law.column("alpha")[~own])
    with pytest.raises(RankDeficient, match="no segment gives a law; segment 1: "):
        tn.track(days[0])


def test_days_that_do_not_belong_together_are_refused(days):
    other = replace(days[1], instrument="OTHER")
    with pytest.raises(CampaignMismatch, match="is of OTHER"):
        tn.track(days[0], other)
    with pytest.raises(FormatError, match="is of one body"):
        tn.track(days[0], days[1].part(1))
    with pytest.raises(RankDeficient, match="there is no calibration"):
        tn.track()


def test_the_tracking_file_gives_back_every_law(law, days, tmp_path):
    made = tn.track(without(days[0], 2), *days[1:])
    made.write(tmp_path / "law.fits")
    one = tn.read_tracking(tmp_path / "law.fits", segment=3)
    assert np.array_equal(one.covariance, law.part(3).covariance)
    assert one.date == law.part(3).date
    with pytest.raises(RankDeficient, match=r"law.fits: segment 2 gave no alpha: .* why"):
        tn.read_tracking(tmp_path / "law.fits", segment=2)
    with pytest.raises(FormatError, match="has 3 segments"):
        tn.read_tracking(tmp_path / "law.fits")
    with fits.open(tmp_path / "law.fits") as hdus:
        table, segments = hdus["LAW"].data, hdus["SEGMENTS"].data
        assert np.array_equal(table["K"], made.column("coefficient"), equal_nan=True)
        assert table["SEGMENT"].tolist() == law.layout.segment.tolist()
        assert segments["TEMPERAT"][0] == pytest.approx(np.mean([14.0, 22.0, 17.0]))
        assert segments["DATE-REF"][2] == hdus["TRACKING", 3].header["DATE-REF"]
    assert law.table.colnames[3:6] == ["SEGMENT", "ALPHA", "E_ALPHA"]


def test_the_command_tracks_all_segments(files, inside, tmp_path):
    words = ("track", *files, "-o", tmp_path / "law.fits", "--accuracy", 0.01)
    code, said, wrong = inside(*words)
    assert (code, wrong) == (0, "")
    assert "3 calibrations" in said.splitlines()[0]
    assert "of 3 segments" in said.splitlines()[0]
    assert said.count("no outliers") == 1
    assert "segments 1 to 3: no outliers" in said
    assert "segments 1 to 3: alpha of the latest calibration is valid to 1 %" in said
    code, said, _ = inside("track", *files, "--json")
    values = checked(said)
    assert values["schema"] == "truenewton.track-segments/2"
    assert [part["segment"] for part in values["segments"]] == [1, 2, 3]


def test_what_changed_is_told_by_segment(days, files, inside, tmp_path):
    """Each with a ratio of its own; one actuator of all reaches the limit by chance, not six."""
    other = days[2]
    alpha = other.found[2].alpha.copy()
    alpha[3] *= 1.05
    parts = dict(other.found) | {2: replace(other.found[2], alpha=alpha)}
    moved = tn.compare(days[0], replace(other, found=parts))
    alone = {n: tn.compare(days[0].found[n], parts[n]) for n in (1, 2, 3)}
    for number, part in alone.items():
        own = other.layout.segment == number
        assert np.array_equal(moved.sigmas[own], part.sigmas)
        assert moved.segments[number].ratio == part.ratio
        assert moved.limit > part.limit
    assert other.layout.id[moved.changed].tolist() == [other.found[2].layout.id[3]]
    page = tmp_path / "changed.html"
    code, said, _ = inside("report", files[0], files[2], "-o", page)
    assert code == 0
    assert "No change" in said
    assert "common ratios, second to first: 0.99" in said
    assert 'data-key="segment"' in page.read_text()
    lost = tn.compare(without(days[0], 3), other)
    assert set(lost.segments) == {1, 2}
    assert np.isnan(lost.sigmas[other.layout.segment == 3]).all()
    tn.write_report(page, lost, overwrite=True)
    assert "no alpha in one of them" in page.read_text()
    with pytest.raises(CampaignMismatch, match="the other of one body"):
        tn.compare(days[0], other.found[1])


@pytest.fixture(scope="module")
def after():
    """A short run, bare, after actuator 105 of segment 1 was replaced."""
    factor = np.ones(42)
    factor[4] = 0.8
    data = day(90, 17.0, factor)
    return replace(data, cycles=tuple(c for c in data.cycles if c.load.key == "bare"))


def test_each_segment_is_recalibrated_as_if_alone(after, days):
    made = tn.recalibrate(after, days[2], [105])
    assert {k: one.asked for k, one in made.found.items()} == {1: (105,), 2: (), 3: ()}
    for number in (1, 2, 3):
        named = [105] if number == 1 else []
        alone = tn.recalibrate(after.part(number), days[2], named)
        assert np.array_equal(made.part(number).calibration.alpha, alone.calibration.alpha)
        assert made.found[number].chi2 == alone.chi2
    new = made.layout.id == 105
    ratio = made.column("calibration.alpha") / days[2].column("alpha")
    assert ratio[new] == pytest.approx(0.8, abs=0.02)
    assert ratio[~new] == pytest.approx(1.0, abs=0.01)


def test_the_command_recalibrates_by_a_law_of_all_segments(after, files, days, inside, tmp_path):
    write_campaign(after.cycles, tmp_path / "after")
    tn.track(without(days[0], 3), *days[1:]).write(tmp_path / "law.fits")
    words = ("recalibrate", tmp_path / "after", "--known", tmp_path / "law.fits")
    code, said, _ = inside(*words, "--actuators", 105, "-o", tmp_path / "new.fits")
    assert code == 0
    assert "105" in said
    back = tn.read(tmp_path / "new.fits")
    assert set(back.failed) == {3}
    assert back.part(1).method == "ml, recalibrated"
    code, said, _ = inside(*words, "--actuators", "auto", "--json")
    values = checked(said)
    assert [one["actuator"] for one in values["segments"][0]["moved"]] == [105]
    assert values["segments"][2]["verdict"]["level"] == "no alpha"
    code, _, wrong = inside(*words, "--actuators", 999)
    assert code == 2
    assert "there is no actuator 999; IDs run from" in wrong
    assert inside(*words, "--actuators", 105, "--segment", 1)[0] == 0


def test_what_cannot_be_recalibrated_is_refused(after, days, files, tmp_path):
    with pytest.raises(UnknownName, match="999"):
        tn.recalibrate(after, files[0], [999])
    with pytest.raises(CampaignMismatch, match="is of OTHER"):
        tn.recalibrate(after, replace(days[0], instrument="OTHER"))
    days[0].part(1).write(tmp_path / "one.fits")
    with pytest.raises(FormatError, match="is of one body, and the run has 3 segments"):
        tn.recalibrate(after, tmp_path / "one.fits")
