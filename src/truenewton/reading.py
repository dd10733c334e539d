"""One door for every file: what a path holds decides what comes back."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

from truenewton.calibration.result import CALIBRATIONS, AnyCalibration, Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.cluster import Client, each
from truenewton.errors import Fault, FormatError, TrueNewtonError, located
from truenewton.records.campaign import Campaign
from truenewton.records.file import fits_paths, read_file, stiffness_from
from truenewton.records.parts import InParts, Parts, body_or_parts_from, has_parts
from truenewton.records.reader import open_by_worker, open_file
from truenewton.records.segmented import SegmentedData, in_segments
from truenewton.records.stiffness_matrix import StiffnessMatrix

if TYPE_CHECKING:
    from typing_extensions import TypeIs

AnyPath = str | os.PathLike[str]
IN_MEMORY = 2**28  # bytes; of files that are larger together FORCE and POSITION stay on disk
Body = Campaign | StiffnessMatrix | Calibration  # of a mirror in one piece
Read = Body | SegmentedData | Parts[Calibration]
Part = TypeVar("Part")
KINDS: dict[type, tuple[str, str]] = {  # what paths hold, and what reads it
    Campaign: ("cycles", "read_campaign"),
    StiffnessMatrix: ("a stiffness matrix", "read_stiffness"),
    Calibration: ("a calibration", "read_calibration"),
    SegmentedData: ("data of several segments", "read"),
    Parts: ("a calibration of several segments", "read"),
}
FOREIGN = {  # extensions of what cannot be calibrated: what it is, and what to do with it
    "TRUTH": Fault("is the truth of a simulation", "give the campaign beside it"),
    "MODES": Fault(
        "is a modal base", "give what it was made from, or the .commanded.fits beside it"
    ),
    "TRACKING": Fault(
        "is a tracking file", "give it to `recalibrate --known`, or to read_tracking in Python"
    ),
    "CALIBRATION": Fault(
        "is a calibration file among others",
        "give it alone, or two of them to `report`: {} is none",
    ),
}


def read(*paths: AnyPath | Iterable[AnyPath], client: Client | None = None) -> Read:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files, or lists of them; a stiffness file may stand among
        cycle files.
    client
        A `dask.distributed.Client`, whose workers read the files, a file each, and leave rows where
        they are (docs/cluster.md).

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        By what the files hold; of a mirror in several segments SegmentedData or Parts.

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
    for file in files:
        faults = [fault for name, fault in FOREIGN.items() if name in file.extensions]
        if file.header.get("CTYPE2") == "ACTUATOR":
            faults += [
                Fault("is a plain matrix of a modal base", "give the .commanded.fits beside it")
            ]
        if file in matrices[1:]:
            faults += [Fault("is a second stiffness file among others", "give it alone")]
        if faults:
            other = next((f.path for f in files if "CALIBRATION" not in f.extensions), "this")
            raise FormatError(
                faults[0].fault, remedy=faults[0].remedy.format(other), path=file.path
            )
    cycles = tuple(one.require_cycle() for one in opened if one.file not in matrices)
    beside = stiffness_from(matrices[0]) if matrices else None
    if in_segments(cycles):
        return SegmentedData(cycles, beside)
    return Campaign(cycles, beside)


def holds_alpha(data: object) -> TypeIs[AnyCalibration]:
    """Tell whether something is a calibration, of one body or of several segments."""
    return isinstance(data, Calibration | Parts)


@overload
def select_segment(data: InParts[Part], number: int | None, path: object) -> Part: ...
@overload
def select_segment(data: Part, number: int | None, path: object) -> Part: ...
def select_segment(data: Any, number: int | None, path: object) -> Any:
    """Return what there is of one segment; what is of a mirror in one piece as it is.

    Raises
    ------
    FormatError
        There are several segments and none is chosen, or one is chosen of a mirror in one piece.
    UnknownName, GeometryError, RankDeficient
        There is no such segment, or nothing of it.
    """
    if has_parts(data):
        if number is None:
            first = data.numbers[0]
            raise FormatError(
                f"has {len(data.numbers)} segments, and this takes one at a time",
                remedy=f"choose it by its number: --segment {first}, or part({first}) in Python",
                path=path,
            )
        try:
            return data.part(number)
        except TrueNewtonError as error:
            raise located(error, path) from None
    if number is not None:
        _require_number(data, number, path)
    return data


def _require_number(data: Any, number: int, path: object) -> None:
    """Refuse data of one body that are not of this segment.

    Raises
    ------
    FormatError
    """
    if isinstance(data, Calibration):  # of one segment, its instrument alone says which
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
    """Read, as ``read``; of several segments one, if it is chosen, else all.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, UnknownName, GeometryError, RankDeficient
    """
    data = read(*paths, client=client)
    return data if segment is None else select_segment(data, segment, paths[0])


def read_data(
    *paths: AnyPath, segment: int | None = None, client: Client | None = None
) -> Campaign | StiffnessMatrix | SegmentedData:
    """Read what can be calibrated: as ``read_chosen``, but a calibration is refused.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, UnknownName, GeometryError
    """
    data = read_chosen(*paths, segment=segment, client=client)
    if holds_alpha(data):
        raise FormatError(
            "is a calibration already", remedy="give cycle files or a stiffness file", path=paths[0]
        )
    return data


def read_campaign(*paths: AnyPath | Iterable[AnyPath], client: Client | None = None) -> Campaign:
    """Read a campaign, as ``read``, and nothing else.

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
    if not isinstance(data, Campaign):
        raise _another(data, "campaign", "give cycle files or their folder", paths)
    return data


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
    data = read(path)
    if not isinstance(data, StiffnessMatrix):
        raise _another(data, "stiffness file", "give what `import` wrote", [path])
    return data


