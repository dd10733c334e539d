"""What data hold, and whether alpha can be had from them, before anything is calibrated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truenewton.calibration.methods import calibrate
from truenewton.calibration.words import rejected_lines, rejected_values, warning_lines
from truenewton.errors import RankDeficient
from truenewton.estimation.diagnosis import Diagnosis
from truenewton.estimation.identifiability import diagnose
from truenewton.estimation.sifted import sift
from truenewton.estimation.stiffness_svd import SOFTEST, asymmetry, modal_stiffness
from truenewton.records.fault import Fault
from truenewton.rounding import with_error

if TYPE_CHECKING:
    from truenewton.records.campaign import Campaign
    from truenewton.records.stiffness_matrix import StiffnessMatrix


def survey_campaign(campaign: Campaign) -> tuple[dict[str, Any], list[str]]:
    """Return what a campaign holds, for scripts and for people."""
    sifted = sift(campaign)
    moments, strange = sifted.moments, sifted.rejected
    diagnosis = diagnose(sifted.sound, moments)
    loads = []
    for load, weight in zip(campaign.loads, campaign.effective_weights.tolist(), strict=True):
        cycles = [c for c in campaign.cycles if c.load.key == load.key]
        loads.append(
            {
                "load": load.name,
                "added": load.added,
                "e_added": load.added_error,
                "tilt": load.tilt,
                "effective_weight": weight,
                "cycles": len(cycles),
                "rows": sum(len(c.time) for c in cycles),
                "invalid": sum(int((~c.valid).sum()) for c in cycles),
            }
        )
    largest = max(cycle.largest_force for cycle in campaign.cycles)
    values = {
        "holds": "campaign",
        "instrument": campaign.instrument,
        "actuators": campaign.layout.n,
        "disabled": int((~campaign.layout.enabled).sum()),
        "files": [c.source.file for c in campaign.cycles if c.source],
        "weight": campaign.weight,
        "e_weight": campaign.weight_error,
        "loads": loads,
        "shapes": len(np.unique(moments.labels[:, 1])),
        "largest_force": largest,
        "noise": moments.noise,
        "strange_rows": rejected_values(campaign, strange),
        "separation": diagnosis.separation,
        "faults": [{"fault": fault, "remedy": remedy} for fault, remedy in diagnosis.faults],
    }
    off = f" ({values['disabled']} disabled)" if values["disabled"] else ""
    lines = [
        f"a campaign of {campaign.instrument}: {campaign.layout.n} actuators{off}, "
        f"{len(campaign.cycles)} cycle files, {values['shapes']} shapes",
        f"  {'weight P':<24}{with_error(campaign.weight, campaign.weight_error)} N",
    ]
    for row in loads:
        invalid = f", {row['invalid']} not valid" if row["invalid"] else ""
        added = f"Q = {with_error(row['added'], row['e_added'])} N"
        tilt = f", tilt {row['tilt']:g} deg" if row["tilt"] else ""
        lines.append(
            f"  load {row['load']:<19}{added}{tilt}, {row['cycles']} cycles, {row['rows']} rows"
            + invalid
        )
    lines.append(f"  {'largest force':<24}{largest:.3g} N commanded")
    if np.isfinite(moments.noise):
        lines.append(
            f"  {'noise of one reading':<24}{1e3 * moments.noise:.3g} mN, from repeated shapes"
        )
    return values, lines + list(rejected_lines(campaign, strange)) + _verdict(diagnosis)


def survey_stiffness(matrix: StiffnessMatrix) -> tuple[dict[str, Any], list[str]]:
    """Return what a stiffness file holds, for scripts and for people."""
    values, off = modal_stiffness(matrix), int(np.count_nonzero(~matrix.layout.enabled))
    try:
        diagnosis = calibrate(matrix).diagnosis or Diagnosis()
    except RankDeficient as error:
        diagnosis = Diagnosis(faults=(Fault(error.fault, error.remedy),))
    facts = {
        "holds": "stiffness",
        "instrument": matrix.instrument,
        "actuators": matrix.layout.n,
        "disabled": off,
        "softest": float(values[-1]),
        "median": float(np.median(values)),
        "stiffest": float(values[0]),
        "used_modes": int(np.count_nonzero(values > SOFTEST)),
        "asymmetry": asymmetry(matrix),
        "separation": diagnosis.separation,
        "faults": [{"fault": fault, "remedy": remedy} for fault, remedy in diagnosis.faults],
    }
    lines = [
        f"a stiffness matrix of {matrix.instrument}: {matrix.layout.n} actuators"
        + (f" ({facts['disabled']} disabled)" if facts["disabled"] else ""),
        f"  {'singular values':<24}{values[-1]:.3g} .. {values[0]:.3g} N/m,"
        f" median {np.median(values):.3g}",
        f"  {'elastic modes':<24}{facts['used_modes']} stiffer than {SOFTEST:g} N/m",
        f"  {'asymmetry':<24}{facts['asymmetry']:.2g}, |K - K'| / |K + K'|",
    ]
    return facts, lines + _verdict(diagnosis)


def _verdict(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.faults:
        return [
            f"  enough for alpha, which stands apart by {diagnosis.separation:.3g}",
            *warning_lines(diagnosis.warnings),
        ]
    return [f"  not enough for alpha: {fault}; {remedy}" for fault, remedy in diagnosis.faults]
