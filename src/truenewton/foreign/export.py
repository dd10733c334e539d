"""A supervisor's five files with alpha in: forces in true Newtons instead of commanded ones."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refuse_unusable
from truenewton.errors import CampaignMismatch, UnreadableFile
from truenewton.files.fits import write_fits
from truenewton.files.format import FileFormat, Keyword
from truenewton.files.outputs import folder_beside
from truenewton.foreign.given import TRACK_NUMBER
from truenewton.foreign.stored import read_stored
from truenewton.foreign.supervisor import MATRIX, channels_of, decomposed, only_array

FIVE = {
    "ff_list": "channels of the electronics",
    "ff_matrix": "true force per displacement, forces in rows",
    "ff_f_svec": "force singular vectors, one a column",
    "ff_p_svec": "position singular vectors, one a column",
    "ff_sval": "singular values, softest first",
}


@dataclass(frozen=True, eq=False)
class _Written:
    """What one of the files holds."""

    values: NDArray[Any]
    track: str | None
    date: datetime.datetime
    unit: str | None
    of: str
    alpha: str


FORM = FileFormat(
    (
        Keyword("DATE", "date", "UTC, when this file was made", kind="date"),
        Keyword("TRACKNUM", "track", "", kind="str"),
        Keyword("BUNIT", "unit", "", kind="str"),
        Keyword("CONTENT", "of", "", kind="str"),
        Keyword("ALPHA", "alpha", "what forces were corrected by", kind="str"),
    ),
    matrix="values",
)


def export_supervisor(
    folder: str | os.PathLike[str],
    calibration: Calibration,
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    force: bool = False,
) -> tuple[str, ...]:
    """Write a supervisor's five files anew, each row of the matrix times alpha of its actuator.

    For electronics into which alpha is loaded: what they are then commanded is true. The sign is
    that of the files. TRACKNUM is the track number in the name of the output, else that of the
    files. Rows of actuators without alpha stay as they are.

    Parameters
    ----------
    folder
        With `ff_matrix.fits` and `ff_list.fits`.
    calibration
        Its IDs are channels, as in a stiffness file that was imported from such a folder.
    output
        Folder to write.
    overwrite, force
        Replace what stands there; go on although the verdict is 'rejected'.

    Returns
    -------
    tuple of str
        What was done, in words.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, NotToBeUsed, OutputExists, OutputFailed

    Examples
    --------
    >>> from astropy.io import fits
    >>> fits.writeto("ff_matrix.fits", matrix.stiffness)
    >>> fits.writeto("ff_list.fits", layout.id)
    >>> done = tn.export_supervisor(".", calibration, "in-true-newtons")
    """
    refuse_unusable(calibration, force=force)
    folder = Path(folder)
    channels, matrix = _measured(folder)
    alpha = _alpha_of(channels, calibration, folder)
    stored = read_stored(folder / MATRIX)
    known = np.isfinite(alpha)
    corrected = np.where(known, alpha, 1.0)[:, None] * matrix
    forces, values, positions = decomposed(corrected)
    named = TRACK_NUMBER.search(Path(output).name)
    track = named[0] if named else str(stored.header.get("TRACKNUM", "")).strip() or None
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    parts: dict[str, tuple[Any, str | None]] = {
        "ff_list": (channels, None),
        "ff_matrix": (corrected, "N/m"),
        "ff_f_svec": (forces, None),
        "ff_p_svec": (positions, None),
        "ff_sval": (values, "N/m"),
    }
    by = f"{calibration.instrument} {calibration.method}"[:60]
    with folder_beside(output, (".fits",), overwrite=overwrite) as temporary:
        for name, (numbers, unit) in parts.items():
            record = _Written(numbers, track, now, unit, FIVE[name], by)
            write_fits(temporary / f"{name}.fits", FORM, record)
    lines = [
        f"{folder}: {len(channels)} channels, rows times alpha of {calibration.instrument}, which"
        f" is {np.nanmin(alpha):.3f} .. {np.nanmax(alpha):.3f}",
        "  forces are true Newtons: load alpha into the electronics too",
        f"  TRACKNUM {track or 'unknown'}",
    ]
    if not known.all():
        ids = ", ".join(map(str, channels[~known][:12].tolist()))
        lines.append(f"  without alpha, as they were: {ids}")
    return tuple(lines)


def _measured(folder: Path) -> tuple[NDArray[np.int64], Array]:
    """Return (m,) channels of a supervisor's folder and the (m, m) matrix, as stored."""
    if not (folder / MATRIX).is_file():
        raise UnreadableFile(
            f"holds no {MATRIX}",
            remedy="give the supervisor's folder of a measurement, named by its track number",
            path=folder,
        )
    channels = channels_of(folder)
    matrix = only_array(folder / MATRIX).values
    if matrix.shape != (len(channels), len(channels)):
        raise CampaignMismatch(
            f"is {' x '.join(map(str, matrix.shape))} for {len(channels)} channels",
            remedy="give ff_matrix.fits and ff_list.fits of one measurement",
            path=folder / MATRIX,
        )
    return channels, matrix


def _alpha_of(channels: NDArray[np.int64], calibration: Calibration, folder: Path) -> Array:
    """Return (m,) alpha of channels; NaN where a calibration has none."""
    at = {name: k for k, name in enumerate(calibration.layout.id.tolist())}
    missing = [c for c in channels.tolist() if c not in at]
    if missing:
        raise CampaignMismatch(
            f"the calibration has no actuator {missing[0]}, which is a channel of the matrix",
            remedy="give that of the stiffness file that `truenewton import` made of this folder",
            path=folder,
        )
    return np.asarray(calibration.alpha[[at[c] for c in channels.tolist()]])
