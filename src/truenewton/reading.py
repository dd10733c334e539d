"""One door for every file: what a path holds decides what comes back."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from truenewton.calibration.file import calibration_from
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.errors import FormatError
from truenewton.files.fits import read_fits
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.file import campaign_from, fits_paths, stiffness_from
from truenewton.records.stiffness_matrix import StiffnessMatrix

IN_MEMORY = 2**28  # bytes; of files that are larger together FORCE and POSITION stay on disk
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

    Warns
    -----
    TrueNewtonWarning
        A calibration is not to be used, or its data show what was not taken out of them.
    """
    every = fits_paths(paths)
    whole = sum(path.stat().st_size for path in every if path.is_file()) <= IN_MEMORY
    files = [read_fits(path, whole=whole) for path in every]
    if len(files) == 1:
        if "CALIBRATION" in files[0].extensions:
            calibration = calibration_from(files[0])
            warn_of(calibration)
            return calibration
        if "STIFFNESS" in files[0].extensions:
            return stiffness_from(files[0])
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
    campaign = campaign_from(file for file in files if file not in matrices)
    return replace(campaign, stiffness=stiffness_from(matrices[0])) if matrices else campaign


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
    warn_of(calibrations[0])
    return calibrations[0]


def read_calibrations(*paths: str | os.PathLike[str]) -> tuple[Calibration, ...]:
    """Read several calibrations; none where one of the paths holds something else.

    Raises
    ------
    UnreadableFile, FormatError
    """
    files = [read_fits(path) for path in paths if not Path(path).is_dir()]
    if len(files) < len(paths) or any("CALIBRATION" not in file.extensions for file in files):
        return ()
    return tuple(map(calibration_from, files))
