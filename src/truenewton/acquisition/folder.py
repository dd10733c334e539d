"""A campaign's folder: lock, plan, complete cycles, and a journal of the cycle under way.

The journal begins with a line that names the cycle. Then each shape is one record, on the disk
before the next shape is commanded, and closed by its CRC-32. A stop damages at most the last
record, which is cut off when the journal is opened again.
"""

from __future__ import annotations

import contextlib
import datetime
import difflib
import hashlib
import os
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from truenewton.acquisition.load_order import with_turns
from truenewton.acquisition.plan import CampaignPlan, read_plan, shapes_and_forces
from truenewton.acquisition.taker import mean_sum
from truenewton.arrays import Array
from truenewton.bench.protocol import Bench, Reading, Shape, gradients_of
from truenewton.errors import BenchFault, CampaignMismatch, FormatError, OutputExists, OutputFailed
from truenewton.files.fits import read_fits, write_fits
from truenewton.files.format import FileFormat, ImageFormat
from truenewton.files.opening import read_text, refuse_odd
from truenewton.files.outputs import file_beside, in_one_line, to_disk
from truenewton.files.toml import toml_text
from truenewton.mirrors.known import Mirror
from truenewton.records.cycle import Cycle
from truenewton.records.file import SUFFIXES, cycle_from, cycle_name
from truenewton.rounding import counted
from truenewton.statics.layout import Layout
from truenewton.statics.load import LARGEST_FORCE, LEAST_NOISE, Load

EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
MICROSECOND = datetime.timedelta(microseconds=1)
SHORTEST_STEP = 1000  # us, between two readings whose times cannot both be right
LONGEST_PAUSE = 10**13  # us; a clock that leaves four months between two readings was set
JOURNAL_VERSION = 1


class SteadyClock:
    """Turns times of readings into instants [us since 1970, UTC], each later than the one before.

    If the clock was set, or starts again with each run as that of a simulated bench does, it counts
    on from the last instant of the campaign.
    """

    def __init__(self, last: int | None = None) -> None:
        self._last, self._offset = last, 0

    def go_on_after(self, instant: int) -> None:
        """Make all further instants later than this one, too."""
        self._last = instant if self._last is None else max(self._last, instant)

    def instant(self, when: datetime.datetime | None) -> int:
        """Return the instant of a reading; without a reliable time, just after the last one."""
        last = self._last
        if when is None and last is not None:
            instant = last + SHORTEST_STEP
        else:
            instant = instant_of(when or datetime.datetime.now(datetime.UTC)) + self._offset
            if last is not None and not 0 < instant - last <= LONGEST_PAUSE:
                self._offset += last + SHORTEST_STEP - instant
                instant = last + SHORTEST_STEP
        self._last = instant
        return instant


def instant_of(date: datetime.datetime) -> int:
    """Return a date as an instant [us since 1970, UTC]; one without zone is UTC."""
    return ((date if date.tzinfo else date.replace(tzinfo=datetime.UTC)) - EPOCH) // MICROSECOND


def record_type(n: int) -> np.dtype[np.void]:
    """Return the form of a record of n actuators: instant [us since 1970, UTC], ..., CRC-32."""
    return np.dtype(
        [
            ("instant", "<i8"), ("shape", "<i4"), ("sign", "<i4"), ("valid", "<i4"),
            ("temperature", "<f8"), ("noise", "<f8"),  # [deg C], of one force reading [N]
            ("force", "<f8", (n,)), ("position", "<f8", (n,)), ("crc", "<u4"),  # [N], [m]
        ]
    )  # fmt: skip


def journal_path(folder: Path, load: Load, number: int) -> Path:
    """Return the path of a cycle's journal: hidden, beside its file."""
    return folder / f".{Path(cycle_name(load, number)).stem}.journal"


def remove_journal(folder: Path, load: Load, number: int) -> None:
    """Remove the journal of a cycle that is safe in its file, if there is one."""
    with in_one_line(folder):
        journal_path(folder, load, number).unlink(missing_ok=True)


