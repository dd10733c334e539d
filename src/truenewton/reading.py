"""Reading: the files at some paths become a campaign, a stiffness matrix or a calibration."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, overload

from truenewton.calibration.result import CALIBRATIONS, AnyCalibration, Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.cluster import Client, each
from truenewton.errors import (
    Fault,
    FormatError,
    TrueNewtonError,
    UnreadableFile,
    naming,
)
from truenewton.files.content import FitsFile, Table
from truenewton.files.hdf5 import STREAM
from truenewton.files.stored_rows import StoredRows
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.records.file import (
    cycle_from,
    fits_paths,
    holds_cycle,
    read_file,
    stiffness_from,
)
from truenewton.records.parts import InParts, Parts, body_or_parts_from, has_parts
from truenewton.records.segmented import SegmentedData, in_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix

if TYPE_CHECKING:
    from typing_extensions import TypeIs

AnyPath = str | os.PathLike[str]
IN_MEMORY = 2**28  # bytes; FORCE and POSITION of files that are larger in total stay on disk
Body = Campaign | StiffnessMatrix | Calibration  # of a mirror in one piece
Read = Body | SegmentedData | Parts[Calibration]
Part = TypeVar("Part")
Kind = TypeVar("Kind", bound=Body)
KINDS: dict[type, tuple[str, str]] = {  # what files contain, and the function that reads them
    Campaign: ("a campaign", "read_campaign"),
    StiffnessMatrix: ("a stiffness matrix", "read_stiffness"),
    Calibration: ("a calibration", "read_calibration"),
    SegmentedData: ("data of several segments", "read"),
    Parts: ("a calibration of several segments", "read"),
}
FOREIGN = {  # extensions of files that cannot be calibrated: what the file is, and what to do
    "TRUTH": Fault("is the truth of a simulation", "give the campaign beside it"),
    "MODES": Fault(
        "is a modal base", "give what it was made from, or the .commanded.fits beside it"
    ),
    "TRACKING": Fault(
        "is a tracking file", "give it to `recalibrate --known`, or to read_tracking in Python"
    ),
    "CALIBRATION": Fault(
        "is a calibration file among others", "give it alone, or two calibrations to `report`"
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
    return _opened(read_file(path, whole=whole), whole=True)


def open_by_worker(names: tuple[str, str]) -> Opened:
    """Open a file by its absolute path, and name it by the second one in messages."""
    path, name = names
    try:
        return _opened(replace(read_file(path, whole=False), path=name), whole=False)
    except TrueNewtonError as error:
        raise error.changed(path=name) from None


def _opened(file: FitsFile, *, whole: bool) -> Opened:
    """Return a file with its cycle; if not whole, means of samples stay in the file."""
    if not holds_cycle(file):
        return Opened(file, None)
    # Columns of samples are as long as the stream; the cycle contains what is needed of them.
    light = {n: Table(0, {}) if n == STREAM else part for n, part in file.extensions.items()}
    kept = replace(file, extensions=light)
    try:
        cycle = cycle_from(file, whole=whole)
        if not whole:
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
            remedy="write it anew with write_cycle, or calibrate without a cluster",
            path=cycle.name,
        )


def read(*paths: AnyPath | Iterable[AnyPath], client: Client | None = None) -> Read:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files, or lists of them; one stiffness file may be among
        cycle files.
    client
        A `dask.distributed.Client`: its workers read one file each, and rows stay in the files
        (docs/campaign.md).

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        Depending on the files; of a mirror in several segments SegmentedData or Parts.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, ClusterFailed

    Warns
    -----
    TrueNewtonWarning
        The verdict on a calibration is 'doubtful' or 'rejected'.

    Examples
    --------
    >>> tn.read("day")
    <Campaign of P45: 45 actuators, 4 cycles under bare, ring>
    """
    every = fits_paths(_flat(paths))
    if client is None:
        whole = sum(path.stat().st_size for path in every if path.is_file()) <= IN_MEMORY
        opened = list(each(partial(open_file, whole=whole), every))
    else:
        names = [(str(path.absolute()), str(path)) for path in every]
        opened = list(each(open_by_worker, names, client))
    files = [one.file for one in opened]
    if len(files) == 1:
        if "CALIBRATION" in files[0].extensions:
            calibration = body_or_parts_from(files[0], CALIBRATIONS)
            warn_of(calibration)
            return calibration
        if "STIFFNESS" in files[0].extensions:
            matrix = stiffness_from(files[0])
            return SegmentedData(stiffness=matrix) if matrix.layout.segments else matrix
    matrices = [file for file in files if "STIFFNESS" in file.extensions]
    _refuse_foreign(files, matrices)
    cycles = tuple(one.require_cycle() for one in opened if one.file not in matrices)
    beside = stiffness_from(matrices[0]) if matrices else None
    return SegmentedData(cycles, beside) if in_segments(cycles) else Campaign(cycles, beside)


def _flat(paths: Iterable[AnyPath | Iterable[AnyPath]]) -> list[AnyPath]:
    """Return paths and lists of paths as one list."""
    return [
        one for path in paths for one in ([path] if isinstance(path, str | os.PathLike) else path)
    ]


def _refuse_foreign(files: list[FitsFile], matrices: list[FitsFile]) -> None:
    """Raise FormatError for a file that does not belong to a campaign."""
    for file in files:
        faults = [fault for name, fault in FOREIGN.items() if name in file.extensions]
        if file.header.get("CTYPE2") == "ACTUATOR":
            faults += [
                Fault("is a plain matrix of a modal base", "give the .commanded.fits beside it")
            ]
        if file in matrices[1:]:
            faults += [Fault("is a second stiffness file among others", "give it alone")]
        for fault, remedy in faults:
            raise FormatError(fault, remedy=remedy, path=file.path)


