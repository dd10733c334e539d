"""HDF5: cycle files under the names of the FITS contract, and streams of raw samples."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from helpers.comparison import same
from truenewton.errors import FormatError, OutputFailed, UnreadableFile
from truenewton.files import stored_rows
from truenewton.files.hdf5 import Hdf5Rows
from truenewton.records import reader
from truenewton.records.file import write_campaign

h5py = pytest.importorskip("h5py", reason="h5py, extra `hdf5`, is missing")


@pytest.fixture(scope="module")
def cycles():
    """Four cycles with all columns."""
    random = np.random.default_rng(5)
    campaign, _ = campaign_of(seed=3, noise=1e-4, cycles=2, disabled=(5,), invalid=(3,))
    return tuple(
        replace(
            cycle,
            position=1e-8 * random.standard_normal(cycle.force.shape),
            temperature=20.0 + random.standard_normal(len(cycle.time)),
            coil_gradient=600.0,
        )
        for cycle in campaign
    )


@pytest.fixture
def folder(cycles, tmp_path):
    """The cycles as HDF5."""
    for k, cycle in enumerate(cycles):
        tn.write_cycle(cycle, tmp_path / f"c{k}.h5")
    return tmp_path


def test_a_cycle_comes_back_as_it_was(cycles, folder):
    for k, cycle in enumerate(cycles):
        back = tn.read(folder / f"c{k}.h5").cycles[0]
        assert same(replace(back, source=None), cycle)
        assert len(back.source.sha256) == 64
    with h5py.File(folder / "c3.h5") as file:  # names and units are those of FITS
        assert (file.attrs["LOAD"], file.attrs["WEIGHT"]) == (cycles[3].load.name, cycles[3].weight)
        force = file["MEASUREMENTS/FORCE"]
        assert force.attrs["unit"] == "N"
        assert force.chunks is not None
        assert force.fletcher32
        assert set(file["ACTUATORS"]) == {"ID", "X", "Y", "NZ", "ENABLED"}
    tn.write_cycle(cycles[0], folder / "again.hdf5")
    assert (folder / "again.hdf5").read_bytes() == (folder / "c0.h5").read_bytes()


def test_a_campaign_is_calibrated_as_from_fits(cycles, folder, tmp_path, monkeypatch):
    write_campaign(cycles, tmp_path / "fits")
    one = tn.calibrate(tn.read(tmp_path / "fits"), "svd")
    for in_memory, kind in ((2**28, np.ndarray), (-1, Hdf5Rows)):
        monkeypatch.setattr(reader, "IN_MEMORY", in_memory)
        monkeypatch.setattr(stored_rows, "BLOCK_BYTES", 800)
        campaign = tn.read(folder)  # its .h5 files; the folder in it is none
        assert isinstance(campaign.cycles[0].force, kind)
        other = tn.calibrate(campaign, "svd")
        for name in ("alpha", "statistical_error", "cycle_error"):
            wanted = pytest.approx(getattr(one, name), rel=1e-9, nan_ok=True)
            assert getattr(other, name) == wanted


def test_rows_are_those_of_the_array(cycles, folder, monkeypatch):
    monkeypatch.setattr(reader, "IN_MEMORY", -1)
    with h5py.File(folder / "c0.h5", "r+") as file:  # packed, in single precision, in mN
        force = file["MEASUREMENTS/FORCE"][()]
        del file["MEASUREMENTS/FORCE"]
        packed = file["MEASUREMENTS"].create_dataset(
            "force", data=(1e3 * force).astype(">f4"), chunks=(5, 4), compression="gzip"
        )
        packed.attrs["units"] = b"mN"
    stored = tn.read(folder / "c0.h5").cycles[0].force
    wanted = 1e-3 * (1e3 * force).astype(np.float32).astype(float)
    backwards, none = slice(None, None, -1), slice(4, 4)
    for rows in (slice(None), slice(3, 11), backwards, none, 5, -1, [7, 8, 3, 3, 0, 1]):
        assert stored[rows].shape == wanted[rows].shape
        assert stored[rows] == pytest.approx(wanted[rows], rel=1e-15, nan_ok=True)


def cut(path):
    path.write_bytes(path.read_bytes()[:9000])


def spoil(path):
    raw = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        at = file["MEASUREMENTS/FORCE"].id.get_chunk_info(0).byte_offset
    raw[at + 100] ^= 1
    path.write_bytes(raw)


def edited(change):
    def edit(path):
        with h5py.File(path, "r+") as file:
            change(file)

    return edit


def elsewhere(file):
    del file["MEASUREMENTS/FORCE"]
    file["MEASUREMENTS/FORCE"] = h5py.ExternalLink("other.h5", "/FORCE")


def shorter(file):
    del file["MEASUREMENTS/TIME"]
    file["MEASUREMENTS/TIME"] = np.arange(3.0)


FAULTS = {
    "cut short": (cut, UnreadableFile, "is damaged or truncated; fetch it again"),
    "a byte": (spoil, UnreadableFile, "is damaged or truncated; fetch it again"),
    "not HDF5": (lambda p: p.write_bytes(b"x" * 99), UnreadableFile, "is not an HDF5 file; fetch"),
    "no weight": (edited(lambda f: f.attrs.pop("WEIGHT")), FormatError, "has no WEIGHT; add it"),
    "no unit": (
        edited(lambda f: f["MEASUREMENTS/FORCE"].attrs.pop("unit")),
        FormatError,
        "column FORCE of MEASUREMENTS declares no unit; declare N",
    ),
    "elsewhere": (edited(elsewhere), FormatError, "MEASUREMENTS/FORCE stands in another file; w"),
    "shorter": (
        edited(shorter),
        FormatError,
        "of MEASUREMENTS has .* rows, other columns .*; end the recording cleanly",
    ),
}


@pytest.mark.parametrize(("spoilt", "kind", "line"), FAULTS.values(), ids=FAULTS)
def test_a_spoilt_file_is_refused_in_one_line(folder, spoilt, kind, line):
    spoilt(folder / "c1.h5")
    with pytest.raises(kind, match=rf"c1.h5: .*{line}"):
        tn.read(folder)


def test_damage_is_found_where_rows_stay_in_the_file(folder, monkeypatch):
    monkeypatch.setattr(reader, "IN_MEMORY", -1)
    spoil(folder / "c1.h5")
    with pytest.raises(UnreadableFile, match=r"c1.h5: /MEASUREMENTS/FORCE is damaged; fetch"):
        tn.read(folder)


def test_a_file_that_changes_while_in_use_is_refused(folder, monkeypatch):
    monkeypatch.setattr(reader, "IN_MEMORY", -1)
    campaign = tn.read(folder)
    os.utime(folder / "c1.h5", ns=(1, 1))
    with pytest.raises(UnreadableFile, match=r"c1.h5: was changed while it was in use; "):
        tn.calibrate(campaign)


def test_without_h5py_the_extra_is_named(cycles, folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(UnreadableFile, match=r"c0.h5: is HDF5, .*'truenewton\[hdf5\]'"):
        tn.read(folder)
    with pytest.raises(OutputFailed, match=r"x.h5: .*'truenewton\[hdf5\]'"):
        tn.write_cycle(cycles[0], folder / "x.h5")
