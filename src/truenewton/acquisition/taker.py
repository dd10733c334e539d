"""Taking one shape: limits before and after, and again if the reading is not sound.

An onlooker is shown how it goes, and Ctrl-C ends the run between two shapes.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import FrameType
from typing import Any, Protocol

import numpy as np

from truenewton.acquisition.checks import Guard, shape_name
from truenewton.acquisition.journal import RunLog
from truenewton.acquisition.plan import CampaignPlan
from truenewton.arrays import Array
from truenewton.bench.protocol import Bench, OwnTime, Reading, Shape
from truenewton.errors import BenchFault, Interrupted
from truenewton.statics.layout import Layout

SIGNALS = (signal.SIGINT, signal.SIGTERM)
POLL_INTERVAL = 0.05  # [s], after which a sleep looks whether to stop
MAX_ATTEMPTS = 3  # of each shape, before it is marked as not valid
MAX_ABSENCE = 120.0  # with a bench that is gone [s]
POSITION_TOLERANCE = 0.1  # of a shape's largest displacement, by which an actuator may miss it
POSITION_SIGMAS = 6.0  # standard deviations of a sample besides
FIRST_WAIT, LONGEST_WAIT = 0.5, 10.0  # between two looks at it [s]
HANG_TIME, MAX_HANGS = 30.0, 2  # a fault after so long [s], so many times in a row, ends a run


class Interruption:
    """Notes the first signal, and raises KeyboardInterrupt at the second.

    Signals reach the main thread only; elsewhere nothing is noted.
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
        """Stop here if someone asked."""
        if self.asked:
            raise Interrupted("stopped as asked")

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Let one signal do, where no shape is under way but somebody is waited for."""
        self._at_once = True
        try:
            yield
        except (KeyboardInterrupt, EOFError):
            raise Interrupted("stopped as asked") from None
        finally:
            self._at_once = False

    def sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until someone asks to stop."""
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
    shapes: int  # of each cycle, to be taken with both signs
    done: int  # shapes of the whole campaign
    total: int
    smallest_gap: float  # so far in this run [m]
    largest_force: float = 0.0  # [N]
    taken: int = 0  # shapes of this run
    seconds: float = 0.0  # that they took; changing loads is not counted
    invalid: int = 0  # shapes of this run that are not valid
    in_a_row: int = 0  # of the last ones

    @property
    def seconds_left(self) -> float:
        """At the pace of this run [s]."""
        return self.seconds / self.taken * (self.total - self.done)

    def with_taken(self, shape: Shape, valid: bool, seconds: float) -> Progress:
        """Return how far it is with one shape more, which took so long [s]."""
        return replace(
            self,
            shape=shape,
            done=self.done + 1,
            taken=self.taken + 1,
            seconds=self.seconds + seconds,
            invalid=self.invalid + (not valid),
            in_a_row=0 if valid else self.in_a_row + 1,
        )


class Onlooker(Protocol):
    """Who is shown how a campaign goes."""

    def progress(self, now: Progress) -> None:
        """Show how far it is; called after each shape."""

    def say(self, line: str) -> None:
        """Show one line: a load that is on, a reading that was not sound, a bench that is gone."""


class SilentOnlooker:
    """An onlooker who shows nothing."""

    def progress(self, now: Progress) -> None:
        """Show nothing."""

    def say(self, line: str) -> None:
        """Show nothing."""


