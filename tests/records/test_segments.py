"""Mirrors in several segments: each balances by itself, and files hold them together."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.segmented import in_one, pieces
from truenewton.errors import CampaignMismatch, FormatError, GeometryError
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


def test_files_of_single_segments_make_the_mirror(cycles, tmp_path):
    """In any order, of some segments or of one; where one has two, they are its campaign."""
    with pytest.raises(CampaignMismatch, match="3 segments, which balance separately"):
        Campaign(tuple(cycles))
    whole = tn.SegmentedData(tuple(cycles))
    for number in (3, 1, 2):
        one = [c for c in whole.part(number) if number != 2 or c.number < 2]
        write_campaign(one, tmp_path / f"s{number}")
    write_campaign([c for c in cycles if c.number > 1], tmp_path / "whole")
    parts = tn.read(*(tmp_path / f"s{number}" for number in (3, 1)))
    assert (parts.numbers, parts.instrument) == ((1, 3), whole.instrument)
    assert parts.layout.id.tolist() == [
        *whole.part(1).layout.id.tolist(), *whole.part(3).layout.id.tolist()
    ]  # fmt: skip
    for mine, yours in zip(parts.part(3), whole.part(3), strict=True):
        assert np.array_equal(mine.force, yours.force)
        assert mine.instrument == yours.instrument
    both = tn.read(tmp_path / "s2", tmp_path / "whole")
    assert both.numbers == (1, 2, 3)
    assert len(both.part(2)) == len(whole.part(2))
    assert both.instrument == whole.instrument
    alone = tn.read(tmp_path / "s2")
    assert isinstance(alone, tn.Campaign)
    other = replace(alone.cycles[0], instrument="OTHER")
    with pytest.raises(CampaignMismatch, match=r"is of TEST, .* of OTHER"):
        tn.SegmentedData((other, *whole.part(1)))


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
