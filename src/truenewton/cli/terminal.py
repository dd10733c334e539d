"""How results look in a terminal: plain tables, JSON, that something takes its time."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, TypeVar

from truenewton.errors import (
    NotConverged,
    NotToBeUsed,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
    located,
    printable,
)

Item = TypeVar("Item")
REFUSALS = RankDeficient, TooManyOutliers, NotConverged, NotToBeUsed  # of data


def say(*lines: object, stream: TextIO | None = None, end: str = "\n") -> None:
    """Print lines, whatever the names in them hold; the only place that prints to people.

    A reader of standard error that goes away ends no command: results are elsewhere.
    """
    for line in lines:
        try:
            print(printable(str(line)), file=stream, end=end, flush=True)
        except BrokenPipeError:
            if stream is None or stream is not sys.stderr:
                raise


@contextlib.contextmanager
def about(
    paths: Sequence[Path], kinds: tuple[type[TrueNewtonError], ...] = REFUSALS
) -> Iterator[None]:
    """Let a refusal of data name the path that was given, if there is but one and it names none."""
    try:
        yield
    except kinds as error:
        raise located(error, paths[0]) if len(paths) == 1 else error from None


def print_result(
    lines: Iterable[str],
    *written: Path | None,
    values: Mapping[str, Any] | None = None,
    schema: str = "",
    quiet: bool = False,
) -> None:
    """Print lines and the files written, None for one that was not; or values as JSON instead.

    Quietly the files alone. Before the values stands the name of their schema, with its version:
    keys may be added to it, and another number stands there where one changed or went.

    Of the values what is not finite becomes null, which JSON can hold.
    """
    if values is not None:
        from truenewton.arrays import jsonable  # NumPy, which --help does not need

        print(json.dumps(jsonable({"schema": f"truenewton.{schema}/2", **values}), indent=2))
        return
    say(*(() if quiet else lines), *(f"written: {path}" for path in filter(None, written)))
    if None in written and not quiet:
        say("not written; -o FILE keeps it")


def schema_of(name: str, result: object) -> str:
    """Return the schema of a result of one body, or that of a result of several segments."""
    from truenewton.records.parts import has_parts

    return f"{name}-segments" if has_parts(result) else name


def table_lines(title: str, *table: Sequence[str]) -> Iterator[str]:
    """Yield a title and the rows of a table; its first column is text, the others stand right."""
    yield title
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for first, *others in table:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  " + "  ".join([first.ljust(widths[0]), *cells]).rstrip()


def track(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Yield items behind a progress bar on standard error, where a person looks at it."""
    if len(items) < 2 or not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track as rich_track

    yield from rich_track(items, description=what, console=Console(stderr=True), transient=True)


@dataclass
class Waiting:
    """What someone at the terminal waits for.

    Attributes
    ----------
    keep
        Makes a complete result of what has been found so far; None before anything has.
    """

    keep: Callable[[], Any] | None = None

    def end_of(self, work: Callable[[], Any]) -> Any:
        """Return the result of some work; what there is, if it is interrupted and something is."""
        try:
            return work()
        except KeyboardInterrupt:
            if self.keep is None:
                raise
            return self.keep()


@contextlib.contextmanager
def busy(what: str, *, keeping: bool = False) -> Iterator[Waiting]:
    """Show on standard error what goes on and how far it is, where a person looks.

    If ``keeping``, also what was found: it can be kept by whoever interrupts the rest.
    """
    from truenewton.progress import progress_to

    waiting = Waiting()
    with contextlib.ExitStack() as stack:
        shown: Progress | None = None
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                Progress,
                SpinnerColumn,
                TextColumn,
                TimeRemainingColumn,
            )

            columns = SpinnerColumn(), TextColumn("{task.description}", markup=False)
            shown = Progress(*columns, console=Console(stderr=True), transient=True)
            stack.enter_context(shown)
            task = shown.add_task(what, total=None)

        def told(now: str, done: float, keep: Callable[[], Any] | None) -> None:
            if keep is not None:
                if keeping:
                    waiting.keep = keep
                    if shown is not None:
                        shown.console.print(f"{now}; Ctrl+C keeps this", highlight=False)
                return
            if shown is None:
                return
            if done:
                shown.columns = (*columns, BarColumn(bar_width=20), TimeRemainingColumn())
                shown.update(task, completed=done, total=1.0)
            shown.update(task, description=f"{what}: {now}")

        stack.enter_context(progress_to(told))
        yield waiting