class Journal:
    """The record of one cycle under way, of n actuators, in the folder of its campaign.

    It holds `count` records; `dropped` bytes were cut off when it was opened.
    """

    def __init__(self, folder: Path, load: Load, number: int, n: int) -> None:
        self.path = journal_path(folder, load, number)
        self.load, self.number, self.form = load, number, record_type(n)
        self._head = (
            f"truenewton journal {JOURNAL_VERSION}: {load.key!r}, cycle {number}, {n}\n".encode()
        )
        if self.path.exists():
            refuse_odd(self.path)
        with in_one_line(self.path):
            binary = getattr(os, "O_BINARY", 0)  # Windows would write every \n as two bytes
            self._handle = os.open(self.path, os.O_RDWR | os.O_CREAT | binary, 0o666)
            try:
                self.count, self.dropped = self._sound()
            except BaseException:
                os.close(self._handle)
                raise
            to_disk(folder)

    def _sound(self) -> tuple[int, int]:
        """Keep whole records and cut off the rest; return how many, and the bytes cut off."""
        raw = self.path.read_bytes()
        head, size = self._head, self.form.itemsize
        if not (raw.startswith(head) or head.startswith(raw)):
            raise FormatError("is no journal of this cycle", remedy="move it away", path=self.path)
        if len(raw) < len(head):  # stopped before its first shape
            os.ftruncate(self._handle, 0)
            os.write(self._handle, head)
            os.fsync(self._handle)
            return 0, len(raw)
        count, body = 0, memoryview(raw)[len(head) :]
        for start in range(0, len(body) - size + 1, size):
            record = body[start : start + size]
            if zlib.crc32(record[:-4]) != int.from_bytes(record[-4:], "little"):
                break
            count += 1
        # Those at the end that were not sound are taken again.
        valid = np.frombuffer(body[: count * size], dtype=self.form)["valid"]
        count = int(np.flatnonzero(valid)[-1]) + 1 if valid.any() else 0
        end = len(head) + count * size
        os.ftruncate(self._handle, end)
        os.lseek(self._handle, end, os.SEEK_SET)
        return count, len(raw) - end

    def append(
        self, instant: int, shape: Shape, valid: bool, reading: Reading | None, noise: float
    ) -> None:
        """Add a shape; it is on the disk when this returns. Without a reading it holds NaN."""
        record = np.zeros(1, dtype=self.form)
        record["instant"], record["valid"], record["noise"] = instant, valid, noise
        record["shape"], record["sign"] = shape.number, shape.sign
        for name in ("temperature", "force", "position"):
            record[name] = np.nan if reading is None else getattr(reading, name)
        raw = record.tobytes()[:-4]
        raw += zlib.crc32(raw).to_bytes(4, "little")
        with in_one_line(self.path):
            while raw:
                raw = raw[os.write(self._handle, raw) :]
            os.fsync(self._handle)
        self.count += 1

    def rows(self) -> NDArray[Any]:
        """Return the (count,) records so far, as they lie on the disk; see `record_type`."""
        if not self.count:
            return np.zeros(0, dtype=self.form)
        offset = len(self._head)
        with in_one_line(self.path):
            return np.memmap(self.path, self.form, "r", offset=offset, shape=(self.count,))

    def cycle(self, mirror: Mirror, layout: Layout, bench: Bench) -> Cycle:
        """Return the cycle that the records make, taken of a mirror on a bench.

        The layout is as files name and place the actuators. No valid record is a `BenchFault`.
        """
        rows = self.rows()
        valid = rows["valid"].astype(bool)
        if not valid.any():
            raise BenchFault(f"no shape of cycle {self.number} under '{self.load.name}' is valid")
        noise = float(np.sqrt(np.mean(rows["noise"][valid] ** 2)))
        temperature = rows["temperature"]
        coil_gradient, bias_gradient = gradients_of(bench)
        return Cycle(
            instrument=mirror.name,
            date=EPOCH + int(rows["instant"][0]) * MICROSECOND,
            number=self.number,
            load=self.load,
            weight=mirror.weight,
            weight_error=mirror.weight_error,
            layout=layout,  # the bench's is the same but for rounding
            time=(rows["instant"] - rows["instant"][0]) * 1e-6,
            shape=rows["shape"],
            sign=rows["sign"],
            force=rows["force"],
            valid=valid,
            temperature=temperature if np.isfinite(temperature[valid]).all() else None,
            position=rows["position"],
            gap=bench.gap,
            force_error=noise if LEAST_NOISE <= noise <= LARGEST_FORCE else None,
            coil_gradient=coil_gradient,
            bias_gradient=bias_gradient,
        )

    def close(self) -> None:
        """Close the file; it stays."""
        os.close(self._handle)


PLAN, SHAPES, LOCK = "plan.toml", ".shapes", ".lock"
SHAPES_FORMAT = FileFormat(extensions=(ImageFormat("SHAPES", "", "m"),))  # FITS, with checksums
MAX_LINES_SHOWN = 8  # of a difference between two plans


@dataclass(frozen=True)
class Finished:
    """What a run needs to know of a complete cycle."""

    end: int  # its last instant [us since 1970, UTC]
    total: float | None  # of the forces at rest [N], see `mean_sum`


