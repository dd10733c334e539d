"""One door for every file: what a path holds decides what comes back."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from truenewton.calibration.file import calibration_from, is_calibration_file
from truenewton.calibration.result import Calibration
from truenewton.errors import FormatError
from truenewton.files.content import FitsFile
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.file import campaign_from, fits_paths, is_stiffness_file, stiffness_from
from truenewton.records.stiffness_matrix import StiffnessMatrix

IN_MEMORY = 2**28  # bytes; of files that are larger together FORCE and POSITION stay on disk


def read(*paths: str | os.PathLike[str]) -> Campaign | StiffnessMatrix | Calibration:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files; a stiffness file may stand among cycle files.

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        By what the files hold.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch
    """
    every = fits_paths(paths)
    whole = sum(path.stat().st_size for path in every if path.is_file()) <= IN_MEMORY
    files = [read_fits(path, whole=whole) for path in every]
    if len(files) == 1:
        if is_calibration_file(files[0]):
            return calibration_from(files[0])
        if is_stiffness_file(files[0]):
            return stiffness_from(files[0])
    matrices = [file for file in files if is_stiffness_file(file)]
    for file in files:
        fault = _stranger(file)
        if fault is None and file in matrices[1:]:
            fault = Fault("is a second stiffness file among others", "give it alone")
        if fault is not None:
            raise FormatError(fault.fault, remedy=fault.remedy, path=file.path)
    campaign = campaign_from(file for file in files if file not in matrices)
    return replace(campaign, stiffness=stiffness_from(matrices[0])) if matrices else campaign


def _stranger(file: FitsFile) -> Fault | None:
    """Say what a file is that does not belong among the cycle files of a campaign."""
    if file.holds("TRUTH"):
        return Fault("is the truth of a simulation", "give the campaign beside it")
    if file.header.get("CTYPE2") == "ACTUATOR":
        return Fault("is a plain matrix of a modal base", "give the .commanded.fits beside it")
    if file.holds("MODES"):
        remedy = "give what it was made from, or the .commanded.fits beside it"
        return Fault("is a modal base", remedy)
    if file.holds("TRACKING"):
        remedy = "give it to `recalibrate --known`, or to read_tracking in Python"
        return Fault("is a tracking file", remedy)
    if is_calibration_file(file):
        return Fault("is a calibration file among others", "give it alone")
    return None


def read_data(*paths: str | os.PathLike[str]) -> Campaign | StiffnessMatrix:
    """Read what can be calibrated: as ``read``, but a calibration is refused.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch
    """
    data = read(*paths)
    if isinstance(data, Calibration):
        raise FormatError(
            "is a calibration already", remedy="give cycle files or a stiffness file", path=paths[0]
        )
    return data


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    UnreadableFile, FormatError
    """
    calibrations = read_calibrations(path)
    if not calibrations:
        raise FormatError("is no calibration", remedy="give what `calibrate -o` wrote", path=path)
    return calibrations[0]


def read_calibrations(*paths: str | os.PathLike[str]) -> tuple[Calibration, ...]:
    """Read several calibrations; none where one of the paths holds something else.

    Raises
    ------
    UnreadableFile, FormatError
    """
    if any(Path(path).is_dir() for path in paths):
        return ()
    files = []
    for path in paths:
        files.append(read_fits(path))
        if not is_calibration_file(files[-1]):
            return ()
    return tuple(calibration_from(file) for file in files)
