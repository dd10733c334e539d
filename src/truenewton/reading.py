"""One door for every file: what a path holds decides what comes back."""

from __future__ import annotations

import os

from truenewton.calibration import Calibration, calibration_from, is_calibration_file
from truenewton.campaign import Campaign
from truenewton.campaign_files import (
    campaign_from,
    fits_paths,
    is_stiffness_file,
    stiffness_from,
)
from truenewton.errors import FormatError
from truenewton.fitsfiles import read_fits
from truenewton.measurements import StiffnessMatrix


def read(*paths: str | os.PathLike[str]) -> Campaign | StiffnessMatrix | Calibration:
    """Read cycle files, a stiffness file, or a calibration.

    Parameters
    ----------
    paths
        Folders of cycle files and single files.

    Returns
    -------
    Campaign, StiffnessMatrix or Calibration
        By what the files hold.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch
    """
    files = [read_fits(path) for path in fits_paths(paths)]
    if len(files) == 1:
        if is_calibration_file(files[0]):
            return calibration_from(files[0])
        if is_stiffness_file(files[0]):
            return stiffness_from(files[0])
    for file in files:
        if "TRUTH" in file.tables:
            raise FormatError(
                "is the truth of a simulation", remedy="give the campaign beside it", path=file.path
            )
        if is_calibration_file(file) or is_stiffness_file(file):
            raise FormatError(
                f"is a {'calibration' if is_calibration_file(file) else 'stiffness'} file among"
                " others",
                remedy="give it alone",
                path=file.path,
            )
    return campaign_from(files)


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
