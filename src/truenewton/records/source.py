"""Where data come from, and what of it went into a result; when it was measured."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from truenewton.errors import FormatError


@dataclass(frozen=True)
class Source:
    """A file that was read.

    Attributes
    ----------
    file, sha256
        Its path, in a result its name; the digest of its bytes.
    rows, rejected
        How many of its rows went into a result, and how many were left out as outliers.
    """

    file: str
    sha256: str
    rows: int = 0
    rejected: int = 0


def check_date(date: object) -> None:
    """Refuse what is no date."""
    if not isinstance(date, datetime.datetime):
        raise FormatError(f"the date is {date!r}", remedy="give a datetime.datetime, UTC", got=date)
