"""A calibration as the terminal tells it, and as a script reads it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from truenewton.report.wording import (
    headline,
    rejected_sentence,
    rejected_values,
    scale_limit,
    summary_rows,
)

if TYPE_CHECKING:
    from truenewton.calibration import Calibration
    from truenewton.campaign import Campaign
    from truenewton.diagnosis import RejectedRow
    from truenewton.estimators.elastic import Imbalance


def print_summary(calibration: Calibration) -> None:
    """Print what was found, how sure it is, and what limits it."""
    c = calibration
    print(headline(c))
    for name, value, note in summary_rows(c):
        print(f"  {name:<24}{value:<36}{note}".rstrip())
    limit = scale_limit(c)
    if limit is not None:
        fault, remedy = limit
        print(f"  {fault[0].upper()}{fault[1:]}{': ' if remedy else ''}{remedy}.")
    for fault, remedy in c.diagnosis.warnings if c.diagnosis else ():
        print(f"  WARNING: {fault}; {remedy}")


def rejected_lines(campaign: Campaign, rejected: Sequence[RejectedRow]) -> Iterator[str]:
    """Yield the rows left out, a line each, the farthest first, at most five."""
    rows = rejected_values(campaign, rejected)
    for row in rows[:5]:
        yield f"  left out: {rejected_sentence(row)}"
    if len(rows) > 5:
        yield f"  and {len(rows) - 5} rows more"


def imbalance_lines(judged: Sequence[Imbalance]) -> Iterator[str]:
    """Yield a table of the imbalance of elastic modes before and after, if there are any."""
    if judged:
        yield "  rms imbalance of elastic modes, force and torques, per unit of force:"
        yield f"    {'':<32}alpha = 1   calibrated"
        for line in judged:
            yield f"    {line.modes:<32}{line.before:9.4f}   {line.after:10.4f}"


def summary_values(calibration: Calibration, judged: Sequence[Imbalance] = ()) -> dict[str, Any]:
    """Return the same figures for a script."""
    c = calibration
    return {
        "instrument": c.instrument,
        "date": c.date.isoformat(),
        "method": c.method,
        "scale": c.scale,
        "shapes": c.shapes_used,
        "invalid": c.invalid,
        "rejected": c.rejected,
        "noise": c.noise,
        "condition": c.condition,
        "rank": c.rank,
        "separation": c.diagnosis.separation if c.diagnosis else None,
        "warnings": [fault for fault, _ in c.diagnosis.warnings] if c.diagnosis else [],
        "bias_force": c.bias_force,
        "e_bias_force": c.bias_force_error,
        "loads": [
            {"load": load.name, "torque_y": my, "e_torque_y": e[0], "torque_x": mx,
             "e_torque_x": e[1]}
            for load, my, mx, e in zip(
                c.loads, c.torque_y.tolist(), c.torque_x.tolist(), c.torque_errors.tolist(),
                strict=True,
            )
        ],
        "actuators": {
            "id": c.layout.id,
            "alpha": c.alpha,
            "e_alpha": c.error,
            "e_stat": c.statistical,
            "e_syst": c.systematic_error,
            "e_cycle": c.cycle_error,
        },
        "chi2": c.chi2,
        "degrees_of_freedom": c.degrees_of_freedom,
        "goodness": None if c.goodness is None else {
            "chi2": c.goodness.chi2,
            "degrees_of_freedom": c.goodness.degrees_of_freedom,
            "against": c.goodness.against,
            "probability": c.goodness.probability,
        },
        "scale_errors": [
            {"source": line.source, "relative": line.relative} for line in c.scale_errors
        ],
        "weakest": c.diagnosis.weakest if c.diagnosis else "",
        "imbalance": [
            {"modes": line.modes, "before": line.before, "after": line.after} for line in judged
        ],
    }  # fmt: skip
