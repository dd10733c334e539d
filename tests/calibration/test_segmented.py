"""Segments are calibrated as if each were alone; one that is refused harms no other."""

import os
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

import truenewton as tn
from helpers.json_output import checked
from helpers.segmented import in_one, pieces
from truenewton.calibration import figures
from truenewton.calibration.verdict import REGARDLESS, Level, without_unusable
from truenewton.calibration.workers import Processes
from truenewton.comparison.calibrations import compare_calibrations
from truenewton.errors import (
    CampaignMismatch,
    Fault,
    FormatError,
    RankDeficient,
    TrueNewtonWarning,
    UnknownName,
)
from truenewton.figures.maps import bears_names, dot_radius, segment_places
from truenewton.mirrors.known import p45
from truenewton.mirrors.segmented import gmt
from truenewton.modal.turbulence import pupil_of
from truenewton.progress import progress_to
from truenewton.records.file import write_campaign
from truenewton.records.segmented import segment_couplings
from truenewton.report.verdict import headline_of
from truenewton.rounding import numbered
from truenewton.statics.arms import enabled_arms


@pytest.fixture(scope="module")
def three():
    return pieces(3)[0]


@pytest.fixture(scope="module")
def data(three):
    return tn.SegmentedData(tuple(in_one(three)))


@pytest.fixture(scope="module")
def alone(three):
    return [tn.calibrate(campaign) for campaign in three]


@pytest.fixture(scope="module")
def whole(data):
    return tn.calibrate(data)


