"""Campaigns larger than memory: rows stay in their files, and nothing else changes."""

import dataclasses
import gc
import gzip
import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from astropy.io import fits

from helpers.balanced import arms_of, campaign_of
from helpers.comparison import same
from truenewton.calibration.methods import calibrate
from truenewton.errors import UnreadableFile
from truenewton.estimation.paper.equations import system_c
from truenewton.estimation.paper.svd import CycleErrors, from_rows
from truenewton.estimation.readings import repeats
from truenewton.estimation.readings import rows as row_blocks
from truenewton.estimation.readings.repeats import read_rows
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.files import stored_rows
from truenewton.files.stored_rows import StoredRows
from truenewton.reading import read, read_data
from truenewton.records import reader
from truenewton.records.file import write_campaign, write_cycle
from truenewton.statics.layout import rings


@pytest.fixture
def left_on_disk(monkeypatch):
    """Leave rows of every file on disk, and take few of them at once."""
    monkeypatch.setattr(reader, "IN_MEMORY", -1)
    for module in (stored_rows, repeats, row_blocks):
        monkeypatch.setattr(module, "BLOCK_BYTES", 800)


@pytest.fixture(scope="module", params=["ml", "svd"])
def method(request):
    """A method, each with its folder."""
    return request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory, method):
    """A campaign with all that may happen: gradients, positions, noises, bad rows.

    For ml outliers too, of which svd knows nothing.
    """
    outliers = method == "ml"
    random = np.random.default_rng(3)
    campaign, _ = campaign_of(seed=12, noise=1e-4, cycles=3, disabled=(5,), invalid=(3, 20))
    wrong, cycles = 0.02 * random.standard_normal(14), []
    for k, cycle in enumerate(campaign.cycles):
        force, position = cycle.force.copy(), 1e-7 * random.standard_normal(cycle.force.shape)
        force[7 + k, 2] += outliers * 0.05  # a spike against its repeats
        force[12] += outliers * (k < 3) * wrong  # in all repeats of a shape: against the balance
        position[[3, 20]] = np.nan
        cycles.append(
            replace(
                cycle,
                force=force,
                position=position,
                coil_gradient=600.0,
                bias_gradient=31.0 if k else None,
                force_error=(1e-4, 2e-4)[k % 2],
            )
        )
    path = tmp_path_factory.mktemp("stored") / "c"
    write_campaign(cycles, path)
    return path


def test_a_calibration_is_the_same_bit_for_bit(folder, monkeypatch, method):
    """From memory and from disk; blocks of another size change rounding only."""
    for module in (stored_rows, repeats, row_blocks):
        monkeypatch.setattr(module, "BLOCK_BYTES", 800)
    one = calibrate(read_data(folder), method)
    monkeypatch.setattr(reader, "IN_MEMORY", -1)
    campaign = read_data(folder)
    assert all(isinstance(c.force, StoredRows) for c in campaign.cycles)
    assert all(isinstance(c.position, StoredRows) for c in campaign.cycles)
    other = calibrate(campaign, method)
    assert same(one, other)
    if method == "ml":
        assert {row.against for row in one.rejected_rows} == {"repeats", "balance"}
    assert one.invalid == 12
    assert np.isnan(one.alpha[5])
    assert np.isfinite(one.cycle_error).sum() == 13
    for module in (stored_rows, repeats, row_blocks):
        monkeypatch.setattr(module, "BLOCK_BYTES", 2**24)
    large = calibrate(campaign, method)
    assert len(other.rejected_rows) == len(large.rejected_rows)
    for name in ("alpha", "statistical_error", "cycle_error"):
        assert getattr(other, name) == pytest.approx(getattr(large, name), rel=1e-8, nan_ok=True)


INDICES = (
    slice(None), slice(3, 11), slice(1, None, 3), slice(None, None, -1), slice(4, 4), slice(20, 99),
    5, -1, np.array([7, 8, 9, 3, 3, 23, 0, 1]), np.arange(24) % 5 < 2,
)  # fmt: skip


