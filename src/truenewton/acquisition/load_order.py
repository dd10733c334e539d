"""The order of the loads: which is put on when, for which cycles, and the errors by drift.

With one turn all cycles of a load are taken before the next is put on. With more turns, the loads
are taken back and forth, each time with a part of the cycles:

    turns   parts of the cycles     bare and ring, 4 cycles         times at which, in changes
    1       1                       bare 4, ring 4                  0, 1
    2       1 : 1                   bare 2, ring 4, bare 2          0, 1, 2
    3       1 : 2 : 1               bare 1, ring 3, bare 3, ring 1  0, 1, 2, 3

The parts are binomial coefficients, so that the difference of the means of two loads is a finite
difference of the order of the turns: two turns cancel linear drift, three quadratic drift.

The common scale s and B follow from s S_l + B = -W_l by least squares over the loads, S_l the sums
of the forces at rest (docs/campaign.md), so an error dS_l gives ds / s = sum r_l dS_l. Under two
loads r = (+1, -1) / (S_2 - S_1). If alpha drifts by g an hour, dS_l = -g h_l S_l.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.acquisition.plan import MAX_CYCLES, MAX_TURNS, CampaignPlan, expected_alpha
from truenewton.arrays import Array
from truenewton.bench.simulated.loop import Control
from truenewton.mirrors.known import Mirror
from truenewton.statics.arms import effective_weight
from truenewton.statics.load import Load, change_by_coil_shift

HOUR = 3600.0
WEIGHT_TOLERANCE = 1e-12  # relative difference of weights that is rounding
MIN_VARIANCE_SHARE = 1e-9  # of the errors of weights, which is left to readings
MAX_ERROR_RATIO = 0.99  # to the error of one turn, for mounting a load again to be worth it


@dataclass(frozen=True)
class Mounting:
    """A load that is put on, and the numbers of its cycles that are taken until the next one."""

    load: Load
    cycles: range
    start: float = 0.0  # of the first cycle, from the start of the campaign [s]
    end: float = 0.0  # of the last

    def __str__(self) -> str:
        first, last = self.cycles[0], self.cycles[-1]
        return f"{self.load.name} {first}" if first == last else f"{self.load.name} {first}-{last}"


def cycles_of_turns(cycles: int, turns: int) -> tuple[int, ...]:
    """Return how many of the cycles under each load every turn takes."""
    if turns == 1:
        return (cycles,)
    back = cycles // 2  # linear drift cancels if half of the cycles are taken on the way back
    if turns == 2:
        return cycles - back, back
    last = (cycles - back) // 2
    return cycles - back - last, back, last


def mountings(plan: CampaignPlan, shapes: int = 0) -> tuple[Mounting, ...]:
    """Return the order of a plan whose turns are known, with times for so many shapes."""
    order: list[tuple[Load, range]] = []
    taken = 0
    for turn, count in enumerate(cycles_of_turns(plan.cycles, plan.turns)):
        numbers = range(taken + 1, taken + count + 1)
        for load in plan.loads[:: -1 if turn % 2 else 1]:
            if order and order[-1][0] is load:  # at a turn it stays on
                order[-1] = load, range(order[-1][1].start, numbers.stop)
            else:
                order.append((load, numbers))
        taken += count
    timed, clock = list[Mounting](), 0.0
    for load, numbers in order:
        end = clock + len(numbers) * cycle_time(plan, shapes)
        timed.append(Mounting(load, numbers, clock, end))
        clock = end + plan.pause
    return tuple(timed)


def cycle_time(plan: CampaignPlan, shapes: int) -> float:
    """Return the time of one cycle of so many shapes, both signs [s]."""
    return 2 * shapes * reading_time(plan)


def reading_time(plan: CampaignPlan) -> float:
    """Return the time of one reading, settling included [s]."""
    return plan.settling + plan.samples / Control.rate


def mounting_words(order: tuple[Mounting, ...], index: int) -> str:
    """Return which mounting it is, what it is for, and what comes after."""
    here = order[index]
    first, last = here.cycles[0], here.cycles[-1]
    numbers = f"cycle {first}" if first == last else f"cycles {first} to {last}"
    after = [f"then '{each.load.name}'" for each in order[index + 1 : index + 2]] or ["the last"]
    return f"mounting {index + 1} of {len(order)}: '{here.load.name}' for {numbers}, {after[0]}"


@dataclass(frozen=True, eq=False)
class ScaleBalance:
    """How the common scale follows from the sums of the forces at rest under L loads."""

    held: Array  # (L,) S, true [N]
    response: Array  # (L,) r, relative change of the scale for each Newton of a sum [1/N]
    covariance: Array  # (L, L) of what weights and readings leave unknown of S + W [N^2]
    zero: float  # change of a sum for a common change of all zeros of the readings [N / N]

    @property
    def error(self) -> float:
        """Relative error of the scale, from weights and readings."""
        return float(np.sqrt(self.response @ self.covariance @ self.response))


def scale_balance(plan: CampaignPlan, mirror: Mirror, shapes: int) -> ScaleBalance | None:
    """Return how the scale follows from so many shapes; None if the loads do not fix it."""
    nz = mirror.layout.nz[mirror.layout.enabled]
    added = np.array([load.added for load in plan.loads])
    tilt = np.array([load.tilt for load in plan.loads])
    held = -(effective_weight(mirror.weight, added, tilt) + mirror.bias_force * nz.sum())
    if np.ptp(held) <= WEIGHT_TOLERANCE * np.abs(held).max():
        return None
    alpha = expected_alpha(mirror)
    noise = alpha * plan.force_noise * np.linalg.norm(nz) / np.sqrt(2 * shapes * plan.cycles)
    errors = _weight_changes(plan, mirror, held)
    covariance = errors @ errors.T
    # Of readings far better than the weights no less than rounding leaves, or it has no inverse.
    covariance += max(noise**2, MIN_VARIANCE_SHARE * np.trace(covariance)) * np.eye(len(held))
    design = np.column_stack([held, np.ones_like(held)])
    inverse = np.linalg.inv(covariance)
    response = -np.linalg.solve(design.T @ inverse @ design, design.T @ inverse)[0]
    return ScaleBalance(held, response, covariance, alpha * float(nz.sum()))


def _weight_changes(plan: CampaignPlan, mirror: Mirror, held: Array) -> Array:
    """Return (L, errors) changes of W by one standard uncertainty of each error [N].

    ``held`` is (L,) S [N].
    """
    loads = plan.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    columns = [mirror.weight_error * cosine]
    for tool in {load.tool or load.key for load in loads}:
        hangs = [load.added_error * ((load.tool or load.key) == tool) for load in loads]
        columns.append(np.array(hangs) * cosine)
    for index, load in enumerate(loads):
        leaned = np.zeros(len(loads))
        total = (mirror.weight + load.added) * np.sin(np.radians(load.tilt))
        leaned[index] = total * np.radians(load.tilt_error)
        columns.append(leaned)
    nz = float(mirror.layout.nz[mirror.layout.enabled].sum())
    by_shift = change_by_coil_shift(-held, nz, mirror.coil_gradient, mirror.bias_gradient)
    columns += list(np.diag([load.coil_shift_error or 0.0 for load in loads] * by_shift))
    return np.column_stack(columns)


@dataclass(frozen=True)
class OrderCost:
    """Time and relative errors of the common scale of an order of the loads.

    Drift counts relative to alpha in the middle of the campaign.
    """

    turns: int
    order: str  # loads and numbers of their cycles
    changes: int  # of the load
    duration: float  # [s]
    known: float  # error from weights and readings, whatever the order
    gain: float  # by how much the assumed drift of alpha moves the scale, with sign
    zero: float  # and that of the zeros
    remounting: float  # standard error from zeros that move at each mounting

    @property
    def drift(self) -> float:
        """Size of all that drift and mounting do."""
        return float(np.linalg.norm([self.gain, self.zero, self.remounting]))

    @property
    def error(self) -> float:
        """Of the scale, drift and mounting included."""
        return float(np.hypot(self.known, self.drift))


def order_cost(plan: CampaignPlan, mirror: Mirror, shapes: int) -> OrderCost | None:
    """Return the cost of the order of a plan; None if the loads do not fix the scale."""
    balance = scale_balance(plan, mirror, shapes)
    if balance is None:
        return None
    order = mountings(plan, shapes)
    of_load, share = _shares(plan, order)
    middle = np.array([0.5 * (each.start + each.end) for each in order]) / HOUR
    middle -= middle @ share / len(plan.loads)  # every load has as many cycles
    hours = np.bincount(of_load, weights=share * middle).round(9)  # 0 but for rounding is 0
    r, drift = balance.response, plan.drift
    return OrderCost(
        turns=plan.turns,
        order=", ".join(map(str, order)),
        changes=len(order) - 1,
        duration=order[-1].end,
        known=balance.error,
        gain=float(-drift.alpha * (r * balance.held) @ hours),
        zero=float(drift.zero * balance.zero * r @ hours),
        remounting=float(np.sqrt(r**2 @ mounting_variance(plan, balance))),
    )


def mounting_variance(plan: CampaignPlan, balance: ScaleBalance) -> Array:
    """Return (L,) variances of S, of zeros that change at each mounting [N^2]."""
    of_load, share = _shares(plan, mountings(plan))
    one = (plan.drift.remounting * balance.zero) ** 2
    return np.asarray(one * np.bincount(of_load, weights=share**2))


def _shares(plan: CampaignPlan, order: Sequence[Mounting]) -> tuple[NDArray[np.int64], Array]:
    """Return for each mounting the index of its load, and its share of the cycles."""
    keys = [load.key for load in plan.loads]
    of_load = np.array([keys.index(each.load.key) for each in order])
    return of_load, np.array([len(each.cycles) for each in order]) / plan.cycles


def order_costs(plan: CampaignPlan, mirror: Mirror, shapes: int) -> tuple[OrderCost, ...]:
    """Return the cost of each number of turns, from one; none if the scale is not fixed."""
    turns = range(1, min(MAX_TURNS, plan.cycles) + 1) if len(plan.loads) > 1 else range(1, 2)
    costs = (order_cost(replace(plan, turns=one), mirror, shapes) for one in turns)
    return tuple(cost for cost in costs if cost is not None)


def without_remounting(plan: CampaignPlan, mirror: Mirror, shapes: int, cost: OrderCost) -> float:
    """Return the error of one load after the other, the time of more mountings put into cycles."""
    spare = (cost.changes - (len(plan.loads) - 1)) * plan.pause
    more = spare / (len(plan.loads) * cycle_time(plan, shapes))
    cycles = {plan.cycles, plan.cycles + int(min(more, MAX_CYCLES - plan.cycles))}
    single = replace(plan, turns=1)
    costs = (order_cost(replace(single, cycles=each), mirror, shapes) for each in cycles)
    return min(cost.error for cost in costs if cost is not None)


def turns_that_pay(plan: CampaignPlan, mirror: Mirror, shapes: int) -> int:
    """Return the turns of a plan that leaves them open: as many as possible, or one.

    Loads are mounted again if the error of the scale is then smaller than if the same time were
    spent on more cycles in one turn.
    """
    costs = order_costs(plan, mirror, shapes)
    if not costs:
        return 1
    most = costs[-1]
    pays = most.error < MAX_ERROR_RATIO * without_remounting(plan, mirror, shapes, most)
    return most.turns if pays else 1


def with_turns(plan: CampaignPlan, mirror: Mirror, shapes: int) -> CampaignPlan:
    """Return a plan whose turns are known, of so many shapes."""
    return plan if plan.turns else replace(plan, turns=turns_that_pay(plan, mirror, shapes))