@pytest.fixture(scope="module")
def folder(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("segments") / "campaign"
    write_campaign(data.cycles, path)
    return path


def spoilt(data, number, change):
    """Return data whose FORCE of one segment is changed."""
    own = data.layout.segment == number
    return replace(
        data,
        cycles=tuple(
            replace(c, force=np.where(own, change(np.asarray(c.force)), c.force))
            for c in data.cycles
        ),
    )


def same(one, other):
    """Hold a calibration of a segment, its actuators in any order, against one of it alone."""
    order, there = np.argsort(one.layout.id), np.argsort(other.layout.id)
    for name in ("alpha", "error", "statistical_error", "systematic_error", "cycle_error"):
        mine, yours = getattr(one, name)[order], getattr(other, name)[there]
        assert mine == pytest.approx(yours, rel=1e-6, abs=1e-9), name
    for name in ("bias_force", "bias_force_error", "noise", "weight"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6), name
    assert one.torque_y == pytest.approx(other.torque_y, rel=1e-6, abs=1e-9)


def test_each_segment_is_calibrated_as_if_alone(whole, alone):
    assert whole.failed == {}
    for number, (other, truth) in enumerate(zip(alone, pieces(3)[1], strict=True), 1):
        same(whole.found[number], other)
        own = whole.layout.segment == number
        assert np.array_equal(whole.column("alpha")[own], whole.part(number).alpha)
        assert np.array_equal(whole.column("error")[own], whole.part(number).error)
        assert np.abs((other.alpha - truth[:14]) / other.error).max() < 5.0


def test_three_bodies_taken_for_one_are_not_sound(data):
    """One B and one pair of torques for all of them."""
    whole = replace(data.layout, segment=None)
    cycles = tuple(replace(c, layout=whole, segments=()) for c in data.cycles)
    assert tn.calibrate(tn.Campaign(cycles)).verdict.level != Level.SOUND


def test_a_segment_that_is_refused_does_not_change_the_others(data, alone):
    random = np.random.default_rng(1)
    wild = spoilt(data, 2, lambda force: random.permutation(force) * random.standard_normal())
    with pytest.warns(TrueNewtonWarning):
        made = tn.calibrate(wild)
    same(made.found[1], alone[0])
    same(made.found[3], alone[2])
    assert made.verdict.level == Level.USABLE
    assert made.verdict.faults[0].values["segments"] == [2]
    kept = without_unusable(made)
    assert set(kept.found) == {1, 3}
    assert np.isnan(kept.column("alpha")[data.layout.segment == 2]).all()
    with pytest.raises(RankDeficient, match="segment 2 gave no alpha"):
        kept.part(2)


def test_processes_and_files_give_the_same_result_and_the_same_refusals(data, alone, tmp_path):
    """One segment without actuators, one without forces, one that is sound."""
    off = replace(data.layout, enabled=data.layout.enabled & (data.layout.segment != 1))
    still = spoilt(
        replace(data, cycles=tuple(replace(c, layout=off) for c in data.cycles)), 3, np.zeros_like
    )
    made = tn.calibrate(still)
    assert set(made.failed) == {1, 3}
    assert "no actuator is ENABLED" in made.failed[1][0].fault
    assert "FORCE is zero throughout" in made.failed[3][0].fault
    same(made.found[2], alone[1])
    made.write(tmp_path / "alpha.fits.gz")
    parallel = tn.calibrate(still, processes=2)
    for other in (parallel, tn.read(tmp_path / "alpha.fits.gz")):
        for name in ("alpha", "error"):
            assert np.array_equal(other.column(name), made.column(name), equal_nan=True)
        assert other.failed == made.failed
        assert other.verdict == made.verdict
        assert other.layout.same_as(made.layout)
    assert not parallel.found[2].covariance.flags.writeable
    assert not parallel.found[2].layout.x.flags.writeable


def test_files_that_disagree_on_a_segment_are_refused(data):
    first, *others = data.cycles
    own = first.segments
    shifted = (
        own[0]._replace(weight=own[0].weight - 0.1), own[1]._replace(weight=own[1].weight + 0.1),
        own[2],
    )  # fmt: skip
    with pytest.raises(CampaignMismatch, match="WEIGHT or E_WEIGHT of segment 1"):
        tn.SegmentedData((replace(first, segments=shifted), *others))
    with pytest.raises(UnknownName, match="there is no segment 9; choose 1, 2, 3"):
        data.part(9)
    with pytest.raises(FormatError, match="in one piece"):
        tn.SegmentedData(data.part(1).cycles)
    bare = tuple(c for c in data.cycles if c.load.key == "bare")
    with pytest.raises(RankDeficient, match="no segment gives alpha; segment 1: "):
        tn.calibrate(tn.SegmentedData(bare))


def test_the_file_gives_back_everything(whole, tmp_path):
    whole.write(tmp_path / "alpha.fits")
    made = tn.read(tmp_path / "alpha.fits")
    assert isinstance(made, tn.Parts)
    assert np.array_equal(made.column("alpha"), whole.column("alpha"))
    assert made.layout.same_as(whole.layout)
    assert made.verdict == whole.verdict
    for number, one in whole.found.items():
        back = made.found[number]
        assert np.array_equal(back.covariance, one.covariance)
        assert (back.method, back.bias_force, back.instrument) == (
            one.method,
            one.bias_force,
            one.instrument,
        )
    table = QTable.read(tmp_path / "alpha.fits", hdu="ALPHA")
    assert table.colnames[:6] == ["ID", "X", "Y", "SEGMENT", "ALPHA", "E_ALPHA"]
    assert np.array_equal(table["ALPHA"], whole.column("alpha"))
    segments = QTable.read(tmp_path / "alpha.fits", hdu="SEGMENTS")
    assert segments["VERDICT"].tolist() == [str(one.verdict.level) for one in whole.found.values()]
    with fits.open(tmp_path / "alpha.fits") as hdus:
        assert hdus["CALIBRATION", 2].header["BIAS"] == whole.found[2].bias_force
        assert len(hdus["CALIBRATION", 3].data) == 14
    for name in ("a.csv", "a.ecsv", "a.npy"):
        whole.write(tmp_path / name)
    assert np.array_equal(np.load(tmp_path / "a.npy"), whole.column("alpha"))
    table = QTable.read(tmp_path / "a.ecsv")
    assert table.meta["VERDICT"] == str(whole.verdict.level)
    assert np.array_equal(table["SEGMENT"], whole.layout.segment)
    assert (tmp_path / "a.csv").read_text().startswith("ID,X,Y,SEGMENT,ALPHA,E_ALPHA")
    assert list(whole.table.colnames)[:5] == ["ID", "X", "Y", "SEGMENT", "ALPHA"]


def test_a_damaged_file_of_segments_is_refused_in_one_line(whole, tmp_path):
    path = tmp_path / "alpha.fits"
    whole.write(path)
    with fits.open(path) as hdus:
        kept = [hdu for hdu in hdus if (hdu.name, hdu.ver) != ("COVARIANCE", 2)]
        fits.HDUList(kept).writeto(tmp_path / "less.fits")
        kept = [hdu for hdu in hdus if hdu.ver != 2]
        fits.HDUList(kept).writeto(tmp_path / "none.fits")
        hdus["ALPHA"].data["ALPHA"][3] *= 1.01
        hdus.writeto(tmp_path / "other.fits")
    for name, words in (
        ("less", "of segment 2, there is no image COVARIANCE"),
        ("none", "does not name each segment"),
        ("other", "ALPHA is not that of the segments|DATASUM|CHECKSUM"),
    ):
        with pytest.raises(tn.errors.TrueNewtonError, match=words) as refused:
            tn.read(tmp_path / f"{name}.fits")
        assert str(refused.value).startswith(str(tmp_path))


@pytest.fixture(scope="module")
def two():
    """A stiffness of two segments, and of each alone."""
    random = np.random.default_rng(3)
    layout = tn.rings([0.05, 0.1], [6, 12])
    blocks = []
    for _ in range(2):
        a = enabled_arms(layout)
        out = np.eye(18) - np.linalg.pinv(a) @ a
        root = out @ random.standard_normal((18, 18))
        blocks.append(1e4 * root @ root.T / random.uniform(0.8, 1.2, 18)[:, None])
    n = 36
    stiffness = np.zeros((n, n))
    stiffness[:18, :18], stiffness[18:, 18:] = blocks
    both = tn.layout(
        np.concatenate([layout.x, layout.x + 0.5]),
        np.tile(layout.y, 2),
        segment=np.repeat([1, 2], 18),
    )
    date = pieces(1)[0][0].cycles[0].date
    alone = []
    for where, block in zip((slice(18), slice(18, 36)), blocks, strict=True):
        place = tn.layout(layout.x, layout.y, id=both.id[where])  # from its own middle
        alone.append(tn.StiffnessMatrix("ONE", date, place, block))
    return tn.StiffnessMatrix("TWO", date, both, stiffness), alone


def test_a_stiffness_is_calibrated_by_segment(two, tmp_path):
    matrix, alone = two
    tn.write_stiffness(matrix, tmp_path / "k.fits")
    made = tn.calibrate(tn.read(tmp_path / "k.fits"), "svd")
    for number, one in enumerate(alone, 1):
        other = tn.calibrate(one, "svd")
        assert made.found[number].alpha == pytest.approx(other.alpha, rel=1e-7)
        codes = {each.code for each in made.found[number].findings}
        assert tn.Code.SEGMENTS_COUPLED not in codes
    with pytest.raises(FormatError, match="of 2 segments, which balance separately"):
        tn.calibrate(matrix)


def test_what_couples_segments_is_told_from_noise(two):
    (matrix, _), random = two, np.random.default_rng(4)
    stiffness = matrix.stiffness
    size = 1e-3 * np.abs(stiffness).max()
    noisy = stiffness + size * random.standard_normal(stiffness.shape)
    joined = noisy.copy()
    joined[:18, 18:] += (link := size * random.standard_normal((18, 18)))
    joined[18:, :18] += link.T
    swapped = np.roll(noisy, 18, axis=0)
    for k, count in ((noisy, 0), (joined, 2), (swapped + noisy, 2)):
        assert len(segment_couplings(replace(matrix, stiffness=k))) == count
    made = tn.calibrate(tn.SegmentedData(stiffness=replace(matrix, stiffness=joined)), "svd")
    told = [each for each in made.verdict.faults if each.cause.code is tn.Code.SEGMENTS_COUPLED]
    assert [each.values["segments"] for each in told] == [[1, 2]]


@pytest.mark.study
def test_modes_of_segments_are_those_of_each_alone(two, inside, tmp_path):
    matrix, alone = two
    tn.write_stiffness(matrix, tmp_path / "k.fits")
    words = ("modes", tmp_path / "k.fits", "--anyway", "-o", tmp_path / "m.fits", "--off", 1)
    words += ("--diameter", 2.13)
    code, said, wrong = inside(*words)
    assert (code, wrong) == (0, "")
    assert "m-1.fits" in said
    for number, one in enumerate(alone, 1):
        whole, own = pupil_of(matrix.layout, 2.13), pupil_of(one.layout, 1.0)
        part = {"diameter": 2.13 * own.radius / whole.radius, "off": [1] if number == 1 else ()}
        other = tn.find_modes(one, accept_rejected=True, **part)
        with fits.open(tmp_path / f"m-{number}.fits") as hdus:
            budget = hdus["BUDGET"].data
        base = other.after.modes.stiffness
        assert budget["STIFFNESS"] == pytest.approx(base, rel=1e-6, abs=1e-6 * np.abs(base).max())
        assert budget["RESIDUAL"] == pytest.approx(other.after.costs[0].residual, rel=1e-6)
    code, _, wrong = inside(*words)
    assert code == 2
    assert "m-1.fits: exists already" in wrong
    with pytest.raises(UnknownName, match="there is no actuator 99"):
        tn.find_modes(tn.SegmentedData(stiffness=matrix), off=[99])


def test_modes_name_the_calibration_that_is_not_to_be_used(two, inside, tmp_path):
    """That of one segment beside the modes of the other; that of all is refused."""
    matrix, bad = tmp_path / "k.fits", tmp_path / "bad.fits"
    tn.write_stiffness(two[0], matrix)
    made = tn.calibrate(tn.read(matrix), "svd")
    turned = {k: replace(one, alpha=-one.alpha) for k, one in made.found.items()}
    replace(made, found={**made.found, 2: turned[2]}).write(bad)
    words = ("modes", matrix, "--calibration", bad)
    code, said, wrong = inside(*words)
    assert (code, wrong) == (0, "")
    (line,) = [line for line in said.splitlines() if "no modes" in line]
    negative = "rejected: alpha is negative for all 18 actuators; check order and sign of the rows"
    assert line.startswith(f"segment 2: no modes: {bad} gives no alpha: {negative}")
    assert line.endswith(REGARDLESS)
    assert "no modes" not in inside(*words, "--anyway")[1]
    replace(made, found=turned).write(bad, overwrite=True)
    code, _, wrong = inside(*words)
    assert code == 2
    assert wrong.startswith(f"truenewton: {bad}: rejected: segments 1, 2")


def test_commands_take_segments(folder, inside, tmp_path, monkeypatch):
    out = tmp_path / "alpha.fits"
    code, said, _ = inside("calibrate", folder, "-o", out)
    assert code == 0
    assert "of 3 segments" in said
    assert "segment 3" in said
    code, said, _ = inside("info", out)
    assert code == 0
    assert "a calibration of several segments" in said
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])
    for path in (out, folder):
        assert inside("figures", path, "-o", tmp_path / "figures")[1].startswith("  verdict  ")
    code, said, _ = inside("info", folder)
    assert code == 0
    assert "alpha is determined for 3" in said
    code, said, _ = inside("calibrate", folder, "--segment", 2, "-o", tmp_path / "two.fits")
    assert code == 0
    assert isinstance(tn.read(tmp_path / "two.fits"), tn.Calibration)
    code, _, wrong = inside("export", folder, "--calibration", out, "-o", tmp_path / "x.fits")
    assert code == 2
    assert wrong.count("\n") == 1
    assert "has 3 segments, and this takes one at a time; choose it by its number" in wrong
    assert isinstance(tn.read_calibration(out, segment=3), tn.Calibration)
    values = checked(inside("calibrate", folder, "--json")[1])
    assert values["schema"] == "truenewton.calibrate-segments/2"
    assert [part["segment"] for part in values["segments"]] == [1, 2, 3]
    assert len(values["actuators"]["alpha"]) == 42


