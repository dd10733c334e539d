"""Progress of a long computation, and its best result so far, for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

Item = TypeVar("Item")
# Takes what is computed, the fraction that is done, and a function that returns the best result.
Listener = Callable[[str, float, Callable[[], Any] | None], None]
_LISTENER: ContextVar[Listener] = ContextVar("listener", default=lambda *_: None)


@contextmanager
def progress_to(listener: Listener) -> Iterator[None]:
    """Report all progress inside to a function."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


@contextmanager
def kept_as(converted: Callable[[Any], Any]) -> Iterator[None]:
    """Convert the best result that is reported inside."""
    outer = _LISTENER.get()

    def listener(what: str, done: float, keep: Callable[[], Any] | None) -> None:
        outer(what, done, None if keep is None else lambda: converted(keep()))

    with progress_to(listener):
        yield


def report_progress(what: str, done: float = 0.0, keep: Callable[[], Any] | None = None) -> None:
    """Report what begins, and the fraction that is done, 0 if unknown; or what has been found.

    In the latter case ``keep`` returns it as a complete result, in case that the user stops.
    """
    _LISTENER.get()(what, done, keep)


def with_progress(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """Yield items, and report how many of them are done."""
    report_progress(f"0 of {total} {what}")
    for number, item in enumerate(items, 1):
        yield item
        report_progress(f"{number} of {total} {what}", number / total)
