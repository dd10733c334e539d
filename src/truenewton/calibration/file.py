"""The calibration file (docs/files.md): its format, and how it is read."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from truenewton.calibration.result import Calibration
from truenewton.errors import FormatError
from truenewton.estimation.findings.catalogue import REPEATED, read_name, read_warning
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.estimate import (
    Diagnosis,
    ErrorKind,
    ErrorSource,
    Goodness,
    NoiseSource,
    ScaleError,
)
from truenewton.estimation.findings.finding import Finding, from_stored
from truenewton.estimation.matrix.facts import Symmetry
from truenewton.estimation.paper.equations import Unknowns
from truenewton.files.content import FitsFile
from truenewton.files.format import Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.records.file import ID, INSTRUMENT, NZ, SOURCES, X, Y

ACTUATORS = TableFormat(
    "CALIBRATION",
    (
        ID,
        X,
        Y,
        Column("ALPHA", "alpha"),
        Column("E_ALPHA", lambda c: c.error),
        Column("E_STAT", "reading_error"),
        Column("E_SYST", "systematic_error"),
        Column("E_CYCLE", "cycle_error"),
        Column("HALVES", "halves", absent=None),
        NZ,
    ),
)
CALIBRATION = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC, start of the data", kind="date"),
        Keyword("DATE-END", "date_end", "UTC, end of the data", kind="date"),
        Keyword("TEMPERAT", "temperature", "mean over the rows used", "deg_C", absent=np.nan),
        Keyword("WEIGHT", "weight", "weight of the mirror, P", "N", absent=np.nan),
        Keyword("E_WEIGHT", "weight_error", "standard uncertainty of WEIGHT", "N", absent=np.nan),
        Keyword("BIAS", "bias_force", "total force of the bias magnets, B", "N", absent=np.nan),
        Keyword("E_BIAS", lambda c: c.bias_force_error, "standard uncertainty of BIAS", "N"),
        Keyword("METHOD", "method", "estimator", kind="str"),
        Keyword("SCALE", "scale", "what fixes the common scale", kind="str"),
        Keyword("NSHAPES", "shapes_used", "rows used", kind="int"),
        Keyword("NREJECT", "rejected", "rows rejected as outliers", kind="int"),
        Keyword("NINVALID", "invalid", "rows marked as not valid", kind="int"),
        Keyword(
            "CONDITIO", "condition", "condition of E, coordinates in units of RMS", absent=np.nan
        ),
        Keyword("SOLVCOND", "solved_condition", "condition of E as svd solves it", absent=np.nan),
        Keyword("RANK", "rank", "directions held above noise", kind="int"),
        Keyword("NOISE", "noise", "standard deviation of one force reading", "N", absent=np.nan),
        Keyword("DOF", "degrees_of_freedom", "degrees of freedom", kind="count", absent=None),
        Keyword("CHI2", "chi2", "against FORCERR", absent=np.nan),
        Keyword("FITCHI2", "goodness.chi2", "of the balance against FITNOISE", absent=np.nan),
        Keyword("FITNOISE", "goodness.against", "source of the noise", kind="str", absent=""),
        Keyword("FITPROB", "goodness.probability", "of a larger FITCHI2", absent=np.nan),
        Keyword("ASYM", "matrix_facts.asymmetry", "asymmetry as commanded", absent=np.nan),
        Keyword(
            "ASYMALPH", "matrix_facts.asymmetry_with_alpha", "asymmetry with ALPHA", absent=np.nan
        ),
        Keyword(
            "ASYMGAIN", "matrix_facts.asymmetry_with_gains", "and with sensor gains", absent=np.nan
        ),
        Keyword("VERDICT", lambda c: str(c.verdict.level), "of all in this file", kind="str"),
    ),
    (
        ACTUATORS,
        TableFormat(
            "LOADS",
            (
                Column("LOAD", "loads.name", kind="str"),
                Column("ADDED", "loads.added", "N"),
                Column("E_ADDED", "loads.added_error", "N"),
                Column("TILT", "loads.tilt", "deg"),
                Column("MY", "torque_y", "N m"),
                Column("E_MY", lambda c: c.torque_errors[:, 0], "N m"),
                Column("MX", "torque_x", "N m"),
                Column("E_MX", lambda c: c.torque_errors[:, 1], "N m"),
                Column("TOOL", "loads.tool", kind="str", absent=None),
            ),
        ),
        ImageFormat("COVARIANCE", "covariance"),
        ImageFormat("SYSTEMATIC", "systematic_covariance"),
        SOURCES,
        TableFormat(
            "REJECTED",
            (
                Column("CYCLE", "cycle", kind="int"),
                Column("ROW", "row", kind="int"),
                Column("ACTUATOR", "actuator", kind="int"),
                Column("SIGMAS", "sigmas"),
                Column("AGAINST", "against", kind="str"),
            ),
            of="rejected_rows",
            optional=True,
        ),
        TableFormat(
            "EFFECTS",
            (
                Column("CODE", "code", kind="str", absent=""),
                Column("EFFECT", "name", kind="str"),
                Column("DETAIL", "detail", kind="str", absent=""),
                Column("PLACE", "where", kind="str"),
                Column("ACTUATORS", "ids", kind="str", absent=""),
                Column("PROBABILITY", "probability"),
                Column("SIZE", "size"),
                Column("UNIT", "unit", kind="str"),
                Column("CORRECTED", "corrected", kind="bool"),
                Column("REMEDY", "remedy", kind="str"),
            ),
            of="effects",
            optional=True,
        ),
        TableFormat(
            "WARNINGS",
            (
                Column("CODE", "code", kind="str", absent=""),
                Column("LEVEL", "grade", kind="str", absent=""),
                Column("FAULT", "fault", kind="str"),
                Column("REMEDY", "remedy", kind="str"),
                Column("VALUES", "stored", kind="str", absent=""),
            ),
            of="diagnosis.warnings",
            optional=True,
        ),
        TableFormat(
            "BUDGET",
            (
                Column("KIND", "source.kind.name", kind="str"),
                Column("NAME", "source.name", kind="str", absent=""),
                Column("RELATIVE", "relative", finite=True),
            ),
            of="scale_errors",
            optional=True,
        ),
        TableFormat(
            "UNSEEN",
            (Column("WHAT", "name", kind="str"), Column("RELATIVE", "relative", finite=True)),
            of="unseen",
            optional=True,
        ),
        TableFormat(
            "IMBALANCE",
            (
                Column("MODES", "modes", kind="str"),
                Column("BEFORE", "before"),
                Column("AFTER", "after"),
            ),
            of="imbalances",
            optional=True,
        ),
        TableFormat(
            "SENSORS",
            (
                Column("ID", "actuator", kind="int"),
                Column("GAIN", "gain"),
                Column("E_GAIN", "gain_error"),
                Column("DX", "x", "m"),
                Column("E_DX", "x_error", "m"),
                Column("DY", "y", "m"),
                Column("E_DY", "y_error", "m"),
                Column("STATE", "state", kind="str"),
            ),
            of="sensors",
            optional=True,
        ),
    ),
)


LARGEST = 1e30  # of any number in it
ALIKE = 1e-3  # of a variance, rounding to 32 bits allowed


def calibration_from(file: FitsFile) -> Calibration:
    """Return the calibration that a file holds.

    Raises
    ------
    FormatError
        The file breaks the contract of a calibration file.
    """
    values = file.values(CALIBRATION, LARGEST)
    values["layout"]["enabled"] = file.enabled(values["alpha"], "calibrate again")
    count = Unknowns(values["alpha"].size, values["torque_y"].size).count
    file.require_covariances(count, "n + 1 + 2 L", "calibrate again")
    _refuse_disagreement(file, values)
    try:
        values["goodness"] = _goodness(values["degrees_of_freedom"], **values["goodness"])
        values["scale_errors"] = _scale_errors(values.pop("scale_errors", None))
        values["effects"] = _findings(values.pop("effects", None))
    except (KeyError, ValueError) as error:
        raise FormatError(
            f"FITNOISE, a KIND of BUDGET or ACTUATORS of EFFECTS is {error}",
            remedy="calibrate again",
            path=file.path,
        ) from None
    facts = Symmetry(**values.pop("matrix_facts"))
    values["matrix_facts"] = facts if np.isfinite(facts.asymmetry) else None
    warnings = values.pop("diagnosis", {}).get("warnings")
    if warnings is not None:
        values["diagnosis"] = Diagnosis(warnings=_warnings(warnings))
    return file.filled(Calibration, values)


def _refuse_disagreement(file: FitsFile, values: dict[str, Any]) -> None:
    """Refuse errors of alpha that are not those of the covariances."""
    n, systematic = values["alpha"].size, values["systematic_error"] ** 2
    for names, errors, matrix in (
        ("E_STAT and E_SYST", values["reading_error"] ** 2 + systematic, "covariance"),
        ("E_SYST", systematic, "systematic_covariance"),
    ):
        variances = np.diag(values[matrix])[:n]
        if (np.abs(variances - errors) > ALIKE * np.maximum(variances, errors)).any():
            raise FormatError(
                f"{names} are not those of the covariances",
                remedy="calibrate again",
                path=file.path,
            )


def _goodness(
    freedom: int | None, chi2: float, against: str, probability: float
) -> Goodness | None:
    """Return how well the data fit; None of files that do not say, or where it has no meaning."""
    if freedom is None or not against:
        return None
    return Goodness(chi2, freedom, NoiseSource(against), probability)


def _findings(columns: dict[str, Any] | None) -> tuple[Finding, ...]:
    """Return what was found; of files that have no codes, by its name and place."""
    if columns is None:
        return ()
    cells = (each.tolist() if isinstance(each, np.ndarray) else each for each in columns.values())
    rows = zip(*cells, strict=True)
    return tuple(_finding(**dict(zip(columns, row, strict=True))) for row in rows)


def _finding(code: str, name: str, detail: str, where: str, ids: str, **values: Any) -> Finding:
    if not code:
        found, detail = read_name(name)
        actuator, _, only = where.partition(" ")
        ids = only if actuator == "actuator" and only.isdigit() else ""
    elif code in set(Code):
        found = Code(code)
    else:  # of a newer version
        found, detail = Code.OTHER, name
    actuators = tuple(int(i) for i in ids.split())
    return Finding(code=found, detail=detail, where=where, actuators=actuators, **values)


def _warnings(columns: dict[str, Any]) -> tuple[Finding, ...]:
    """Return what is weak in a result; of files without codes, and of newer ones, by its text."""
    rows = zip(
        *(columns[name] for name in ("code", "grade", "fault", "remedy", "stored")), strict=True
    )
    return tuple(_warning(*row) for row in rows if row[0] or not str(row[2]).startswith(REPEATED))


def _warning(code: str, level: str, fault: str, remedy: str, stored: str) -> Finding:
    try:
        return from_stored(code, remedy, json.loads(stored))
    except (KeyError, ValueError, TypeError, AttributeError):
        graded = Level.read(level) if level else read_warning(fault)
        return Finding(code=Code.OTHER, detail=fault, graded=graded, remedy=remedy)


def _scale_errors(columns: dict[str, Any] | None) -> tuple[ScaleError, ...]:
    """Return the budget of the common scale; nothing of files that do not say."""
    if columns is None:
        return ()
    source = columns["source"]
    rows = zip(source["kind"]["name"], source["name"], columns["relative"].tolist(), strict=True)
    return tuple(
        ScaleError(ErrorSource(ErrorKind[kind], name), relative) for kind, name, relative in rows
    )
