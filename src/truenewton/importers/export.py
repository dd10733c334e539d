"""Export: a matrix that was imported, times alpha, as the file stored it (`StoredAs`)."""

from __future__ import annotations

import datetime
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.io
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refusal_of
from truenewton.errors import CampaignMismatch, FormatError, OutputExists, TrueNewtonError
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Scale
from truenewton.files.fits import read_fits, write_fits
from truenewton.files.format import FileFormat, Keyword
from truenewton.files.outputs import file_beside, folder_beside
from truenewton.importers.importing import stiffness_from
from truenewton.importers.inputs import (
    CHANNELS,
    MATRIX,
    TRACK_NUMBER,
    channels_of,
    folder_of_matrix,
    only_array,
)
from truenewton.importers.selection import MAX_NAMED
from truenewton.importers.stored import read_stored
from truenewton.records.file import stiffness_from as matrix_in_file
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted, named

README = "README.txt"
HOW_TO_USE = """
Direction: alpha = true Newton / commanded Newton. Row i of ff_matrix was MULTIPLIED by alpha of
{row}. The measured
matrix is in commanded Newtons. This matrix is in true Newtons (times one unknown factor if the
scale is 'mean 1'). This matrix is correct only if the electronics DIVIDE a requested force by
alpha, or multiply it by 1 / alpha.

To go back: load the measured matrix ({old}) together with the previous alpha (1 for every
channel if there was none). The measured files were not changed."""
BY_CHANNEL = (
    "the channel in row i of ff_list, and the singular values and vectors were computed again"
)
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


@dataclass(frozen=True, eq=False)
class _Source:
    """A matrix as its file stores it, with forces in rows.

    ``which`` are (m,) channels or IDs of its rows, and ``alpha`` theirs, NaN if it is unknown; a
    row of no actuator has the ID -1.
    """

    values: Array
    which: NDArray[np.int64]
    alpha: Array
    unit: str
    convention: str  # a text on sign, unit and order
    track: str = ""
    transposed: bool = False  # in the file
    channels: bool = False

    @property
    def corrected(self) -> Array:
        """(m, m) forces times alpha, as the file stores them."""
        known = np.where(np.isfinite(self.alpha), self.alpha, 1.0)
        forces = known[:, None] * self.values
        return forces.T if self.transposed else forces


def export_matrix(
    source: str | os.PathLike[str],
    calibration: Calibration,
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    accept_rejected: bool = False,
) -> tuple[str, ...]:
    """Write a matrix that was imported with each row multiplied by alpha.

    For electronics into which alpha is loaded, so that commanded forces are true ones. Sign, unit,
    order of rows, orientation and displacements are those of the file that was imported. Rows of
    actuators without alpha are not changed.

    Parameters
    ----------
    source
        Stiffness file that `import` wrote, of a matrix in any format; or the folder of a
        supervisor (`ff_matrix.fits`, `ff_list.fits`) or of opticalib.
    calibration
        Of the same actuators, by ID.
    output
        File to write, .npy, .fits, .csv or .mat. Of a folder also a folder: five files of a
        supervisor, ff_matrix.fits of opticalib, and README.txt, which describes each file, the
        direction, and how to go back. The files of a supervisor have a new track number: that in
        the name of the output, otherwise the time.
    overwrite, accept_rejected
        Replace an existing output; continue although the verdict is 'doubtful' or 'rejected'.

    Returns
    -------
    tuple of str
        Texts on what was done, the verdict included.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, NotToBeUsed, OutputExists, OutputFailed

    Examples
    --------
    >>> made = tn.stiffness_from(-1e-6 * matrix.stiffness, layout, unit="N/um", instrument="P45")
    >>> tn.write_stiffness(made.matrix, "ff.fits")
    >>> done = tn.export_matrix("ff.fits", calibration, "in-true-newtons.npy")  # negative, N/um
    """
    verdict = calibration.verdict
    if verdict.level <= Level.DOUBTFUL and not accept_rejected:
        raise refusal_of(verdict.level, verdict.faults[0].fault, verdict.faults[0].remedy)
    source, target = Path(source), Path(output)
    write = next((WRITERS[end] for end in WRITERS if target.name.lower().endswith(end)), None)
    if write is None and not source.is_dir():
        raise FormatError(
            "is no name for a matrix",
            remedy=f"use a name that ends in {', '.join(WRITERS)}; files of a supervisor or of"
            " opticalib are written from their folder",
            path=target,
        )
    of = _in_folder(source, calibration) if source.is_dir() else _in_file(source, calibration)
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    record = SimpleNamespace(
        values=of.corrected, unit=of.unit or None, date=now, track=None,
        content=f"true force per displacement, forces in {'column' if of.transposed else 'row'}s",
        alpha=f"{calibration.instrument} {calibration.method}"[:60],
    )  # fmt: skip
    if write is None and of.channels:
        record.track = _track_of(target, of.track, now)
    lines = tuple(_lines(source, of, calibration, record.track))
    if write is not None:
        with file_beside(target, overwrite=overwrite) as temporary:
            write(temporary, record)
        return lines
    row = BY_CHANNEL if of.channels else "the actuator in row i of the positions"
    how = HOW_TO_USE.format(row=row, old=of.track)
    with folder_beside(target, (".fits", README), overwrite=overwrite) as temporary:
        files = _write_files(temporary, of, record)
        (temporary / README).write_text("\n".join((*lines, "", "Files:", *files, how, "")), "utf-8")
    return lines


