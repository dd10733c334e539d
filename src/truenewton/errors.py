"""All errors: each states in one line what is wrong, where, and what to do.

The parts of the sentence are attributes (``path``, ``fault``, ``remedy``), for programs.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple, Self


def printable(text: str) -> str:
    """Return a text in one line, with control characters escaped: file names may contain any."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class TrueNewtonError(Exception):
    """Base of all errors raised on purpose.

    Parameters
    ----------
    fault
        What is wrong, without a full stop.
    remedy
        What to do about it.
    path
        The file or folder concerned, if any.

    Examples
    --------
    >>> try:
    ...     tn.read("nowhere.fits")
    ... except tn.errors.TrueNewtonError as error:
    ...     print(error.path, "|", error.fault)
    nowhere.fits | cannot be read (No such file or directory)
    """

    def __init__(self, fault: str, *, remedy: str = "", path: object = None) -> None:
        self.fault, self.remedy, self.path = fault, remedy, path
        where = f"{path}: " if path is not None else ""
        then = f"; {remedy}" if remedy else ""
        super().__init__(printable(f"{where}{fault}{then}"))

    def changed(self, **parts: Any) -> Self:
        """Return a copy with some of fault, remedy and path changed."""
        return type(self)(**{**vars(self), **parts})


class Fault(NamedTuple):
    """What is wrong with data or a result, and its remedy, which may be empty."""

    fault: str
    remedy: str


class UnreadableFile(TrueNewtonError, OSError):
    """A file that cannot be opened, is truncated, is of another format, or fails its checksum."""


class FormatError(TrueNewtonError, ValueError):
    """Data with an invalid keyword, column, unit or value."""


class SeveralSegments(FormatError):
    """Data of several segments, of which one must be chosen.

    ``segments`` are the actuators of each by its number: an interface that takes one after the
    other needs no other reading.
    """

    def __init__(
        self, fault: str, *, segments: Any = None, remedy: str = "", path: object = None
    ) -> None:
        super().__init__(fault, remedy=remedy, path=path)
        self.segments = segments or {}


class CampaignMismatch(TrueNewtonError, ValueError):
    """Files, or a bench and its plan, that do not belong to the same campaign or mirror."""


class RankDeficient(TrueNewtonError, ValueError):
    """Data that do not determine the unknowns; the remedy names what to add."""


class GeometryError(TrueNewtonError, ValueError):
    """An impossible layout or shell."""


class LimitExceeded(TrueNewtonError, ValueError):
    """A force or stroke beyond the limits of the mirror."""


class UnknownName(TrueNewtonError, LookupError):
    """A mirror, method or load that does not exist."""


class OutputExists(TrueNewtonError, FileExistsError):
    """An output that exists and was not to be overwritten."""


class OutputFailed(TrueNewtonError, OSError):
    """An output that could not be written; no partial file is left."""


class TooManyOutliers(TrueNewtonError, ValueError):
    """A campaign with so many outliers that the other rows cannot be trusted."""


class NotToBeUsed(TrueNewtonError, ValueError):
    """A calibration whose verdict is 'rejected'; for an export also 'doubtful'."""


class TrueNewtonWarning(UserWarning):
    """A verdict that is 'doubtful' or 'rejected'."""


class NotConverged(TrueNewtonError, ArithmeticError):
    """An iteration that does not converge."""


class BenchFault(TrueNewtonError, RuntimeError):
    """A bench that stopped, lost its connection, or gives invalid readings."""


class LoopUnstable(BenchFault):
    """Gains with which the simulated loop is unstable: its noise grows."""


class Interrupted(TrueNewtonError):
    """A run that was stopped; complete cycles are kept."""


def located(error: TrueNewtonError, path: object) -> TrueNewtonError:
    """Return the error with a path, unless it has one."""
    return error if error.path is not None else error.changed(path=path)


@contextlib.contextmanager
def naming(path: object) -> Iterator[None]:
    """Add a path to the errors raised in a block, unless they have one."""
    try:
        yield
    except TrueNewtonError as error:
        raise located(error, path) from error.__cause__
