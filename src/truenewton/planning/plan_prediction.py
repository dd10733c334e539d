"""The prediction of a plan: errors, time, and changes that reach a target.

The errors are those of `prediction`, for the forces that the shell model predicts.
"""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.acquisition.load_order import mountings
from truenewton.acquisition.plan import CampaignPlan, expected_alpha, read_plan
from truenewton.arrays import Array
from truenewton.errors import LimitExceeded, RankDeficient, TrueNewtonError, located
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.reciprocity.sensor_model import Kind, Request, places_of
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.mirrors.sensor_model import model_sensors
from truenewton.planning.forces import (
    Prepared,
    Strain,
    noiseless,
    prepared_bodies,
    strain,
    within_limits,
)
from truenewton.planning.prediction import (
    Prediction,
    SensorInformation,
    predict,
    sensor_errors,
    sensor_information,
)
from truenewton.progress import report_progress, with_progress
from truenewton.rounding import counted
from truenewton.statics.load import LIKELY_COIL_SHIFT, Load

MAX_CYCLES = 999
FACTORS = 1.0 + 0.1 * np.arange(1, 191)  # 1.1 to 20 times as much
MAX_TILT, TILT_ERROR = 60, 0.1  # of a mirror that is leaned by hand [deg, guess]


def predict_errors(ready: Prepared) -> Prediction:
    """Return the errors that a plan will give."""
    return _predict_for(ready, [ready.plan.cycles])[0]