@pytest.mark.parametrize("form", ["D", "E"])
@pytest.mark.parametrize("far", [True, False], ids=["far apart", "side by side"])
def test_rows_are_those_of_the_array(tiny, tmp_path, left_on_disk, form, far):
    cycle = tiny.cycles[0]
    write_cycle(cycle, tmp_path / "c.fits")
    with fits.open(tmp_path / "c.fits") as hdus:
        columns = list(hdus["MEASUREMENTS"].columns)
        force = np.array(1e3 * cycle.force, dtype=np.float32 if form == "E" else float)
        at = [c.name for c in columns].index("FORCE")
        columns[at] = fits.Column("FORCE", f"12{form}", unit="mN", array=force)
        if far:
            columns.insert(at, fits.Column("OTHER", "99D", array=np.ones((24, 99))))
        table = fits.BinTableHDU.from_columns(columns, name="MEASUREMENTS")
        fits.HDUList([hdus[0], hdus["ACTUATORS"], table]).writeto(tmp_path / "other.fits")
    stored = read(tmp_path / "other.fits").cycles[0].force
    assert isinstance(stored, StoredRows)
    wanted = 1e-3 * force.astype(float)
    for rows in INDICES:
        assert stored[rows].dtype == np.float64
        assert stored[rows].shape == wanted[rows].shape
        assert stored[rows] == pytest.approx(wanted[rows], rel=1e-15)
    assert (np.asarray(stored) == stored[:]).all()


def test_rows_of_a_gzipped_file_are_read(tiny, tmp_path, left_on_disk):
    cycle = tiny.cycles[0]
    write_cycle(cycle, tmp_path / "c.fits")
    (tmp_path / "packed.fits.gz").write_bytes(gzip.compress((tmp_path / "c.fits").read_bytes()))
    packed = read(tmp_path / "packed.fits.gz").cycles[0]
    assert isinstance(packed.force, np.ndarray)
    assert (packed.force == cycle.force).all()


def test_a_campaign_written_from_disk_is_the_same_file(tiny, tmp_path, left_on_disk):
    write_campaign(tiny.cycles, tmp_path / "one")
    write_campaign(read(tmp_path / "one").cycles, tmp_path / "two")
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


CHANGED = "was changed while it was in use; "
CHANGES = {
    "touched": (lambda path: os.utime(path, ns=(1, 1)), CHANGED),
    "cut short": (lambda path: path.write_bytes(path.read_bytes()[:9000]), CHANGED),
    "longer": (lambda path: path.write_bytes(path.read_bytes() + bytes(2880)), CHANGED),
    "gone": (lambda path: path.unlink(), r"cannot be read any more \(No such"),
}


@pytest.mark.parametrize(("change", "line"), CHANGES.values(), ids=CHANGES)
def test_a_file_that_changes_while_in_use_is_refused(tiny, tmp_path, left_on_disk, change, line):
    write_campaign(tiny.cycles, tmp_path / "c")
    campaign = read_data(tmp_path / "c")
    change(tmp_path / "c/ring-001.fits")
    with pytest.raises(UnreadableFile, match=f"ring-001.fits: {line}"):
        calibrate(campaign)


def peak_of_reading_twice(path):
    """Return the most that a campaign takes while its rows are read twice, files of any size."""
    tracemalloc.start()
    stored = read_data(path)
    gc.collect()  # files leave rings of objects behind
    tracemalloc.reset_peak()
    screen_campaign(stored)
    read_rows(stored, (CycleErrors(stored, np.ones(stored.layout.n + 5)).take,))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.study
def test_memory_does_not_grow_with_repeats(tmp_path, left_on_disk, monkeypatch):
    for module in (stored_rows, repeats, row_blocks):
        monkeypatch.setattr(module, "BLOCK_BYTES", 2**16)
    layout, peaks = rings([0.05, 0.08, 0.11, 0.14], [12, 24, 36, 48]), []
    for cycles in (3, 12):
        campaign = campaign_of(seed=13, noise=1e-4, layout=layout, cycles=cycles)[0]
        write_campaign(campaign.cycles, tmp_path / str(cycles))
        rows = 2 * cycles * campaign.cycles[0].force.nbytes
        del campaign
        # Once in a while the interpreter's own tables grow, by megabytes.
        peaks.append(min(peak_of_reading_twice(tmp_path / str(cycles)) for _ in range(2)))
    assert peaks[1] - peaks[0] < 0.1 * rows
    assert peaks[0] > 2 * 2 * layout.n**2 * 8  # the means


def test_a_cycle_near_rank_deficiency_is_solved_from_its_rows(monkeypatch):
    """E_CYCLE by singular values, a block after the other, is that of all rows at once."""
    monkeypatch.setattr(stored_rows, "BLOCK_BYTES", 800)
    campaign, truth = campaign_of(seed=14, noise=1e-3, cycles=1)
    cycle, a = campaign.cycles[0], arms_of(campaign.layout)
    force = cycle.force.copy()
    force[:, 0] *= 1e-7
    cycle = dataclasses.replace(cycle, force=force)
    external = (-2.9, *truth[14:17].tolist())
    matrix, right = system_c(force, a, *external)
    values = scipy.linalg.svdvals(matrix)
    assert 1e5 < values[0] / values[-1] < 1e9
    found = from_rows(cycle, a, external)
    assert found == pytest.approx(scipy.linalg.lstsq(matrix, right)[0], rel=1e-6)