def _track_of(target: Path, old: str, now: datetime.datetime) -> str:
    """Return the track number in the name of an output, otherwise the time."""
    in_name = TRACK_NUMBER.search(target.name)
    track = in_name[0] if in_name else f"{now:%Y%m%d_%H%M%S}"
    if track == old:
        remedy = "choose a name with another track number, or without one"
        raise OutputExists(
            "has the track number of the measured matrix", remedy=remedy, path=target
        )
    return track


def _lines(source: Path, of: _Source, calibration: Calibration, track: str | None) -> Iterator[str]:
    """Yield texts on what is done with alpha."""
    relative = calibration.scale == Scale.MEAN_ONE
    newtons = "true Newtons times one unknown factor" if relative else "true Newtons"
    there, what = of.which >= 0, "channel" if of.channels else "actuator"
    yield (
        f"{source}: {counted(int(np.count_nonzero(there)), what)},"
        f" each {'column' if of.transposed else 'row'} of the matrix multiplied by alpha of"
        f" {calibration.instrument}, {np.nanmin(of.alpha):.3f} .. {np.nanmax(of.alpha):.3f}"
    )
    yield f"  as stored: {of.convention}"
    yield f"  verdict on alpha: {calibration.verdict}"
    yield f"  common scale of alpha: {Scale(calibration.scale).origin}"
    yield f"  forces are {newtons}: load alpha into the electronics together with these files"
    if track:
        yield f"  track number {track}; of the measured matrix: {of.track}"
    unknown = of.which[there & ~np.isfinite(of.alpha)].tolist()
    if unknown:
        yield f"  without alpha, so not multiplied: {named(what, unknown, MAX_NAMED)}"


def _write_files(folder: Path, of: _Source, record: Any) -> Iterator[str]:
    """Write the files of a supervisor, or that of opticalib, and yield what each contains."""
    parts: dict[str, tuple[str, Any, str | None]] = {
        "ff_matrix": (record.content, record.values, record.unit)
    }
    if of.channels:
        # U S V' = matrix; the files contain the softest singular value first
        forces, sizes, positions = scipy.linalg.svd(record.values)
        parts |= {
            "ff_list": ("channels of the electronics", of.which, None),
            "ff_f_svec": ("force singular vectors, one a column", forces[:, ::-1], None),
            "ff_p_svec": ("position singular vectors, one a column", positions[::-1].T, None),
            "ff_sval": ("singular values, softest first", sizes[::-1], record.unit),
        }
    for name, (content, numbers, unit) in parts.items():
        values = vars(record) | {"values": numbers, "unit": unit, "content": content}
        write_fits(folder / f"{name}.fits", FORM, SimpleNamespace(**values))
        yield f"  {name + '.fits':<16}{content}{f' [{unit}]' * bool(unit)}"


def _write_fits(path: Path, record: Any) -> None:
    write_fits(path, FORM, record)


def _write_npy(path: Path, record: Any) -> None:
    with path.open("wb") as file:  # by its name, numpy might add an ending
        np.save(file, record.values)


def _write_mat(path: Path, record: Any) -> None:
    content = {"ff_matrix": record.values, "unit": record.unit or "unknown",
               "content": record.content, "alpha": record.alpha}  # fmt: skip
    scipy.io.savemat(path, content, appendmat=False)


