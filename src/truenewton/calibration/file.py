"""A calibration in files: read from FITS, and written whole, as its table, or alpha alone."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import ACTUATORS, CALIBRATION, Calibration
from truenewton.errors import FormatError
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.estimate import (
    Diagnosis,
    ErrorKind,
    ErrorSource,
    Goodness,
    NoiseSource,
    ScaleError,
)
from truenewton.estimation.findings.finding import Finding, as_sentences, from_stored
from truenewton.estimation.matrix.facts import Symmetry
from truenewton.estimation.paper.equations import Unknowns
from truenewton.files.content import FitsFile
from truenewton.files.format import columns_of, header_of
from truenewton.records.result import FORMATS, OTHER_FORMATS, OtherFormat, format_of

MAX_NUMBER = 1e30  # in a file
VARIANCE_TOLERANCE = 1e-3  # relative; rounding to 32 bits allowed


def calibration_from(file: FitsFile) -> Calibration:
    """Return the calibration that a file contains.

    Raises FormatError if the file is not as declared.
    """
    values = file.values(CALIBRATION, MAX_NUMBER)
    values["layout"]["enabled"] = file.enabled(values["alpha"], "calibrate again")
    count = Unknowns(values["alpha"].size, values["torque_y"].size).count
    file.require_covariances(count, "n + 1 + 2 L", "calibrate again")
    _refuse_disagreement(file, values)
    try:
        values["goodness"] = _goodness(**values["goodness"])
        if "scale_errors" in values:
            values["scale_errors"] = tuple(_scale_errors(**values["scale_errors"]))
        if "effects" in values:
            names, rows = values["effects"], _rows(*values["effects"].values())
            found = (_finding(**dict(zip(names, row, strict=True))) for row in rows)
            values["effects"] = tuple(found)
        diagnosis = values["diagnosis"]
        if "warnings" in diagnosis:
            warnings = diagnosis["warnings"]
            rows = _rows(*(warnings[k] for k in ("code", "level", "fault", "remedy", "stored")))
            diagnosis["warnings"] = tuple(_warning(*row) for row in rows)
    except (KeyError, ValueError) as error:
        raise FormatError(
            f"FITNOISE, a KIND of BUDGET, LEVEL or ACTUATORS of EFFECTS or WARNINGS is {error}",
            remedy="calibrate again",
            path=file.path,
        ) from None
    facts = Symmetry(**values.pop("matrix_facts"))
    values["matrix_facts"] = facts if np.isfinite(facts.asymmetry) else None
    values["diagnosis"] = Diagnosis(**diagnosis)
    return file.filled(Calibration, values)


def _rows(*columns: Any) -> Iterator[tuple[Any, ...]]:
    """Return the rows of columns that are arrays or tuples of texts."""
    lists = (each.tolist() if isinstance(each, np.ndarray) else each for each in columns)
    return zip(*lists, strict=True)


def _refuse_disagreement(file: FitsFile, values: dict[str, Any]) -> None:
    """Refuse errors of alpha that are not those of the covariances."""
    n, systematic = values["alpha"].size, values["systematic_error"] ** 2
    for names, errors, matrix in (
        ("E_STAT and E_SYST", values["statistical_error"] ** 2 + systematic, "covariance"),
        ("E_SYST", systematic, "systematic_covariance"),
    ):
        variances = np.diag(values[matrix])[:n]
        if (np.abs(variances - errors) > VARIANCE_TOLERANCE * np.maximum(variances, errors)).any():
            raise FormatError(
                f"{names} are not those of the covariances",
                remedy="calibrate again",
                path=file.path,
            )


def _goodness(
    degrees_of_freedom: int | None, chi2: float, against: str, probability: float
) -> Goodness | None:
    """Return how well the data fit; None if the file does not contain it."""
    if degrees_of_freedom is None or not against:
        return None
    return Goodness(chi2, degrees_of_freedom, NoiseSource(against), probability)


def _scale_errors(source: dict[str, Any], relative: Array) -> Iterator[ScaleError]:
    """Yield the budget of the common scale."""
    for kind, name, size in _rows(source["kind"]["name"], source["name"], relative):
        yield ScaleError(ErrorSource(ErrorKind[kind], name), size)


def _finding(
    code: str, level: str, name: str, detail: str, where: str, ids: str, **values: Any
) -> Finding:
    """Return a finding of table EFFECTS; one whose code only a newer version knows by its level."""
    found = Code(code) if code in set(Code) else Code.OTHER
    if found is Code.OTHER:
        detail, values["graded"] = name, Level(level)
    actuators = tuple(int(i) for i in ids.split())
    return Finding(code=found, detail=detail, where=where, actuators=actuators, **values)


def _warning(code: str, level: str, fault: str, remedy: str, stored: str) -> Finding:
    """Return a finding of table WARNINGS; one of a newer version by its text and level."""
    try:
        return from_stored(code, remedy, json.loads(stored))
    except (KeyError, ValueError, TypeError, AttributeError):
        return Finding(code=Code.OTHER, detail=fault, graded=Level(level), remedy=remedy)


FORMATS[Calibration] = CALIBRATION


def lacking(calibration: Calibration, path: str | os.PathLike[str]) -> str:
    """Return what a file of that name does not contain of a calibration; '' if it contains all."""
    other = format_of(Calibration, path)
    if other is None:
        return ""
    return (
        f"{Path(path).name} contains {other.lacks}. The verdict is '{calibration.verdict.level}'."
        " Other commands need a .fits file, which contains everything."
    )


def _write_alpha(calibration: Calibration, path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, calibration.alpha, allow_pickle=False)


def _write_table(calibration: Calibration, path: Path) -> None:
    """Write the table with all digits; ECSV also has units, keywords and the verdict's faults."""
    from astropy.table import Column, Table

    table = Table()
    for name, _, unit, values in columns_of(calibration, ACTUATORS):
        if name != "NZ":
            table[name] = Column(values, unit=unit)
    if path.suffix.lower() == ".ecsv":
        for name, value, _ in header_of(calibration, CALIBRATION):  # YAML knows plain types alone
            table.meta[name] = str(value) if isinstance(value, str) else np.asarray(value).item()
        faults = calibration.verdict.faults
        table.meta["FAULTS"] = [as_sentences(each) for each in faults]
    table.write(path, format=f"ascii{path.suffix.lower()}")


OTHER_FORMATS[Calibration] = {
    ".ecsv": OtherFormat(_write_table, "the table and the verdict, without covariance"),
    ".csv": OtherFormat(
        _write_table, "only the table, without units (X and Y are in m), verdict and covariance"
    ),
    ".npy": OtherFormat(
        _write_alpha, "only alpha (NaN for disabled actuators), without errors and verdict"
    ),
}
