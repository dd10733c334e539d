"""The prediction of a plan: text for the terminal, values for scripts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import starmap
from typing import Any

import numpy as np

from truenewton.acquisition.load_order import Mounting, mountings, reading_time
from truenewton.acquisition.taker import POSITION_SIGMAS, POSITION_TOLERANCE
from truenewton.calibration.summary import warning_lines
from truenewton.estimation.findings.estimate import scale_budget
from truenewton.files.values import Values
from truenewton.planning.plan_prediction import Change, Curve, PlanPrediction, WithSensors
from truenewton.planning.prediction import Prediction
from truenewton.rounding import counted, percent, row


def lines(outcome: PlanPrediction) -> Iterator[str]:
    """Yield the errors, the time, what is near its limit, and the order of the loads."""
    ready, strain, prediction = outcome.ready, outcome.strain, outcome.prediction
    plan, limits = ready.plan, ready.plan.limits
    relative, shapes = prediction.error / prediction.alpha, len(ready.shapes)
    typical_error, from_readings, from_weights = prediction.typical_errors
    names = ", ".join(load.name for load in plan.loads)
    yield (
        f"{ready.mirror.name}, predicted: {len(prediction.alpha)} actuators,"
        f" {counted(plan.cycles, 'cycle')}"
        f" of {shapes} shapes and their negatives under {counted(plan.loads, 'load')} ({names})"
    )
    ids = prediction.layout.id[prediction.layout.enabled]
    order = mountings(plan, shapes)
    count = 2 * shapes * plan.cycles * len(plan.loads)
    rows = []
    if prediction.scale_is_free:
        rows.append(("common scale", "free", "no two loads differ in weight"))
    else:
        rows += [
            ("typical error of alpha", percent(typical_error),
             f"E_ALPHA, 1 sigma; largest {percent(relative.max())} (ID {ids[relative.argmax()]})"),
            ("  common scale", percent(from_weights), "E_SYST, from the weights"),
        ]  # fmt: skip
    rows += [
        ("  statistical", percent(from_readings),
         f"E_STAT, for a noise of {1e3 * plan.force_noise:.3g} mN per reading"),
        ("duration", _time(outcome.duration),
         f"{count} rows, {counted(len(order) - 1, 'load change')} of {_time(plan.pause)}"),
        ("largest force", f"{strain.force:.3g} N",
         f"limit {limits.force:g} N; actuator {strain.actuator}, load '{strain.load}'"),
        ("largest stroke", f"{1e6 * strain.stroke:.3g} um",
         f"limit {1e6 * limits.displacement:g} um"),
        *_small_shapes(outcome),
        ("smallest gap", f"{1e6 * strain.gap:.3g} um", f"limit {1e6 * limits.gap:g} um"),
    ]  # fmt: skip
    yield from starmap(row, rows)
    yield row(
        "order of the loads",
        ", ".join(map(str, order)),
        f"cycles of each load; turns = {plan.turns}",
    )
    yield from warning_lines(outcome.warnings)


def detail_lines(outcome: PlanPrediction) -> Iterator[str]:
    """Yield where the errors come from, and how they depend on the plan."""
    ready, strain, prediction = outcome.ready, outcome.strain, outcome.prediction
    parts = scale_budget(prediction.scale_errors).items()
    if parts and not prediction.scale_is_free:
        budget = ", ".join(f"{what} {percent(part)}" for what, part in parts)
        yield row("budget of the scale", budget)
    share, lowest = percent(prediction.diagnosis.weakest_share), min(ready.mirror.alpha_range)
    yield row("least certain pattern", prediction.diagnosis.weakest,
              f"{share} of the variance E_STAT^2")  # fmt: skip
    yield row("force at lowest alpha", f"{strain.force_at_worst:.3g} N",
              f"actuator {strain.actuator}, if its alpha is {lowest:g}")  # fmt: skip
    yield row("time of one reading", f"{1e3 * reading_time(ready.plan):.3g} ms")
    yield from _reciprocity_lines(outcome)
    order = mountings(ready.plan, len(ready.shapes))
    if len(order) > 1:
        changes = (f"'{each.load.name}' at {_time(each.start)}" for each in order[1:])
        yield row("load changes end", ", ".join(changes))
    yield "  typical errors of alpha by number of cycles, and by added weight:"
    yield from _table("cycles", outcome.against_cycles)
    if outcome.reciprocity.planned is not None:
        error = outcome.reciprocity.against_cycles.statistical_error.tolist()
        yield f"      {'by reciprocity':<20}" + "".join(f"{percent(e):>9}" for e in error)
    yield from _table("added weight, factor", outcome.against_weight)


def _small_shapes(outcome: PlanPrediction) -> list[tuple[str, str, str]]:
    """Return a row if shapes are so small that `acquire` would confuse noise with a fault."""
    shapes, noise = outcome.ready.shapes, outcome.ready.plan.sensors.noise
    strokes = np.abs(shapes).max(axis=1)
    small = int(np.count_nonzero(POSITION_TOLERANCE * strokes < POSITION_SIGMAS * noise))
    if not small:
        return []
    return [
        ("smallest stroke", f"{1e9 * strokes.min():.3g} nm",
         f"`acquire` will report position noise ({1e9 * noise:.2g} nm) as a fault in {small} of"
         f" {counted(len(strokes), 'shape')}; reduce shapes.count, or provide position_scatter")
    ]  # fmt: skip


def _reciprocity_lines(outcome: PlanPrediction) -> Iterator[str]:
    """Yield the errors of reciprocity, or why it is not possible."""
    found, plan = outcome.reciprocity, outcome.ready.plan
    if found.planned is None:
        yield row("by reciprocity", f"not possible: {found.why_not}")
        return
    yield f"  with calibrate --method reciprocity --mirror {plan.mirror}:"
    error, from_readings, _ = found.planned.typical_errors
    sensors, rows = plan.sensors, []
    if not found.planned.scale_is_free:
        rows.append(("error of alpha", percent(error), "E_ALPHA, typical"))
    rows.append(
        ("statistical", percent(from_readings),
         f"E_STAT, for a noise of {1e9 * sensors.noise:.2g} nm per position")
    )  # fmt: skip
    if sensors.gain:
        note = f"E_GAIN, typical; gains scatter by {percent(sensors.gain)}"
        rows.append(("sensor gains", percent(float(np.median(found.gain_error))), note))
    if sensors.offset:
        note = f"E_DX, E_DY; offsets of {1e3 * sensors.offset:.2g} mm rms per axis"
        typical_offset = f"{1e3 * float(np.median(found.offset_error)):.2g} mm"
        rows.append(("sensor offsets", typical_offset, note))
    for name, value, note in rows:
        yield row(f"  {name}", value, note)


def _table(name: str, curve: Curve) -> Iterator[str]:
    if curve.values.size:
        yield f"    {name:<22}" + "".join(f"{value:>9g}" for value in curve.values.tolist())
        for kind, error in (("E_ALPHA", curve.error), ("E_STAT", curve.statistical_error)):
            if error[0] < float("inf"):
                yield f"      {kind:<20}" + "".join(f"{percent(e):>9}" for e in error.tolist())


def change_lines(target: float | None, changes: Sequence[Change]) -> Iterator[str]:
    """Yield the changes for the wanted error."""
    if target is None:
        return
    if not changes:
        yield f"  the plan reaches {percent(target)}"
        return
    yield f"  to reach {percent(target)}, change one of these:"
    for change in changes:
        if change.reached:
            said = f"{change.change}: {percent(change.error)}, {_time(change.duration)}"
        elif change.plan is not None:
            error = percent(change.error) if change.error < float("inf") else "a free scale"
            said = f"{change.change}: {error}, not sufficient"
        else:
            said = f"not possible: {change.change}"
        yield f"    {change.what:<22}{said}"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _mountings(outcome: PlanPrediction) -> tuple[Mounting, ...]:
    return tuple(mountings(outcome.ready.plan, len(outcome.ready.shapes)))


TYPICAL = "typical_error", "typical_e_stat", "typical_e_syst"
STATISTICAL = ("e_stat", "statistical_error")
SYSTEMATIC = ("e_syst", "systematic_error")
ERRORS = ("e_alpha", "error"), STATISTICAL
CURVE = "error", STATISTICAL
CURVES = Values(
    PlanPrediction,
    ("cycles", Values(Curve, ("cycles", "values"), *CURVE, SYSTEMATIC, path="against_cycles")),
    ("added_factor",
     Values(Curve, ("added_factor", "values"), *CURVE, SYSTEMATIC, path="against_weight")),
)  # fmt: skip
MOUNTINGS = Values(
    Mounting, ("load", "load.name"), ("cycles", lambda one: (one.cycles[0], one.cycles[-1])),
    "start", "end", path=_mountings,
)  # fmt: skip
VALUES = Values(
    PlanPrediction, ("instrument", "ready.mirror.name"),
    ("shapes", lambda p: len(p.ready.shapes), int),
    ("cycles", "ready.plan.cycles"), ("loads", "ready.plan.loads"), ("turns", "ready.plan.turns"),
    ("scale_errors", "prediction.scale_errors"),
    ("actuators", Values(
        Prediction, ("id", lambda p: p.layout.id[p.layout.enabled]), "alpha", *ERRORS, SYSTEMATIC,
        path="prediction",
    )),
    ("weakest", "prediction.diagnosis.weakest"),
    ("undetermined", "prediction.diagnosis.undetermined"), "duration", ("mountings", MOUNTINGS),
    ("largest_force", "strain.force"), ("actuator", "strain.actuator"),
    ("load", "strain.load"), ("force_at_worst", "strain.force_at_worst"),
    ("largest_stroke", "strain.stroke"), ("gap", "strain.gap"), ("curves", CURVES),
    ("warnings", "warnings.fault"),
)  # fmt: skip
RECIPROCITY = Values(
    WithSensors,
    ("actuators", Values(
        WithSensors, ("e_alpha", "planned.error"), ("e_stat", "planned.statistical_error"),
        ("e_gain", "gain_error"), ("e_offset", "offset_error"),
    )),
    ("cycles", Values(Curve, ("cycles", "values"), *CURVE, path="against_cycles")),
)  # fmt: skip
WAYS = Values(Change, "what", "reached", "change", "error", "duration")


def values(
    outcome: PlanPrediction, target: float | None, changes: Sequence[Change]
) -> dict[str, Any]:
    """Return the values for a script; infinite if the scale is free."""
    found = outcome.reciprocity
    reciprocity = {"why_not": found.why_not}
    if found.planned is not None:
        reciprocity = _typical_values(found.planned) | RECIPROCITY.of(found)
    return {
        **VALUES.of(outcome), **_typical_values(outcome.prediction), "reciprocity": reciprocity,
        "target": target, "ways": WAYS.of(tuple(changes)),
    }  # fmt: skip


def _typical_values(prediction: Prediction) -> dict[str, Any]:
    return dict(zip(TYPICAL, prediction.typical_errors, strict=True))
