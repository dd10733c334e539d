"""Export: the files of an LBT supervisor, with alpha in their matrix (`importers.inputs`)."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refusal_of
from truenewton.errors import CampaignMismatch, FormatError, OutputExists, UnreadableFile
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Scale
from truenewton.files.fits import write_fits
from truenewton.files.format import FileFormat, Keyword
from truenewton.files.outputs import folder_beside
from truenewton.importers.inputs import MATRIX, TRACK_NUMBER, channels_of, only_array
from truenewton.importers.selection import MAX_NAMED
from truenewton.importers.stored import read_stored
from truenewton.rounding import named

README = "README.txt"
HOW_TO_USE = """
Direction: alpha = true Newton / commanded Newton. Row i of ff_matrix was MULTIPLIED by alpha of the
channel in row i of ff_list, and the singular values and vectors were computed again. The measured
matrix is in commanded Newtons. This matrix is in true Newtons (times one unknown factor if the
scale is 'mean 1'). This matrix is correct only if the electronics DIVIDE a requested force by
alpha, or multiply it by 1 / alpha.

To go back: load the measured matrix ({}) together with the previous alpha (1 for every
channel if there was none). The measured files were not changed."""
FORM = FileFormat(
    (
        Keyword("DATE", "date", "UTC, when this file was made", kind="date"),
        Keyword("TRACKNUM", "track", "", kind="str"),
        Keyword("BUNIT", "unit", "", kind="str"),
        Keyword("CONTENT", "content", "", kind="str"),
        Keyword("ALPHA", "alpha", "calibration that corrected the forces", kind="str"),
    ),
    matrix="values",
)


def export_supervisor(
    folder: str | os.PathLike[str],
    calibration: Calibration,
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    accept_rejected: bool = False,
) -> tuple[str, ...]:
    """Write the five files of a supervisor with each row of the matrix multiplied by alpha.

    For electronics into which alpha is loaded, so that commanded forces are true ones. The sign is
    that of the files. Rows of actuators without alpha are not changed. The files have a new track
    number: that in the name of the output, otherwise the time. README.txt beside them describes
    each file, the direction, and how to go back.

    Parameters
    ----------
    folder
        With `ff_matrix.fits` and `ff_list.fits`.
    calibration
        Its IDs are channels, as in a stiffness file that was imported from such a folder.
    output
        Folder to write.
    overwrite, accept_rejected
        Replace an existing folder; continue although the verdict is 'doubtful' or 'rejected'.

    Returns
    -------
    tuple of str
        Texts on what was done, the verdict included.

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
    verdict = calibration.verdict
    if verdict.level <= Level.DOUBTFUL and not accept_rejected:
        raise refusal_of(verdict.level, verdict.faults[0].fault, verdict.faults[0].remedy)
    folder = Path(folder)
    channels, matrix, old = _measured(folder)
    alpha = _alpha_of(channels, calibration, folder)
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    in_name = TRACK_NUMBER.search(Path(output).name)
    track = in_name[0] if in_name else f"{now:%Y%m%d_%H%M%S}"
    if track == old:
        remedy = "choose a name with another track number, or without one"
        raise OutputExists(
            "has the track number of the measured matrix", remedy=remedy, path=output
        )
    known = np.isfinite(alpha)
    relative = calibration.scale == Scale.MEAN_ONE
    newtons = "true Newtons times one unknown factor" if relative else "true Newtons"
    corrected = np.where(known, alpha, 1.0)[:, None] * matrix
    lines: tuple[str, ...] = (
        f"{folder}: {len(channels)} channels, each row of the matrix multiplied by alpha of"
        f" {calibration.instrument}, {np.nanmin(alpha):.3f} .. {np.nanmax(alpha):.3f}",
        f"  verdict on alpha: {verdict}",
        f"  common scale of alpha: {Scale(calibration.scale).origin}",
        f"  forces are {newtons}: load alpha into the electronics together with these files",
        f"  track number {track}; of the measured matrix: {old}",
    )
    if not known.all():
        unknown = named("channel", channels[~known].tolist(), MAX_NAMED)
        lines += (f"  without alpha, so not multiplied: {unknown}",)
    with folder_beside(output, (".fits", README), overwrite=overwrite) as temporary:
        by = f"{calibration.instrument} {calibration.method}"[:60]
        contents = _write_files(temporary, channels, corrected, track=track, date=now, alpha=by)
        text = "\n".join((*lines, "", "Files:", *contents, HOW_TO_USE.format(old)))
        (temporary / README).write_text(f"{text}\n", encoding="utf-8")
    return lines


def _write_files(
    folder: Path, channels: NDArray[np.int64], matrix: Array, **values: Any
) -> Iterator[str]:
    """Write the five files of an (m, m) matrix, and yield what each contains."""
    # U S V' = matrix; the files contain the softest singular value first
    forces, sizes, positions = scipy.linalg.svd(matrix)
    parts: dict[str, tuple[str, Any, str | None]] = {
        "ff_list": ("channels of the electronics", channels, None),
        "ff_matrix": ("true force per displacement, forces in rows", matrix, "N/m"),
        "ff_f_svec": ("force singular vectors, one a column", forces[:, ::-1], None),
        "ff_p_svec": ("position singular vectors, one a column", positions[::-1].T, None),
        "ff_sval": ("singular values, softest first", sizes[::-1], "N/m"),
    }
    for name, (content, numbers, unit) in parts.items():
        record = SimpleNamespace(values=numbers, unit=unit, content=content, **values)
        write_fits(folder / f"{name}.fits", FORM, record)
        yield f"  {name + '.fits':<16}{content}{f' [{unit}]' * bool(unit)}"


def _measured(folder: Path) -> tuple[NDArray[np.int64], Array, str]:
    """Return (m,) channels of a supervisor's folder, the (m, m) matrix as stored, track number."""
    if not (folder / MATRIX).is_file():
        raise UnreadableFile(
            f"contains no {MATRIX}",
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
    header = read_stored(folder / MATRIX).header
    if applied := str(header.get("ALPHA", "")).strip():
        raise FormatError(
            f"its rows were multiplied by alpha already (ALPHA is {applied})",
            remedy="export the folder as it was measured",
            path=folder / MATRIX,
        )
    return channels, matrix, str(header.get("TRACKNUM", "")).strip() or folder.name


def _alpha_of(channels: NDArray[np.int64], calibration: Calibration, folder: Path) -> Array:
    """Return (m,) alpha of channels, NaN if it is unknown."""
    at = {name: k for k, name in enumerate(calibration.layout.id.tolist())}
    missing = [c for c in channels.tolist() if c not in at]
    if missing:
        raise CampaignMismatch(
            f"the calibration has no actuator {missing[0]}, which is a channel of the matrix",
            remedy="give that of the stiffness file that `truenewton import` made of this folder",
            path=folder,
        )
    return np.asarray(calibration.alpha[[at[c] for c in channels.tolist()]])