def test_the_report_has_a_section_for_each_segment(data, inside, tmp_path):
    """Segment 3 without forces: its section names the reason."""
    bad, page = tmp_path / "alpha", tmp_path / "report.html"
    write_campaign(spoilt(data, 3, np.zeros_like).cycles, bad)
    code, said, _ = inside("report", bad, "-o", page)
    text = page.read_text()
    assert code == 0
    assert "Alpha of 2 of 3 segments" in said
    for number in (1, 2, 3):
        assert f'id="title-segment-{number}"' in text
        assert f'href="#title-segment-{number}"' in text
    assert 'data-key="segment"' in text
    assert "FORCE is zero throughout" in text


def test_the_report_counts_no_segment_that_is_not_to_be_used(whole):
    """Nor is the range of alpha that of wrong ones; where no other is, it is told as it is."""
    turned = {k: replace(one, alpha=-one.alpha) for k, one in whole.found.items()}
    one = headline_of(replace(whole, found={**whole.found, 2: turned[2]}))
    assert one.sentence.startswith("Alpha of 2 of 3 segments")
    assert [value.startswith("-") for _, value, _ in one.numbers] == [False] * 3
    every = headline_of(replace(whole, found=turned))
    assert every.level == Level.REJECTED
    assert every.numbers[0][1].startswith("-")


