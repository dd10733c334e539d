"""Reading measured data: the files at some paths become a campaign or a stiffness matrix."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from truenewton.errors import Fault, FormatError, TrueNewtonError, UnreadableFile
from truenewton.files.content import FitsFile
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.file import cycle_from, fits_paths, holds_cycle, stiffness_from
from truenewton.records.segmented import of_one_body
from truenewton.records.stiffness_matrix import StiffnessMatrix

AnyPath = str | os.PathLike[str]
Measured = Campaign | StiffnessMatrix
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


def open_file(path: AnyPath) -> Opened:
    """Open a file."""
    file = read_fits(path)
    if not holds_cycle(file):
        return Opened(file, None)
    try:
        return Opened(file, cycle_from(file))
    except UnreadableFile:
        raise
    except TrueNewtonError as error:
        return Opened(file, error.changed(path=file.path))


def open_files(paths: Iterable[AnyPath | Iterable[AnyPath]]) -> list[Opened]:
    """Open the files of paths and folders."""
    return [open_file(path) for path in fits_paths(flat(paths))]


def measured_in(opened: Sequence[Opened], segment: int | None = None) -> Measured:
    """Return the data in files, of one segment if it is chosen: cycles, a matrix, or both."""
    matrices = [one.file for one in opened if "STIFFNESS" in one.file.extensions]
    if len(opened) > 1 or not matrices:
        _refuse_foreign([one.file for one in opened], matrices)
    cycles = [one.require_cycle() for one in opened if one.file not in matrices]
    matrix = stiffness_from(matrices[0]) if matrices else None
    return of_one_body(cycles, matrix, segment)


def measured_from(given: Any) -> Measured:
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
        return measured_in(open_files(items))
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
