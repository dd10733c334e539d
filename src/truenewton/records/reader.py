"""Reading measured data: the files at some paths become a campaign or a stiffness matrix."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from truenewton.cluster import Client, each
from truenewton.errors import Fault, FormatError, TrueNewtonError, UnreadableFile
from truenewton.files.content import FitsFile, Table
from truenewton.files.hdf5 import STREAM
from truenewton.files.stored_rows import StoredRows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.file import cycle_from, fits_paths, holds_cycle, read_file, stiffness_from
from truenewton.records.segmented import of_one_body
from truenewton.records.stiffness_matrix import StiffnessMatrix

AnyPath = str | os.PathLike[str]
Measured = Campaign | StiffnessMatrix
IN_MEMORY = 2**28  # bytes; FORCE and POSITION of files that are larger in total stay on disk
FOREIGN = {  # extensions of files that cannot be calibrated: what the file is, and what to do
    "TRUTH": Fault("is the truth of a simulation", "give the campaign beside it"),
    "MODES": Fault(
        "is a modal basis", "give what it was made from, or the .commanded.fits beside it"
    ),
    "TRACKING": Fault(
        "is a tracking file", "give it to `recalibrate --known`, or to read_tracking in Python"
    ),
    "CHANGES": Fault(
        "is what `compare` wrote", "read it with read_comparison in Python, or give its data"
    ),
    "CALIBRATION": Fault(
        "is a calibration file among others", "give it alone, or two calibrations to `report`{}"
    ),
}


class Opened(NamedTuple):
    """A file that was read, and its cycle or what is wrong with that; None for other files.

    The fault is raised after all files are opened, since a file of another kind is reported first.
    """

    file: FitsFile
    cycle: Cycle | TrueNewtonError | None

    def require_cycle(self) -> Cycle:
        """Return the cycle."""
        if isinstance(self.cycle, TrueNewtonError):
            raise self.cycle
        return cycle_from(self.file) if self.cycle is None else self.cycle


def open_file(path: AnyPath, *, whole: bool) -> Opened:
    """Open a file; if not whole, vector columns stay on disk."""
    return _opened(read_file(path, whole=whole), means_in_memory=True)


def open_by_worker(names: tuple[str, str]) -> Opened:
    """Open a file by its absolute path, and name it by the second one in messages."""
    path, name = names
    try:
        return _opened(replace(read_file(path, whole=False), path=name), means_in_memory=False)
    except TrueNewtonError as error:
        raise error.changed(path=name) from None


def _opened(file: FitsFile, *, means_in_memory: bool) -> Opened:
    """Return a file with its cycle; if not ``means_in_memory``, means of samples stay in it."""
    if not holds_cycle(file):
        return Opened(file, None)
    # Columns of samples are as long as the stream; the cycle contains what is needed of them.
    light = {n: Table(0, {}) if n == STREAM else part for n, part in file.extensions.items()}
    kept = replace(file, extensions=light)
    try:
        cycle = cycle_from(file, means_in_memory=means_in_memory)
        if not means_in_memory:
            _require_stored(cycle)
            cycle.stroke  # noqa: B018  # reads POSITION here, not where all files are needed
    except UnreadableFile:
        raise
    except TrueNewtonError as error:
        return Opened(kept, error.changed(path=file.path))
    return Opened(kept, cycle)


def _require_stored(cycle: Cycle) -> None:
    if not all(isinstance(rows, StoredRows | None) for rows in (cycle.force, cycle.position)):
        raise FormatError(
            "is gzipped, or FORCE or POSITION has TSCAL or TDIM: workers cannot read parts of it",
            remedy="write it again with write_cycle, or calibrate without a cluster",
            path=cycle.name,
        )


def open_files(
    paths: Iterable[AnyPath | Iterable[AnyPath]], client: Client | None = None
) -> list[Opened]:
    """Open the files of paths and folders, here or by the workers of a cluster."""
    every = fits_paths(flat(paths))
    if client is None:
        whole = sum(path.stat().st_size for path in every if path.is_file()) <= IN_MEMORY
        return list(each(partial(open_file, whole=whole), every))
    names = [(str(path.absolute()), str(path)) for path in every]
    return list(each(open_by_worker, names, client))


def measured_in(opened: Sequence[Opened], segment: int | None = None) -> Measured:
    """Return the data in files, of one segment if it is chosen: cycles, a matrix, or both."""
    matrices = [one.file for one in opened if "STIFFNESS" in one.file.extensions]
    if len(opened) > 1 or not matrices:
        _refuse_foreign([one.file for one in opened], matrices)
    cycles = [one.require_cycle() for one in opened if one.file not in matrices]
    matrix = stiffness_from(matrices[0]) if matrices else None
    return of_one_body(cycles, matrix, segment)


def measured_from(given: Any, client: Client | None = None) -> Measured:
    """Return data as they are, those at a path or paths, or those of cycles.

    Raises
    ------
    TypeError
        It is something else.
    """
    if isinstance(given, Measured):
        return given
    several = isinstance(given, Iterable) and not isinstance(given, str | os.PathLike)
    items = [*given] if several and not hasattr(given, "dtype") else [given]
    if items and all(isinstance(one, str | os.PathLike) for one in items):
        return measured_in(open_files(items, client))
    cycles = [one for one in items if isinstance(one, Cycle)]
    matrices = [one for one in items if isinstance(one, StiffnessMatrix)]
    if items and len(cycles) + len(matrices) == len(items):
        return of_one_body(cycles, matrices[0] if matrices else None)
    wrong = next((one for one in items if not isinstance(one, Cycle | str | os.PathLike)), given)
    raise TypeError(
        f"cannot calibrate a {type(wrong).__name__}; give a path, paths, cycles, a Campaign or"
        " StiffnessMatrix"
    )


def flat(paths: Iterable[AnyPath | Iterable[AnyPath]]) -> list[AnyPath]:
    """Return paths and lists of paths as one list."""
    return [
        one for path in paths for one in ([path] if isinstance(path, str | os.PathLike) else path)
    ]


def _refuse_foreign(files: list[FitsFile], matrices: list[FitsFile]) -> None:
    """Raise FormatError for a file that does not belong to a campaign."""
    for file in files:
        faults = [fault for name, fault in FOREIGN.items() if name in file.extensions]
        if "ACTUATOR" in (file.header.get("CTYPE1"), file.header.get("CTYPE2")):
            faults += [
                Fault("is a plain matrix of a modal basis", "give the .commanded.fits beside it")
            ]
        if file in matrices[1:]:
            faults += [Fault("is a second stiffness file among others", "give it alone")]
        if len(files) == 1 and "CALIBRATION" in file.extensions:
            faults = [Fault("is a calibration already", "give cycle files or a stiffness file")]
        for fault, remedy in faults:
            others = [f": {f.path} is not one" for f in files if "CALIBRATION" not in f.extensions]
            raise FormatError(fault, remedy=remedy.format(*others[:1] or [""]), path=file.path)
