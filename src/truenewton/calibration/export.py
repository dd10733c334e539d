"""A calibration as a file, in the format of its suffix: all of it, its table, or alpha."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from truenewton.calibration.result import ACTUATORS, CALIBRATIONS, AnyCalibration, Calibration
from truenewton.calibration.summary import as_sentences
from truenewton.errors import OutputExists, OutputFailed
from truenewton.files.format import columns_of, header_of
from truenewton.files.outputs import file_beside
from truenewton.records.parts import has_parts
from truenewton.records.result import write

WHOLE = (".fits", ".fits.gz")
LACKS = {  # of the other formats, what they contain and lack
    ".ecsv": "the table and the verdict; no covariance",
    ".csv": "the table alone; no units (X, Y in m), no verdict, no covariance",
    ".npy": "alpha alone, NaN where disabled; no errors, no verdict",
}


def suffix_of(path: str | os.PathLike[str]) -> str:
    """Return the suffix of a name that decides its format; raise OutputExists or OutputFailed."""
    name = Path(path).name.lower()
    for suffix in (*WHOLE, *LACKS):
        if name.endswith(suffix):
            return suffix
    if Path(path).is_dir():
        raise OutputExists("is a folder", remedy="choose another name", path=path)
    raise OutputFailed(
        "is no name for a calibration",
        remedy=f"let it end in {', '.join((*WHOLE, *LACKS))}",
        path=path,
    )


def lacking(calibration: AnyCalibration, path: str | os.PathLike[str]) -> str:
    """Return what a file of that name does not contain of a calibration; '' if it contains all."""
    lacks = LACKS.get(suffix_of(path), "")
    if not lacks:
        return ""
    return (
        f"{Path(path).name} holds {lacks}; the verdict is '{calibration.verdict.level}'."
        " A name in .fits keeps all, which the other commands take"
    )


@write.register(Calibration)
def write_calibration(
    calibration: AnyCalibration, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a calibration in the format of the suffix; raise OutputExists or OutputFailed."""
    suffix = suffix_of(path)
    if suffix in WHOLE:
        write.dispatch(object)(calibration, path, overwrite=overwrite)
        return
    with file_beside(path, overwrite=overwrite) as temporary:
        if suffix == ".npy":
            with temporary.open("wb") as file:
                np.save(file, calibration.column("alpha"), allow_pickle=False)
        else:
            _write_table(calibration, temporary, suffix)


def _write_table(calibration: AnyCalibration, path: Path, suffix: str) -> None:
    """Write the table with all digits; ECSV also has units, keywords and the verdict's faults."""
    from astropy.table import Column, Table

    kind, several = CALIBRATIONS, has_parts(calibration)
    form, actuators = (kind.whole, kind.actuators) if several else (kind.form, ACTUATORS)
    table = Table()
    for name, _, unit, values in columns_of(calibration, actuators):
        if name not in ("NZ", "ENABLED"):
            table[name] = Column(values, unit=unit)
    if suffix == ".ecsv":
        for name, value, _ in header_of(calibration, form):  # YAML knows plain types alone
            table.meta[name] = str(value) if isinstance(value, str) else np.asarray(value).item()
        faults = calibration.verdict.faults
        table.meta["FAULTS"] = [as_sentences(each) for each in faults]
    table.write(path, format=f"ascii{suffix}")
