"""What drift costs the common scale in each order of the loads, from statics alone.

A gain that all coils share leaves elastic forces in balance; what it spoils is the sum of the
forces at rest, S_l = sum nz_i alpha_i c_i = -(W_l + B), from which the scale s and B follow:
s S_l + B = -W_l, by least squares over the loads. So a sum that is read wrong by dS_l moves

    ds / s = sum r_l dS_l,      under two loads  r = (+1, -1) / (S_2 - S_1),

where alpha drifts by g an hour, dS_l = -g h_l S_l, with h_l the mean hour of the cycles under a
load: under two loads g times what is held, over what the loads differ by, times the hours between
them. Zeros of the readings add n alpha z, once by the hour and once for each mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.acquisition.mountings import Mounting, cycle_time, mountings
from truenewton.acquisition.plan import MOST_CYCLES, MOST_TURNS, CampaignPlan
from truenewton.acquisition.shapes import expected_alpha
from truenewton.arrays import Array
from truenewton.mirrors.known import Mirror
from truenewton.statics.arms import effective_weight

HOUR = 3600.0
SAME = 1e-12  # relative difference of weights that is rounding
ROUNDING = 1e-9  # of the errors of weights, which is left to readings
PAYS = 0.99  # of the error without: so much less must be left for someone to mount a load again


@dataclass(frozen=True, eq=False)
class ScaleBalance:
    """How the common scale follows from the sums of the forces at rest under L loads.

    Attributes
    ----------
    held
        (L,) S, true [N].
    response
        (L,) r, relative change of the scale for each Newton by which a sum is read wrong.
    covariance
        (L, L) of what weights and readings leave unknown of S + W [N^2].
    zero
        Change of a sum for a common change of all zeros of the readings [N / N].
    """

    held: Array
    response: Array
    covariance: Array
    zero: float

    @property
    def error(self) -> float:
        """Relative error of the scale, from weights and readings."""
        return float(np.sqrt(self.response @ self.covariance @ self.response))


def scale_balance(plan: CampaignPlan, mirror: Mirror, shapes: int) -> ScaleBalance | None:
    """Return how the scale follows from so many shapes; None where the loads leave it free."""
    nz = mirror.layout.nz[mirror.layout.enabled]
    added = np.array([load.added for load in plan.loads])
    tilt = np.array([load.tilt for load in plan.loads])
    held = -(effective_weight(mirror.weight, added, tilt) + mirror.bias_force * nz.sum())
    if np.ptp(held) <= SAME * np.abs(held).max():
        return None
    alpha = expected_alpha(mirror)
    noise = alpha * plan.force_noise * np.linalg.norm(nz) / np.sqrt(2 * shapes * plan.cycles)
    errors = _weight_changes(plan, mirror)
    covariance = errors @ errors.T
    # Of readings far better than the weights no less than rounding leaves, or it has no inverse.
    covariance += max(noise**2, ROUNDING * np.trace(covariance)) * np.eye(len(held))
    design = np.column_stack([held, np.ones_like(held)])
    inverse = np.linalg.inv(covariance)
    response = -np.linalg.solve(design.T @ inverse @ design, design.T @ inverse)[0]
    return ScaleBalance(held, response, covariance, alpha * float(nz.sum()))


def _weight_changes(plan: CampaignPlan, mirror: Mirror) -> Array:
    """Return (L, errors) changes of W by one standard uncertainty of each error [N]."""
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
    return np.column_stack(columns)


@dataclass(frozen=True)
class OrderCost:
    """What an order of the loads costs: time, and errors of the common scale, relative.

    Attributes
    ----------
    turns
        Of the plan.
    order
        Loads and numbers of their cycles, in words.
    changes
        How often the load is changed.
    duration
        [s]
    known
        Error from weights and readings, whatever the order.
    gain, zero
        By how much the assumed drift of alpha and of the zeros moves the scale, in terms of alpha
        in the middle of the campaign; with sign.
    remounting
        Standard error from zeros that move at each mounting.
    """

    turns: int
    order: str
    changes: int
    duration: float
    known: float
    gain: float
    zero: float
    remounting: float

    @property
    def drift(self) -> float:
        """Size of all that drift and mounting do."""
        return float(np.linalg.norm([self.gain, self.zero, self.remounting]))

    @property
    def error(self) -> float:
        """Of the scale, drift and mounting included."""
        return float(np.hypot(self.known, self.drift))


def order_cost(plan: CampaignPlan, mirror: Mirror, shapes: int) -> OrderCost | None:
    """Return what the order of a plan costs; None where the loads leave the scale free."""
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
    """Return (L,) variances of S, from zeros that each mounting moves anew [N^2]."""
    of_load, share = _shares(plan, mountings(plan))
    one = (plan.drift.remounting * balance.zero) ** 2
    return np.asarray(one * np.bincount(of_load, weights=share**2))


def _shares(plan: CampaignPlan, order: Sequence[Mounting]) -> tuple[NDArray[np.int64], Array]:
    """Return for each mounting the index of its load, and its share of the cycles."""
    keys = [load.key for load in plan.loads]
    of_load = np.array([keys.index(each.load.key) for each in order])
    return of_load, np.array([len(each.cycles) for each in order]) / plan.cycles


def order_costs(plan: CampaignPlan, mirror: Mirror, shapes: int) -> tuple[OrderCost, ...]:
    """Return what each number of turns costs, one first; none where the scale is free."""
    turns = range(1, min(MOST_TURNS, plan.cycles) + 1) if len(plan.loads) > 1 else range(1, 2)
    costs = (order_cost(replace(plan, turns=one), mirror, shapes) for one in turns)
    return tuple(cost for cost in costs if cost is not None)


def without_remounting(plan: CampaignPlan, mirror: Mirror, shapes: int, cost: OrderCost) -> float:
    """Return the error of one load after the other, the time of more mountings put into cycles."""
    spare = (cost.changes - (len(plan.loads) - 1)) * plan.pause
    more = spare / (len(plan.loads) * cycle_time(plan, shapes))
    cycles = {plan.cycles, plan.cycles + int(min(more, MOST_CYCLES - plan.cycles))}
    single = replace(plan, turns=1)
    costs = (order_cost(replace(single, cycles=each), mirror, shapes) for each in cycles)
    return min(cost.error for cost in costs if cost is not None)


def turns_that_pay(plan: CampaignPlan, mirror: Mirror, shapes: int) -> int:
    """Return the turns of a plan that leaves them open: as many as can be, or one.

    Loads are mounted again where that leaves the scale better known than the same time in cycles
    of one load after the other would.
    """
    costs = order_costs(plan, mirror, shapes)
    if not costs:
        return 1
    most = costs[-1]
    pays = most.error < PAYS * without_remounting(plan, mirror, shapes, most)
    return most.turns if pays else 1


def with_turns(plan: CampaignPlan, mirror: Mirror, shapes: int) -> CampaignPlan:
    """Return a plan whose turns are known, of so many shapes."""
    return plan if plan.turns else replace(plan, turns=turns_that_pay(plan, mirror, shapes))
