"""The contents of data, and whether alpha can be determined from them (`truenewton info`)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.methods import (
    Options,
    calibrate,
    calibration_of,
    doubts_of_coupling,
    estimate_alpha,
    refusals,
    resolve_method,
)
from truenewton.calibration.result import Calibration
from truenewton.calibration.summary import (
    rejected_lines,
    rejected_values,
    summary_lines,
    summary_values,
    verdict_lines,
    warning_lines,
)
from truenewton.errors import NotConverged, RankDeficient, TooManyOutliers
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Diagnosis, RejectedRow, Scale
from truenewton.estimation.findings.finding import Verdict, as_sentences, judged, no_alpha
from truenewton.estimation.matrix.facts import MIN_SINGULAR_VALUE, MatrixFacts
from truenewton.estimation.matrix.screen import screen_matrix
from truenewton.estimation.paper.identifiability import diagnose
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.files.format import attributes
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import counted, percent, row, with_error


def survey(
    data: Campaign | StiffnessMatrix | Calibration,
    method: str | None = None,
    *,
    population: bool = False,
    motion: Array | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Return the contents of data, or of a calibration, as values for JSON and as lines of text.

    ``method``, ``population`` and ``motion``, (6, n, n), are those of `calibrate`. Unless one of
    them is given, a matrix is described and screened, but no alpha is fitted, which takes long.
    """
    if isinstance(data, Calibration):
        what = f"a calibration, method {data.method}, common scale {Scale(data.scale).origin}"
        return {"holds": "calibration", **summary_values(data)}, [what, *summary_lines(data)]
    screened_only = isinstance(data, StiffnessMatrix) and not (method or population)
    screened_only = screened_only and motion is None
    method, options = resolve_method(data, method, population=population, motion=motion)
    if isinstance(data, Campaign):
        holds = what = "campaign"
        facts, (contents, *lines), diagnosis, verdict = _survey_campaign(data, method, options)
    else:
        holds, what = "stiffness", "stiffness matrix"
        solve = None if screened_only else partial(calibrate, data, method, **options._asdict())
        facts, (contents, *lines), diagnosis, verdict = _survey_stiffness(data, solve)
    refused = verdict.level == Level.NONE
    disabled = int(np.count_nonzero(~data.layout.enabled))
    values = {
        "holds": holds,
        "instrument": data.instrument,
        "actuators": data.layout.n,
        "disabled": disabled,
        **facts,
        "separation": diagnosis.separation,
        "faults": [attributes(each, "fault", "remedy") for each in verdict.faults if refused],
        "verdict": verdict if verdict.faults or not screened_only else None,
    }
    off = f" ({disabled} disabled)" if disabled else ""
    headline = f"a {what} of {data.instrument}: {counted(data.layout.n, 'actuator')}{off}{contents}"
    lines.insert(0, headline)
    if screened_only and not refused:
        lines.append(row("alpha", "not estimated", "use `truenewton calibrate`"))
        lines += warning_lines(verdict.findings)
    elif refused:
        lines += [f"  alpha is not determined: {as_sentences(each)}" for each in verdict.faults]
    else:
        apart = diagnosis.separation
        note = f"uniqueness {apart:.3g} (1: not unique)" if apart > 0 else ""
        lines.append(row("alpha", "determined by the data", note))
        lines += verdict_lines(verdict)
    return values, lines


