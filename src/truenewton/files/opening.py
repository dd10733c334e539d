"""Files that are opened for reading: plain files only, texts, and what gzipped bytes contain."""

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

from truenewton.errors import TrueNewtonError, UnreadableFile, naming

GZIP = b"\x1f\x8b"
MAX_TEXT_BYTES = 2**24  # bytes of what people write by hand
MAX_UNPACKED_BYTES = 2**30  # bytes that a compressed file may fill in memory
CHUNK_BYTES = 2**22


def refuse_odd(path: str | os.PathLike[str]) -> None:
    """Refuse a pipe or a device; a missing file raises OSError."""
    mode = Path(path).stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise UnreadableFile("is a pipe or a device", remedy="give a file", path=path)


@contextlib.contextmanager
def open_plain(path: str | os.PathLike[str]) -> Iterator[BufferedReader]:
    """Open a file for reading bytes, if it is one.

    A named pipe would keep us waiting for its writer, and a device has no end. Errors of the block
    name the file.
    """
    with naming(path):
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
            ) from error


def read_text(path: str | os.PathLike[str]) -> str:
    """Return a text that somebody wrote, UTF-8."""
    with open_plain(path) as file:
        raw = file.read(MAX_TEXT_BYTES + 1)
        if len(raw) > MAX_TEXT_BYTES:
            fault = f"is longer than {MAX_TEXT_BYTES >> 20} MB"
            raise UnreadableFile(fault, remedy="give the text file")
        try:
            return raw.decode("utf-8").replace("\r\n", "\n")
        except UnicodeDecodeError as error:
            raise UnreadableFile(f"is not text ({error})", remedy="store it as UTF-8") from error


def refuse_too_large(size: int, path: str | os.PathLike[str], part: str = "") -> None:
    """Refuse to take so many bytes into memory, as declared by a file that is much smaller."""
    if size > max(MAX_UNPACKED_BYTES, Path(path).stat().st_size):
        raise UnreadableFile(
            f"{part} unpacks to {size / 2**30:.1f} GB, more than the allowed 1 GB".lstrip(),
            remedy="store it uncompressed, or only the part that is needed",
        )


def unpacked(raw: bytes, path: str) -> bytes:
    """Return what gzipped bytes contain, if that is not too large."""
    whole = io.BytesIO()
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
            while part := file.read(CHUNK_BYTES):
                whole.write(part)
                refuse_too_large(whole.tell(), path)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise UnreadableFile("is damaged or truncated", remedy="fetch it again") from error
    return whole.getvalue()
