"""Taking one shape: limits before and after, and again if the reading is not sound.

Whether a load is on follows from the forces at rest, sum nz_i alpha_i c_i = -(W + B)
(docs/method.md). Between two loads the sum of nz_i c_i changes by -(W_1 - W_2) over a mean of
alpha. B is unknown and alpha roughly known: two loads show whether about the right weight was put
on or taken off, one load shows nothing.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from truenewton.acquisition.plan import CampaignPlan, MirrorLimits
from truenewton.arrays import Array, jsonable, rms
from truenewton.bench.protocol import Bench, OwnTime, Reading, Shape, faults_of
from truenewton.errors import BenchFault, Interrupted, LimitExceeded
from truenewton.files.outputs import in_one_line
from truenewton.mirrors.known import Mirror
from truenewton.statics.arms import effective_weight
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

SATURATION_SIGMAS = 3.0  # standard deviations beyond the mean, where no sample may saturate
# alpha lies between 0.7 and 1.1 [paper]; a simulated P45 gave 0.96 to 1.38 in 60 draws.
CHANGE_RANGE = (0.6, 1.5)
MAX_CHANGE = 0.4  # of the sum under one load, relative to the smallest step between two loads
MIN_STEP_SIGMAS = 5.0  # standard deviations of a sum, for a step to be recognised


@dataclass(frozen=True, eq=False)
class Guard:
    """Refuses whatever is beyond a limit; every method raises LimitExceeded."""

    limits: MirrorLimits
    layout: Layout
    gap: float  # nominal distance from the reference plate [m]

    def check_shapes(self, shapes: Array) -> None:
        """Refuse (shapes, n) planned displacements [m] with a stroke beyond a limit."""
        worst = np.abs(shapes).max(axis=1).argmax()  # NaN before any number
        self._check_planned_stroke(shapes[worst], f"in planned shape {worst + 1}")

    def check_room(self, plan: CampaignPlan, mirror: Mirror, load: Load, rest_force: Array) -> None:
        """Refuse (n,) forces at rest [N] that leave no room for those of the shapes.

        A shape takes at most the true force of the plan over the lowest alpha.
        """
        force = plan.shapes.force
        largest = self._enabled(np.abs(rest_force)) + force / mirror.alpha_range[0]
        said = f"may take {{:.4g}} N, {force:g} N for the shapes included, beyond its limit of"
        self._refuse(largest, self.limits.force, said, f"at rest under '{load.name}'")

    def check_command(self, shape: Shape) -> None:
        """Refuse a command before it is given."""
        where = f"in {shape_name(shape)}, which was not commanded"
        self._check_planned_stroke(shape.position, where)

    def check_reading(self, shape: Shape, reading: Reading) -> None:
        """Refuse a reading beyond a limit; NaN is not judged here."""
        where, limits = f"in {shape_name(shape)}", self.limits
        force = self._enabled(np.abs(reading.force))
        self._refuse(force, limits.force, "takes {:.4g} N, beyond its limit of", where)
        sampled = force + SATURATION_SIGMAS * self._enabled(np.nan_to_num(reading.force_scatter))
        said = "takes {:.4g} N in single samples, beyond saturation at"
        self._refuse(sampled, limits.saturation, said, where)
        self._check_stroke(self._enabled(reading.position), where)
        low, high = limits.temperature
        if reading.temperature < low or reading.temperature > high:
            raise LimitExceeded(
                f"the mirror has {reading.temperature:g} deg C {where}, and may have {low:g} to"
                f" {high:g}",
                remedy="wait until it has",
            )

    def _enabled(self, values: Array) -> Array:
        return np.where(self.layout.enabled, values, 0.0)

    def _check_planned_stroke(self, position: Array, where: str) -> None:
        """Refuse a stroke, also of disabled actuators, which the glass follows; refuse NaN."""
        if not np.isfinite(position).all():
            raise LimitExceeded(f"a displacement is NaN, {where}", remedy="correct the shape")
        self._check_stroke(position, where)

    def _check_stroke(self, position: Array, where: str) -> None:
        said = "takes {:.4g} m of stroke, beyond its limit of"
        self._refuse(position, self.limits.displacement, said, where)
        # The plate may be on either side.
        said = f"takes {{:.4g}} m of a gap of {self.gap:g} m, beyond its limit of"
        self._refuse(position, self.gap - self.limits.gap, said, where)

    def _refuse(self, values: Array, limit: float, said: str, where: str) -> None:
        """Raise LimitExceeded if an actuator has more than a limit; NaN is not more."""
        size = np.where(np.isnan(values), 0.0, np.abs(values))
        worst = int(size.argmax())
        if size[worst] > limit:
            raise LimitExceeded(
                f"actuator {self.layout.id[worst]} {said.format(size[worst])} {limit:g}, {where}",
                remedy="find out why, or use another plan and folder",
            )


def shape_name(shape: Shape) -> str:
    """Return which shape it is, for people."""
    which = f"shape {shape.number} {'+' if shape.sign > 0 else '-'}" if shape.number else "rest"
    return f"{which} of cycle {shape.cycle} under '{shape.load.name}'"


def sum_at_rest(layout: Layout, force: Array) -> float:
    """Return the sum of nz_i c_i of the enabled actuators [N]."""
    on = layout.enabled
    return float(layout.nz[on] @ force[on])


def mean_sum(
    layout: Layout,
    force: Array,
    shape: NDArray[np.int64],
    sign: NDArray[np.int64],
    valid: NDArray[np.bool_],
) -> float | None:
    """Return the sum at rest by (N, n) commanded forces [N]; None if no shape has both signs.

    Of shapes that have: there the elastic forces cancel.
    """
    plus, minus = (valid.astype(bool) & (sign == each) for each in (1, -1))
    both = np.isin(shape, np.intersect1d(shape[plus], shape[minus]))
    if not both.any():
        return None
    means = [force[both & each].mean(axis=0) for each in (plus, minus)]
    return sum_at_rest(layout, np.mean(means, axis=0))


def sum_error(layout: Layout, reading: Reading, samples: int) -> float:
    """Return the standard deviation of that sum [N]; 0 if unknown.

    From the scatter of independent samples if the bench does not give the error of the mean.
    """
    error = reading.force_error
    if error is None:
        error = reading.force_scatter / np.sqrt(samples)
    return float(np.linalg.norm(np.nan_to_num((layout.nz * error)[layout.enabled])))


def judge(
    weight: float,
    loads: Iterable[Load],
    load: Load,
    rest_sums: Mapping[str, float],
    total: float,
    error: float = 0.0,
) -> tuple[bool | None, str]:
    """Return whether a load of a plan is on, and why; None if the forces do not show it.

    The sum at rest now and its error [N] are compared with the sums under the loads that were on
    before [N], by key. ``weight`` is P of the mirror [N].
    """
    names = {each.key: each.name for each in loads}
    weights = {each.key: float(effective_weight(weight, each.added, each.tilt)) for each in loads}
    step = {key: other - weights[load.key] for key, other in weights.items()}
    smallest = min((abs(value) for value in step.values() if value), default=0.0)
    if smallest * MAX_CHANGE <= MIN_STEP_SIGMAS * error:
        return None, f"the loads differ by {smallest:.3g} N, too little to distinguish them"
    compared = [key for key in rest_sums if key == load.key or step[key]]
    if not compared:
        return None, "this is assumed, because no other load has been measured yet"
    for key in compared:
        change, name = total - rest_sums[key], names[key]
        changed = f"the sum of the forces changed by {change:.4g} N"
        if key == load.key:
            if abs(change) > MAX_CHANGE * smallest:
                return False, f"{changed} since '{name}' was on before"
        elif not CHANGE_RANGE[0] <= change / step[key] <= CHANGE_RANGE[1]:
            low, high = (100 * part for part in CHANGE_RANGE)
            due = f"{step[key]:.4g} N are due ({low:.0f} to {high:.0f} % of it)"
            sign = ": the wrong way, as if Force is not positive along +z"
            turned = sign if change / step[key] <= -CHANGE_RANGE[0] else ""
            return False, f"{changed} from '{name}', where {due}{turned}"
    beside = ", ".join(f"'{names[key]}'" for key in compared)
    return True, f"the sum of the forces is {total:.4g} N, as expected from {beside}"


SIGNALS = (signal.SIGINT, signal.SIGTERM)
POLL_INTERVAL = 0.05  # between two checks of a sleep for an interruption [s]
MAX_ATTEMPTS = 3  # of each shape, before it is marked as not valid
MAX_ABSENCE = 120.0  # of a bench that is gone [s]
POSITION_TOLERANCE = 0.1  # of an actuator, relative to the largest displacement of the shape
POSITION_SIGMAS = 6.0  # standard deviations of a sample besides
FIRST_WAIT, LONGEST_WAIT = 0.5, 10.0  # between two looks at a bench that is gone [s]


class RunLog:
    """Writes events to a new file run-001.jsonl, run-002.jsonl, ... of a campaign's folder."""

    def __init__(self, folder: Path) -> None:
        with in_one_line(folder):
            numbers = [
                int(name[1])
                for path in folder.iterdir()
                if (name := re.fullmatch(r"run-(\d+)\.jsonl", path.name))
            ]
            self.path = folder / f"run-{max(numbers, default=0) + 1:03d}.jsonl"
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._handle = os.open(self.path, flags, 0o666)
        self._start = time.monotonic()

    def note(self, event: str, of: Shape | None = None, **values: Any) -> None:
        """Write one line, of a shape or not."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        elapsed = round(time.monotonic() - self._start, 4)
        line: dict[str, Any] = {"time": now, "elapsed": elapsed, "event": event}
        if of is not None:
            line |= {"load": of.load.name, "cycle": of.cycle, "shape": of.number, "sign": of.sign}
        text = json.dumps(jsonable(line | values))
        with in_one_line(self.path):
            os.write(self._handle, text.encode() + b"\n")

    def close(self) -> None:
        """Close the file."""
        os.close(self._handle)


class Interruption:
    """Notes the first signal, and raises KeyboardInterrupt at the second.

    Signals reach the main thread only; in other threads nothing is noted.
    """

    def __init__(self) -> None:
        self.asked = False
        self._at_once = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._before = {each: signal.signal(each, self._note) for each in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked or self._at_once:
            raise KeyboardInterrupt
        self.asked = True

    def check(self) -> None:
        """Raise Interrupted after the first signal."""
        if self.asked:
            raise Interrupted("stopped as asked")

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Let the first signal end the block: a person is awaited, and no shape is under way."""
        self._at_once = True
        try:
            yield
        except (KeyboardInterrupt, EOFError):
            raise Interrupted("stopped as asked") from None
        finally:
            self._at_once = False

    def sleep(self, seconds: float) -> None:
        """Sleep, or raise Interrupted as soon as there is a signal."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, POLL_INTERVAL))
        self.check()


@dataclass(frozen=True)
class Progress:
    """How far a campaign is. Shapes are counted with each sign."""

    shape: Shape  # the one just taken
    cycles: int  # under each load
    smallest_gap: float  # so far in this run [m]
    shapes: int = 0  # of each cycle, to be taken with both signs
    done: int = 0  # shapes of the whole campaign
    total: int = 0
    largest_force: float = 0.0  # [N]
    invalid: int = 0  # shapes of this run that are not valid
    invalid_in_a_row: int = 0  # of the last ones


class Onlooker(Protocol):
    """Is shown how a campaign proceeds."""

    def progress(self, now: Progress) -> None:
        """Show how far it is; called after each shape."""

    def say(self, line: str) -> None:
        """Show one line: a load that is on, a reading that was not sound, a bench that is gone."""


class SilentOnlooker:
    """An onlooker that shows nothing."""

    def progress(self, now: Progress) -> None:
        """Show nothing."""

    def say(self, line: str) -> None:
        """Show nothing."""


@dataclass(frozen=True, eq=False)
class Row:
    """A shape that was taken: its last reading, if any, and whether that is valid."""

    shape: Shape
    reading: Reading | None
    valid: bool


@dataclass(eq=False)
class Taker:
    """Takes shapes on a bench, and remembers what the next reading is compared with."""

    bench: Bench
    plan: CampaignPlan
    log: RunLog
    onlooker: Onlooker
    interruption: Interruption

    def __post_init__(self) -> None:
        plan, bench = self.plan, self.bench
        self._name = type(bench).__name__
        self.guard = Guard(plan.limits, bench.layout, bench.gap)
        first = Shape(plan.loads[0], 1, 0, 1, np.zeros(bench.layout.n))
        self.progress = Progress(first, plan.cycles, smallest_gap=bench.gap)
        self._counter: int | None = None
        self._last: datetime.datetime | None = None  # time of the last sound reading
        self._sound: tuple[Shape, Reading] | None = None  # the last
        self._rest: Reading | None = None  # the last of the mirror at rest

    def take(
        self, shape: Shape, refused: Callable[[str], None] | None = None
    ) -> tuple[Reading | None, str]:
        """Command a shape and read it, up to `MAX_ATTEMPTS` times.

        Return the last reading, if any, and why it is not valid, or ''. If the bench refuses the
        command, ``refused`` is called once with the reason. A bench that is gone for too long is a
        `BenchFault`.
        """
        self.guard.check_command(shape)
        reading, fault = None, ""
        for attempt in range(1, MAX_ATTEMPTS + 1):
            self._await_bench()
            commanded = False
            try:
                self.log.note("command", shape, stroke=float(np.abs(shape.position).max()))
                with faults_of(f"{self._name}.command"):
                    self.bench.command(shape)
                commanded = True
                reading = self._read(shape)
            except BenchFault as error:
                remedy = f" ({error.remedy})" if error.remedy else ""
                fault = f"{error.fault or 'a fault without a message'}{remedy}"
            else:
                fault = self._unsound(shape, reading)
                self._counter = reading.counter
                if not fault:
                    self._sound, self._last = (shape, reading), reading.time
                    self._rest = self._rest if shape.number else reading
                    break
            self.log.note("not sound", shape, attempt=attempt, fault=fault)
            self.onlooker.say(f"{shape_name(shape)}, attempt {attempt} of {MAX_ATTEMPTS}: {fault}")
            if refused is not None and not commanded and attempt < MAX_ATTEMPTS:
                refused(fault)
                refused = None
        return reading, fault

    def rest(self) -> None:
        """Bring the mirror to rest; wait for a bench that is gone."""
        for attempt in range(1, MAX_ATTEMPTS + 1):
            self._await_bench()
            try:
                with faults_of(f"{self._name}.rest"):
                    self.bench.rest()
            except BenchFault as error:
                self.log.note("not at rest", attempt=attempt, fault=error.fault)
                if attempt == MAX_ATTEMPTS:
                    raise
            else:
                return

    def _read(self, shape: Shape) -> Reading:
        plan, bench = self.plan, self.bench
        n, on = bench.layout.n, bench.layout.enabled
        with faults_of(f"{self._name}.read"):
            if isinstance(bench, OwnTime):
                bench.wait(plan.settling)
            else:
                time.sleep(plan.settling)
            reading = bench.read(plan.samples)
            for name in ("force", "position", "force_scatter", "position_scatter", "force_error"):
                value = getattr(reading, name)
                if value is not None and value.shape != (n,):
                    raise BenchFault(
                        f"the bench gives {name} of shape {value.shape} for {n} actuators",
                        remedy="give one value for each, NaN where it is unknown",
                    )
        force = float(np.nan_to_num(np.abs(reading.force[on])).max(initial=0.0))
        gap = bench.gap - float(np.nan_to_num(np.abs(reading.position[on])).max(initial=0.0))
        self.progress = replace(
            self.progress,
            largest_force=max(self.progress.largest_force, force),
            smallest_gap=min(self.progress.smallest_gap, gap),
        )
        self.log.note(
            "reading",
            shape,
            largest_force=force,
            smallest_gap=gap,
            samples=plan.samples,
            force_scatter=rms(reading.force_scatter[on]),
            position_scatter=rms(reading.position_scatter[on]),
            force_error=force_noise(bench.layout, reading),
            temperature=reading.temperature,
            counter=reading.counter,
            settled=reading.settled,
        )
        self.guard.check_reading(shape, reading)
        return reading

    def _unsound(self, shape: Shape, reading: Reading) -> str:
        """Return why a reading is not sound, or ''."""
        layout, on, before = self.bench.layout, self.bench.layout.enabled, None
        if self._sound is not None and not np.array_equal(self._sound[0].position, shape.position):
            before = self._sound[1]
        if reading.counter == self._counter:
            return f"the counter stands still at {reading.counter}: the reading is stale"
        if self._last is not None and reading.time < self._last:
            return (
                f"the reading is of {reading.time:%Y-%m-%d %H:%M:%S}, before the last one of"
                f" {self._last:%Y-%m-%d %H:%M:%S}: the clock of the bench was set back"
            )
        for name, values in (("force", reading.force), ("position", reading.position)):
            if (wrong := ~np.isfinite(values[on])).any():
                return f"the {name} of actuator {layout.id[on][wrong][0]} is NaN"
            if before is not None and np.array_equal(values[on], getattr(before, name)[on]):
                return f"no {name} has changed since the last shape: the reading is frozen"
        if not reading.settled:
            return "the mirror did not settle"
        return self._position_fault(shape, reading)

    def _position_fault(self, shape: Shape, reading: Reading) -> str:
        """Return which actuator is not at its commanded position, or ''.

        Positions are relative to the mirror at rest, since the zero of a sensor is arbitrary.
        """
        if self._rest is None or shape.number == 0:
            return ""
        on, stroke = self.bench.layout.enabled, float(np.abs(shape.position).max())
        off = np.abs(reading.position - self._rest.position - shape.position)[on]
        scatter = reading.position_scatter[on]
        beyond = off - POSITION_TOLERANCE * stroke - POSITION_SIGMAS * np.nan_to_num(scatter)
        worst = int(beyond.argmax())
        if beyond[worst] <= 0:
            return ""
        allowed = f"allowed are {POSITION_TOLERANCE:.0%} of the stroke"
        if np.isfinite(scatter[worst]):
            allowed += (
                f" and {POSITION_SIGMAS:g} times its position_scatter of {scatter[worst]:.2g} m"
            )
        else:
            allowed += (
                f"; the bench gives no position_scatter, {POSITION_SIGMAS:g} times which would be"
                " allowed: if that is noise, give position_scatter, or plan fewer shapes (count)"
            )
        return (
            f"actuator {self.bench.layout.id[on][worst]} is {off[worst]:.3g} m from its commanded"
            f" position in a shape of {stroke:.3g} m; {allowed}"
        )

    def _await_bench(self) -> None:
        """Return when the bench takes commands; wait for one that is gone."""
        gone, wait, start = "", FIRST_WAIT, time.monotonic()
        while True:
            try:
                with faults_of(f"{self._name}.status"):
                    status = self.bench.status()
                    ready, message, counter = status.ready, status.message, status.counter
            except BenchFault as error:
                gone = error.fault
            else:
                if ready:
                    if self._counter is None:
                        self._counter = counter
                    return
                if not gone:
                    raise BenchFault(f"the bench takes no commands: {message}", remedy="check it")
                gone = message
            if time.monotonic() - start > MAX_ABSENCE:
                raise BenchFault(
                    f"the bench did not come back within {MAX_ABSENCE:g} s ({gone})",
                    remedy="check it",
                )
            self.log.note("gone", fault=gone)
            self.onlooker.say(f"the bench is gone ({gone}); looking again in {wait:g} s")
            self.interruption.sleep(wait)
            wait = min(2 * wait, LONGEST_WAIT)


def force_noise(layout: Layout, reading: Reading | None) -> float:
    """Return the RMS over actuators of the error of a mean force [N]; NaN if it is unknown."""
    if reading is None or reading.force_error is None:
        return float("nan")
    return rms(reading.force_error[layout.enabled])
