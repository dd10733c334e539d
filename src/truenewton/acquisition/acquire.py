"""A plan run on a bench: checked, locked, resumed, and the mirror at rest whatever happens."""

from __future__ import annotations

import os
import platform
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.acquisition.folder import (
    Journal,
    SteadyClock,
    begin_or_resume,
    cycle_names,
    finished_cycles,
    journal_path,
    locked,
    remove_journal,
)
from truenewton.acquisition.load_order import mounting_words, mountings
from truenewton.acquisition.plan import CampaignPlan, planned_mirror, recorded_layout
from truenewton.acquisition.taker import (
    Guard,
    Interruption,
    Onlooker,
    Progress,
    RunLog,
    SilentOnlooker,
    Taker,
    force_noise,
    judge,
    mean_sum,
    shape_name,
    sum_at_rest,
    sum_error,
)
from truenewton.arrays import Array
from truenewton.bench.opcua import connect
from truenewton.bench.opticalib import from_address
from truenewton.bench.protocol import Bench, Operator, Shape, gradients_of
from truenewton.bench.simulated.bench import SimulatedBench
from truenewton.bench.simulated.static import seed_of
from truenewton.errors import (
    BenchFault,
    CampaignMismatch,
    Interrupted,
    LimitExceeded,
    OutputFailed,
    TrueNewtonError,
    located,
)
from truenewton.files.outputs import to_disk
from truenewton.mirrors.known import Mirror
from truenewton.records.file import cycle_name, write_cycle
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

SEGMENT = "{segment}"  # in address and keys: its number, since each has its own control unit
MAX_INVALID_IN_A_ROW = 5  # so many shapes that are not valid, one after another, end a run
MAX_INVALID_AT_END = 3  # the same at the end of a cycle, which would else be complete
MAX_REQUESTS = 3  # times for a load that is not on


def acquire(
    bench: Bench,
    plan: CampaignPlan,
    folder: str | os.PathLike[str],
    *,
    beside: str | os.PathLike[str] = ".",
    operator: Operator | None = None,
    onlooker: Onlooker | None = None,
) -> tuple[Path, ...]:
    """Run or resume a plan on a bench, into a folder of cycle files (docs/campaign.md).

    The mirror is always brought to rest at the end. The same call resumes after a stop, and repeats
    at most one shape.

    Parameters
    ----------
    bench
        Hardware, a server or a simulation.
    plan
        The campaign. If it is resumed, the plan must be equal to the copy in the folder.
    folder
        For the cycle files; made if it does not exist.
    beside
        The folder to which the files that the plan names are relative.
    operator, onlooker
        Mounts the loads, by default the bench; is shown the progress.

    Returns
    -------
    tuple of pathlib.Path
        The cycle files, in the order of the plan.

    Raises
    ------
    CampaignMismatch
        Bench and plan disagree, or the plan was edited since the campaign began.
    LimitExceeded
        A command or a reading beyond a limit of the plan.
    BenchFault
        The bench does not answer, gives invalid readings, or a load is not in place.
    Interrupted
        Ctrl-C; a second one raises KeyboardInterrupt at once.
    OutputExists, OutputFailed, UnreadableFile, FormatError
        The folder cannot be used.

    Examples
    --------
    >>> plan = tn.CampaignPlan("p45", (tn.Load("bare"),), 1, shapes=tn.PlannedShapes(count=8))
    >>> [file.name for file in tn.acquire(tn.SimulatedBench(tn.mirrors.p45()), plan, "one-cycle")]
    ['bare-001.fits']
    """
    mirror, layout = _agreed(bench, plan, beside)
    operator = operator or bench  # type: ignore[assignment]
    if not isinstance(operator, Operator):
        raise BenchFault("no operator puts the loads on", remedy="give an operator")
    with Interruption() as interruption, locked(folder) as folder:
        plan, shapes = begin_or_resume(folder, plan, mirror, beside)
        Guard(plan.limits, mirror.layout, bench.gap).check_shapes(shapes)
        complete = finished_cycles(folder, plan, mirror, layout, 2 * len(shapes))
        files = tuple(folder / name for name in cycle_names(plan))
        if len(complete) == len(files):
            return files
        progress = _progress(bench, plan, len(shapes), len(complete))
        with closing(RunLog(folder)) as log:
            run = Run(
                plan=plan,
                mirror=mirror,
                layout=layout,
                shapes=shapes,
                folder=folder,
                operator=operator,
                taker=Taker(bench, plan, log, onlooker or SilentOnlooker(), interruption, progress),
                complete=complete,
                rest_sums={key: c.total for (key, _), c in complete.items() if c.total is not None},
                clock=SteadyClock(max((each.end for each in complete.values()), default=None)),
            )
            _note_start(run)
            with _at_rest_in_the_end(run):
                take_all(run)
        return files


