"""Progress of a long computation, and its best result so far, for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

Item = TypeVar("Item")


# Who is told what goes on, which share is done, and how to keep what there is.
Told = Callable[[str, float, Callable[[], Any] | None], None]


def _nobody(what: str, done: float, keep: Callable[[], Any] | None) -> None:
    """Take no note."""


_TOLD: ContextVar[Told] = ContextVar("told", default=_nobody)


@contextmanager
def telling(told: Told) -> Iterator[None]:
    """Report all progress inside to a function."""
    token = _TOLD.set(told)
    try:
        yield
    finally:
        _TOLD.reset(token)


@contextmanager
def kept_as(made_of: Callable[[Any], Any]) -> Iterator[None]:
    """Convert every result that is kept inside."""
    outer = _TOLD.get()

    def told(what: str, done: float, keep: Callable[[], Any] | None) -> None:
        outer(what, done, None if keep is None else lambda: made_of(keep()))

    with telling(told):
        yield


def tell(what: str, done: float = 0.0, keep: Callable[[], Any] | None = None) -> None:
    """Report progress.

    Parameters
    ----------
    what
        What begins now; with ``keep``, what has been found.
    done
        Fraction of the work that is done; 0 if not known.
    keep
        Returns a complete result from what has been computed, if the user stops waiting.
    """
    _TOLD.get()(what, done, keep)


def telling_of(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """Yield items, and report how many of them are done."""
    tell(f"0 of {total} {what}")
    for number, item in enumerate(items, 1):
        yield item
        tell(f"{number} of {total} {what}", number / total)
