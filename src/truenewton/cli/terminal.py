"""How results look in a terminal: plain tables, JSON, progress."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")


def print_json(values: Mapping[str, Any]) -> None:
    """Print values as JSON; what is not finite becomes null, which JSON can hold."""
    print(json.dumps(_plain(values), indent=2))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def print_result(
    lines: Iterable[str],
    output: Path | None,
    more: Iterable[Path] = (),
    *,
    values: Mapping[str, Any] | None = None,
) -> None:
    """Print lines and the files that hold them, or how to have the first; or values instead."""
    if values is not None:
        print_json(values)
        return
    for line in lines:
        print(line)
    for path in (*([output] if output else []), *more):
        print(f"written: {path}")
    if output is None:
        print("not written; -o FILE keeps it")


def print_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table whose first column is text and whose others stand to the right."""
    table = [tuple(head), *map(tuple, rows)]
    widths = [max(len(row[k]) for row in table) for k in range(len(head))]
    print(title)
    for row in table:
        cells = [
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  " + "  ".join(cells).rstrip())


def track(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Yield items behind a progress bar on standard error, where a person looks at it."""
    if len(items) < 2 or not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track as rich_track

    yield from rich_track(items, description=what, console=Console(stderr=True), transient=True)


@contextlib.contextmanager
def busy(what: str) -> Iterator[None]:
    """Show on standard error that something takes its time, where a person looks at it."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


class ProgressBar:
    """One progress bar on standard error, where a person looks at it, and lines beside it."""

    def __init__(self) -> None:
        self._bar: Any = None

    def show(self, done: int, total: int, what: str, figures: str, seconds_left: float) -> None:
        """Draw the bar: what is done, figures, and the time that is left."""
        if not sys.stderr.isatty():
            return
        shown = {"completed": done, "total": total, "description": what, "figures": figures,
                 "left": clock_time(seconds_left)}  # fmt: skip
        if self._bar is None:
            self._bar = _bar()
            self._bar.add_task(**shown)
            self._bar.start()
        self._bar.update(0, **shown)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._bar is None:
            print(line, flush=True)
        else:
            self._bar.console.print(line, markup=False, highlight=False)

    def stop(self) -> None:
        """Take the bar away, as before a question; it comes back when it is drawn again."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TextColumn("{task.fields[figures]}", markup=False),
        TextColumn("{task.fields[left]} left", markup=False),
        console=Console(stderr=True),
        transient=True,
    )


def clock_time(seconds: float) -> str:
    """Return a time as h:mm:ss."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
