"""What a run writes: its log, and the shapes of the cycle under way with times that only grow.

Each shape is one record of the journal, on the disk before the next is commanded.
A line says which cycle; then records of one size follow, each closed by its CRC-32. A stop tears
at most the last of them, which is cut off when the journal is opened again.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import re
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import jsonable
from truenewton.bench.protocol import Bench, Reading, Shape, gradients_of
from truenewton.errors import BenchFault, FormatError, OutputFailed
from truenewton.files.opening import refuse_odd
from truenewton.files.outputs import in_one_line, to_disk
from truenewton.mirrors.known import Mirror
from truenewton.records.cycle import Cycle
from truenewton.records.file import cycle_name
from truenewton.statics.layout import Layout
from truenewton.statics.load import LARGEST_FORCE, LEAST_NOISE, Load

EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
MICROSECOND = datetime.timedelta(microseconds=1)
SHORTEST_STEP = 1000  # us, between two readings whose times cannot both be right
LONGEST_PAUSE = 10**13  # us; a clock that leaves four months between two readings was set
JOURNAL_VERSION = 1


class SteadyClock:
    """Turns times of readings into instants, each later than the one before.

    A clock that was set, or begins anew with each run as that of a simulated bench does, counts on
    from the last instant of the campaign [us since 1970, UTC].
    """

    def __init__(self, last: int | None = None) -> None:
        self._last, self._offset = last, 0

    def go_on_after(self, instant: int) -> None:
        """Let what follows be later than an instant [us since 1970, UTC] too."""
        self._last = instant if self._last is None else max(self._last, instant)

    def instant(self, when: datetime.datetime | None) -> int:
        """Return the instant of a reading [us since 1970, UTC].

        A time without zone is UTC; None, where a reading has no time to be trusted, is just after
        the last instant.
        """
        last = self._last
        if when is not None:
            instant = instant_of(when) + self._offset
            if last is not None and not 0 < instant - last <= LONGEST_PAUSE:
                self._offset += last + SHORTEST_STEP - instant
                instant = last + SHORTEST_STEP
        elif last is not None:
            instant = last + SHORTEST_STEP
        else:
            instant = instant_of(datetime.datetime.now(datetime.UTC))
        self._last = instant
        return instant


def moment(instant: int) -> datetime.datetime:
    """Return an instant as a date, UTC."""
    return EPOCH + instant * MICROSECOND


def instant_of(date: datetime.datetime) -> int:
    """Return a date as an instant [us since 1970, UTC]; one without zone is UTC."""
    return ((date if date.tzinfo else date.replace(tzinfo=datetime.UTC)) - EPOCH) // MICROSECOND


def record_type(n: int) -> np.dtype[np.void]:
    """Return the form of a record of n actuators.

    INSTANT [us since 1970, UTC], SHAPE, SIGN, VALID, TEMPERATURE [deg C], NOISE of one force
    reading [N], FORCE [N], POSITION [m], CRC of all that.
    """
    return np.dtype(
        [
            ("instant", "<i8"), ("shape", "<i4"), ("sign", "<i4"), ("valid", "<i4"),
            ("temperature", "<f8"), ("noise", "<f8"), ("force", "<f8", (n,)),
            ("position", "<f8", (n,)), ("crc", "<u4"),
        ]
    )  # fmt: skip


def journal_path(folder: Path, load: Load, number: int) -> Path:
    """Return where the journal of a cycle is kept: hidden, beside its file."""
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
        while (count + 1) * size <= len(body) and _whole(body[count * size : (count + 1) * size]):
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

    def check_order(self, planned: Sequence[tuple[int, int]]) -> None:
        """Refuse records that are not the first of the shapes and signs planned."""
        held = self.rows()[["shape", "sign"]].tolist()
        if held != planned[: len(held)]:
            raise FormatError(
                "holds other shapes than those planned", remedy="move it away", path=self.path
            )

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
            date=moment(int(rows["instant"][0])),
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


def _whole(record: memoryview) -> bool:
    return zlib.crc32(record[:-4]) == int.from_bytes(record[-4:], "little")


class RunLog:
    """Writes events to a new file run-001.jsonl, run-002.jsonl, ... of a campaign's folder."""

    def __init__(self, folder: Path) -> None:
        with in_one_line(folder):
            numbers = [
                int(name[1])
                for path in folder.iterdir()
                if (name := re.fullmatch(r"run-(\d+)\.jsonl", path.name))
            ]
            self.path = folder / f"run-{max(numbers, default=0) + 1:03d}.jsonl"
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._handle = os.open(self.path, flags, 0o666)
        self._start = time.monotonic()

    def note(self, event: str, of: Shape | None = None, **values: Any) -> None:
        """Write one line, of a shape or not."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        elapsed = round(time.monotonic() - self._start, 4)
        line: dict[str, Any] = {"time": now, "elapsed": elapsed, "event": event}
        if of is not None:
            line |= {"load": of.load.name, "cycle": of.cycle, "shape": of.number, "sign": of.sign}
        text = json.dumps(jsonable(line | values))
        with in_one_line(self.path):
            os.write(self._handle, text.encode() + b"\n")

    def last_words(self, event: str, **values: Any) -> None:
        """Write one line if that can be done: on the way out nothing may stand in the way."""
        with contextlib.suppress(OutputFailed):
            self.note(event, **values)

    def close(self) -> None:
        """Close the file."""
        os.close(self._handle)