def test_figures_show_all_segments(whole):
    points, *_ = figures.plot_actuators(whole).lines
    assert points.get_ydata() == pytest.approx(whole.column("alpha"), rel=1e-15)
    names = {text.get_text() for text in whole.plot().texts}
    assert names >= {"1", "2", "3"}


def test_what_is_said_of_several_segments_is_said_once(data):
    """With the numbers of the first; what else differs, as names of actuators, stays apart."""
    made = tn.calibrate(data)
    same = {k: replace(one, systematic_error=0.3 * k * one.alpha, scale_errors=())
            for k, one in made.found.items()}  # fmt: skip
    [one] = [each for each in replace(made, found=same).verdict.faults
             if each.cause.code is tn.Code.SCALE_BY_WEIGHTS]  # fmt: skip
    assert one.fault.startswith("segments 1 to 3: the uncertainty of the common scale is 30 %")
    assert one.fault.endswith("(numbers of segment 1)")
    refused = {k: (Fault(f"actuator {k} is dead", "do"),) for k in (1, 2)}
    other = replace(made, found={3: made.found[3]}, failed=refused)
    assert [each.fault for each in other.verdict.faults][:2] == [
        "segment 1: actuator 1 is dead", "segment 2: actuator 2 is dead",
    ]  # fmt: skip
    assert numbered("segment", [1, 2, 3, 5, 7, 8]) == "segments 1 to 3, 5, 7, 8"


