"""Files read by the workers of a dask cluster: the same numbers, whatever happens to a worker."""

import os
import pickle
import shutil
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest

import truenewton as tn
from helpers.balanced import campaign_of
from helpers.comparison import same
from helpers.raw_samples import stream
from truenewton import cluster, errors
from truenewton.errors import ClusterFailed, FormatError, TrueNewtonError, UnreadableFile
from truenewton.estimation.readings import repeats, rows
from truenewton.records.file import write_campaign, write_cycle
from truenewton.records.samples import AveragedRows


@pytest.fixture(scope="module")
def workers():
    """Two worker processes, and their client."""
    distributed = pytest.importorskip("distributed", reason="dask, extra `cluster`, is missing")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign with gradients, positions, several noises, and rows that do not belong."""
    random = np.random.default_rng(3)
    campaign, _ = campaign_of(seed=12, noise=1e-4, cycles=3, disabled=(5,), invalid=(3, 20))
    cycles = []
    for k, cycle in enumerate(campaign.cycles):
        force, position = cycle.force.copy(), 1e-7 * random.standard_normal(cycle.force.shape)
        force[7 + k, 2] += 0.05  # a spike against its repeats
        position[[3, 20]] = np.nan
        gradients = {"coil_gradient": 600.0, "bias_gradient": 31.0 if k else None}
        noise = (1e-4, 2e-4)[k % 2]
        cycles.append(
            replace(cycle, force=force, position=position, force_error=noise, **gradients)
        )
    path = tmp_path_factory.mktemp("cluster") / "c"
    write_campaign(cycles, path)
    return path


@pytest.fixture(scope="module")
def alone(folder):
    """What one machine finds."""
    return tn.calibrate(tn.read(folder))


@pytest.fixture
def small_tasks(monkeypatch):
    """Cut the work into many tasks."""
    for module in (repeats, rows):
        monkeypatch.setattr(module, "BLOCK_BYTES", 800)


def test_errors_cross_from_machine_to_machine():
    kinds = [each for each in vars(errors).values() if isinstance(each, type)]
    kinds = [each for each in kinds if issubclass(each, TrueNewtonError)]
    assert len(kinds) > 10
    for kind in kinds:
        one = kind("is\nwrong", remedy="mend it", path="c.fits")
        other = pickle.loads(pickle.dumps(one))
        assert type(other) is kind
        assert str(other) == str(one) == "c.fits: is\\nwrong; mend it"
        assert vars(other) == vars(one)


def test_two_workers_find_what_one_machine_finds(workers, folder, alone, small_tasks):
    one = alone
    campaign = tn.read(folder, client=workers)
    other = tn.calibrate(campaign, client=workers)
    assert {row.against for row in one.rejected_rows} == {"repeats"}
    assert other.rejected_rows == one.rejected_rows
    for name in ("alpha", "statistical_error", "cycle_error"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9, nan_ok=True)
    assert other.sources == one.sources
    assert [c.name for c in campaign] == [c.name for c in tn.read(folder)]


def test_a_command_prints_the_same(workers, folder, inside):
    address = workers.scheduler.address
    assert inside("calibrate", folder, "--cluster", address) == inside("calibrate", folder)


@pytest.fixture(scope="module")
def raw_folder(folder, tmp_path_factory):
    """The same as raw samples."""
    path = tmp_path_factory.mktemp("cluster") / "raw"
    path.mkdir()
    for k, cycle in enumerate(cycle for cycle in tn.read(folder) if cycle.number < 3):
        stream(cycle, path / f"c{k}.h5", seed=k)
    return path


def test_raw_samples_are_averaged_by_the_workers(workers, raw_folder):
    here, there = tn.read(raw_folder), tn.read(raw_folder, client=workers)
    for one, other in zip(here, there, strict=True):
        assert isinstance(other.force, AveragedRows)
        assert other.force_error == one.force_error
    one, other = tn.calibrate(here), tn.calibrate(there, client=workers)
    assert np.isfinite(one.alpha).sum() == 13
    assert other.verdict == one.verdict
    assert other.rejected_rows == one.rejected_rows
    for name in ("alpha", "statistical_error", "cycle_error"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9, nan_ok=True)


def flip(path):
    """Damage a byte of the readings."""
    import h5py  # an extra

    at = 9000
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            at = file["SAMPLES/FORCE"].id.get_chunk_info(0).byte_offset
    raw = bytearray(path.read_bytes())
    raw[at] ^= 1
    path.write_bytes(raw)


def spoil(path):
    import h5py  # an extra

    with h5py.File(path, "r+") as file:
        file["SAMPLES/FORCE"][30, 0] = np.nan


def cut(path):
    path.write_bytes(path.read_bytes()[:9000])


def make_heavy(path):
    """Write a cycle that no reader accepts: a mirror that is drawn upwards."""
    cycle = tn.read(path).cycles[0]
    wrong = object.__new__(type(cycle))
    vars(wrong).update(vars(cycle) | {"weight": 3.0})
    write_cycle(wrong, path, overwrite=True)


@pytest.mark.parametrize(
    ("name", "change", "line"),
    [
        ("c1.h5", spoil, "FORCE in row 1 is nan for actuator "),
        ("c1.h5", flip, "/SAMPLES/FORCE is damaged"),
        ("bare-002.fits", cut, ""),
        ("bare-002.fits", make_heavy, "WEIGHT is 3"),
        ("ring-001.fits", flip, ""),
    ],
)
def test_a_file_with_a_fault_gives_the_same_line(
    workers, folder, raw_folder, tmp_path, monkeypatch, name, change, line
):
    """Also where no worker knows the folder in which the command runs."""
    shutil.copytree(raw_folder if name.endswith("h5") else folder, tmp_path / "c")
    change(tmp_path / "c" / name)
    monkeypatch.chdir(tmp_path)

    def said(client):
        with pytest.raises(TrueNewtonError) as refused:
            tn.read("c", client=client)
        return str(refused.value)

    assert said(workers) == said(None)
    assert said(None).startswith(f"c/{name}: {line}")


def test_a_file_of_another_kind_gives_the_same_line(workers, folder, alone, tmp_path):
    shutil.copytree(folder, tmp_path / "c")
    alone.write(tmp_path / "c/alpha.fits")
    for client in (workers, None):
        with pytest.raises(FormatError, match=r"alpha.fits: is a calibration file among others"):
            tn.read(tmp_path / "c", client=client)


def test_a_file_that_changes_while_in_use_is_refused(workers, folder, tmp_path):
    write_campaign(tn.read(folder), tmp_path / "c")
    campaign = tn.read(tmp_path / "c", client=workers)
    os.utime(tmp_path / "c/ring-001.fits", ns=(1, 1))
    with pytest.raises(UnreadableFile, match=r"ring-001.fits: was changed while it was in use; "):
        tn.calibrate(campaign, client=workers)


def test_what_no_worker_can_read_is_refused(workers, folder, tmp_path):
    with pytest.raises(FormatError, match=r"bare-001.fits: its rows are in the memory of this pro"):
        tn.calibrate(tn.read(folder), client=workers)
    cycle = tn.read(folder).cycles[0]
    write_cycle(cycle, tmp_path / "packed.fits.gz")
    with pytest.raises(FormatError, match=r"packed.fits.gz: is gzipped, .*; write it again"):
        tn.read(tmp_path, client=workers)


def test_a_worker_that_is_killed_changes_nothing(workers, folder, monkeypatch, small_tasks):
    """What it had done and not yet handed over is done again by the other one."""
    whole = tn.calibrate(tn.read(folder, client=workers), client=workers)
    victim, kept = next(iter(workers.run(os.getpid).values())), []
    keep = repeats.RepeatSums._keep

    def keep_and_kill(self, sums):
        kept.append(sums.block)
        if len(kept) == 2:
            os.kill(victim, signal.SIGKILL)
        keep(self, sums)

    monkeypatch.setattr(repeats.RepeatSums, "_keep", keep_and_kill)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("logging.Logger.handle", lambda *_: None)  # dask tells of it at length
        again = tn.calibrate(tn.read(folder, client=workers), client=workers)
    assert len(kept) > 10
    assert same(again, whole)
    assert victim not in workers.run(os.getpid).values()


def test_a_cluster_that_is_not_there(monkeypatch):
    pytest.importorskip("distributed", reason="dask, extra `cluster`, is missing")
    monkeypatch.setattr(cluster, "PATIENCE", "0.2s")
    with (
        pytest.raises(ClusterFailed, match=r"no dask scheduler answers at tcp://127.0.0.1:1; st"),
        cluster.connected("tcp://127.0.0.1:1"),
    ):
        pass
    with pytest.raises(ClusterFailed, match="no dask scheduler"), cluster.connected("nonsense:x"):
        pass


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ClusterFailed, match=r"--cluster needs .*'truenewton\[cluster\]'"),
        cluster.connected("tcp://127.0.0.1:8786"),
    ):
        pass


def test_what_is_wrong_with_a_worker_is_one_line(workers):
    with pytest.raises(ClusterFailed, match=r"cannot do their part: ModuleNotFoundError, No mod"):
        list(cluster.each(needs_what_is_not_there, [1], workers))


def needs_what_is_not_there(_):
    import truenewton_of_another_version  # noqa: F401