def _progress(bench: Bench, plan: CampaignPlan, shapes: int, complete: int) -> Progress:
    """Return the progress of a campaign of so many shapes, with so many cycles complete."""
    return Progress(
        shape=Shape(plan.loads[0], 1, 0, 1, np.zeros(bench.layout.n)),
        cycles=plan.cycles,
        shapes=shapes,
        done=2 * shapes * complete,
        total=2 * shapes * plan.cycles * len(plan.loads),
        smallest_gap=bench.gap,
    )


def _agreed(
    bench: Bench, plan: CampaignPlan, beside: str | os.PathLike[str]
) -> tuple[Mirror, Layout]:
    """Return the mirror of a plan and its layout as recorded; refuse a bench of another mirror.

    The bench of a segment may place its actuators as the segment does, or as the whole mirror.
    """
    mirror, recorded = planned_mirror(plan, beside), recorded_layout(plan, beside)
    if bench.layout.n != mirror.layout.n:
        what = f"has {bench.layout.n} actuators, the plan's {mirror.name} {mirror.layout.n}"
    elif bench.instrument != mirror.name:
        what = f"is {bench.instrument}, the plan is for {mirror.name}"
    elif (apart := mirror.layout.difference(bench.layout)) and recorded.difference(bench.layout):
        what = f"has other actuators than {mirror.name}: {apart} (the bench's first)"
    elif not 0 < bench.gap < 1:
        raise BenchFault(f"the bench gives a gap of {bench.gap!r} m", remedy="give its own [m]")
    else:
        gradients_of(bench)  # refused now, not when the first cycle is complete
        return mirror, recorded
    raise CampaignMismatch(f"the bench {what}", remedy="plan for the mirror on the bench")


def _note_start(run: Run) -> None:
    bench, choice = run.taker.bench, run.plan.bench
    run.taker.log.note(
        "start",
        truenewton=version("truenewton"),
        python=platform.python_version(),
        host=platform.node(),
        process=os.getpid(),
        bench=type(bench).__name__,
        kind=choice.kind,
        address=choice.address,
        instrument=bench.instrument,
        actuators=bench.layout.n,
        gap=bench.gap,
        complete=len(run.complete),
    )


@contextmanager
def _at_rest_in_the_end(run: Run) -> Iterator[None]:
    """Bring the mirror to rest whatever happens, and add to an error how to continue."""
    log = run.taker.log
    try:
        yield
        run.taker.rest()
    except BaseException as error:
        with suppress(OutputFailed):  # a full disk must not keep the mirror from its rest
            log.note("stop", error=type(error).__name__, why=str(error))
        try:
            run.taker.bench.rest()
        except BenchFault as fault:
            with suppress(OutputFailed):
                log.note("not at rest", fault=fault.fault)
            why = error.fault if isinstance(error, TrueNewtonError) else error
            raise BenchFault(
                f"the mirror may not be at rest ({fault.fault}), after: {why}",
                remedy="check the bench; the same command goes on with the campaign",
                path=run.folder,
            ) from error
        with suppress(OutputFailed):
            log.note("rest")
        if isinstance(error, TrueNewtonError):
            then = "the mirror is at rest, what was taken is kept; the same command goes on"
            then += ", once that is corrected" if isinstance(error, LimitExceeded) else ""
            remedy = f"{error.remedy}; {then}" if error.remedy else then
            raise located(error, run.folder).changed(remedy=remedy) from error
        raise
    log.note("complete", invalid=run.taker.progress.invalid)


def chosen_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> Bench:
    """Return the bench of a plan; files that the plan names are relative to ``beside``."""
    choice = plan.bench
    if choice.kind == "simulated":
        return simulated_bench(plan, beside)
    mirror = planned_mirror(plan, beside)  # refuses a missing segment before any connection
    if plan.segment:
        given, number = vars(choice).items(), str(plan.segment)
        texts: dict[str, Any] = {k: text.replace(SEGMENT, number) for k, text in given
                                 if isinstance(text, str)}  # fmt: skip
        choice = replace(choice, **texts)
    if choice.kind == "opticalib":
        return from_address(choice.address, mirror, beside)
    return connect(choice, beside)


def simulated_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> SimulatedBench:
    """Return the simulated bench of a plan; its truth depends on seed and segment only."""
    seed = plan.bench.seed
    return SimulatedBench(
        planned_mirror(plan, beside),
        seed_of(seed, plan.segment) if plan.segment else seed,
        loads=plan.loads,
        force_noise=plan.bench.force_noise,
        fidelity=plan.bench.fidelity,
    )


