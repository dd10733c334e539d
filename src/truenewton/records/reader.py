"""Files of cycles as they are opened, here or by a worker of a cluster."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import NamedTuple

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile
from truenewton.files.content import FitsFile, Table
from truenewton.files.hdf5 import STREAM
from truenewton.files.stored_rows import StoredRows
from truenewton.records.cycle import Cycle
from truenewton.records.file import cycle_from, holds_cycle, read_file


class Opened(NamedTuple):
    """A file that was read, and the cycle in it, or what is wrong with that; None of other files.

    The fault is raised once all files are known: one that does not belong here is said first.
    """

    file: FitsFile
    cycle: Cycle | TrueNewtonError | None

    def require_cycle(self) -> Cycle:
        """Return the cycle."""
        if isinstance(self.cycle, TrueNewtonError):
            raise self.cycle
        return cycle_from(self.file) if self.cycle is None else self.cycle


def open_file(path: str | os.PathLike[str], *, whole: bool) -> Opened:
    """Open a file; if not whole, vector columns are left in it."""
    return _opened(read_file(path, whole=whole), whole=True)


def _opened(file: FitsFile, *, whole: bool) -> Opened:
    """Return a file, and its cycle; if not whole, means of samples are left in the file."""
    if not holds_cycle(file):
        return Opened(file, None)
    # Columns of samples are as long as the stream; what they say is in the cycle.
    light = {n: Table(0, {}) if n == STREAM else part for n, part in file.extensions.items()}
    kept = replace(file, extensions=light)
    try:
        cycle = cycle_from(file, whole=whole)
        if not whole:
            _require_stored(cycle)
            cycle.stroke  # noqa: B018  # reads POSITION, here rather than where all files are wanted
    except UnreadableFile:
        raise
    except TrueNewtonError as error:
        return Opened(kept, error.changed(path=file.path))
    return Opened(kept, cycle)


def _require_stored(cycle: Cycle) -> None:
    if not all(isinstance(rows, StoredRows | None) for rows in (cycle.force, cycle.position)):
        raise FormatError(
            "is gzipped, or FORCE or POSITION has TSCAL or TDIM: no worker can read parts of it",
            remedy="write it anew, by write_cycle, or calibrate without a cluster",
            path=cycle.name,
        )


def open_by_worker(names: tuple[str, str]) -> Opened:
    """Open a file whose rows stay in it, given its absolute path, and the name to call it by."""
    path, name = names
    try:
        return _opened(replace(read_file(path, whole=False), path=name), whole=False)
    except TrueNewtonError as error:
        raise error.changed(path=name) from None
