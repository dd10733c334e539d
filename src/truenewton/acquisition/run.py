"""Taking what is missing of a campaign: load by load, cycle by cycle, shape by shape."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from truenewton.acquisition.clock import SteadyClock
from truenewton.acquisition.folder import Finished, finished, static_force
from truenewton.acquisition.journal import Journal, journal_path
from truenewton.acquisition.limits import shape_name
from truenewton.acquisition.load_check import judge, sum_at_rest, sum_error
from truenewton.acquisition.plan import CampaignPlan
from truenewton.acquisition.progress import Progress
from truenewton.acquisition.taker import Taker, force_noise, shape_fields
from truenewton.arrays import Array
from truenewton.bench.protocol import Graded, Operator, OwnTime, Shape
from truenewton.errors import BenchFault, Interrupted
from truenewton.files.outputs import to_disk
from truenewton.mirrors.known import Mirror
from truenewton.records.file import cycle_name, write_cycle
from truenewton.statics.load import Load

IN_A_ROW = 5  # so many shapes that are not valid, one after another, end a run
ASKED = 3  # times for a load that is not on


@dataclass
class Count:
    """What a run counts.

    Attributes
    ----------
    done
        Shapes of the whole campaign, each sign counted.
    taken, seconds
        Shapes of this run, and what they took [s]; changing loads is not counted.
    invalid, in_a_row
        Shapes of this run that are not valid, and how many of the last ones.
    """

    done: int
    taken: int = 0
    seconds: float = 0.0
    invalid: int = 0
    in_a_row: int = 0

    def add(self, valid: bool, seconds: float) -> None:
        """Count one shape."""
        self.done, self.taken, self.seconds = self.done + 1, self.taken + 1, self.seconds + seconds
        self.invalid += not valid
        self.in_a_row = 0 if valid else self.in_a_row + 1


@dataclass
class Written:
    """What has been written down of a campaign.

    Attributes
    ----------
    cycles
        Those that are complete, by load and number.
    rest_sums
        Sums of the forces at rest under the loads that were on [N], by key.
    clock
        Goes on after the last instant.
    """

    cycles: dict[tuple[str, int], Finished]
    rest_sums: dict[str, float] = field(init=False)
    clock: SteadyClock = field(init=False)

    def __post_init__(self) -> None:
        self.rest_sums = {key: each.total for (key, _), each in self.cycles.items()}
        self.wind_clock()

    def wind_clock(self, *later: int) -> None:
        """Set the clock after the cycles and other instants [us since 1970, UTC]."""
        self.clock = SteadyClock(
            max((*(each.end for each in self.cycles.values()), *later), default=None)
        )


@dataclass(frozen=True, eq=False)
class Run:
    """What a run has at hand: shapes (shapes, n) [m], and whom and what it deals with."""

    plan: CampaignPlan
    mirror: Mirror
    shapes: Array
    folder: Path
    operator: Operator
    taker: Taker
    count: Count
    written: Written


def take_all(run: Run) -> None:
    """Take whatever is missing, in the order of the plan."""
    for load in run.plan.loads:
        numbers = range(1, run.plan.cycles + 1)
        missing = [number for number in numbers if (load.key, number) not in run.written.cycles]
        if missing:
            rest_force = _put_on(run, load, missing[0])
            for number in missing:
                _take_cycle(run, load, number, rest_force)


def _put_on(run: Run, load: Load, number: int) -> Array:
    """Have a load put on, until the forces say that it is; return those at rest, (n,) [N]."""
    run.taker.rest()
    sums, layout, samples = run.written.rest_sums, run.taker.bench.layout, run.plan.samples
    if load.key not in sums:
        sums |= _sum_under_way(run, load, number)
    rest = Shape(load, number, 0, 1, np.zeros(layout.n))
    why = ""
    for _ in range(ASKED):
        with run.taker.interruption.at_once():
            run.operator.put_on(load)
        taken = run.taker.take(rest)
        if taken.reading is None or taken.fault:
            raise BenchFault(f"no sound reading at rest: {taken.fault}", remedy="see to it")
        total = sum_at_rest(layout, taken.reading.force)
        error = sum_error(layout, taken.reading, samples)
        verdict = judge(run.mirror.weight, run.plan.loads, load, sums, total, error)
        why = verdict.why
        run.taker.log.note("load", load=load.name, on=verdict.on, total=total, why=why)
        if verdict.on is not False:
            run.taker.onlooker.say(f"'{load.name}' is on: {why}")
            sums[load.key] = total
            run.taker.guard.check_room(run.plan, run.mirror, load, taken.reading.force)
            return taken.reading.force
        run.taker.onlooker.say(f"'{load.name}' is not on: {why}")
    raise BenchFault(f"'{load.name}' is not on: {why}", remedy="put it on as the plan says")


def _sum_under_way(run: Run, load: Load, number: int) -> dict[str, float]:
    """Return the sum of the forces at rest by the shapes of the cycle under way, if there are."""
    layout = run.taker.bench.layout
    if not journal_path(run.folder, load, number).exists():
        return {}
    with closing(Journal(run.folder, load, number, layout.n)) as journal:
        rows = journal.rows()
    if journal.count < 2:
        return {}
    return {load.key: sum_at_rest(layout, static_force(rows["force"], rows["sign"], rows["valid"]))}


def _take_cycle(run: Run, load: Load, number: int, rest_force: Array) -> None:
    """Take what is missing of a cycle, and write its file."""
    count, layout = len(run.shapes), run.taker.bench.layout
    shape, sign = np.repeat(np.arange(1, count + 1), 2), np.tile([1, -1], count)
    with closing(Journal(run.folder, load, number, layout.n)) as journal:
        journal.check_order(shape, sign)
        if journal.count or journal.dropped:
            run.taker.log.note(
                "resume", load=load.name, cycle=number, kept=journal.count, cut=journal.dropped
            )
            run.count.done += journal.count
            run.written.wind_clock(*journal.rows()["instant"][-1:].tolist())
        twin: Array | None = None
        if journal.count % 2:  # as its + twin the last one on record counts, which was valid
            twin = np.array(journal.rows()["force"][-1])
        for row in range(journal.count, 2 * count):
            k, s = int(shape[row]), int(sign[row])
            # The mirror answers in proportion: what + takes beyond rest, - takes short of it.
            forecast = None if twin is None or s > 0 else 2 * rest_force - twin
            wanted = Shape(load, number, k, s, s * run.shapes[k - 1])
            twin = _take_shape(run, journal, wanted, forecast)
        _write(run, journal, load, number)
    journal.remove()


def _take_shape(run: Run, journal: Journal, shape: Shape, forecast: Array | None) -> Array | None:
    """Take one shape into the journal; return its forces [N] where they are valid."""
    try:
        run.taker.interruption.check()
        start = time.monotonic()
        taken = run.taker.take(shape, forecast)
    except Interrupted:
        raise Interrupted(f"stopped as asked, before {shape_name(shape)}") from None
    reading, valid, clock = taken.reading, not taken.fault, run.written.clock
    instant = clock.instant(reading.time if reading is not None and valid else None)
    if clock.leap:
        run.taker.log.note("clock", **shape_fields(shape), leap=clock.leap)
    if clock.leap and not isinstance(run.taker.bench, OwnTime):  # a simulated day begins anew
        run.taker.onlooker.say(
            f"the clock of the bench leapt by {clock.leap:.3g} s; TIME counts on steadily"
        )
    noise = force_noise(run.taker.bench.layout, reading, run.plan.samples)
    journal.append(instant, shape, valid, reading, noise)
    run.count.add(valid, time.monotonic() - start)
    _show(run, shape)
    if run.count.in_a_row == IN_A_ROW:
        raise BenchFault(
            f"{IN_A_ROW} shapes in a row gave no sound reading, the last {shape_name(shape)}:"
            f" {taken.fault}",
            remedy="see to the bench",
        )
    return reading.force if reading is not None and valid else None


def _show(run: Run, shape: Shape) -> None:
    plan, count, shapes = run.plan, run.count, len(run.shapes)
    total = len(plan.loads) * plan.cycles * 2 * shapes
    run.taker.onlooker.progress(
        Progress(
            shape=shape,
            cycles=plan.cycles,
            shapes=shapes,
            done=count.done,
            total=total,
            invalid=count.invalid,
            largest_force=run.taker.largest_force,
            smallest_gap=run.taker.smallest_gap,
            seconds_left=count.seconds / count.taken * (total - count.done),
        )
    )


def _write(run: Run, journal: Journal, load: Load, number: int) -> None:
    """Write the file of a cycle; when this returns it is on the disk, complete."""
    gradients = run.taker.bench.gradients if isinstance(run.taker.bench, Graded) else (None, None)
    cycle = journal.cycle(run.mirror, run.taker.bench.layout, run.taker.bench.gap, gradients)
    path = run.folder / cycle_name(load, number)
    write_cycle(cycle, path)
    to_disk(run.folder)
    run.written.cycles[load.key, number] = finished(cycle)
    run.taker.log.note("cycle", file=path.name, invalid=int((~cycle.valid).sum()))
