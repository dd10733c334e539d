"""A plan run on a bench: checked, locked, resumed, and the mirror at rest whatever happens."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np

from truenewton.acquisition.folder import (
    Finished,
    begin_or_resume,
    cycle_names,
    cycle_of,
    finished_cycles,
    locked,
)
from truenewton.acquisition.load_order import mounting_words, mountings
from truenewton.acquisition.plan import CampaignPlan, planned_mirror
from truenewton.acquisition.taker import (
    Guard,
    Interruption,
    Onlooker,
    Row,
    RunLog,
    SilentOnlooker,
    Taker,
    judge,
    shape_name,
    sum_at_rest,
    sum_error,
)
from truenewton.arrays import Array
from truenewton.bench.choice import BENCH_KINDS, Order
from truenewton.bench.protocol import Bench, Operator, OwnTime, Shape, faults_of, gradients_of
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

SEGMENT = "{segment}"  # in an address: its number, since each has its own control unit
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

    The mirror is always brought to rest at the end. After a stop, the same call takes the cycles
    that are missing.

    Parameters
    ----------
    bench
        Hardware or a simulation.
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
    with faults_of(f"{type(bench).__name__} with its instrument, layout, gap or gradients"):
        mirror, layout = _agreed(bench, plan, beside)
    operator = operator or bench  # type: ignore[assignment]
    if not isinstance(operator, Operator):
        raise BenchFault("no operator puts the loads on", remedy="give an operator")
    with Interruption() as interruption, locked(folder) as folder:
        shapes = begin_or_resume(folder, plan, mirror, beside)
        Guard(plan.limits, mirror.layout, bench.gap).check_shapes(shapes)
        complete = finished_cycles(folder, plan, mirror, layout, 2 * len(shapes))
        files = tuple(folder / name for name in cycle_names(plan))
        if len(complete) == len(files):
            return files
        with closing(RunLog(folder)) as log:
            run = Run(
                bench, plan, log, onlooker or SilentOnlooker(), interruption,
                mirror, layout, shapes, folder, operator, complete,
            )  # fmt: skip
            with run.noted():
                run.take_all()
        return files


def _agreed(
    bench: Bench, plan: CampaignPlan, beside: str | os.PathLike[str]
) -> tuple[Mirror, Layout]:
    """Return the mirror of a plan and its layout as recorded; refuse a bench of another mirror.

    The bench of a segment may place its actuators as the segment does, or as the whole mirror.
    """
    mirror, recorded = planned_mirror(plan, beside)
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


def chosen_bench(plan: CampaignPlan, beside: str | os.PathLike[str] = ".") -> Bench:
    """Return the bench of a plan; files that the plan names are relative to ``beside``.

    The truth of a simulated one depends on seed and segment only.
    """
    choice, mirror = plan.bench, planned_mirror(plan, beside)[0]
    if plan.segment:
        address = choice.address.replace(SEGMENT, str(plan.segment))
        choice = replace(choice, address=address, seed=seed_of(choice.seed, plan.segment))
    return BENCH_KINDS[choice.kind][0](Order(choice, mirror, plan.loads, beside))


@dataclass(eq=False)
class Run(Taker):
    """A run of a plan: takes what is missing of a campaign into its folder."""

    mirror: Mirror
    layout: Layout  # the actuators as files name and place them
    shapes: Array  # (shapes, n) [m]
    folder: Path
    operator: Operator
    complete: dict[tuple[str, int], Finished]  # by loads and numbers of cycles
    rest_sums: dict[str, float] = field(default_factory=dict)  # under loads that were on [N]

    def __post_init__(self) -> None:
        super().__post_init__()
        self._planned = list(product(range(1, len(self.shapes) + 1), (1, -1)))
        every, done = len(self.plan.loads) * self.plan.cycles, len(self.complete)
        rows = len(self._planned)
        self.progress = replace(self.progress, shapes=len(self.shapes), done=rows * done,
                                total=rows * every)  # fmt: skip
        for (key, _), cycle in self.complete.items():
            if cycle.total is not None:
                self.rest_sums[key] = cycle.total
        if self.complete:
            end = max(cycle.end for cycle in self.complete.values())
            start = min(cycle.start for cycle in self.complete.values())
            if isinstance(self.bench, OwnTime):  # it begins again with each run
                self.bench.wait((end - start).total_seconds() + self.plan.pause)
            else:
                self._last = end

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Bring the mirror to rest whatever happens, and add to an error how to continue."""
        log, bench, choice = self.log, self.bench, self.plan.bench
        log.note(
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
            complete=len(self.complete),
        )
        try:
            yield
            self.rest()
        except BaseException as error:
            with suppress(OutputFailed):  # a full disk must not keep the mirror from its rest
                log.note("stop", error=type(error).__name__, why=str(error))
            try:
                with faults_of(f"{self._name}.rest"):
                    bench.rest()
            except BenchFault as fault:
                with suppress(OutputFailed):
                    log.note("not at rest", fault=fault.fault)
                why = error.fault if isinstance(error, TrueNewtonError) else error
                raise BenchFault(
                    f"the mirror may not be at rest ({fault.fault}), after: {why}",
                    remedy="check the bench; the same command takes the cycles that are missing",
                    path=self.folder,
                ) from error
            with suppress(OutputFailed):
                log.note("rest")
            if isinstance(error, TrueNewtonError):
                then = "the mirror is at rest, complete cycles are kept; the same command takes the"
                then += " others"
                then += ", once that is corrected" if isinstance(error, LimitExceeded) else ""
                remedy = f"{error.remedy}; {then}" if error.remedy else then
                raise located(error, self.folder).changed(remedy=remedy) from error
            raise
        log.note("complete", invalid=self.progress.invalid)

    def take_all(self) -> None:
        """Take all cycles that are missing, in the order of the plan."""
        order = mountings(self.plan)
        for index, (load, cycles) in enumerate((each.load, each.cycles) for each in order):
            if missing := [each for each in cycles if (load.key, each) not in self.complete]:
                if self.plan.turns > 1:
                    self.onlooker.say(mounting_words(order, index))
                self._put_on(load, missing[0])
                for number in missing:
                    self._take_cycle(load, number)

    def _put_on(self, load: Load, number: int, *, again: bool = False) -> None:
        """Have a load put on until the forces at rest show that it is.

        With ``again``, a person is asked only if the forces do not show that the load is still on.
        """
        self.rest()
        bench: object = self.bench
        sums, layout, message = self.rest_sums, self.bench.layout, ""
        rest = Shape(load, number, 0, 1, np.zeros(layout.n))
        ask = not again or self.operator is bench
        for _ in range(MAX_REQUESTS):
            if ask:
                who = type(self.operator).__name__
                with faults_of(f"{who}.put_on"), self.interruption.at_once():
                    self.operator.put_on(load)
            reading, fault = self.take(rest)
            if reading is None or fault:
                raise BenchFault(f"no valid reading at rest: {fault}", remedy="check the bench")
            total = sum_at_rest(layout, reading.force)
            error = sum_error(layout, reading, self.plan.samples)
            on, why = judge(self.mirror.weight, self.plan.loads, load, sums, total, error)
            self.log.note("load", load=load.name, on=on, total=total, why=why)
            message = f"'{load.name}' is {'not ' if on is False else ''}on: {why}"
            self.onlooker.say(message)
            if on or (ask and on is None):
                sums[load.key] = total
                self.guard.check_room(self.plan, self.mirror, load, reading.force)
                return
            ask = True
        raise BenchFault(
            message,
            remedy="put it on as the plan specifies; if it is on, check that Force is the whole"
            " commanded force, positive along +z (docs/hardware.md)",
        )

    def _take_cycle(self, load: Load, number: int) -> None:
        """Take the shapes of a cycle, and write its file in one step."""
        rows = [
            self._take_shape(Shape(load, number, shape, sign, sign * self.shapes[shape - 1]))
            for shape, sign in self._planned
        ]
        cycle = cycle_of(rows, self.mirror, self.layout, self.bench)
        path = self.folder / cycle_name(load, number)
        write_cycle(cycle, path)
        to_disk(self.folder)  # from here on the cycle is safe
        self.log.note("cycle", file=path.name, invalid=int((~cycle.valid).sum()))

    def _take_shape(self, shape: Shape) -> Row:
        """Take one shape."""

        def put_on_again(why: str) -> None:  # as after its electronics were restarted
            self.log.note("load again", shape, why=why)
            self.onlooker.say(
                f"the bench refuses a shape ({why}): it may have lost its load; '{shape.load.name}'"
                " is put on again"
            )
            self._put_on(shape.load, shape.cycle, again=True)

        try:
            self.interruption.check()
            reading, fault = self.take(shape, put_on_again)
        except Interrupted:
            raise Interrupted(f"stopped as asked, before {shape_name(shape)}") from None
        now = self.progress
        in_a_row = now.invalid_in_a_row + 1 if fault else 0
        self.progress = replace(now, shape=shape, done=now.done + 1,
                                invalid=now.invalid + bool(fault),
                                invalid_in_a_row=in_a_row)  # fmt: skip
        self.onlooker.progress(self.progress)
        at_end = (shape.number, shape.sign) == self._planned[-1]
        if in_a_row == MAX_INVALID_IN_A_ROW or (at_end and in_a_row >= MAX_INVALID_AT_END):
            raise BenchFault(
                f"{in_a_row} shapes in a row gave no valid reading, the last {shape_name(shape)}:"
                f" {fault}",
                remedy="check the bench",
            )
        return Row(shape, reading, not fault)