def holds_alpha(data: object) -> TypeIs[AnyCalibration]:
    """Return whether something is a calibration, of one body or of several segments."""
    return isinstance(data, Calibration | Parts)


@overload
def select_segment(data: InParts[Part], number: int | None, path: object) -> Part: ...
@overload
def select_segment(data: Part, number: int | None, path: object) -> Part: ...
def select_segment(data: Any, number: int | None, path: object) -> Any:
    """Return the data of one segment; data of a mirror in one piece are returned unchanged.

    Raises
    ------
    FormatError
        There are several segments and none is chosen, or the data are not of the one chosen.
    UnknownName, GeometryError, RankDeficient
        There is no such segment, or there are no data of it.
    """
    if not has_parts(data):
        _require_number(data, number, path)
        return data
    if number is None:
        first = data.numbers[0]
        raise FormatError(
            f"has {len(data.numbers)} segments, and this takes one at a time",
            remedy=f"choose it by its number: --segment {first}, or part({first}) in Python",
            path=path,
        )
    with naming(path):
        return data.part(number)


def _require_number(data: Any, number: int | None, path: object) -> None:
    """Raise FormatError if data of one body are not of this segment."""
    if number is None:
        return
    if isinstance(data, Calibration):  # only its instrument contains the number
        _, of, said = data.instrument.rpartition(" segment ")
        own = int(said) if of and said.isdecimal() else number
    elif data.layout.segment is None:
        raise FormatError("is of a mirror in one piece", remedy="leave --segment out", path=path)
    else:
        own = int(data.layout.segment[0])
    if own != number:
        raise FormatError(
            f"is of segment {own}, not {number}",
            remedy=f"give the files of segment {number}",
            path=path,
        )


def read_chosen(*paths: AnyPath, segment: int | None = None, client: Client | None = None) -> Read:
    """Read as `read`, and return one segment if it is chosen, otherwise all."""
    data = read(*paths, client=client)
    return data if segment is None else select_segment(data, segment, paths[0])


def read_data(
    *paths: AnyPath, segment: int | None = None, client: Client | None = None
) -> Campaign | StiffnessMatrix | SegmentedData:
    """Read as `read_chosen`, and refuse a calibration."""
    data = read_chosen(*paths, segment=segment, client=client)
    if holds_alpha(data):
        raise FormatError(
            "is a calibration already", remedy="give cycle files or a stiffness file", path=paths[0]
        )
    return data


def _required(data: Read, wanted: type[Kind], remedy: str, path: object) -> Kind:
    """Return data if they are of the class wanted, otherwise raise FormatError."""
    if isinstance(data, wanted):
        return data
    kind, reader = KINDS[type(data)]
    raise FormatError(
        f"is not {KINDS[wanted][0]}, but {kind}",
        remedy=f"{remedy}, or read it with {reader} in Python",
        path=path,
    )


def read_campaign(*paths: AnyPath | Iterable[AnyPath], client: Client | None = None) -> Campaign:
    """Read a campaign; other data are refused.

    Parameters
    ----------
    paths, client
        As of `read`.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Examples
    --------
    >>> tn.read_campaign("day/bare-001.fits", "day/ring-001.fits")
    <Campaign of P45: 45 actuators, 2 cycles under bare, ring>
    """
    data = read(*paths, client=client)
    return _required(data, Campaign, "give cycle files or their folder", _flat(paths)[0])


def read_stiffness(path: AnyPath) -> StiffnessMatrix:
    """Read a stiffness file.

    Parameters
    ----------
    path
        The stiffness file.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Examples
    --------
    >>> tn.write_stiffness(matrix, "feedforward.fits")
    >>> tn.read_stiffness("feedforward.fits")
    <StiffnessMatrix of P45: 45 actuators>
    """
    return _required(read(path), StiffnessMatrix, "give what `import` wrote", path)


def read_calibration(path: AnyPath, *, segment: int | None = None) -> Calibration:
    """Read a calibration file of one body, or one segment of several; `read` reads all segments.

    Parameters
    ----------
    path
        The calibration, as written by `Calibration.write`.
    segment
        Number of the segment.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, UnknownName, RankDeficient

    Examples
    --------
    >>> calibration.write("alpha.fits")
    >>> tn.read_calibration("alpha.fits").method
    'ml'
    """
    return select_segment(read_alpha(path, segment=segment), None, path)


def read_alpha(path: AnyPath, *, segment: int | None = None) -> AnyCalibration:
    """Read a calibration file; of several segments one if it is chosen, otherwise all."""
    data = read_chosen(path, segment=segment)
    if holds_alpha(data):
        return data
    return _required(data, Calibration, "give what `calibrate -o` wrote", path)


def read_calibrations(*paths: AnyPath, segment: int | None = None) -> tuple[AnyCalibration, ...]:
    """Read several calibrations, or return () if one of the paths contains something else."""
    files = [read_file(path) for path in paths if not Path(path).is_dir()]
    if len(files) < len(paths) or any("CALIBRATION" not in file.extensions for file in files):
        return ()
    every = [(body_or_parts_from(file, CALIBRATIONS), file.path) for file in files]
    return tuple(
        one if segment is None else select_segment(one, segment, path) for one, path in every
    )