@contextlib.contextmanager
def locked(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Make a campaign's folder if it does not exist, and keep it for this run alone.

    The lock is the system's: it goes with the process that holds it, however that ends.
    """
    folder = Path(folder)
    lock = FileLock(folder / LOCK)
    with in_one_line(folder):
        folder.mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise OutputFailed(
                "another run writes here",
                remedy="let it end first; the newest run-*.jsonl names its host and process",
                path=folder,
            ) from None
    try:
        yield folder
    finally:
        lock.release()


def _plan_text(plan: CampaignPlan, beside: str | os.PathLike[str]) -> str:
    """Return a plan as it is kept beside its data, with the digests of the files that it names."""
    named = [plan.mirror, plan.shapes.source]
    files = [path for name in named if (path := Path(beside) / name).is_file()]
    digests = [f"# {path.name}: {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    return "\n".join([*digests, toml_text(plan)])


def begin_or_resume(
    folder: Path, plan: CampaignPlan, mirror: Mirror, beside: str | os.PathLike[str]
) -> tuple[CampaignPlan, Array]:
    """Return plan and (shapes, n) displacements [m], as kept in the folder by the first run.

    The first run chooses turns that the plan leaves open. Shapes are not computed again, because
    modes of one stiffness may differ on another machine. Another plan is a `CampaignMismatch`.
    """
    half_written = tuple(f".{name}." for name in (PLAN, SHAPES, *cycle_names(plan)))
    with in_one_line(folder):  # by a run that was killed: this one has the lock of the folder
        for path in [each for each in folder.iterdir() if each.name.startswith(half_written)]:
            shutil.rmtree(path)
    if (folder / PLAN).exists():
        refuse_other_plan(folder, plan, beside)
        shapes = read_fits(folder / SHAPES).pixels("SHAPES", "m")
        return _with_turns_begun(plan, read_plan(folder / PLAN)), shapes
    if any(path.name.endswith(SUFFIXES) for path in folder.iterdir()):
        raise OutputExists(
            f"contains FITS files but no {PLAN}", remedy="choose another name", path=folder
        )
    shapes = shapes_and_forces(plan, mirror, beside)[0]
    plan = with_turns(plan, mirror, len(shapes))
    write_fits(folder / SHAPES, SHAPES_FORMAT, shapes, overwrite=True)
    with file_beside(folder / PLAN) as temporary:  # last: with it the campaign has begun
        temporary.write_text(_plan_text(plan, beside), encoding="utf-8")
    with in_one_line(folder):
        to_disk(folder)
    return plan, shapes


def _with_turns_begun(plan: CampaignPlan, begun: CampaignPlan) -> CampaignPlan:
    """Return a plan that leaves its turns open with those of the plan of its folder."""
    return plan if plan.turns else replace(plan, turns=begun.turns)


def refuse_other_plan(
    folder: str | os.PathLike[str], plan: CampaignPlan, beside: str | os.PathLike[str]
) -> None:
    """Refuse a plan that is not the one a folder was begun with, and show the difference."""
    path = Path(folder) / PLAN
    begun_plan = read_plan(path)
    digests = [line for line in read_text(path).splitlines()
               if line.startswith("#") and not line.startswith(f"# {SHAPES}")]  # fmt: skip
    # As this version writes it, defaults included.
    begun = [*digests, *toml_text(begun_plan).splitlines()]
    wanted = _plan_text(_with_turns_begun(plan, begun_plan), beside).splitlines()
    if begun == wanted:
        return
    lines = list(difflib.unified_diff(begun, wanted, n=0, lineterm=""))
    changed = [line for line in lines[2:] if not line.startswith("@@") and line[1:].strip()]
    more = (
        f" and {counted(len(changed) - MAX_LINES_SHOWN, 'line')} more"
        if len(changed) > MAX_LINES_SHOWN
        else ""
    )
    raise CampaignMismatch(
        f"was begun with another plan: {', '.join(changed[:MAX_LINES_SHOWN])}{more}",
        remedy=f"take the plan back ({PLAN} in the folder has it), or give another folder",
        path=folder,
    )


def is_complete(folder: str | os.PathLike[str], plan: CampaignPlan) -> bool:
    """Return whether a folder that was begun with a plan holds all its cycles."""
    return all((Path(folder) / name).exists() for name in (PLAN, *cycle_names(plan)))


def invalid_rows(folder: str | os.PathLike[str], plan: CampaignPlan) -> dict[str, tuple[int, int]]:
    """Return how many rows of each complete cycle file are not valid, and how many it has."""
    valid = {name: cycle_from(read_fits(Path(folder) / name)).valid for name in cycle_names(plan)}
    return {name: (int((~each).sum()), each.size) for name, each in valid.items()}


def cycle_names(plan: CampaignPlan) -> list[str]:
    """Return the names of the cycle files of a plan, in its order."""
    return [cycle_name(load, k + 1) for load in plan.loads for k in range(plan.cycles)]


def finished_cycles(
    folder: Path, plan: CampaignPlan, mirror: Mirror, layout: Layout, rows: int
) -> dict[tuple[str, int], Finished]:
    """Return the complete cycles, by load and number; every file is read and verified.

    The journal of a complete cycle is removed. A file of another campaign is a
    `CampaignMismatch`.
    """
    complete = {}
    for load, number in product(plan.loads, range(1, plan.cycles + 1)):
        path = folder / cycle_name(load, number)
        if not path.exists():
            continue
        cycle = cycle_from(read_fits(path))
        if not (
            cycle.instrument == mirror.name
            and (cycle.weight, cycle.weight_error) == (mirror.weight, mirror.weight_error)
            and cycle.layout.same_as(layout)
            and (cycle.load, cycle.number) == (load, number)
            and len(cycle.time) == rows
        ):
            raise CampaignMismatch("is not of this plan", remedy="move it away", path=path)
        remove_journal(folder, load, number)  # of a run which was killed before it could do so
        complete[load.key, number] = Finished(
            end=instant_of(cycle.date) + round(float(cycle.time[-1]) * 1e6),
            total=mean_sum(cycle.layout, cycle.force, cycle.shape, cycle.sign, cycle.valid),
        )
    return complete
