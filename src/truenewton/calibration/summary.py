"""Text and numbers of a calibration for the terminal, the report and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import starmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.calibration.result import ACTUATORS, Calibration
from truenewton.calibration.verdict import NO_ERROR, rejected_sentence
from truenewton.errors import Fault
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import (
    FROM_READINGS,
    NoiseSource,
    RejectedRow,
    Scale,
    scale_budget,
    typical,
)
from truenewton.estimation.findings.finding import Finding, Verdict, as_sentences
from truenewton.files.format import attributes
from truenewton.files.values import Columns, Values
from truenewton.records.campaign import Campaign
from truenewton.records.result import Summary, summary_of
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted, percent, row, to_digits, with_error

MEANINGS = {
    Level.SOUND: "the stated errors are valid",
    Level.USABLE: "alpha can be used within the limits below",
    Level.DOUBTFUL: "the stated errors may be too small: do not load alpha before the checks below",
    Level.REJECTED: "do not use alpha",
}
LABELS = {Level.USABLE: "limit", Level.SOUND: "note"}  # of the others: the level
NOISE_PART = "the noise is part of E_STAT"  # of the common scale
Row = tuple[str, str, str]  # name, value, note
NOISE_FROM = {
    NoiseSource.REPEATS: "from repeated shapes",
    NoiseSource.DECLARED: "as declared by FORCERR",
    NoiseSource.MINIMUM: "from the fit",
}


def summary_lines(calibration: Calibration, changes: Iterable[str] = ()) -> Iterator[str]:
    """Yield what was found, how certain it is, the lines of what changed, and what limits it."""
    c = calibration
    yield headline(c)
    yield from starmap(row, _results(c))
    if c.unseen:
        yield "  undetectable here, not in E_ALPHA:"
        yield from (f"    {percent(each.relative):<7} if {each.name}" for each in c.unseen)
    yield from changes
    yield from verdict_lines(c.verdict)


def detail_lines(
    calibration: Calibration, data: Campaign | StiffnessMatrix | None = None
) -> Iterator[str]:
    """Yield the other numbers of a calibration, and the rows of its data left out."""
    c = calibration
    yield from starmap(row, _details(c))
    if c.imbalances:
        yield "  rms imbalance of elastic modes, force and torques, per unit of force:"
        yield f"    {'':<32}alpha = 1   calibrated"
        for line in c.imbalances:
            yield f"    {line.modes:<32}{line.before:9.4f}   {line.after:10.4f}"
    if isinstance(data, Campaign):
        yield from rejected_lines(data, c.rejected_rows)


def verdict_lines(verdict: Verdict, meanings: Mapping[Level, str] = MEANINGS) -> Iterator[str]:
    """Yield the level of a verdict, its meaning, its findings and advice."""
    yield row("verdict", str(verdict.level), meanings.get(verdict.level, ""))
    yield from warning_lines(verdict.findings)


def warning_lines(findings: Iterable[Finding | Fault]) -> Iterator[str]:
    """Yield a line for each finding, with what it leaves of the result, and one for each remedy."""
    remedies = set[str]()
    for each in findings:
        label = LABELS.get(each.level, each.level) if isinstance(each, Finding) else "warning"
        yield f"  {label}: {as_sentences(Fault(each.fault, ''))}"
        if each.remedy and each.remedy not in remedies:
            yield f"  advice: {as_sentences(Fault('', each.remedy))}"
        remedies.add(each.remedy)


def rejected_lines(campaign: Campaign, rejected: Sequence[RejectedRow]) -> Iterator[str]:
    """Yield the rows left out, a line each, the farthest first, at most five."""
    rows = sorted(rejected, key=lambda each: -each.sigmas)
    for one in rows[:5]:
        yield f"  left out: {rejected_sentence(one, campaign.cycles[one.cycle].name)}"
    if len(rows) > 5:
        yield f"  and {counted(len(rows) - 5, 'row')} more"


def _loads(c: Calibration) -> list[dict[str, Any]]:
    errors = c.torque_errors
    torques = c.loads, c.torque_y, errors[:, 0], c.torque_x, errors[:, 1]
    names = "load", "torque_y", "e_torque_y", "torque_x", "e_torque_x"
    return [
        dict(zip(names, (load.name, *of_it), strict=True))
        for load, *of_it in zip(*torques, strict=True)
    ]


COLUMNS = "alpha", "e_alpha", "e_stat", "e_syst", "e_cycle"
VALUES = Values(
    Calibration, "instrument", "date", "verdict", "method", "scale", ("shapes", "shapes_used"),
    "invalid", "rejected", "noise", "condition", "solved_condition", "rank",
    ("separation", "diagnosis.separation"), ("warnings", "diagnosis.warnings.fault"),
    "bias_force", ("e_bias_force", "bias_force_error"), ("loads", _loads),
    ("actuators", Columns(ACTUATORS, "id", *COLUMNS)),
    "chi2", "degrees_of_freedom", "goodness", "scale_errors", "effects", "unseen", "sensors",
    ("weakest", "diagnosis.weakest"), ("imbalance", "imbalances"), ("matrix", "matrix_facts"),
    "halves",
)  # fmt: skip


def summary_values(calibration: Calibration) -> dict[str, Any]:
    """Return the same figures for a script."""
    return dict(VALUES.of(calibration))


def headline(calibration: Calibration) -> str:
    """Return what was calibrated, from how much."""
    c, on = calibration, calibration.layout.enabled
    text = f"{c.instrument}, {c.date:%Y-%m-%d}:"
    text += f" {counted(int(on.sum()), 'actuator')}"
    text += f" ({(~on).sum()} disabled)" if not on.all() else ""
    if c.loads:
        text += f", {counted(c.shapes_used, 'row')} under {counted(c.loads, 'load')}"
    else:
        text += f", {counted(c.shapes_used, 'elastic mode')}"
    text += f", {counted(c.invalid, 'row')} not valid left out" if c.invalid else ""
    return text + (", by reciprocity" if c.sensors else "")


@summary_of.register(Calibration)
def _summary(calibration: Calibration) -> Summary:
    verdict = calibration.verdict
    rows = [*summary_rows(calibration), ("verdict", str(verdict.level), "")]
    return Summary(headline(calibration), rows, warning_lines(verdict.faults))


def summary_rows(calibration: Calibration) -> Iterator[Row]:
    """Yield name, value and note of each result, its uncertainty, and what limits it."""
    c = calibration
    yield from _results(c)
    if c.unseen:
        yield "undetectable here", "", "not in E_ALPHA"
    for each in c.unseen:
        yield f"  if {each.name}", percent(each.relative), ""
    yield from _details(c)


def _results(c: Calibration) -> Iterator[Row]:
    """Yield the rows of alpha and its errors."""
    ends, ids = _range_of_alpha(c)
    ratio = "relative, mean 1" if c.scale == Scale.MEAN_ONE else "true N / commanded N"
    yield "alpha", ends, f"{ratio}; lowest: actuator {ids[0]}, highest: {ids[1]}"
    yield "typical error of alpha", percent(typical(c.error, c.alpha)), "E_ALPHA, one sigma"
    if c.scale == Scale.MEAN_ONE:
        yield "common scale", "not measured", "needs cycles under known weights"
    else:
        scale = typical(c.systematic_error, c.alpha)
        if scale > NO_ERROR:
            yield "  common scale", percent(scale), "E_SYST, from the weights"
        else:
            yield "  common scale", "not stated", "the weights are given without errors"
        biased = ", without the bias of svd" if c.method == "svd" else ""
        statistical = percent(typical(c.statistical_error, c.alpha))
        yield "  statistical", statistical, f"E_STAT, from the readings{biased}"
    if fit := c.goodness:
        note = f"DOF {fit.degrees_of_freedom}, noise from {fit.against}"
        if np.isfinite(fit.probability):
            note += f", probability {fit.probability:.2g}"
        judged = np.isfinite(fit.reduced)
        yield "fit", f"chi2/DOF = {fit.reduced:.3g}" if judged else "cannot be judged", note
    if np.isfinite(c.diagnosis.separation):
        note = "second-best imbalance / best (1: not unique)"
        yield "uniqueness", f"{c.diagnosis.separation:.3g}", note


def _details(c: Calibration) -> Iterator[Row]:
    """Yield the rows of what else was found, and of what limits alpha."""
    if c.layout.number is not None:
        how = (
            f"IDs count positions: {c.layout.shown[0]}"
            if c.layout.has_texts
            else "IDs are channels"
        )
        yield "numbering", how, "number on the mirror: column NUMBER"
    if budget := scale_budget(c.scale_errors):
        parts = (f"{what} {percent(part)}" for what, part in budget.items())
        yield (
            "budget of the scale",
            ", ".join(parts),
            NOISE_PART if str(FROM_READINGS) in budget else "",
        )
    if c.scale == Scale.MEAN_ONE:
        yield from _symmetry(c)
    else:
        if np.isfinite(c.cycle_error).any():
            relative = c.cycle_error / np.abs(c.alpha)
            ends = map(percent, (np.nanmin(relative), np.nanmax(relative)))
            note = "E_CYCLE, 3 sigma, for comparison (Ricci 2008)"
            yield "scatter of cycles", " .. ".join(ends), note
        yield "bias magnets B", f"{with_error(c.bias_force, c.bias_force_error)} N", ""
        torques = np.stack([c.torque_x, c.torque_y], axis=1)
        errors = c.torque_errors[:, ::-1]
        for load, values, sigmas in zip(c.loads, 1e3 * torques, 1e3 * errors, strict=True):
            texts = ", ".join(map(with_error, values, sigmas))
            yield f"torques, {load.name}", texts, "M_x, M_y [mN m] about x = y = 0"
    if fitted := [sensor for sensor in c.sensors if sensor.state == "fitted"]:
        gains = float(np.std([sensor.gain for sensor in fitted]))
        off = float(np.sqrt(np.mean([[s.x**2, s.y**2] for s in fitted])))
        note = f"offsets from their magnets: {1e3 * off:.2g} mm rms per axis (table SENSORS)"
        yield "sensors", f"gains scatter by {percent(gains)}", note
    elif c.verdict.notes:
        note = "gains and positions are estimated by reciprocity only, which was not used"
        yield "sensors", "not estimated", note
    if np.isfinite(c.noise):
        source = c.goodness.against if c.goodness is not None else NoiseSource.REPEATS
        yield "noise of one reading", f"{1e3 * c.noise:.3g} mN", NOISE_FROM[source]
    if c.diagnosis.weakest:
        note = f"{percent(c.diagnosis.weakest_share)} of the variance E_STAT^2"
        yield "least certain pattern", c.diagnosis.weakest, note
    if np.isfinite(c.condition):
        note = f"of the scaled balance equations E; rank {c.rank}"
        yield "condition", f"{c.condition:.3g}", note
    if np.isfinite(c.solved_condition):
        yield "  as solved by svd", f"{c.solved_condition:.3g}", "of E, torques in N m"


def _range_of_alpha(c: Calibration) -> tuple[str, NDArray[np.str_]]:
    """Return the smallest and the largest alpha with their digits, and (2,) their names."""
    ends = [int(np.nanargmin(c.alpha)), int(np.nanargmax(c.alpha))]
    return " .. ".join(map(to_digits, c.alpha[ends], c.error[ends])), c.layout.shown[ends]


def _symmetry(c: Calibration) -> Iterator[Row]:
    """Yield the symmetry of a matrix, and how far its two halves agree."""
    facts = c.matrix_facts
    if facts is not None:
        value = f"{percent(facts.asymmetry)}, with alpha {percent(facts.asymmetry_with_alpha)}"
        gains = facts.asymmetry_with_gains
        note = f"with sensor gains {percent(gains)}" if np.isfinite(gains) else ""
        yield "asymmetry", value, note
    if c.halves is not None and np.isfinite(c.halves).any():
        rms = float(np.sqrt(np.nanmean(c.halves**2)))
        far = np.argsort(-np.abs(np.nan_to_num(c.halves)))[:3]
        names = ", ".join(f"{c.layout.shown[k]} ({percent(float(c.halves[k]))})" for k in far)
        yield "halves of the modes", f"alpha differs by {percent(rms)} rms", f"largest: {names}"


def rejected_values(campaign: Campaign, rejected: Sequence[RejectedRow]) -> list[dict[str, Any]]:
    """Return the rows left out, the farthest first, for JSON."""
    return [
        {"file": campaign.cycles[row.cycle].name, "row": row.row + 1}
        | attributes(row, "actuator", "sigmas", "against")
        for row in sorted(rejected, key=lambda row: -row.sigmas)
    ]
