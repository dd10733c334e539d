"""The order of the loads: which is mounted when, and for which cycles.

With one turn all cycles of a load are taken before the next is put on. With more turns, the loads
are taken back and forth, each time with a part of the cycles:

    turns   parts of the cycles     bare and ring, 4 cycles         times at which, in changes
    1       1                       bare 4, ring 4                  0, 1
    2       1 : 1                   bare 2, ring 4, bare 2          0, 1, 2
    3       1 : 2 : 1               bare 1, ring 3, bare 3, ring 1  0, 1, 2, 3

The parts are binomial coefficients, so that the difference of the means of two loads is a finite
difference of the order of the turns: two turns cancel linear drift, three quadratic drift
(docs/campaign.md).
"""

from __future__ import annotations

from dataclasses import dataclass

from truenewton.acquisition.plan import CampaignPlan
from truenewton.bench.simulated.loop import Control
from truenewton.statics.load import Load


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
    """Return the order of a plan, with times for so many shapes."""
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
