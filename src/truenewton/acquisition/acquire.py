"""A plan run on a bench: checked, locked, resumed, and the mirror at rest whatever happens."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import closing, contextmanager
from importlib.metadata import version
from pathlib import Path

import numpy as np

from truenewton.acquisition.clock import SteadyClock
from truenewton.acquisition.folder import (
    PLAN,
    begin_or_resume,
    cycle_names,
    finished_cycles,
    locked,
)
from truenewton.acquisition.interruption import Interruption
from truenewton.acquisition.limits import Guard
from truenewton.acquisition.plan import CampaignPlan, planned_mirror, recorded_layout
from truenewton.acquisition.progress import Nobody, Onlooker, Progress
from truenewton.acquisition.run import Run, take_all
from truenewton.acquisition.run_log import RunLog
from truenewton.acquisition.taker import Taker
from truenewton.bench.protocol import Bench, Operator, Shape, gradients_of
from truenewton.errors import (
    BenchFault,
    CampaignMismatch,
    LimitExceeded,
    TrueNewtonError,
    located,
)
from truenewton.mirrors.known import Mirror
from truenewton.statics.layout import Layout


def acquire(
    bench: Bench,
    plan: CampaignPlan,
    folder: str | os.PathLike[str],
    *,
    beside: str | os.PathLike[str] = ".",
    operator: Operator | None = None,
    onlooker: Onlooker | None = None,
) -> tuple[Path, ...]:
    """Run a plan on a bench, or go on with it, into a folder of cycle files (docs/acquisition.md).

    Whatever ends it, the mirror is brought to rest, and what was taken is kept: the same call goes
    on where it stopped, and at most the shape under way is taken again.

    Parameters
    ----------
    bench
        Hardware, a server or a simulation.
    plan
        What to take. Its copy in the folder decides when the campaign is resumed.
    folder
        For the cycle files; made where it is not there.
    beside
        The folder relative to which files that the plan names stand.
    operator, onlooker
        Who puts the loads on, the bench if it can; who is told how it goes, nobody unless told.

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
        The bench is gone, gives no sound readings, or a load is not on.
    Interrupted
        Someone stopped it (Ctrl-C; a second one raises KeyboardInterrupt at once).
    OutputExists, OutputFailed, UnreadableFile, FormatError
        The folder cannot be used.

    Examples
    --------
    >>> plan = tn.CampaignPlan("p45", (tn.Load("bare"),), 1, shapes=tn.PlannedShapes(count=8))
    >>> [file.name for file in tn.acquire(tn.SimulatedBench(tn.mirrors.p45()), plan, "one-cycle")]
    ['bare-001.fits']
    """
    mirror, layout = _agreed(bench, plan, beside)
    operator = operator or _operator_of(bench)
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
                taker=Taker(bench, plan, log, onlooker or Nobody(), interruption, progress),
                complete=complete,
                rest_sums={
                    key: each.total for (key, _), each in complete.items() if each.total is not None
                },
                clock=SteadyClock(max((each.end for each in complete.values()), default=None)),
            )
            _note_start(run)
            with _at_rest_in_the_end(run):
                take_all(run)
        return files


def _operator_of(bench: Bench) -> Operator:
    if not isinstance(bench, Operator):
        raise BenchFault("nobody puts the loads on", remedy="give an operator")
    return bench


def _agreed(
    bench: Bench, plan: CampaignPlan, beside: str | os.PathLike[str]
) -> tuple[Mirror, Layout]:
    """Return the mirror of a plan and its actuators as recorded; refuse a bench of another.

    A segment's may name and place its actuators as the segment does, or as the whole mirror.
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


def _progress(bench: Bench, plan: CampaignPlan, shapes: int, complete: int) -> Progress:
    """Return how far a campaign of so many shapes is, with so many cycles complete."""
    return Progress(
        shape=Shape(plan.loads[0], 1, 0, 1, np.zeros(bench.layout.n)),
        cycles=plan.cycles,
        shapes=shapes,
        done=2 * shapes * complete,
        total=2 * shapes * plan.cycles * len(plan.loads),
        smallest_gap=bench.gap,
    )


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
        plan=hashlib.sha256((run.folder / PLAN).read_bytes()).hexdigest(),
        shapes=hashlib.sha256(run.shapes.tobytes()).hexdigest(),
        complete=len(run.complete),
    )


@contextmanager
def _at_rest_in_the_end(run: Run) -> Iterator[None]:
    """Bring the mirror to rest whatever happens, and say how to go on."""
    log = run.taker.log
    try:
        yield
        run.taker.rest()
    except BaseException as error:
        log.last_words("stop", error=type(error).__name__, why=str(error))
        try:
            run.taker.bench.rest()
        except BenchFault as fault:
            log.last_words("not at rest", fault=fault.fault)
            why = error.fault if isinstance(error, TrueNewtonError) else error
            raise BenchFault(
                f"the mirror may not be at rest ({fault.fault}), after: {why}",
                remedy="see to the bench; the same command goes on with the campaign",
                path=run.folder,
            ) from error
        log.last_words("rest")
        if isinstance(error, TrueNewtonError):
            then = "the mirror is at rest, what was taken is kept; the same command goes on"
            then += ", once that is mended" if isinstance(error, LimitExceeded) else ""
            remedy = f"{error.remedy}; {then}" if error.remedy else then
            raise located(error, run.folder).changed(remedy=remedy) from error
        raise
    log.note("complete", invalid=run.taker.progress.invalid)