@dataclass(eq=False)
class Taker:
    """Takes shapes on a bench, and remembers what the next reading is compared with."""

    bench: Bench
    plan: CampaignPlan
    log: RunLog
    onlooker: Onlooker
    interruption: Interruption
    progress: Progress

    def __post_init__(self) -> None:
        self.guard = Guard(self.plan.limits, self.bench.layout, self.bench.gap)
        self._counter: int | None = None
        self._sound: tuple[Shape, Reading] | None = None  # the last
        self._rest: Reading | None = None  # the last of the mirror at rest
        self._hung = 0  # attempts in a row

    def take(
        self,
        shape: Shape,
        forecast: Array | None = None,
        refused: Callable[[str], None] | None = None,
    ) -> tuple[Reading | None, str]:
        """Command a shape, with (n,) forces [N] forecast, and read it, up to `MAX_ATTEMPTS` times.

        Return the last reading, if there is one, and why it is not valid, or an empty text. If a
        bench refuses the command, `refused` is called with the reason, once, before it is given
        again. A bench that is gone and does not come back, or hangs, is a `BenchFault`.
        """
        self.guard.check_command(shape, forecast)
        reading, fault = None, ""
        for attempt in range(1, MAX_ATTEMPTS + 1):
            self._await_bench()
            begun, commanded = time.monotonic(), False
            try:
                self._command(shape)
                commanded = True
                reading = self._read(shape)
            except BenchFault as error:
                fault = _words(error)
                self._end_where_it_hangs(time.monotonic() - begun - self.plan.settling, fault)
            else:
                self._hung = 0
                fault = self._unsound(shape, reading)
                self._counter = reading.counter
                if not fault:
                    self._sound = shape, reading
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
                self.bench.rest()
            except BenchFault as error:
                self.log.note("not at rest", attempt=attempt, fault=error.fault)
                if attempt == MAX_ATTEMPTS:
                    raise
            else:
                return

    def _end_where_it_hangs(self, seconds: float, fault: str) -> None:
        """End a run on a bench that takes long for each fault, as one that does not answer."""
        self._hung = self._hung + 1 if seconds > HANG_TIME else 0
        if self._hung == MAX_HANGS:
            raise BenchFault(
                f"the bench hangs: {MAX_HANGS} attempts in a row failed, the last after"
                f" {seconds:.0f} s: {fault}",
                remedy="see to it",
            )

    def _command(self, shape: Shape) -> None:
        stroke = float(np.abs(shape.position).max())
        self.log.note("command", shape, stroke=stroke)
        self.bench.command(shape)

    def _read(self, shape: Shape) -> Reading:
        plan, bench = self.plan, self.bench
        if isinstance(bench, OwnTime):
            bench.wait(plan.settling)
        else:
            time.sleep(plan.settling)
        reading, n, on = bench.read(plan.samples), bench.layout.n, bench.layout.enabled
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
            force_scatter=_rms(reading.force_scatter[on]),
            position_scatter=_rms(reading.position_scatter[on]),
            force_error=force_noise(bench.layout, reading),
            temperature=reading.temperature,
            counter=reading.counter,
            settled=reading.settled,
        )
        self.guard.check_reading(shape, reading)
        return reading

    def _unsound(self, shape: Shape, reading: Reading) -> str:
        """Return what speaks against a reading, or nothing."""
        layout, on, before = self.bench.layout, self.bench.layout.enabled, None
        if self._sound is not None and not np.array_equal(self._sound[0].position, shape.position):
            before = self._sound[1]
        if reading.counter == self._counter:
            return f"the counter stands still at {reading.counter}: the reading is stale"
        for name, values in (("force", reading.force), ("position", reading.position)):
            if (wrong := ~np.isfinite(values[on])).any():
                return f"the {name} of actuator {layout.id[on][wrong][0]} is NaN"
            if before is not None and np.array_equal(values[on], getattr(before, name)[on]):
                return f"no {name} has changed since the last shape: the reading is frozen"
        if not reading.settled:
            return "the mirror did not settle"
        return self._elsewhere(shape, reading)

    def _elsewhere(self, shape: Shape, reading: Reading) -> str:
        """Say which actuator stands elsewhere than it was commanded to, or nothing.

        Counted from the mirror at rest: the zero of a sensor may be anywhere.
        """
        if self._rest is None or shape.number == 0:
            return ""
        on, stroke = self.bench.layout.enabled, float(np.abs(shape.position).max())
        off = np.abs(reading.position - self._rest.position - shape.position)[on]
        beyond = (
            off
            - POSITION_TOLERANCE * stroke
            - POSITION_SIGMAS * np.nan_to_num(reading.position_scatter[on])
        )
        worst = int(beyond.argmax())
        if beyond[worst] <= 0:
            return ""
        scatter = reading.position_scatter[on][worst]
        known = f"six times its position_scatter of {scatter:.2g} m"
        unknown = (
            "the bench gives no position_scatter, six times which is let pass: where that is"
            " noise, give position_scatter, or plan fewer shapes (count)"
        )
        return (
            f"actuator {self.bench.layout.id[on][worst]} stands {off[worst]:.3g} m from where it"
            f" was commanded, in a shape of {stroke:.3g} m, of which a tenth is let pass"
            f"{f', and {known}' if np.isfinite(scatter) else f'; {unknown}'}"
        )

    def _await_bench(self) -> None:
        """Return when the bench takes commands; wait for one that is gone."""
        gone, wait, start = "", FIRST_WAIT, time.monotonic()
        while True:
            try:
                status = self.bench.status()
            except BenchFault as error:
                gone = error.fault
            else:
                if status.ready:
                    if self._counter is None:
                        self._counter = status.counter
                    return
                if not gone:
                    raise BenchFault(
                        f"the bench takes no commands: {status.message}", remedy="see to it"
                    )
                gone = status.message
            if time.monotonic() - start > MAX_ABSENCE:
                raise BenchFault(
                    f"the bench did not come back within {MAX_ABSENCE:g} s ({gone})",
                    remedy="see to it",
                )
            self.log.note("gone", fault=gone)
            self.onlooker.say(f"the bench is gone ({gone}); looking again in {wait:g} s")
            self.interruption.sleep(wait)
            wait = min(2 * wait, LONGEST_WAIT)


def _words(error: BenchFault) -> str:
    """Return a fault and its remedy, as part of a sentence."""
    remedy = f" ({error.remedy})" if error.remedy else ""
    return f"{error.fault or 'a fault without a word'}{remedy}"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def force_noise(layout: Layout, reading: Reading | None) -> float:
    """Return the RMS over actuators of the error of a mean force [N]; NaN where it is unknown."""
    if reading is None or reading.force_error is None:
        return float("nan")
    return float(np.sqrt(np.mean(reading.force_error[layout.enabled] ** 2)))
