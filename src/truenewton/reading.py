"""The public functions that read data or a calibration; `records.reader` opens the files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from truenewton.calibration.file import calibration_from
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.errors import FormatError, naming
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.reader import AnyPath, Measured, flat, measured_in, open_files
from truenewton.records.result import OTHER_FORMATS
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.layout import require_segment

Read = Measured | Calibration
Kind = TypeVar("Kind", Campaign, StiffnessMatrix, Calibration)
KIND_NAMES: dict[type, tuple[str, str]] = {  # what files contain, and the function that reads them
    Campaign: ("a campaign", "read_campaign"),
    StiffnessMatrix: ("a stiffness matrix", "read_stiffness"),
    Calibration: ("a calibration", "read_calibration"),
}


def read(*paths: AnyPath | Iterable[AnyPath], segment: int | None = None) -> Read:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files, or lists of them; one stiffness file may be among
        cycle files.
    segment
        Number of the segment to read of a mirror in several segments, as if it were alone.

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        Depending on the files.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, ClusterFailed
    SeveralSegments
        The files are of several segments, and none is chosen.
    UnknownName
        There is no such segment.

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
        calibration = calibration_from(opened[0].file)
        if segment is not None:
            _require_segment_of(calibration, segment, opened[0].file.path)
        warn_of(calibration)
        return calibration
    return measured_in(opened, segment)


def _require_segment_of(calibration: Calibration, segment: int, path: str) -> None:
    """Raise UnknownName if INSTRUME of a calibration does not name this segment."""
    _, of, number = calibration.instrument.rpartition(" segment ")
    with naming(path):
        require_segment(segment, [int(number)] if of and number.isdecimal() else [])


def read_data(*paths: AnyPath, segment: int | None = None) -> Measured:
    """Read as `read`, and refuse a calibration."""
    data = read(*paths, segment=segment)
    if isinstance(data, Calibration):
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


def read_campaign(*paths: AnyPath | Iterable[AnyPath], segment: int | None = None) -> Campaign:
    """Read a campaign; other data are refused.

    Parameters
    ----------
    paths, segment
        As of `read`.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, SeveralSegments, UnknownName

    Examples
    --------
    >>> tn.read_campaign("day/bare-001.fits", "day/ring-001.fits")
    <Campaign of P45: 45 actuators, 2 cycles under bare, ring>
    """
    data = read(*paths, segment=segment)
    return _required(data, Campaign, "give cycle files or their folder", flat(paths)[0])


def read_stiffness(path: AnyPath, *, segment: int | None = None) -> StiffnessMatrix:
    """Read a stiffness file.

    Parameters
    ----------
    path
        The stiffness file.
    segment
        As of `read`.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, SeveralSegments, UnknownName

    Examples
    --------
    >>> tn.write_stiffness(matrix, "feedforward.fits")
    >>> tn.read_stiffness("feedforward.fits")
    <StiffnessMatrix of P45: 45 actuators>
    """
    return _required(read(path, segment=segment), StiffnessMatrix, "give what `import` wrote", path)


def read_calibration(path: AnyPath) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path
        The calibration, as written by `Calibration.write`.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Examples
    --------
    >>> calibration.write("alpha.fits")
    >>> tn.read_calibration("alpha.fits").method
    'ml'
    """
    other = OTHER_FORMATS[Calibration].get(Path(path).suffix.lower())
    if other is not None and Path(path).is_file():
        raise FormatError(
            f"contains {other.lacks.partition(',')[0]}",
            remedy="give the .fits of the same calibration, which contains all of it",
            path=path,
        )
    return _required(read(path), Calibration, "give what `calibrate -o` wrote", path)


def read_compared(*paths: AnyPath, segment: int | None = None) -> tuple[Read, ...]:
    """Read two calibrations, or two states of a mirror; () if there are not two, or other data.

    A state is a stiffness file or the folder of a campaign.
    """
    kinds = {_compared_kind(path) for path in paths}
    if len(paths) != 2 or len(kinds) > 1 or kinds == {""}:
        return ()
    return tuple(read(path, segment=segment) for path in paths)


def _compared_kind(path: AnyPath) -> str:
    """Return 'state', 'calibration', or '' for a file of other data."""
    if Path(path).is_dir():
        return "state"
    extensions = read_fits(path).extensions
    if "CALIBRATION" in extensions:
        return "calibration"
    return "state" if "STIFFNESS" in extensions else ""
