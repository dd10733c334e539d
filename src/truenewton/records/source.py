"""Where data come from: the file read, the file that went into a result."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from truenewton.errors import FormatError
from truenewton.files.fits import Sheet, ascii_text


@dataclass(frozen=True)
class UsedSource:
    """A file that went into a calibration: name, digest, rows used, rows rejected."""

    file: str
    sha256: str
    rows: int
    rejected: int


def sources_sheet(sources: tuple[UsedSource, ...], name: str = "SOURCES") -> Sheet:
    """Return the table of the files that went into a result."""
    files = [ascii_text(source.file) for source in sources]
    return Sheet(
        name,
        columns=(
            ("FILE", f"{max(map(len, files), default=1)}A", None, files),
            ("SHA256", "64A", None, [source.sha256 for source in sources]),
            ("ROWS", "J", None, [source.rows for source in sources]),
            ("REJECTED", "J", None, [source.rejected for source in sources]),
        ),
    )


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
