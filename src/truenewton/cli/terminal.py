"""What a person or a script sees in a terminal: results, JSON, progress."""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import Any, TextIO

from truenewton.errors import (
    FormatError,
    NotConverged,
    NotToBeUsed,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
    located,
    printable,
)
from truenewton.rounding import WIDTH, counted, wrapped

# Each number was checked when it was read; only together are they absurd.
BROKEN = "the calculation broke down"
WHAT_TO_DO = "numbers are too large, too small or too similar; check each file with `info`"
ERRORS_OF_DATA = FormatError, RankDeficient, TooManyOutliers, NotConverged, NotToBeUsed


def say(*lines: object, stream: TextIO | None = None, end: str = "\n") -> None:
    """Print lines to people, their control characters escaped.

    If the reader of standard error goes away, the command continues: results are elsewhere.
    """
    for line in lines:
        try:
            print(printable(str(line)), file=stream, end=end, flush=True)
        except BrokenPipeError:
            if stream is None or stream is not sys.stderr:
                raise


def told(error: Exception) -> str:
    """Return the line that states an error, or that the calculation broke down with it."""
    if isinstance(error, TrueNewtonError):
        return str(error)
    return f"{BROKEN} ({error}): {WHAT_TO_DO}"


def refuse(line: str, code: int = 2) -> int:
    """Print why a command failed, and return its exit code."""
    with contextlib.suppress(OSError):  # standard error may be closed or full
        print(f"truenewton: {printable(' '.join(line.split()))}", file=sys.stderr)
    return code


@contextlib.contextmanager
def about(paths: Sequence[Path]) -> Iterator[None]:
    """Add the path to an error of the data that names no file, if there is only one path."""
    try:
        yield
    except ERRORS_OF_DATA as error:
        raise located(error, paths[0]) if len(paths) == 1 else error from None


def tell(lines: Iterable[str], stream: TextIO | None = None) -> None:
    """Print lines of text, wrapped to the terminal and to at most 100 columns."""
    shown = stream or sys.stdout
    columns = shutil.get_terminal_size().columns if shown and shown.isatty() else WIDTH
    say(*wrapped(lines, min(columns, WIDTH)), stream=stream)


def print_result(
    lines: Iterable[str],
    *written: Path | None,
    details: Iterable[str] = (),
    values: Mapping[str, Any] | None = None,
    schema: str = "",
    json: bool = False,
    quiet: bool = False,
    verbose: bool = False,
    then: str = "",
) -> None:
    """Print lines, the files written (None: not written) and the next command; or values as JSON.

    The ``details`` are printed if ``verbose``, otherwise how many there are. With ``quiet``, print
    the files only. The JSON begins with the name of its schema and the version, which changes if a
    key changes or is removed (`json_schema`). Numbers that are not finite become null.
    """
    if json and values is not None:
        from truenewton.arrays import jsonable  # imports NumPy, which --help does not need

        print(dumps(jsonable({"schema": f"truenewton.{schema}/2", **values}), indent=2))
        return
    if not quiet:
        tell(lines)
        more = list(details)
        tell(more if verbose or not more else [f"  {counted(more, 'more line')} with --verbose"])
    say(*(f"written: {path}" for path in filter(None, written)))
    if None in written and not quiet:
        say("No file was written. To save the result, add -o FILE.")
    if then and not quiet:
        say(f"next: {then}")


class Bar:
    """A line on standard error with what happens, how far it is, and the time left.

    It is drawn only if standard error is a terminal.
    """

    def __init__(self) -> None:
        self._drawn: Any = None

    def show(self, text: str, done: float = 0.0) -> None:
        """Draw the line; ``done`` is a share of the work, 0 if it is unknown."""
        if not sys.stderr.isatty():
            return
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeRemainingColumn,
        )

        if self._drawn is None:
            columns = SpinnerColumn(), TextColumn("{task.description}", markup=False)
            self._drawn = Progress(*columns, console=Console(stderr=True), transient=True)
            self._drawn.add_task(printable(text), total=None)
            self._drawn.start()
        if done and len(self._drawn.columns) == 2:
            self._drawn.columns += BarColumn(bar_width=20), TimeRemainingColumn()
        known = {"completed": done, "total": 1.0} if done else {}
        self._drawn.update(0, description=printable(text), **known)

    def say(self, line: str, stream: TextIO | None = None) -> None:
        """Print a line above the bar, or to a stream if no bar is drawn."""
        if self._drawn is None:
            tell([line], stream)
        else:
            self._drawn.console.print(printable(line), markup=False, highlight=False)

    def stop(self) -> None:
        """Remove the line; the next `show` draws it again."""
        if self._drawn is not None:
            self._drawn.stop()
            self._drawn = None


@dataclass
class Waiting:
    """Contains how to make a result of what has been found so far; None before there is any."""

    keep: Callable[[], Any] | None = None

    def end_of(self, work: Callable[[], Any]) -> Any:
        """Return the result of some work, or what was found so far if Ctrl-C interrupts it."""
        try:
            return work()
        except KeyboardInterrupt:
            if self.keep is None:
                raise
            return self.keep()


@contextlib.contextmanager
def busy(what: str, *, keeping: bool = False) -> Iterator[Waiting]:
    """Show a bar while the block runs; with ``keeping``, also which result Ctrl-C would keep."""
    from truenewton.progress import progress_to

    waiting, bar = Waiting(), Bar()

    def show(now: str, done: float, keep: Callable[[], Any] | None) -> None:
        if keep is None:
            bar.show(f"{what}: {now}", done)
        elif keeping:
            waiting.keep = keep
            if sys.stderr.isatty():
                bar.say(f"{now}; Ctrl+C keeps this", sys.stderr)

    bar.show(what)
    try:
        with progress_to(show):
            yield waiting
    finally:
        bar.stop()
