"""Taking what is missing of a campaign: mounting by mounting, cycle by cycle, shape by shape."""

from __future__ import annotations

import time
from collections.abc import Collection
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from truenewton.acquisition.clock import SteadyClock
from truenewton.acquisition.journal import Journal, journal_path, remove_journal
from truenewton.acquisition.limits import shape_name
from truenewton.acquisition.load_check import judge, mean_sum, sum_at_rest, sum_error
from truenewton.acquisition.mountings import mounting_words, mountings
from truenewton.acquisition.plan import CampaignPlan
from truenewton.acquisition.taker import Taker, force_noise, shape_fields
from truenewton.arrays import Array
from truenewton.bench.protocol import Operator, Shape
from truenewton.errors import BenchFault, Interrupted
from truenewton.files.outputs import to_disk
from truenewton.mirrors.known import Mirror
from truenewton.records.file import cycle_name, write_cycle
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

IN_A_ROW = 5  # so many shapes that are not valid, one after another, end a run
AT_THE_END = 3  # so many at the end of a cycle do: of more than one shape, both signs
ASKED = 3  # times for a load that is not on


@dataclass(frozen=True, eq=False)
class Run:
    """What a run has at hand.

    Attributes
    ----------
    plan, mirror, shapes, folder, operator, taker
        What is to be taken, (shapes, n) [m], where to, and by whom.
    layout
        The actuators as files name and place them.
    complete
        Loads and numbers of the cycles that need not be taken.
    rest_sums
        Sums of the forces at rest under the loads that were on [N], by key.
    clock
        Goes on after the last instant.
    """

    plan: CampaignPlan
    mirror: Mirror
    layout: Layout
    shapes: Array
    folder: Path
    operator: Operator
    taker: Taker
    complete: Collection[tuple[str, int]]
    rest_sums: dict[str, float]
    clock: SteadyClock


def take_all(run: Run) -> None:
    """Take whatever is missing, in the order of the plan."""
    order = mountings(run.plan)
    for index, mounting in enumerate(order):
        load = mounting.load
        missing = [number for number in mounting.cycles if (load.key, number) not in run.complete]
        if missing:
            if run.plan.turns > 1:
                run.taker.onlooker.say(mounting_words(order, index))
            rest_force = _put_on(run, load, missing[0])
            for number in missing:
                _take_cycle(run, load, number, rest_force)


def _put_on(run: Run, load: Load, number: int, *, anew: bool = False) -> Array:
    """Have a load put on, until the forces say that it is; return those at rest, (n,) [N].

    Anew, where a bench may have forgotten it: it is told again, but a person is asked only where
    the forces do not say that the load is still on.
    """
    run.taker.rest()
    bench: object = run.taker.bench
    sums, layout, said = run.rest_sums, run.taker.bench.layout, ""
    if load.key not in sums and journal_path(run.folder, load, number).exists():
        with closing(Journal(run.folder, load, number, layout.n)) as journal:
            rows = journal.rows()
        columns = (rows[name] for name in ("force", "shape", "sign", "valid"))
        if (before := mean_sum(layout, *columns)) is not None:
            sums[load.key] = before
    rest = Shape(load, number, 0, 1, np.zeros(layout.n))
    ask = not anew or run.operator is bench
    for _ in range(ASKED):
        if ask:
            with run.taker.interruption.at_once():
                run.operator.put_on(load)
        reading, fault = run.taker.take(rest)
        if reading is None or fault:
            raise BenchFault(f"no sound reading at rest: {fault}", remedy="see to the bench")
        total = sum_at_rest(layout, reading.force)
        error = sum_error(layout, reading, run.plan.samples)
        on, why = judge(run.mirror.weight, run.plan.loads, load, sums, total, error)
        run.taker.log.note("load", load=load.name, on=on, total=total, why=why)
        said = f"'{load.name}' is {'not ' if on is False else ''}on: {why}"
        run.taker.onlooker.say(said)
        if on or (ask and on is None):
            sums[load.key] = total
            run.taker.guard.check_room(run.plan, run.mirror, load, reading.force)
            return reading.force
        ask = True
    raise BenchFault(
        said,
        remedy="put it on as the plan says; if it is on, see that Force is the whole commanded"
        " force, positive along +z (docs/hardware.md)",
    )