def _survey_campaign(
    campaign: Campaign, method: str, options: Options
) -> tuple[dict[str, Any], list[str], Diagnosis, Verdict]:
    """Return facts, lines (the first is the end of the headline), diagnosis and verdict."""
    screened, noise, diagnosis = None, np.nan, Diagnosis()
    rejected: tuple[RejectedRow, ...] = ()
    try:
        screened = screen_campaign(campaign)
        noise, rejected = screened.moments.noise, screened.rejected
        diagnosis = diagnose(screened.sound, screened.moments)
        estimate = estimate_alpha(screened, method, options)
        verdict = calibration_of(campaign, estimate).verdict
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        verdict = no_alpha(refusals(error, screened))
    shapes = len(np.unique(np.concatenate([c.shape[c.valid] for c in campaign.cycles])))
    loads, shortest = [], []
    for load, weight in zip(campaign.loads, campaign.effective_weights.tolist(), strict=True):
        cycles = [c for c in campaign.cycles if c.load.key == load.key]
        rows, name = min((len(c.time), c.name) for c in cycles)
        alike = all(len(c.time) == rows for c in cycles)
        shortest.append("" if alike else f" (only {rows} in {name})")
        loads.append(
            {
                **attributes(load, load="name", added="added", e_added="added_error", tilt="tilt"),
                "effective_weight": weight,
                "cycles": len(cycles),
                "rows": sum(len(c.time) for c in cycles),
                "invalid": sum(int((~c.valid).sum()) for c in cycles),
            }
        )
    values = {
        "files": [c.source.file for c in campaign.cycles if c.source],
        "weight": campaign.weight,
        "e_weight": campaign.weight_error,
        "loads": loads,
        "shapes": shapes,
        "largest_force": max(cycle.largest_force for cycle in campaign.cycles),
        "noise": noise,
        "strange_rows": rejected_values(campaign, rejected),
    }
    lines = [
        f", {counted(campaign.cycles, 'cycle file')}, {counted(shapes, 'shape')}",
        row("weight P", f"{with_error(campaign.weight, campaign.weight_error)} N"),
    ]
    for facts, only in zip(loads, shortest, strict=True):
        added = f"Q = {with_error(facts['added'], facts['e_added'])} N"
        tilt = f", tilt {facts['tilt']:g} deg" if facts["tilt"] else ""
        invalid = f", {facts['invalid']} not valid" if facts["invalid"] else ""
        counts = f", {counted(facts['cycles'], 'cycle')}, {counted(facts['rows'], 'row')}{only}"
        lines.append(row(f"load {facts['load']}", added + tilt + counts + invalid))
    lines.append(row("largest force", f"{values['largest_force']:.3g} N commanded"))
    if np.isfinite(noise):
        lines.append(row("noise of one reading", f"{1e3 * noise:.3g} mN, from repeated shapes"))
    lines += rejected_lines(campaign, rejected)
    return values, lines, diagnosis, verdict


def _survey_stiffness(
    matrix: StiffnessMatrix, solve: Callable[[], Calibration] | None
) -> tuple[dict[str, Any], list[str], Diagnosis, Verdict]:
    """Return facts, lines (the first is the end of the headline), diagnosis and verdict.

    The verdict is that of a calibration, or on what screening finds if there is nothing to solve.
    """
    facts = MatrixFacts.of(matrix)
    modes, used = facts.singular_values, len(facts.elastic_modes.values)
    softest, median, stiffest = float(modes[-1]), float(np.median(modes)), float(modes[0])
    values = {
        "softest": softest,
        "median": median,
        "stiffest": stiffest,
        "used_modes": used,
        **attributes(facts, "asymmetry", "rigid_cost", "imbalance"),
    }
    lines = [
        "",
        row("singular values", f"{softest:.3g} .. {stiffest:.3g} N/m, median {median:.3g}"),
        row("elastic modes", f"{used} stiffer than {MIN_SINGULAR_VALUE:g} of the stiffest"),
        row("asymmetry", f"{facts.asymmetry:.2g}, |K - K'| / |K + K'|"),
        row(
            "orientation",
            "transposed" if facts.looks_transposed else "not transposed",
            f"rigid-body residual {percent(facts.rigid_cost)}, column imbalance"
            f" {percent(facts.imbalance)} of the diagonal",
        ),
    ]
    try:
        if solve is None:
            screened = screen_matrix(matrix)
            return (
                values,
                lines,
                Diagnosis(),
                judged((*screened.effects, *screened.warnings, *doubts_of_coupling(matrix))),
            )
        made = solve()
        return values, lines, made.diagnosis, made.verdict
    except (RankDeficient, NotConverged) as error:
        return values, lines, Diagnosis(), no_alpha(refusals(error, None))
