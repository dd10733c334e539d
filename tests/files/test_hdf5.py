"""HDF5: cycle files under the names of the FITS contract, and streams of raw samples."""

import os
import pickle
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from helpers.comparison import same
from helpers.raw_samples import stream
from truenewton.errors import FormatError, OutputFailed, TrueNewtonError, UnreadableFile
from truenewton.files import stored_rows
from truenewton.files.hdf5 import Hdf5Rows
from truenewton.files.stored_rows import columns_of
from truenewton.records import reader
from truenewton.records.file import write_campaign
from truenewton.records.reader import open_by_worker
from truenewton.records.samples import AveragedRows

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


@pytest.mark.parametrize("block", [3000, 1], ids=["in blocks", "by batches"])
def test_samples_are_averaged_as_numpy_does(cycles, tmp_path, monkeypatch, block):
    monkeypatch.setattr(stored_rows, "BLOCK_BYTES", block)
    samples, rows = stream(cycles[0], tmp_path / "raw.h5")
    found = tn.averaged(tmp_path / "raw.h5")
    assert found.number.tolist() == [len(row) for row in rows]
    for name in ("FORCE", "POSITION"):
        mean = np.array([samples[name][row].mean(axis=0) for row in rows])
        variance = np.array([samples[name][row].var(axis=0, ddof=1) for row in rows])
        assert getattr(found.cycle, name.lower()) == pytest.approx(
            mean, rel=1e-11, abs=1e-18, nan_ok=True
        )
        assert getattr(found, f"{name.lower()}_variance") == pytest.approx(
            variance, rel=1e-9, nan_ok=True
        )
    assert found.cycle.time == pytest.approx([samples["TIME"][row].mean() for row in rows])
    assert (found.cycle.shape == cycles[0].shape[cycles[0].valid]).all()
    assert (found.cycle.sign == cycles[0].sign[cycles[0].valid]).all()


def test_forcerr_is_that_of_a_mean_whatever_hangs_together(cycles, tmp_path):
    """White samples: noise over the root of the number; slow ones: more, which batches see."""
    stream(cycles[0], tmp_path / "raw.h5", per_row=400, noise=1e-3)
    white = tn.averaged(tmp_path / "raw.h5").cycle.force_error
    assert white == pytest.approx(1e-3 / np.sqrt(404), rel=0.03)
    with h5py.File(tmp_path / "raw.h5", "r+") as file:
        force, random = file["SAMPLES/FORCE"], np.random.default_rng(2)
        slow = np.repeat(random.standard_normal((len(force) // 10 + 1, 14)), 10, axis=0)
        force[...] += 1e-3 * slow[: len(force)]
    slow_too = tn.averaged(tmp_path / "raw.h5").cycle.force_error
    assert slow_too == pytest.approx(1e-3 * np.sqrt((1 + 10) / 404), rel=0.1)


def test_streams_are_calibrated_like_cycle_files(cycles, tmp_path, inside):
    for k, cycle in enumerate(cycles):
        stream(cycle, tmp_path / f"c{k}.h5", noise=1e-5, seed=k)
        edited(lambda file: file["SAMPLES"].pop("POSITION"))(tmp_path / f"c{k}.h5")
    code, _, err = inside("calibrate", tmp_path, "-o", tmp_path / "alpha.fits")
    assert (code, err) == (0, "")
    plain = tn.calibrate(tn.Campaign(tuple(replace(c, position=None) for c in cycles)))
    made = tn.read_calibration(tmp_path / "alpha.fits")
    apart = (made.alpha - plain.alpha) / plain.statistical_error
    assert np.nanmax(np.abs(apart)) < 1.0
    assert inside("info", tmp_path / "c0.h5")[0] in (0, 1, 2)


def test_a_stream_may_be_larger_than_memory(cycles, tmp_path, monkeypatch):
    monkeypatch.setattr(stored_rows, "BLOCK_BYTES", 2**16)
    samples, _ = stream(cycles[0], tmp_path / "raw.h5", per_row=600)
    size = 2 * samples["FORCE"].nbytes
    names = str(tmp_path / "raw.h5"), "raw.h5"
    tn.averaged(names[0])
    for read in (lambda: tn.averaged(names[0]), lambda: open_by_worker(names)):
        tracemalloc.start()
        made = read()
        np.asarray(made.cycle.force)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 0.6 * size
    assert size > 3e6
    assert isinstance(made.cycle.force, AveragedRows)
    assert len(pickle.dumps(made)) < 0.002 * size  # what a worker says of it


def test_means_left_in_the_file_are_those_of_one_reading(cycles, tmp_path, monkeypatch):
    """Whatever rows and columns are asked for, in whatever order, to the last bit."""
    monkeypatch.setattr(stored_rows, "BLOCK_BYTES", 3000)
    stream(cycles[0], tmp_path / "raw.h5")
    whole = tn.averaged(tmp_path / "raw.h5").cycle
    left = open_by_worker((str(tmp_path / "raw.h5"), "raw.h5")).require_cycle()
    assert left.force_error == whole.force_error
    assert left.largest_force == whole.largest_force
    columns = np.arange(14) % 3 == 1  # without the disabled one
    for name in ("force", "position"):
        means, rows = getattr(whole, name), getattr(left, name)
        assert isinstance(rows, AveragedRows)
        assert np.array_equal(rows, means, equal_nan=True)
        assert np.array_equal(rows[3], means[3], equal_nan=True)
        for some in (slice(4, 9), [5, 2, 3, 2], slice(0, 0)):
            assert np.array_equal(rows[some], means[some], equal_nan=True)
            chosen = columns_of(rows, columns)[some]
            assert np.array_equal(chosen, means[some][:, columns])
    moved = replace(left.position, in_unit=lambda values: values - 1.0)
    assert np.array_equal(moved[:3], whole.position[:3] - 1.0)


def without_shapes(file):
    file["SAMPLES/SHAPE"][...] = 0


WRONG = {
    "no shape": (without_shapes, "SAMPLES has no valid sample of a shape; count shapes from 1"),
    "both": (lambda f: f.create_group("MEASUREMENTS"), "there are both MEASUREMENTS and SAMPLES"),
}


@pytest.mark.parametrize(("change", "line"), WRONG.values(), ids=WRONG)
def test_a_spoilt_stream_is_refused(cycles, tmp_path, change, line):
    stream(cycles[0], tmp_path / "raw.h5")
    edited(change)(tmp_path / "raw.h5")
    with pytest.raises(TrueNewtonError, match=rf"raw.h5: {line}"):
        tn.read(tmp_path / "raw.h5")


def test_averaged_takes_streams_only(folder):
    with pytest.raises(FormatError, match=r"c0.h5: there is no table SAMPLES; .*`read` takes"):
        tn.averaged(folder / "c0.h5")
