"""What to change in a plan for a wanted error: each thing alone, the smallest change that does."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from truenewton.acquisition.plan import CampaignPlan
from truenewton.errors import LimitExceeded
from truenewton.planning.forces import Prepared, within_limits
from truenewton.planning.plan_prediction import duration, predict_errors, with_added
from truenewton.progress import telling_of
from truenewton.rounding import counted
from truenewton.statics.load import Load

MOST_CYCLES = 999
FACTORS = 1.0 + 0.1 * np.arange(1, 191)  # 1.1 to 20 times as much
STEEPEST, TILT_ERROR = 60, 0.1  # of a mirror that is leaned by hand [deg, guess]


@dataclass(frozen=True, eq=False)
class Change:
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


def suggest_changes(ready: Prepared, target: float) -> tuple[Change, ...]:
    """Return what each change of a plan alone can do for a typical error of alpha.

    What it asks of the mirror stays within its own limits; the target is the wanted median over
    actuators of E_ALPHA relative to alpha.
    """
    plan = ready.plan
    ladders = (
        ("cycles", _more_cycles(plan), "there are as many as may be"),
        ("added weight", _heavier(plan), "no load has an added weight"),
        ("balance", _better_known(plan), "no added weight has an error"),
        ("tilt", _tilted(plan), ""),
        ("shapes", _larger(ready), "they are given, or at their limits"),
    )
    tried = telling_of(ladders, len(ladders), "changes tried")
    return tuple(_smallest(ready, target, *ladder) for ladder in tried)


# Changes of a plan, each larger than those before it, and how to say them.
Ladder = Iterator[tuple[str, CampaignPlan]]


def _smallest(ready: Prepared, target: float, what: str, ladder: Ladder, nothing: str) -> Change:
    """Return the first change that suffices, or the last that the limits allow."""

    def breaks(change: tuple[str, CampaignPlan]) -> bool:
        return not within_limits(ready.changed(change[1]))

    def error(change: tuple[str, CampaignPlan]) -> float:
        return predict_errors(ready.changed(change[1])).typical

    changes = tuple(ladder)
    allowed = changes[: bisect_left(changes, True, key=breaks)]
    if not allowed:
        why = "the limits allow no more" if changes else nothing
        return Change(what, False, why, None, float("nan"), float("nan"))
    chosen = allowed[-1]
    reached = error(chosen) <= target
    if reached:
        chosen = allowed[bisect_left(allowed, True, key=lambda change: error(change) <= target)]
    words, plan = chosen
    return Change(what, reached, words, plan, error(chosen), duration(plan, len(ready.shapes)))


def _more_cycles(plan: CampaignPlan) -> Ladder:
    for cycles in range(plan.cycles + 1, MOST_CYCLES + 1):
        yield counted(cycles, "cycle"), replace(plan, cycles=cycles)


def _heavier(plan: CampaignPlan) -> Ladder:
    if any(load.added for load in plan.loads):
        for factor in FACTORS.tolist():
            heavier = with_added(plan, factor)
            words = (f"'{one.name}' {one.added:g} N" for one in heavier.loads if one.added)
            yield ", ".join(words), heavier


def _better_known(plan: CampaignPlan) -> Ladder:
    uncertain = [load for load in plan.loads if load.added_error]
    for factor in FACTORS.tolist() if uncertain else ():
        loads = tuple(
            replace(one, added_error=float(f"{one.added_error / factor:.3g}")) for one in plan.loads
        )
        words = (f"'{one.name}' known to {1e3 * one.added_error:g} mN" for one in loads
                 if one.added_error)  # fmt: skip
        yield ", ".join(words), replace(plan, loads=loads)


def _tilted(plan: CampaignPlan) -> Ladder:
    taken = {load.key for load in plan.loads}
    name = next(name for k in range(len(taken) + 1) if (name := f"tilted{k or ''}") not in taken)
    for tilt in range(1, STEEPEST + 1):
        load = Load(name, tilt=float(tilt), tilt_error=TILT_ERROR)
        words = f"a load tilted by {tilt:g} deg, known to {TILT_ERROR:g} deg"
        yield words, replace(plan, loads=(*plan.loads, load))


def _larger(ready: Prepared) -> Ladder:
    plan, shapes = ready.plan, ready.plan.shapes
    for factor in () if ready.given else FACTORS.tolist():
        larger = replace(shapes, stroke=factor * shapes.stroke, force=factor * shapes.force)
        try:
            wider = replace(plan, shapes=larger)
        except LimitExceeded:
            return
        yield f"up to {1e6 * larger.stroke:.3g} um and {larger.force:.3g} N", wider