@dataclass(frozen=True, eq=False)
class Run:
    """A run of a plan: what is to be taken, by what, and into which folder."""

    plan: CampaignPlan
    mirror: Mirror
    layout: Layout  # the actuators as files name and place them
    shapes: Array  # (shapes, n) [m]
    folder: Path
    operator: Operator
    taker: Taker
    complete: Collection[tuple[str, int]]  # loads and numbers of cycles that need not be taken
    rest_sums: dict[str, float]  # of the forces at rest under the loads that were on [N], by key
    clock: SteadyClock  # goes on after the last instant of the campaign


def take_all(run: Run) -> None:
    """Take all cycles that are missing, in the order of the plan."""
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


def _put_on(run: Run, load: Load, number: int, *, again: bool = False) -> Array:
    """Have a load put on until the forces show that it is on; return those at rest, (n,) [N].

    With ``again``, a person is asked only if the forces do not show that the load is still on.
    """
    run.taker.rest()
    bench: object = run.taker.bench
    sums, layout, message = run.rest_sums, run.taker.bench.layout, ""
    if load.key not in sums and journal_path(run.folder, load, number).exists():
        with closing(Journal(run.folder, load, number, layout.n)) as journal:
            rows = journal.rows()
        columns = (rows[name] for name in ("force", "shape", "sign", "valid"))
        if (before := mean_sum(layout, *columns)) is not None:
            sums[load.key] = before
    rest = Shape(load, number, 0, 1, np.zeros(layout.n))
    ask = not again or run.operator is bench
    for _ in range(MAX_REQUESTS):
        if ask:
            with run.taker.interruption.at_once():
                run.operator.put_on(load)
        reading, fault = run.taker.take(rest)
        if reading is None or fault:
            raise BenchFault(f"no valid reading at rest: {fault}", remedy="check the bench")
        total = sum_at_rest(layout, reading.force)
        error = sum_error(layout, reading, run.plan.samples)
        on, why = judge(run.mirror.weight, run.plan.loads, load, sums, total, error)
        run.taker.log.note("load", load=load.name, on=on, total=total, why=why)
        message = f"'{load.name}' is {'not ' if on is False else ''}on: {why}"
        run.taker.onlooker.say(message)
        if on or (ask and on is None):
            sums[load.key] = total
            run.taker.guard.check_room(run.plan, run.mirror, load, reading.force)
            return reading.force
        ask = True
    raise BenchFault(
        message,
        remedy="put it on as the plan specifies; if it is on, check that Force is the whole"
        " commanded force, positive along +z (docs/hardware.md)",
    )


def _take_cycle(run: Run, load: Load, number: int, rest_force: Array) -> None:
    """Take the missing shapes of a cycle, and write its file."""
    planned = list(product(range(1, len(run.shapes) + 1), (1, -1)))
    with closing(Journal(run.folder, load, number, run.taker.bench.layout.n)) as journal:
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
        cycle = journal.cycle(run.mirror, run.layout, run.taker.bench)
        path = run.folder / cycle_name(load, number)
        write_cycle(cycle, path)
        to_disk(run.folder)  # from here on the cycle is safe
        run.taker.log.note("cycle", file=path.name, invalid=int((~cycle.valid).sum()))
        del cycle  # its rows are mapped from the journal, which Windows would not remove
    remove_journal(run.folder, load, number)


def _take_shape(run: Run, journal: Journal, shape: Shape, forecast: Array | None) -> Array | None:
    """Take one shape into the journal; return its forces [N] if they are valid."""
    taker = run.taker
    try:
        taker.interruption.check()
        reading, fault = taker.take(shape, forecast, lambda why: _put_on_again(run, shape, why))
    except Interrupted:
        raise Interrupted(f"stopped as asked, before {shape_name(shape)}") from None
    sound = None if fault else reading
    instant = run.clock.instant(sound.time if sound else None)
    journal.append(instant, shape, not fault, reading, force_noise(taker.bench.layout, reading))
    now = taker.progress
    in_a_row = now.invalid_in_a_row + 1 if fault else 0
    taker.progress = replace(
        now,
        shape=shape,
        done=now.done + 1,
        invalid=now.invalid + bool(fault),
        invalid_in_a_row=in_a_row,
    )
    taker.onlooker.progress(taker.progress)
    at_end = (shape.number, shape.sign) == (len(run.shapes), -1)
    if in_a_row == MAX_INVALID_IN_A_ROW or (at_end and in_a_row >= MAX_INVALID_AT_END):
        raise BenchFault(
            f"{in_a_row} shapes in a row gave no valid reading, the last {shape_name(shape)}:"
            f" {fault}",
            remedy="check the bench",
        )
    return sound.force if sound else None


def _put_on_again(run: Run, shape: Shape, why: str) -> None:
    """Have the load of a shape put on again, as after a server was restarted."""
    load = shape.load
    run.taker.log.note("load again", shape, why=why)
    run.taker.onlooker.say(
        f"the bench refuses a shape ({why}): it may have lost its load; '{load.name}' is put on"
        " again"
    )
    _put_on(run, load, shape.cycle, again=True)
