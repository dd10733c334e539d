"""What to change in a plan for a wanted error: each thing alone, the smallest change that does."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from truenewton.acquisition.plan import CampaignPlan
from truenewton.errors import LimitExceeded
from truenewton.planning.forces import Prepared, strain
from truenewton.planning.outlook import duration, predicted, with_added
from truenewton.statics.load import Load

MOST_CYCLES = 999
FACTORS = 1.0 + 0.1 * np.arange(1, 191)  # 1.1 to 20 times as much
STEEPEST, TILT_ERROR = 60, 0.1  # of a mirror that is leaned by hand [deg, guess]


@dataclass(frozen=True, eq=False)
class Way:
    """One thing in a plan changed, the others left alone.

    Attributes
    ----------
    what
        'cycles', 'added weight', 'balance', 'tilt' or 'shapes'.
    reached
        Whether it reaches the wanted error.
    change
        In words: the largest that there is where none suffices, or why there is none.
    plan
        The plan so changed; None where there is nothing to change.
    error
        Typical E_ALPHA that it gives, relative to alpha.
    duration
        [s]
    """

    what: str
    reached: bool
    change: str
    plan: CampaignPlan | None
    error: float
    duration: float


def ways_to(ready: Prepared, target: float) -> tuple[Way, ...]:
    """Return what each change alone can do for a typical error of alpha.

    Parameters
    ----------
    ready
        The plan; what it asks of the mirror stays within its own limits.
    target
        Wanted median over actuators of E_ALPHA relative to alpha.
    """
    plan = ready.plan
    ladders = (
        _Ladder("cycles", _more_cycles(plan), _cycles_in_words, "there are as many as may be"),
        _Ladder("added weight", _heavier(plan), _added_in_words, "no load has an added weight"),
        _Ladder("balance", _better_known(plan), _errors_in_words, "no added weight has an error"),
        _Ladder("tilt", _tilted(plan), _tilt_in_words, ""),
        _Ladder("shapes", _larger(ready), _shapes_in_words, "they are given, or at their limits"),
    )
    return tuple(_smallest(ready, ladder, target) for ladder in ladders)


@dataclass(frozen=True, eq=False)
class _Ladder:
    """Plans, each a larger change than those before it; how to say them, or that there is none."""

    what: str
    plans: Iterator[CampaignPlan]
    words: Callable[[CampaignPlan], str]
    nothing: str


def _smallest(ready: Prepared, ladder: _Ladder, target: float) -> Way:
    """Return the first of the plans that suffices, or the last that the limits allow."""

    def breaks(plan: CampaignPlan) -> bool:
        try:
            strain(ready.changed(plan))
        except LimitExceeded:
            return True
        return False

    def error(plan: CampaignPlan) -> float:
        return predicted(ready.changed(plan)).typical

    plans = tuple(ladder.plans)
    allowed = plans[: bisect_left(plans, True, key=breaks)]
    if not allowed:
        why = "the limits allow no more" if plans else ladder.nothing
        return Way(ladder.what, False, why, None, float("nan"), float("nan"))
    chosen = allowed[-1]
    reached = error(chosen) <= target
    if reached:
        chosen = allowed[bisect_left(allowed, True, key=lambda plan: error(plan) <= target)]
    time = duration(chosen, len(ready.shapes))
    return Way(ladder.what, reached, ladder.words(chosen), chosen, error(chosen), time)


def _more_cycles(plan: CampaignPlan) -> Iterator[CampaignPlan]:
    return (replace(plan, cycles=r) for r in range(plan.cycles + 1, MOST_CYCLES + 1))


def _heavier(plan: CampaignPlan) -> Iterator[CampaignPlan]:
    if any(load.added for load in plan.loads):
        yield from (with_added(plan, factor) for factor in FACTORS.tolist())


def _better_known(plan: CampaignPlan) -> Iterator[CampaignPlan]:
    if any(load.added_error for load in plan.loads):
        for factor in FACTORS.tolist():
            loads = [
                replace(one, added_error=float(f"{one.added_error / factor:.3g}"))
                for one in plan.loads
            ]
            yield replace(plan, loads=tuple(loads))


def _tilted(plan: CampaignPlan) -> Iterator[CampaignPlan]:
    taken = {load.key for load in plan.loads}
    name = next(name for k in range(len(taken) + 1) if (name := f"tilted{k or ''}") not in taken)
    for tilt in range(1, STEEPEST + 1):
        load = Load(name, tilt=float(tilt), tilt_error=TILT_ERROR)
        yield replace(plan, loads=(*plan.loads, load))


def _larger(ready: Prepared) -> Iterator[CampaignPlan]:
    if ready.given:
        return
    plan, shapes = ready.plan, ready.plan.shapes
    for factor in FACTORS.tolist():
        larger = replace(shapes, stroke=factor * shapes.stroke, force=factor * shapes.force)
        try:
            yield replace(plan, shapes=larger)
        except LimitExceeded:
            return


def _cycles_in_words(plan: CampaignPlan) -> str:
    return f"{plan.cycles} cycles"


def _added_in_words(plan: CampaignPlan) -> str:
    return ", ".join(f"'{one.name}' {one.added:g} N" for one in plan.loads if one.added)


def _errors_in_words(plan: CampaignPlan) -> str:
    uncertain = (one for one in plan.loads if one.added_error)
    return ", ".join(f"'{one.name}' known to {1e3 * one.added_error:g} mN" for one in uncertain)


def _tilt_in_words(plan: CampaignPlan) -> str:
    return f"a load tilted by {plan.loads[-1].tilt:g} deg, known to {TILT_ERROR:g} deg"


def _shapes_in_words(plan: CampaignPlan) -> str:
    shapes = plan.shapes
    return f"up to {1e6 * shapes.stroke:.3g} um and {shapes.force:.3g} N"
