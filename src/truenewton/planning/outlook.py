"""What a plan comes to: the errors that it will give, how long it takes, what would change them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from truenewton.acquisition.load_order import OrderCost, mountings, order_costs
from truenewton.acquisition.plan import CampaignPlan, read_plan
from truenewton.acquisition.shapes import expected_alpha
from truenewton.arrays import Array
from truenewton.errors import RankDeficient, TrueNewtonError, located
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.findings.scale_budget import typical
from truenewton.estimation.prediction import Prediction, predict
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.reciprocity.prediction import informed, sensor_errors
from truenewton.estimation.reciprocity.prediction import predict as predict_with_sensors
from truenewton.estimation.reciprocity.sensor_model import places_of
from truenewton.estimation.reciprocity.unknowns import Kind, Request
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.mirrors.shell.puck_motion import seen_by
from truenewton.planning.forces import (
    Prepared,
    Strain,
    noiseless,
    prepared_bodies,
    strain,
    within_limits,
)
from truenewton.planning.third_load import ThirdLoad, third_load
from truenewton.progress import tell
from truenewton.records.campaign import Campaign


def predicted(ready: Prepared) -> Prediction:
    """Return the errors that a plan will give.

    Raises
    ------
    RankDeficient
    """
    return _predicted_for(ready, [ready.plan.cycles])[0]


def _predicted_for(ready: Prepared, cycles: Sequence[int]) -> list[Prediction]:
    """Predict for several numbers of cycles."""
    campaign, moments, alpha = _beforehand(ready)
    return [predict(campaign, moments, r, alpha) for r in cycles]


def _beforehand(ready: Prepared) -> tuple[Campaign, Moments, Array]:
    """Return the campaign without noise, its moments, and alpha of the enabled actuators."""
    campaign = noiseless(ready)
    # As planned, shapes repeat over loads and signs.
    moments = replace(campaign_moments(campaign), pooled=True)
    return campaign, moments, np.full(moments.mean.shape[1], expected_alpha(ready.mirror))


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors against one thing that could be changed.

    Attributes
    ----------
    values
        (m,) cycles, or factors of the added weights.
    error, reading_error, systematic_error
        (m,) typical E_ALPHA, E_STAT and E_SYST, relative to alpha.
    """

    values: Array
    error: Array
    reading_error: Array
    systematic_error: Array


@dataclass(frozen=True, eq=False)
class WithSensors:
    """What `reciprocity` will give besides, the glass of the mirror known.

    Attributes
    ----------
    planned
        Of alpha; None where it cannot be had.
    gain_error, offset_error
        (n,) of the sensor gains, relative, and of the offsets, rms of both axes [m]; 0 where they
        are known.
    against_cycles
        Of alpha.
    why_not
        Why it cannot be had.
    """

    planned: Prediction | None
    gain_error: Array
    offset_error: Array
    against_cycles: Curve
    why_not: str = ""


def with_sensors(ready: Prepared, cycles: Sequence[int]) -> WithSensors:
    """Predict what `reciprocity --mirror` will state, for so many cycles among them those planned.

    Raises
    ------
    RankDeficient
        The balance alone cannot give alpha either.
    """
    plan, layout = ready.plan, ready.mirror.layout
    repeats = 2 * len(plan.loads)
    try:
        said = informed(
            places_of(layout, seen_by(ready.glass)),
            Request(plan.sensors.gain, plan.sensors.offset),
            *(np.sqrt(repeats) * each[:, layout.enabled] for each in (ready.shapes, ready.force)),
            force_noise=plan.force_noise,
            position_noise=plan.sensors.noise,
        )
    except RankDeficient as error:
        return WithSensors(None, np.empty(0), np.empty(0), _curve([], []), error.fault)
    campaign, moments, alpha = _beforehand(ready)
    made = [predict_with_sensors(campaign, moments, said, r, alpha) for r in cycles]
    curve = _curve(list(map(float, cycles)), made)
    errors, nothing = sensor_errors(said, plan.cycles), np.zeros(len(alpha))
    gain, x, y = (errors.get(kind, nothing) for kind in (Kind.GAIN, Kind.X, Kind.Y))
    planned = made[cycles.index(plan.cycles)]
    return WithSensors(planned, gain, np.asarray(np.hypot(x, y) / np.sqrt(2)), curve)


