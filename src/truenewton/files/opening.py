"""Files that are opened for reading: plain ones alone, and no more of them than there may be."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import stat
import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from truenewton.errors import TrueNewtonError, UnreadableFile

GZIP = b"\x1f\x8b"
MOST_TEXT = 2**24  # bytes of what people write by hand
MOST_UNPACKED = 2**30  # bytes: what is gzipped is taken into memory whole
AT_ONCE = 2**22


def refuse_odd(path: str | os.PathLike[str]) -> None:
    """Refuse a pipe or a device; what is not there raises OSError.

    Raises
    ------
    UnreadableFile
    """
    mode = Path(path).stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise UnreadableFile("is a pipe or a device", remedy="give a file", path=path)


@contextlib.contextmanager
def open_plain(path: str | os.PathLike[str]) -> Iterator[BufferedReader]:
    """Open a file for reading bytes, if it is one.

    A named pipe would keep us waiting for its writer, and a device has no end.

    Raises
    ------
    UnreadableFile
        It cannot be opened or read, or is a folder, a pipe or a device.
    """
    try:
        refuse_odd(path)
        with Path(path).open("rb") as file:
            yield file
    except TrueNewtonError:
        raise
    except OSError as error:
        folder = isinstance(error, IsADirectoryError)
        raise UnreadableFile(
            f"cannot be read ({error.strerror or error})",
            remedy="give a file, not a folder" if folder else "check the path",
            path=path,
        ) from error


def read_text(path: str | os.PathLike[str]) -> str:
    """Return a text that somebody wrote, UTF-8.

    Raises
    ------
    UnreadableFile
        As `open_plain`; or it is no text, or far too long for one.
    """
    with open_plain(path) as file:
        raw = file.read(MOST_TEXT + 1)
    if len(raw) > MOST_TEXT:
        raise UnreadableFile(
            f"is longer than {MOST_TEXT >> 20} MB", remedy="give the text file", path=path
        )
    try:
        return raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise UnreadableFile(
            f"is not text ({error})", remedy="store it as UTF-8", path=path
        ) from error


def unpacked(raw: bytes, path: str | os.PathLike[str]) -> bytes:
    """Return what gzipped bytes hold, unless a few of them unpack to gigabytes.

    Raises
    ------
    UnreadableFile
    """
    whole = io.BytesIO()
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
            while part := file.read(AT_ONCE):
                whole.write(part)
                if whole.tell() > MOST_UNPACKED:
                    raise UnreadableFile(
                        f"unpacks to more than {MOST_UNPACKED >> 30} GB",
                        remedy="gunzip it: of a plain file not all is taken into memory",
                        path=path,
                    )
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise UnreadableFile(
            "is damaged or truncated", remedy="fetch it again", path=path
        ) from error
    return whole.getvalue()
