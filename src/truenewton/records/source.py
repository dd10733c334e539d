"""Where data come from: the file read, the file that went into a result."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from truenewton.errors import FormatError


@dataclass(frozen=True)
class UsedSource:
    """A file that went into a calibration: name, digest, rows used, rows rejected."""

    file: str
    sha256: str
    rows: int
    rejected: int


@dataclass(frozen=True)
class Source:
    """Where a record came from: the path of its file, and the digest of its bytes."""

    file: str
    sha256: str


def check_date(date: object) -> None:
    """Refuse what is no date.

    Raises
    ------
    FormatError
    """
    if not isinstance(date, datetime.datetime):
        raise FormatError(f"the date is {date!r}", remedy="give a datetime.datetime, UTC", got=date)