def duration(plan: CampaignPlan, shapes: int) -> float:
    """Return how long a plan takes [s]: so many shapes, both signs, and the changes of load."""
    return mountings(plan, shapes)[-1].end


@dataclass(frozen=True, eq=False)
class Outlook:
    """All that is predicted of a plan.

    Attributes
    ----------
    ready, prediction, strain
        The plan with its forces, the errors, and what the mirror has to bear.
    duration
        [s]
    against_cycles, against_weight
        Errors against cycles, and against factors of the added weights (empty without any).
    warnings
        Each with its remedy.
    orders
        What each number of turns costs, one first; none where the scale is free.
    third_load
        What a third load would show; None where there are three, or no scale.
    reciprocity
        What reciprocity will give.
    """

    ready: Prepared
    prediction: Prediction
    strain: Strain
    duration: float
    against_cycles: Curve
    against_weight: Curve
    warnings: tuple[Finding, ...]
    orders: tuple[OrderCost, ...]
    third_load: ThirdLoad | None
    reciprocity: WithSensors


def read_outlook(path: str | os.PathLike[str]) -> Outlook:
    """Predict what the plan in a file will give; of a mirror in segments, to the worst of them.

    Parameters
    ----------
    path
        The plan (TOML).

    Raises
    ------
    TrueNewtonError
        The plan or a file that it names is at fault, or asks more than its limits allow.

    Examples
    --------
    >>> outlook = tn.read_outlook("day.toml")
    >>> outlook.prediction.error.shape
    (45,)
    """
    plan = read_plan(path)
    tell("forces and errors")
    try:
        bodies = map(outlook, prepared_bodies(plan, Path(path).parent))
        return max(bodies, key=lambda one: typical_errors(one.prediction))
    except TrueNewtonError as error:
        raise located(error, path) from None


def outlook(ready: Prepared) -> Outlook:
    """Predict what a plan will give.

    Raises
    ------
    LimitExceeded, RankDeficient, FormatError
    """
    asked, prediction = strain(ready), predicted(ready)
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
    cycles = _cycles_around(ready.plan.cycles)
    tell("what the sensors will see besides", 0.3)
    sensors = with_sensors(ready, cycles)
    tell("errors against cycles and weight", 0.9)
    return Outlook(
        ready,
        prediction,
        asked,
        duration(ready.plan, len(ready.shapes)),
        _curve(list(map(float, cycles)), _predicted_for(ready, cycles)),
        _curve(*_by_weight(ready)),
        warnings,
        order_costs(ready.plan, ready.mirror, len(ready.shapes)),
        third_load(ready),
        sensors,
    )


def _cycles_around(planned: int) -> list[int]:
    """Return cycles in powers of two, and those of the plan."""
    most = max(64, 4 * planned)
    return sorted({2**k for k in range(10) if 2**k <= most} | {planned})


def _by_weight(ready: Prepared) -> tuple[list[float], list[Prediction]]:
    """Predict for added weights in powers of two of those planned, as far as the limits allow."""
    added = any(load.added for load in ready.plan.loads)
    factors = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0] if added else []
    heavier = (ready.changed(with_added(ready.plan, factor)) for factor in factors)
    predictions = [predicted(each) for each in takewhile(within_limits, heavier)]
    return factors[: len(predictions)], predictions


def with_added(plan: CampaignPlan, factor: float) -> CampaignPlan:
    """Return the plan with added weights so many times as heavy, their errors as they are."""
    heavier = tuple(replace(one, added=float(f"{factor * one.added:.6g}")) for one in plan.loads)
    return replace(plan, loads=heavier)


def _curve(values: list[float], predictions: list[Prediction]) -> Curve:
    errors = np.array([typical_errors(one) for one in predictions]).reshape(-1, 3)
    return Curve(np.array(values), *errors.T)


def typical_errors(prediction: Prediction) -> tuple[float, ...]:
    """Return E_ALPHA, E_STAT and E_SYST of a typical actuator, relative to alpha."""
    errors = prediction.error, prediction.reading_error, prediction.systematic_error
    return tuple(typical(error, prediction.alpha) for error in errors)