WRITERS: dict[str, Callable[[Path, Any], None]] = {
    ".npy": _write_npy,
    ".fits": _write_fits,
    ".csv": lambda path, record: np.savetxt(path, record.values, "%.17g", ","),
    ".mat": _write_mat,
}


def _in_file(path: Path, calibration: Calibration) -> _Source:
    """Return the matrix in a stiffness file as the file that was imported stores it."""
    try:
        matrix = matrix_in_file(read_fits(path))
    except TrueNewtonError as error:
        if not path.exists():
            raise
        remedy = "give the stiffness file that `truenewton import` wrote of it: it contains the"
        remedy += " actuators of the rows"
        raise error.changed(remedy=remedy) from None
    if matrix.stored is None:
        raise FormatError(
            "was not imported, so that no other convention of its matrix is known",
            remedy="multiply the rows of its image STIFFNESS by alpha, or import the original file",
            path=path,
        )
    return _as_stored(matrix, matrix.stored.array(matrix.stiffness), calibration, path)


def _as_stored(
    matrix: StiffnessMatrix, values: Array, calibration: Calibration, path: Path
) -> _Source:
    """Return an array of a file, and alpha of the actuators of its rows."""
    of, layout = matrix.stored, matrix.layout
    assert of is not None
    if calibration.instrument != matrix.instrument:
        raise CampaignMismatch(
            f"the matrix is of {matrix.instrument}, the calibration of {calibration.instrument}",
            remedy="give the calibration of the same mirror",
            path=path,
        )
    which, alpha = np.full(of.size, -1), np.full(of.size, np.nan)
    which[of.rows] = layout.id
    at = _rows_of(layout.id, calibration, path)
    if apart := calibration.layout.part(at).other_actuators(layout):
        raise CampaignMismatch(
            f"matrix and calibration disagree on {apart}",
            remedy="give the calibration of the same mirror",
            path=path,
        )
    alpha[of.rows] = calibration.alpha[at]
    sign = "negative" if of.factor < 0.0 else "positive"
    said = f"{of.size} x {of.size}, unit {of.unit or 'unknown'}, {sign} diagonal,"
    said += f" {'sensors' if of.transposed else 'actuators'} in rows, per sensor reading"
    forces = values.T if of.transposed else values
    return _Source(forces, which, alpha, of.unit, said, str(path), of.transposed)


def _in_folder(given: Path, calibration: Calibration) -> _Source:
    """Return the matrix in the folder of a supervisor or of opticalib, as it is stored."""
    folder = folder_of_matrix(given)
    stored, item = read_stored(folder / MATRIX), only_array(folder / MATRIX)
    if applied := str(stored.header.get("ALPHA", "")).strip():
        raise FormatError(
            f"its rows were multiplied by alpha already (ALPHA is {applied})",
            remedy="export the folder as it was measured",
            path=folder / MATRIX,
        )
    if not (folder / CHANNELS).is_file():
        try:
            matrix = stiffness_from(given, instrument=calibration.instrument).matrix
        except TrueNewtonError as error:
            remedy = (
                "give the stiffness file that `truenewton import` wrote of it, and -o FILE.fits"
            )
            raise error.changed(remedy=remedy) from None
        return _as_stored(matrix, item.values, calibration, folder)
    channels = channels_of(folder)
    if item.values.shape != (len(channels), len(channels)):
        raise CampaignMismatch(
            f"is {' x '.join(map(str, item.values.shape))} for {len(channels)} channels",
            remedy="give ff_matrix.fits and ff_list.fits of one measurement",
            path=folder / MATRIX,
        )
    alpha = calibration.alpha[_rows_of(channels, calibration, folder)]
    track = str(stored.header.get("TRACKNUM", "")).strip() or folder.name
    said = "unit, sign, channels and sensor readings of ff_matrix.fits"
    return _Source(item.values, channels, alpha, item.unit or "N/m", said, track, channels=True)


def _rows_of(names: NDArray[np.int64], calibration: Calibration, path: Path) -> NDArray[np.int64]:
    """Return (m,) indices of the calibration of channels or IDs."""
    at = {name: k for k, name in enumerate(calibration.layout.id.tolist())}
    missing = [name for name in names.tolist() if name not in at]
    if missing:
        raise CampaignMismatch(
            f"the calibration has no actuator {missing[0]}, which is a channel of the matrix",
            remedy="give that of the stiffness file that `truenewton import` made of it",
            path=path,
        )
    return np.array([at[name] for name in names.tolist()])
