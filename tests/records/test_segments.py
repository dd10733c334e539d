"""Mirrors in several segments: files hold them together, and data of one are read at a time."""

import datetime
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.segmented import in_one, pieces
from truenewton.errors import (
    CampaignMismatch,
    FormatError,
    GeometryError,
    SeveralSegments,
    UnknownName,
)
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.file import cycle_from, write_campaign, write_cycle
from truenewton.statics.layout import layout


@pytest.fixture(scope="module")
def three():
    return pieces(3)


@pytest.fixture(scope="module")
def cycles(three):
    return in_one(three[0])


@pytest.fixture
def path(cycles, tmp_path):
    """A cycle file of three segments, under the ring."""
    write_cycle(cycles[-1], tmp_path / "ring.fits")
    return tmp_path / "ring.fits"


def test_a_file_gives_back_what_each_segment_was(three, cycles, path):
    made = cycle_from(read_fits(path))
    assert made.segments == cycles[-1].segments
    assert made.layout.same_as(cycles[-1].layout)
    for number, campaign in enumerate(three[0], 1):
        own, alone = made.of_segment(number), campaign.cycles[-1]
        order = np.argsort(own.layout.id)
        assert not own.layout.segments
        for name in ("x", "y", "nz", "id"):
            assert np.array_equal(getattr(own.layout, name)[order], getattr(alone.layout, name))
        assert np.array_equal(np.asarray(own.force)[:, order], alone.force)
        assert np.array_equal(own.used_force[:, order], alone.used_force)
        assert (own.weight, own.weight_error) == (alone.weight, alone.weight_error)
        assert own.load == alone.load


def test_weights_leave_the_header(path):
    assert not {"WEIGHT", "E_WEIGHT", "ADDED", "E_ADDED"} & set(fits.getheader(path))
    fits.setval(path, "WEIGHT", value=-7.0)
    with pytest.raises(FormatError, match="WEIGHT are both in the primary header and in SEG"):
        cycle_from(read_fits(path))


def change_segments(path, change):
    """Rewrite a file with its table SEGMENTS changed, or without it."""
    with fits.open(path) as hdus:
        kept = [hdu.copy() for hdu in hdus if hdu.name != "SEGMENTS"]
        if change is not None:
            kept.append(fits.BinTableHDU(change(hdus["SEGMENTS"].data.copy()), name="SEGMENTS"))
            for column in ("WEIGHT", "E_WEIGHT", "ADDED", "E_ADDED"):
                kept[-1].columns[column].unit = "N"
    fits.HDUList(kept).writeto(path, overwrite=True)


def with_value(column, row, value):
    def change(data):
        data[column][row] = value
        return data

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (None, "ACTUATORS has 3 segments, and their weights are not given"),
        (lambda data: data[:2], "SEGMENTS has no row of 1 segment: 3"),
        (lambda data: data[:0], "SEGMENTS has no rows"),
        (with_value("SEGMENT", 2, 7), "row of segment 7, which has no actuators"),
        (with_value("SEGMENT", 2, 1), "segment 1 is twice in SEGMENTS"),
        (with_value("WEIGHT", 1, 0.0), "WEIGHT is 0 N of segment 2"),
        (with_value("ADDED", 0, 0.1), "ADDED is 0.1 N of segment 1"),
        (with_value("E_ADDED", 0, -0.1), "E_ADDED is -0.1 of segment 1"),
    ],
)
def test_weights_that_cannot_be_are_refused_in_one_line(path, change, words):
    change_segments(path, change)
    with pytest.raises(FormatError, match=words) as refused:
        cycle_from(read_fits(path))
    assert str(refused.value).startswith(str(path))


def test_one_segment_is_a_mirror_in_one_piece(three, tmp_path):
    one = three[0][0].cycles[0]
    same = replace(one.layout, segment=np.full(one.layout.n, 4))
    assert same.segments == ()
    assert same.same_as(one.layout)
    write_cycle(replace(one, layout=same), tmp_path / "one.fits")
    made = cycle_from(read_fits(tmp_path / "one.fits"))
    assert (made.weight, made.segments) == (one.weight, ())
    assert np.array_equal(made.layout.segment, same.segment)
    assert len(Campaign((made,))) == 1


def test_one_segment_is_read_from_files_of_all_or_of_single_ones(three, cycles, tmp_path):
    """In any order, of some segments or of one; where one has two, they are its campaign."""
    alone = {k: [c.of_segment(k) for c in cycles if k != 2 or c.number < 2] for k in (1, 2, 3)}
    for number, own in alone.items():
        write_campaign(own, tmp_path / f"s{number}")
    write_campaign([c for c in cycles if c.number > 1], tmp_path / "whole")
    for folders, number, count in (
        (("s3", "s1"), 1, 4), (("s3", "s1"), 3, 4), (("s2", "whole"), 2, 4), (("s2",), 2, 2),
        (("whole", "s2"), 3, 2),
    ):  # fmt: skip
        found = tn.read_campaign(*(tmp_path / name for name in folders), segment=number)
        assert (len(found), found.instrument) == (count, f"TEST segment {number}")
        for cycle in found:
            name = cycle.load.key, cycle.number
            (mine,) = [c for c in cycles if (c.load.key, c.number) == name]
            assert np.array_equal(cycle.force, mine.of_segment(number).force)
    for paths in ([tmp_path / "whole"], [tmp_path / "s3", tmp_path / "s1"]):
        with pytest.raises(SeveralSegments, match=r"read the files with segment=1, or use of_seg"):
            tn.read(*paths)
    with pytest.raises(SeveralSegments, match=r"bare-002.fits: contains segments 1 to 3, each of"):
        tn.calibrate(tmp_path / "whole")
    with pytest.raises(UnknownName, match=r"bare-001.fits: there is no segment 9; choose 1, 3"):
        tn.read(tmp_path / "s3", tmp_path / "s1", segment=9)
    assert isinstance(tn.read(tmp_path / "s2"), tn.Campaign)


