"""What a plan comes to: the errors that it will give, how long it takes, what would change them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from truenewton.acquisition.drift import OrderCost, order_costs
from truenewton.acquisition.mountings import mountings
from truenewton.acquisition.plan import CampaignPlan, read_plan
from truenewton.acquisition.shapes import expected_alpha
from truenewton.arrays import Array
from truenewton.errors import TrueNewtonError, located
from truenewton.estimation.prediction import Prediction, predict
from truenewton.estimation.sifted import campaign_moments
from truenewton.estimation.weights import typical
from truenewton.planning.forces import Prepared, Strain, noiseless, prepared, strain, within_limits
from truenewton.planning.third_load import ThirdLoad, third_load
from truenewton.records.fault import Fault


def predicted(ready: Prepared) -> Prediction:
    """Return the errors that a plan will give.

    Raises
    ------
    RankDeficient
    """
    return _predicted_for(ready, [ready.plan.cycles])[0]


def _predicted_for(ready: Prepared, cycles: Sequence[int]) -> list[Prediction]:
    """Predict for several numbers of cycles."""
    campaign = noiseless(ready)
    # As planned, shapes repeat over loads and signs.
    moments = replace(campaign_moments(campaign), pooled=True)
    alpha = np.full(moments.mean.shape[1], expected_alpha(ready.mirror))
    return [predict(campaign, moments, r, alpha) for r in cycles]


def duration(plan: CampaignPlan, shapes: int) -> float:
    """Return how long a plan takes [s]: so many shapes, both signs, and the changes of load."""
    return mountings(plan, shapes)[-1].end


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
    """

    ready: Prepared
    prediction: Prediction
    strain: Strain
    duration: float
    against_cycles: Curve
    against_weight: Curve
    warnings: tuple[Fault, ...]
    orders: tuple[OrderCost, ...]
    third_load: ThirdLoad | None


def read_outlook(path: str | os.PathLike[str]) -> Outlook:
    """Predict what the plan in a file will give.

    Raises
    ------
    TrueNewtonError
        The plan or a file that it names is at fault, or asks more than its limits allow.
    """
    plan = read_plan(path)
    try:
        return outlook(prepared(plan, Path(path).parent))
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
            Fault(
                f"an actuator whose alpha is {min(ready.mirror.alpha_range):g} would take"
                f" {asked.force_at_worst:.3g} N, beyond its limit of {limit:g}",
                "plan a smaller shapes.force",
            ),
        )
    return Outlook(
        ready,
        prediction,
        asked,
        duration(ready.plan, len(ready.shapes)),
        _curve(*_by_cycles(ready)),
        _curve(*_by_weight(ready)),
        warnings,
        order_costs(ready.plan, ready.mirror, len(ready.shapes)),
        third_load(ready),
    )


def _by_cycles(ready: Prepared) -> tuple[list[float], list[Prediction]]:
    """Predict for cycles in powers of two, and those of the plan."""
    planned = ready.plan.cycles
    most = max(64, 4 * planned)
    cycles = sorted({2**k for k in range(10) if 2**k <= most} | {planned})
    return list(map(float, cycles)), _predicted_for(ready, cycles)


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
