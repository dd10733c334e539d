"""The public functions that read data or a calibration; `records.reader` opens the files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

from truenewton.calibration.file import CALIBRATIONS, LACKS
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.errors import FormatError, naming
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.parts import InParts, Parts, body_or_parts_from, has_parts
from truenewton.records.reader import AnyPath, Measured, flat, measured_in, open_files
from truenewton.records.segmented import SegmentedData
from truenewton.records.stiffness_matrix import StiffnessMatrix

if TYPE_CHECKING:
    from typing_extensions import TypeIs

Body = Campaign | StiffnessMatrix | Calibration  # of a mirror in one piece
Read = Measured | AnyCalibration
Part = TypeVar("Part")
Kind = TypeVar("Kind", bound=Body)
KIND_NAMES: dict[type, tuple[str, str]] = {  # what files contain, and the function that reads them
    Campaign: ("a campaign", "read_campaign"),
    StiffnessMatrix: ("a stiffness matrix", "read_stiffness"),
    Calibration: ("a calibration", "read_calibration"),
    SegmentedData: ("data of several segments", "read"),
    Parts: ("a calibration of several segments", "read"),
}


def read(*paths: AnyPath | Iterable[AnyPath]) -> Read:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files, or lists of them; one stiffness file may be among
        cycle files.

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        Depending on the files; of a mirror in several segments SegmentedData or Parts.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Warns
    -----
    TrueNewtonWarning
        The verdict on a calibration is 'doubtful' or 'rejected'.

    Examples
    --------
    >>> tn.read("day")
    <Campaign of P45: 45 actuators, 4 cycles under bare, ring>
    """
    opened = open_files(paths)
    if len(opened) == 1 and "CALIBRATION" in opened[0].file.extensions:
        calibration = body_or_parts_from(opened[0].file, CALIBRATIONS)
        warn_of(calibration)
        return calibration
    return measured_in(opened)


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


def read_chosen(*paths: AnyPath, segment: int | None = None) -> Read:
    """Read as `read`, and return one segment if it is chosen, otherwise all."""
    data = read(*paths)
    return data if segment is None else select_segment(data, segment, paths[0])


def read_data(*paths: AnyPath, segment: int | None = None) -> Measured:
    """Read as `read_chosen`, and refuse a calibration."""
    data = read_chosen(*paths, segment=segment)
    if holds_alpha(data):
        raise FormatError(
            "is a calibration already", remedy="give cycle files or a stiffness file", path=paths[0]
        )
    return data


def _required(data: Read, wanted: type[Kind], remedy: str, path: object) -> Kind:
    """Return data if they are of the class wanted, otherwise raise FormatError."""
    if isinstance(data, wanted):
        return data
    kind, reader = KIND_NAMES[type(data)]
    raise FormatError(
        f"is not {KIND_NAMES[wanted][0]}, but {kind}",
        remedy=f"{remedy}, or read it with {reader} in Python",
        path=path,
    )


def read_campaign(*paths: AnyPath | Iterable[AnyPath]) -> Campaign:
    """Read a campaign; other data are refused.

    Parameters
    ----------
    paths
        As of `read`.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Examples
    --------
    >>> tn.read_campaign("day/bare-001.fits", "day/ring-001.fits")
    <Campaign of P45: 45 actuators, 2 cycles under bare, ring>
    """
    data = read(*paths)
    return _required(data, Campaign, "give cycle files or their folder", flat(paths)[0])


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
    suffix = Path(path).suffix.lower()
    if suffix in LACKS and Path(path).is_file():
        raise FormatError(
            f"contains {LACKS[suffix].partition(',')[0]}",
            remedy="give the .fits of the same calibration, which contains all of it",
            path=path,
        )
    data = read_chosen(path, segment=segment)
    if holds_alpha(data):
        return data
    return _required(data, Calibration, "give what `calibrate -o` wrote", path)


def read_compared(*paths: AnyPath, segment: int | None = None) -> tuple[Read, ...]:
    """Read two calibrations, or two states of a mirror; () if there are not two, or other data.

    A state is a stiffness file or the folder of a campaign.
    """
    kinds = {_compared_kind(path) for path in paths}
    if len(paths) != 2 or len(kinds) > 1 or kinds == {""}:
        return ()
    return tuple(read_chosen(path, segment=segment) for path in paths)


def _compared_kind(path: AnyPath) -> str:
    """Return 'state', 'calibration', or '' for a file of other data."""
    if Path(path).is_dir():
        return "state"
    extensions = read_fits(path).extensions
    if "CALIBRATION" in extensions:
        return "calibration"
    return "state" if "STIFFNESS" in extensions else ""