def test_files_that_do_not_belong_together_are_refused(three, cycles, tmp_path):
    alone = [cycles[0].of_segment(k) for k in (1, 2)]
    with pytest.raises(CampaignMismatch, match="3 segments, which balance separately; take one"):
        Campaign(tuple(cycles))
    with pytest.raises(CampaignMismatch, match=r"is of OTHER, .* of TEST"):
        tn.calibrate([alone[0], replace(alone[1], instrument="OTHER")])
    whole = replace(alone[1], layout=replace(alone[1].layout, segment=None))
    with pytest.raises(FormatError, match="has no segment, and other files have; add the column"):
        tn.calibrate([alone[0], whole])
    write_cycle(whole, tmp_path / "one.fits")
    with pytest.raises(UnknownName, match="no segment 2; the mirror is in one piece: leave the"):
        tn.read(tmp_path / "one.fits", segment=2)
    first, *others = cycles
    own = first.segments
    shifted = (
        own[0]._replace(weight=own[0].weight - 0.1), own[1]._replace(weight=own[1].weight + 0.1),
        own[2],
    )  # fmt: skip
    write_campaign([replace(first, segments=shifted), *others], tmp_path / "shifted")
    with pytest.raises(CampaignMismatch, match=r"WEIGHT"):
        tn.read(tmp_path / "shifted", segment=1)
    assert len(tn.read(tmp_path / "shifted", segment=3)) == len(cycles)  # a body of its own


@pytest.fixture(scope="module")
def matrix():
    """A stiffness of two segments that touch nothing, with noise between them."""
    random, one = np.random.default_rng(3), tn.rings([0.05, 0.1], [6, 12])
    both = layout(np.append(one.x, one.x + 0.5), np.tile(one.y, 2), segment=np.repeat([1, 2], 18))
    blocks = np.kron(np.eye(2), np.ones((18, 18))) * random.standard_normal((36, 36))
    noise = 1e-3 * np.abs(blocks).max() * random.standard_normal((36, 36))
    date = datetime.datetime(2026, 5, 6, tzinfo=datetime.UTC)
    return tn.StiffnessMatrix("TWO", date, both, blocks + noise)


def test_a_segment_of_a_matrix_is_its_block(matrix, tmp_path):
    tn.write_stiffness(matrix, tmp_path / "k.fits")
    with pytest.raises(SeveralSegments, match=r"k.fits: contains segments 1, 2, each of which"):
        tn.read_stiffness(tmp_path / "k.fits")
    for number, own in ((1, slice(18)), (2, slice(18, 36))):
        one = tn.read_stiffness(tmp_path / "k.fits", segment=number)
        assert (one.instrument, one.layout.segments) == (f"TWO segment {number}", ())
        assert np.array_equal(one.stiffness, matrix.stiffness[own, own])
        tn.write_stiffness(one, tmp_path / "one.fits", overwrite=True)
        again = tn.read_stiffness(tmp_path / "one.fits", segment=number)
        assert again.instrument == one.instrument
    with pytest.raises(SeveralSegments, match="contains segments 1, 2"):
        tn.calibrate(matrix)


def test_what_couples_segments_is_told_from_noise(matrix):
    random, k = np.random.default_rng(4), matrix.stiffness
    joined = k.copy()
    link = 1e-3 * np.abs(k).max() * random.standard_normal((18, 18))
    joined[:18, 18:] += link
    joined[18:, :18] += link.T
    swapped = np.roll(k, 18, axis=0)
    for stiffness, coupled in ((k, False), (joined, True), (swapped + k, True)):
        for number in (1, 2):
            one = replace(matrix, stiffness=stiffness).of_segment(number)
            assert (one.coupling is not None) == coupled


def test_layouts_name_their_segments():
    place = {"x": [0.0, 0.1, 0.2, 0.3], "y": np.zeros(4)}
    made = layout(**place, segment=[2, 1, 2, 1])
    assert made.segments == (1, 2)
    assert "2 segments" in repr(made)
    assert made.part(made.segment == 2).x.tolist() == [0.0, 0.2]
    assert made.difference(layout(**place)) == "1 and 2 segments"
    assert made.difference(layout(**place, segment=[2, 2, 1, 1])) == (
        "SEGMENT of actuator 2 (row 2): 2 and 1; and 1 more"
    )
    with pytest.raises(GeometryError, match="SEGMENT is 0; segments count from 1"):
        layout(**place, segment=[0, 1, 0, 1])
    with pytest.raises(GeometryError, match="SEGMENT has shape"):
        layout(**place, segment=[1, 2])
    with pytest.raises(GeometryError, match="ID 7 occurs 2 times; give every actuator its own"):
        layout(**place, id=[7, 7, 8, 9], segment=[1, 2, 1, 2])