def _take_cycle(run: Run, load: Load, number: int, rest_force: Array) -> None:
    """Take what is missing of a cycle, and write its file."""
    planned = list(product(range(1, len(run.shapes) + 1), (1, -1)))
    with closing(Journal(run.folder, load, number, run.taker.bench.layout.n)) as journal:
        journal.check_order(planned)
        if journal.count or journal.dropped:
            run.taker.log.note(
                "resume", load=load.name, cycle=number, kept=journal.count, cut=journal.dropped
            )
        if journal.count:
            done = run.taker.progress.done + journal.count
            run.taker.progress = replace(run.taker.progress, done=done)
            run.clock.go_on_after(int(journal.rows()["instant"][-1]))
        twin: Array | None = None
        if journal.count % 2:  # as its + twin the last one on record counts, which was valid
            twin = np.array(journal.rows()["force"][-1])
        for shape_number, sign in planned[journal.count :]:
            # The mirror answers in proportion: what + takes beyond rest, - takes short of it.
            forecast = None if twin is None or sign > 0 else 2 * rest_force - twin
            position = sign * run.shapes[shape_number - 1]
            wanted = Shape(load, number, shape_number, sign, position)
            twin = _take_shape(run, journal, wanted, forecast)
        _write_file(run, journal)
    remove_journal(run.folder, load, number)


def _write_file(run: Run, journal: Journal) -> None:
    """Write the file of a cycle; its rows are mapped from the journal until this returns."""
    cycle = journal.cycle(run.mirror, run.layout, run.taker.bench)
    path = run.folder / cycle_name(journal.load, journal.number)
    write_cycle(cycle, path)
    to_disk(run.folder)  # from here on the cycle is safe
    run.taker.log.note("cycle", file=path.name, invalid=int((~cycle.valid).sum()))


def _take_shape(run: Run, journal: Journal, shape: Shape, forecast: Array | None) -> Array | None:
    """Take one shape into the journal; return its forces [N] where they are valid."""
    taker = run.taker
    try:
        taker.interruption.check()
        start = time.monotonic()
        reading, fault = taker.take(shape, forecast, lambda why: _put_on_anew(run, shape, why))
    except Interrupted:
        raise Interrupted(f"stopped as asked, before {shape_name(shape)}") from None
    sound = None if fault else reading
    instant = run.clock.instant(sound.time if sound else None)
    noise = force_noise(taker.bench.layout, reading)
    journal.append(instant, shape, not fault, reading, noise)
    taker.progress = taker.progress.with_taken(shape, not fault, time.monotonic() - start)
    taker.onlooker.progress(taker.progress)
    in_a_row, at_end = taker.progress.in_a_row, (shape.number, shape.sign) == (len(run.shapes), -1)
    if in_a_row == IN_A_ROW or (at_end and in_a_row >= AT_THE_END):
        raise BenchFault(
            f"{in_a_row} shapes in a row gave no sound reading, the last {shape_name(shape)}:"
            f" {fault}",
            remedy="see to the bench",
        )
    return sound.force if sound else None


def _put_on_anew(run: Run, shape: Shape, why: str) -> None:
    """Have the load of a shape put on again, as after a server was started anew."""
    load = shape.load
    run.taker.log.note("load again", **shape_fields(shape), why=why)
    run.taker.onlooker.say(
        f"the bench refuses a shape ({why}): it may have lost its load; '{load.name}' is put on"
        " again"
    )
    _put_on(run, load, shape.cycle, anew=True)
