"""Taking what is missing of a campaign: load by load, cycle by cycle, shape by shape."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truenewton.acquisition.clock import SteadyClock
from truenewton.acquisition.folder import Finished, finished, static_force
from truenewton.acquisition.interruption import Interruption
from truenewton.acquisition.journal import Journal, journal_path
from truenewton.acquisition.limits import check_room, said
from truenewton.acquisition.load_check import judge, sum_at_rest, sum_error
from truenewton.acquisition.plan import CampaignPlan
from truenewton.acquisition.progress import Onlooker, Progress
from truenewton.acquisition.run_log import RunLog
from truenewton.acquisition.taker import Taker, described, noise_of
from truenewton.arrays import Array
from truenewton.bench.protocol import Bench, Graded, Operator, OwnTime, Shape
from truenewton.errors import BenchFault, Interrupted
from truenewton.files.outputs import to_disk
from truenewton.mirrors.known import Mirror
from truenewton.records.file import cycle_name, write_cycle
from truenewton.statics.load import Load

IN_A_ROW = 5  # so many shapes that are not valid, one after another, end a run
ASKED = 3  # times for a load that is not on


@dataclass(eq=False)
class Run:
    """All that a run has at hand."""

    bench: Bench
    plan: CampaignPlan
    mirror: Mirror
    shapes: Array
    folder: Path
    operator: Operator
    onlooker: Onlooker
    interruption: Interruption
    log: RunLog
    taker: Taker
    clock: SteadyClock
    complete: dict[tuple[str, int], Finished]
    known: dict[str, float]  # sums of forces at rest under the loads that were on [N]
    done: int
    invalid: int = 0
    in_a_row: int = 0
    taken: int = 0
    busy: float = 0.0  # spent on shapes, not on changing loads [s]

    @property
    def rows(self) -> int:
        """Shapes of a cycle, both signs."""
        return 2 * len(self.shapes)


def take_all(run: Run) -> None:
    """Take whatever is missing, in the order of the plan."""
    for load in run.plan.loads:
        numbers = range(1, run.plan.cycles + 1)
        missing = [number for number in numbers if (load.key, number) not in run.complete]
        if missing:
            rest_force = _put_on(run, load, missing[0])
            for number in missing:
                _take_cycle(run, load, number, rest_force)


def _put_on(run: Run, load: Load, number: int) -> Array:
    """Have a load put on, until the forces say that it is; return those at rest, (n,) [N]."""
    run.taker.rest()
    if load.key not in run.known:
        run.known |= _known_under_way(run, load, number)
    rest = Shape(load, number, 0, 1, np.zeros(run.bench.layout.n))
    why = ""
    for _ in range(ASKED):
        with run.interruption.at_once():
            run.operator.put_on(load)
        taken = run.taker.take(rest)
        if taken.reading is None or taken.fault:
            raise BenchFault(f"no sound reading at rest: {taken.fault}", remedy="see to it")
        layout, samples = run.bench.layout, run.plan.samples
        total = sum_at_rest(layout, taken.reading.force)
        error = sum_error(layout, taken.reading, samples)
        verdict = judge(run.mirror.weight, run.plan.loads, load, run.known, total, error)
        why = verdict.why
        run.log.note("load", load=load.name, on=verdict.on, total=total, why=why)
        if verdict.on is not False:
            run.onlooker.say(f"'{load.name}' is on: {why}")
            run.known[load.key] = total
            check_room(run.plan, run.mirror, load, taken.reading.force)
            return taken.reading.force
        run.onlooker.say(f"'{load.name}' is not on: {why}")
    raise BenchFault(f"'{load.name}' is not on: {why}", remedy="put it on as the plan says")


def _known_under_way(run: Run, load: Load, number: int) -> dict[str, float]:
    """Return the sum of the forces at rest by the shapes of the cycle under way, if there are."""
    layout = run.bench.layout
    if not journal_path(run.folder, load, number).exists():
        return {}
    journal = Journal(run.folder, load, number, layout.n)
    rows = journal.rows()
    journal.close()
    if journal.count < 2:
        return {}
    return {load.key: sum_at_rest(layout, static_force(rows["force"], rows["sign"], rows["valid"]))}


def _take_cycle(run: Run, load: Load, number: int, rest_force: Array) -> None:
    """Take what is missing of a cycle, and write its file."""
    count, layout = len(run.shapes), run.bench.layout
    shape, sign = np.repeat(np.arange(1, count + 1), 2), np.tile([1, -1], count)
    journal = Journal(run.folder, load, number, layout.n)
    try:
        journal.check_order(shape, sign)
        if journal.count or journal.dropped:
            run.log.note(
                "resume", load=load.name, cycle=number, kept=journal.count, cut=journal.dropped
            )
            run.done += journal.count
            run.clock = _clock_after(run, journal)
        twin: Array | None = None
        if journal.count % 2:  # as its + twin the last one on record counts, which was valid
            twin = np.array(journal.rows()["force"][-1])
        for row in range(journal.count, run.rows):
            k, s = int(shape[row]), int(sign[row])
            # The mirror answers in proportion: what + takes beyond rest, - takes short of it.
            forecast = None if twin is None or s > 0 else 2 * rest_force - twin
            wanted = Shape(load, number, k, s, s * run.shapes[k - 1])
            twin = _take_shape(run, journal, wanted, forecast)
        _write(run, journal, load, number)
    finally:
        journal.close()
    journal.remove()


def _clock_after(run: Run, journal: Journal) -> SteadyClock:
    ends = [each.end for each in run.complete.values()]
    ends += [int(instant) for instant in journal.rows()["instant"][-1:]]
    return SteadyClock(max(ends, default=None))


def _take_shape(run: Run, journal: Journal, shape: Shape, forecast: Array | None) -> Array | None:
    """Take one shape into the journal; return its forces [N] where they are valid."""
    try:
        run.interruption.check()
        start = time.monotonic()
        taken = run.taker.take(shape, forecast)
    except Interrupted:
        raise Interrupted(f"stopped as asked, before {said(shape)}") from None
    reading, valid = taken.reading, not taken.fault
    instant = run.clock.instant(reading.time if reading is not None and valid else None)
    if run.clock.leap:
        run.log.note("clock", **described(shape), leap=run.clock.leap)
    if run.clock.leap and not isinstance(run.bench, OwnTime):  # a simulated day begins anew
        run.onlooker.say(
            f"the clock of the bench leapt by {run.clock.leap:.3g} s; TIME counts on steadily"
        )
    noise = noise_of(run.bench.layout, reading, run.plan.samples)
    journal.append(instant, shape, valid, reading, noise)
    run.busy += time.monotonic() - start
    run.done, run.taken = run.done + 1, run.taken + 1
    run.invalid += not valid
    run.in_a_row = 0 if valid else run.in_a_row + 1
    _show(run, shape)
    if run.in_a_row == IN_A_ROW:
        raise BenchFault(
            f"{IN_A_ROW} shapes in a row gave no sound reading, the last {said(shape)}:"
            f" {taken.fault}",
            remedy="see to the bench",
        )
    return reading.force if reading is not None and valid else None


def _show(run: Run, shape: Shape) -> None:
    plan = run.plan
    total = len(plan.loads) * plan.cycles * run.rows
    run.onlooker.progress(
        Progress(
            shape=shape,
            cycles=plan.cycles,
            shapes=len(run.shapes),
            done=run.done,
            total=total,
            invalid=run.invalid,
            largest_force=run.taker.largest_force,
            smallest_gap=run.taker.smallest_gap,
            seconds_left=run.busy / run.taken * (total - run.done),
        )
    )


def _write(run: Run, journal: Journal, load: Load, number: int) -> None:
    """Write the file of a cycle; when this returns it is on the disk, complete."""
    gradients = run.bench.gradients if isinstance(run.bench, Graded) else (None, None)
    cycle = journal.cycle(run.mirror, run.bench.layout, run.bench.gap, gradients)
    path = run.folder / cycle_name(load, number)
    write_cycle(cycle, path)
    to_disk(run.folder)
    run.complete[load.key, number] = finished(cycle)
    run.log.note("cycle", file=path.name, invalid=int((~cycle.valid).sum()))