def test_segments_are_named_beside_their_actuators(whole):
    """No dot is hidden, and the nearest is one of their own; the middle one's has no hole."""
    wall = replace(
        whole.layout, x=whole.layout.x - whole.layout.x[whole.layout.segment == 1].mean()
    )
    for some in (gmt().layout, whole.layout, wall):
        places = segment_places(some)
        assert [number for number, _, _ in places] == list(some.segments)
        for number, x, y in places:
            own = some.segment == number
            near = np.hypot(1e3 * some.x - x, 1e3 * some.y - y)
            assert near.min() > 2 * dot_radius(some)
            assert own[near.argmin()]
    assert segment_places(whole.found[1].layout) == []
    one = p45().layout  # of two of them far apart dots are too small for names
    two = tn.layout(np.append(one.x, one.x + 0.5), np.tile(one.y, 2), segment=np.repeat([1, 2], 45))
    assert [bears_names(some) for some in (one, two)] == [True, False]


def test_the_bar_counts_segments(data):
    counts = []
    with progress_to(lambda what, *_: counts.append(what)):
        tn.calibrate(data)
    assert counts == [f"{done} of 3 segments" for done in range(4)]


def test_a_process_that_dies_and_a_call_that_fails_are_told():
    with pytest.raises(ChildProcessError, match="a process ended with 3"):
        list(Processes(1).map(os._exit, [3]))
    with pytest.raises(FileNotFoundError):
        list(Processes(1).map(os.listdir, ["/no/such/folder"]))
    assert list(Processes(2).map(abs, [-1, -2])) == [1, 2]


def test_a_segment_of_several_is_chosen_by_the_method_that_exists(whole, alone):
    with pytest.raises(CampaignMismatch, match=r"--segment, or part\(\.\.\.\) in Python"):
        compare_calibrations(whole, alone[0])
    assert compare_calibrations(whole.part(1), whole.part(1)).changed.size == 0