def _predict_for(
    ready: Prepared, cycles: Sequence[int], gained: SensorInformation | None = None
) -> list[Prediction]:
    campaign = noiseless(ready)
    # In a plan shapes repeat over loads and signs.
    moments = replace(campaign_moments(campaign), pooled=True)
    alpha = np.full(moments.mean.shape[1], expected_alpha(ready.mirror))
    return [predict(campaign, moments, r, alpha, gained) for r in cycles]


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of alpha as a function of cycles or weights."""

    values: Array  # (m,) cycles, or factors of the added weights
    # (m,) medians of E_ALPHA, E_STAT and E_SYST, relative to alpha
    error: Array
    statistical_error: Array
    systematic_error: Array


@dataclass(frozen=True, eq=False)
class WithSensors:
    """What `reciprocity` will give in addition, with a known model of the glass."""

    planned: Prediction | None  # of alpha; None if reciprocity is not possible
    # (n,) of the sensor gains, relative, and of the offsets, rms of both axes [m]; 0 if known
    gain_error: Array
    offset_error: Array
    against_cycles: Curve  # of alpha
    why_not: str = ""  # why reciprocity is not possible


def with_sensors(ready: Prepared, cycles: Sequence[int]) -> WithSensors:
    """Predict the errors of `reciprocity --mirror` for some cycles, including those planned."""
    plan, layout = ready.plan, ready.mirror.layout
    repeats = 2 * len(plan.loads)
    try:
        gained = sensor_information(
            places_of(layout, model_sensors(ready.glass)),
            Request(plan.sensors.gain, plan.sensors.offset),
            *(np.sqrt(repeats) * each[:, layout.enabled] for each in (ready.shapes, ready.force)),
            force_noise=plan.force_noise,
            position_noise=plan.sensors.noise,
        )
    except RankDeficient as error:
        return WithSensors(None, np.empty(0), np.empty(0), _curve([], []), error.fault)
    made = _predict_for(ready, cycles, gained)
    planned, curve = made[cycles.index(plan.cycles)], _curve(cycles, made)
    errors, nothing = sensor_errors(gained, plan.cycles), np.zeros(len(planned.alpha))
    gain, x, y = (errors.get(kind, nothing) for kind in (Kind.GAIN, Kind.X, Kind.Y))
    return WithSensors(planned, gain, np.asarray(np.hypot(x, y) / np.sqrt(2)), curve)


@dataclass(frozen=True, eq=False)
class PlanPrediction:
    """All that is predicted of a plan."""

    # the plan with its forces, the errors, and the largest force and stroke
    ready: Prepared
    prediction: Prediction
    strain: Strain
    duration: float  # [s]
    # errors against cycles, and against factors of the added weights (empty if there are none)
    against_cycles: Curve
    against_weight: Curve
    warnings: tuple[Finding, ...]  # each with its remedy
    reciprocity: WithSensors  # what reciprocity will give


def predict_plan(path: str | os.PathLike[str]) -> PlanPrediction:
    """Predict the errors of the plan in a file; of a segmented mirror those of the worst segment.

    Parameters
    ----------
    path
        The plan (TOML).

    Raises
    ------
    TrueNewtonError
        The plan or a file that it names is invalid, or exceeds its limits.

    Examples
    --------
    >>> outcome = tn.predict_plan("day.toml")
    >>> outcome.prediction.error.shape
    (45,)
    """
    plan = read_plan(path)
    report_progress("forces and errors")
    try:
        bodies = map(predict_prepared, prepared_bodies(plan, Path(path).parent))
        return max(bodies, key=lambda one: one.prediction.typical_errors)
    except TrueNewtonError as error:
        raise located(error, path) from None


def predict_prepared(ready: Prepared) -> PlanPrediction:
    """Predict the errors of a plan whose forces are known."""
    asked, cycles = strain(ready), _cycles_around(ready.plan.cycles)
    by_cycles = _predict_for(ready, cycles)
    prediction = by_cycles[cycles.index(ready.plan.cycles)]
    warnings = prediction.diagnosis.warnings
    limit = ready.plan.limits.force
    if asked.force_at_worst > limit:
        warnings += (
            Finding.of(
                Code.PLANNED_FORCE_TOO_LARGE,
                alpha=min(ready.mirror.alpha_range),
                force=asked.force_at_worst,
                limit=limit,
            ),
        )
    report_progress("errors of the sensors", 0.3)
    sensors = with_sensors(ready, cycles)
    report_progress("errors against cycles and weight", 0.9)
    return PlanPrediction(
        ready,
        prediction,
        asked,
        mountings(ready.plan, len(ready.shapes))[-1].end,
        _curve(cycles, by_cycles),
        _curve(*_by_weight(ready)),
        warnings,
        sensors,
    )


def _cycles_around(planned: int) -> list[int]:
    most = max(64, 4 * planned)
    return sorted({2**k for k in range(10) if 2**k <= most} | {planned})


def _by_weight(ready: Prepared) -> tuple[list[float], list[Prediction]]:
    """Predict errors for multiples of the planned added weights, within the limits."""
    added = any(load.added for load in ready.plan.loads)
    factors = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0] if added else []
    heavier = (ready.changed(with_added(ready.plan, factor)) for factor in factors)
    predictions = [predict_errors(each) for each in takewhile(within_limits, heavier)]
    return factors[: len(predictions)], predictions


def with_added(plan: CampaignPlan, factor: float) -> CampaignPlan:
    """Return the plan with added weights multiplied by a factor, their errors unchanged."""
    heavier = tuple(replace(one, added=float(f"{factor * one.added:.6g}")) for one in plan.loads)
    return replace(plan, loads=heavier)


def _curve(values: Sequence[float], predictions: list[Prediction]) -> Curve:
    errors = np.array([one.typical_errors for one in predictions]).reshape(-1, 3)
    return Curve(np.array(values, dtype=np.float64), *errors.T)


@dataclass(frozen=True, eq=False)
class Change:
    """A change of one property of a plan."""

    what: str  # 'cycles', 'added weight', 'weighing', 'tilt' or 'shapes'
    reached: bool  # whether it reaches the wanted error
    change: str  # description of the change, or why there is none
    plan: CampaignPlan | None  # the changed plan; None if there is no such change
    error: float  # its median E_ALPHA relative to alpha
    duration: float  # [s]


def suggest_changes(ready: Prepared, target: float) -> tuple[Change, ...]:
    """Return the smallest change of each property alone that reaches a target, within the limits.

    The target is the wanted median over actuators of E_ALPHA relative to alpha.
    """
    plan = ready.plan
    ladders = (
        ("cycles", _more_cycles(plan), "there are as many as possible"),
        ("added weight", _heavier(plan), "no load has an added weight"),
        ("weighing", _better_known(plan), "no added weight has an error"),
        ("tilt", _tilted(plan), ""),
        ("shapes", _larger(ready), "they are given, or at their limits"),
    )
    tried = with_progress(ladders, len(ladders), "changes tried")
    return tuple(_smallest(ready, target, *ladder) for ladder in tried)


# Descriptions, and attributes of the plan, each changed more than those before it.
Ladder = Iterator[tuple[str, dict[str, Any]]]


def _smallest(ready: Prepared, target: float, what: str, ladder: Ladder, nothing: str) -> Change:
    """Return the first change that reaches the target, or the last within the limits."""

    def changed(change: tuple[str, dict[str, Any]]) -> Prepared:
        return ready.changed(replace(ready.plan, **change[1]))

    def error(change: tuple[str, dict[str, Any]]) -> float:
        return predict_errors(changed(change)).typical

    changes = tuple(ladder)
    allowed = changes[: bisect_left(changes, True, key=lambda one: not within_limits(changed(one)))]
    if not allowed:
        why = "the limits allow no more" if changes else nothing
        return Change(what, False, why, None, float("nan"), float("nan"))
    chosen = allowed[-1]
    reached = error(chosen) <= target
    if reached:
        chosen = allowed[bisect_left(allowed, True, key=lambda change: error(change) <= target)]
    words, plan = chosen[0], replace(ready.plan, **chosen[1])
    end = mountings(plan, len(ready.shapes))[-1].end
    return Change(what, reached, words, plan, error(chosen), end)


def _more_cycles(plan: CampaignPlan) -> Ladder:
    for cycles in range(plan.cycles + 1, MAX_CYCLES + 1):
        yield counted(cycles, "cycle"), {"cycles": cycles}


def _heavier(plan: CampaignPlan) -> Ladder:
    if any(load.added for load in plan.loads):
        for factor in FACTORS.tolist():
            loads = with_added(plan, factor).loads
            words = (f"'{one.name}' {one.added:g} N" for one in loads if one.added)
            yield ", ".join(words), {"loads": loads}


def _better_known(plan: CampaignPlan) -> Ladder:
    uncertain = [load for load in plan.loads if load.added_error]
    for factor in FACTORS.tolist() if uncertain else ():
        loads = tuple(
            replace(one, added_error=float(f"{one.added_error / factor:.3g}")) for one in plan.loads
        )
        words = (f"'{one.name}' ± {1e3 * one.added_error:g} mN" for one in loads
                 if one.added_error)  # fmt: skip
        yield ", ".join(words), {"loads": loads}


def _tilted(plan: CampaignPlan) -> Ladder:
    taken = {load.key for load in plan.loads}
    name = next(name for k in range(len(taken) + 1) if (name := f"tilted{k or ''}") not in taken)
    for tilt in range(1, MAX_TILT + 1):
        load = Load(
            name, tilt=float(tilt), tilt_error=TILT_ERROR, coil_shift_error=LIKELY_COIL_SHIFT
        )
        coils = f"coil displacement ± {1e6 * LIKELY_COIL_SHIFT:g} um"
        words = f"a load tilted by {tilt:g} ± {TILT_ERROR:g} deg, {coils}"
        yield words, {"loads": (*plan.loads, load)}


def _larger(ready: Prepared) -> Ladder:
    plan, shapes = ready.plan, ready.plan.shapes
    for factor in () if ready.given else FACTORS.tolist():
        larger = replace(shapes, stroke=factor * shapes.stroke, force=factor * shapes.force)
        try:
            replace(plan, shapes=larger)
        except LimitExceeded:
            return
        yield f"up to {1e6 * larger.stroke:.3g} um and {larger.force:.3g} N", {"shapes": larger}
