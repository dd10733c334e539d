"""One tree of errors; each says in one line what is wrong, where, and what to do.

An error carries its parts as values (``path``, ``fault``, ``remedy``, ``got``, ``want``), so that
programs need not parse the sentence that people read.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple, Self


def printable(text: str) -> str:
    """Return a text in one line, its control characters escaped.

    Names that come from files may hold line breaks, or what commands a terminal.
    """
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
    got, want
        The offending value and what was expected instead, if they can be told.

    Examples
    --------
    >>> try:
    ...     tn.read("nowhere.fits")
    ... except tn.errors.TrueNewtonError as error:
    ...     print(error.path, "|", error.fault)
    nowhere.fits | cannot be read (No such file or directory)
    """

    def __init__(
        self,
        fault: str,
        *,
        remedy: str = "",
        path: object = None,
        got: Any = None,
        want: Any = None,
    ) -> None:
        self.fault, self.remedy, self.path = fault, remedy, path
        self.got, self.want = got, want
        where = f"{path}: " if path is not None else ""
        then = f"; {remedy}" if remedy else ""
        super().__init__(printable(f"{where}{fault}{then}"))

    def changed(self, **parts: Any) -> Self:
        """Return the same error, but for some of fault, remedy, path, got and want."""
        return type(self)(**{**vars(self), **parts})


class Fault(NamedTuple):
    """What is wrong with data or a result, and what mends it: clauses without a full stop.

    The remedy is empty where there is nothing to be done.
    """

    fault: str
    remedy: str


class UnreadableFile(TrueNewtonError, OSError):
    """A path that cannot be opened, is not FITS, is truncated, or fails its checksum."""


class FormatError(TrueNewtonError, ValueError):
    """A FITS file that breaks its contract: a keyword, column, unit or value."""


class CampaignMismatch(TrueNewtonError, ValueError):
    """Files, or a bench and its plan, that cannot belong to one campaign."""


class RankDeficient(TrueNewtonError, ValueError):
    """Data that cannot fix what is asked of them; the remedy names what to add."""


class GeometryError(TrueNewtonError, ValueError):
    """A layout or a shell that cannot be."""


class LimitExceeded(TrueNewtonError, ValueError):
    """A force or stroke beyond what the mirror may bear."""


class UnknownName(TrueNewtonError, LookupError):
    """A mirror, method or load that does not exist."""


class OutputExists(TrueNewtonError, FileExistsError):
    """An output that stands already and was not to be overwritten."""


class OutputFailed(TrueNewtonError, OSError):
    """An output that could not be written; nothing was left in its place."""


class TooManyOutliers(TrueNewtonError, ValueError):
    """A campaign in which so many rows do not belong that the rest cannot be trusted."""


class NotToBeUsed(TrueNewtonError, ValueError):
    """A calibration whose verdict is 'rejected'."""


class TrueNewtonWarning(UserWarning):
    """A calibration whose verdict is 'doubtful' or 'rejected'."""


class NotConverged(TrueNewtonError, ArithmeticError):
    """An iteration that does not settle."""


class ClusterFailed(TrueNewtonError, RuntimeError):
    """A cluster that is not there, or whose workers cannot do their part."""


class BenchFault(TrueNewtonError, RuntimeError):
    """A bench that stopped itself, went away, or gives no sound readings."""


class LoopUnstable(BenchFault):
    """Gains that the loop cannot hold: refused beforehand, or found out as its noise grows."""


class Interrupted(TrueNewtonError):
    """A run that someone stopped; what it took is kept."""


def located(error: TrueNewtonError, path: object) -> TrueNewtonError:
    """Return the same error, naming the file it came from."""
    return error if error.path is not None else error.changed(path=path)


@contextlib.contextmanager
def naming(path: object) -> Iterator[None]:
    """Let the errors of a block name the file that they are about, unless they name another."""
    try:
        yield
    except TrueNewtonError as error:
        if error.path is not None or path is None:
            raise
        raise error.changed(path=path) from error.__cause__