def read_calibration(path: AnyPath, *, segment: int | None = None) -> Calibration:
    """Read a calibration file; of a mirror in several segments, which `read` takes whole, one.

    Parameters
    ----------
    path
        The calibration, as `Calibration.write` writes it.
    segment
        Number of the one.

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
    """Read a calibration file as `read_calibration`; of several segments all if none is chosen.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, UnknownName, RankDeficient
    """
    data = read_chosen(path, segment=segment)
    if not holds_alpha(data):
        raise _another(data, "calibration", "give what `calibrate -o` wrote", [path])
    return data


def _another(
    data: Read,
    wanted: str,
    remedy: str,
    paths: Iterable[AnyPath | Iterable[AnyPath]],
) -> FormatError:
    """Return the refusal of files that hold something else than was asked for."""
    kind, reader = KINDS[type(data)]
    return FormatError(
        f"is no {wanted}, but holds {kind}",
        remedy=f"{remedy}, or this to {reader} in Python",
        path=_flat(paths)[0],
    )


def _flat(paths: Iterable[AnyPath | Iterable[AnyPath]]) -> list[AnyPath]:
    """Return paths one by one, where lists of them may stand among them."""
    return [
        one for path in paths for one in ([path] if isinstance(path, str | os.PathLike) else path)
    ]


def read_calibrations(*paths: AnyPath, segment: int | None = None) -> tuple[AnyCalibration, ...]:
    """Read several calibrations; none where one of the paths holds something else.

    Of mirrors in several segments that of one, if it is chosen.

    Raises
    ------
    UnreadableFile, FormatError
    """
    files = [read_file(path) for path in paths if not Path(path).is_dir()]
    if len(files) < len(paths) or any("CALIBRATION" not in file.extensions for file in files):
        return ()
    every = [(body_or_parts_from(file, CALIBRATIONS), file.path) for file in files]
    return tuple(
        one if segment is None else select_segment(one, segment, path) for one, path in every
    )
