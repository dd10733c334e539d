"""Files that are opened for reading: plain ones alone, and no more of them than there may be.

A damaged FITS header may declare 2^63 axes, rows or columns, over which a FITS reader works for
minutes or asks for all memory. So what headers say of the size of a file is compared with it first
(FITS Standard 4.0, sections 3.1, 4.4 and 7.3), and CHECKSUM and DATASUM with its bytes
(appendix J).
"""

from __future__ import annotations

import contextlib
import gzip
import io
import math
import os
import re
import stat
import zlib
from collections.abc import Iterator
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile, naming
from truenewton.files.stored_rows import blocks

GZIP = b"\x1f\x8b"
MAX_TEXT_BYTES = 2**24  # bytes of what people write by hand
MAX_UNPACKED_BYTES = 2**30  # bytes: what is gzipped is taken into memory whole
CHUNK_BYTES = 2**22
BLOCK, CARD = 2880, 80  # bytes
MAX_HEADER_BLOCKS = 2000  # of one header: 72,000 cards
MAX_COLUMNS = 999  # the standard's limit
TABLE_BYTES = {b"L": 1, b"B": 1, b"A": 1, b"I": 2, b"J": 4, b"E": 4,
               b"K": 8, b"D": 8, b"C": 8, b"P": 8, b"M": 16, b"Q": 16}  # fmt: skip
TABLE_FORMAT = re.compile(rb"\s*'\s*(\d{0,18})([LXBIJKAEDCMPQ])")
NUMBER = re.compile(rb"\s*([+-]?\d{1,19})\s*(?:/|$)")


def refuse_odd(path: str | os.PathLike[str]) -> None:
    """Refuse a pipe or a device; what is not there raises OSError."""
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


def unpacked(raw: bytes) -> bytes:
    """Return what gzipped bytes hold, unless a few of them unpack to gigabytes."""
    whole = io.BytesIO()
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
            while part := file.read(CHUNK_BYTES):
                whole.write(part)
                if whole.tell() > MAX_UNPACKED_BYTES:
                    raise UnreadableFile(
                        f"unpacks to more than {MAX_UNPACKED_BYTES >> 30} GB",
                        remedy="gunzip it: of a plain file not all is taken into memory",
                    )
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise UnreadableFile("is damaged or truncated", remedy="fetch it again") from error
    return whole.getvalue()


def check_sizes(stream: BufferedIOBase) -> None:
    """Refuse a file whose headers declare more than there is in it."""
    end = stream.seek(0, 2)
    start, index = 0, 0
    while start + BLOCK <= end:
        stream.seek(start)
        header = _header(stream)
        part = (
            header.get(b"EXTNAME", b"").partition(b"/")[0].strip(b" '").decode("ascii", "replace")
        )
        part = part or f"part {index}"
        size = _data_size(header, part)
        start = stream.tell() + -(-size // BLOCK) * BLOCK
        if stream.tell() + size > end:
            raise UnreadableFile(
                f"is truncated, or damaged: {part} declares {size} bytes of data, and"
                f" {end - stream.tell()} follow",
                remedy="fetch it again",
            )
        index += 1
    stream.seek(0)


def _header(stream: BufferedIOBase) -> dict[bytes, bytes]:
    """Return what stands behind each keyword of the header that begins here."""
    values: dict[bytes, bytes] = {}
    for _ in range(MAX_HEADER_BLOCKS):
        block = stream.read(BLOCK)
        for first in range(0, len(block), CARD):
            card = block[first : first + CARD]
            if card.rstrip() == b"END":
                return values
            values.setdefault(card[:8].rstrip(), card[10:])
        if len(block) < BLOCK:
            break
    raise UnreadableFile("is damaged: a header does not end", remedy="fetch the file again")


def _data_size(header: dict[bytes, bytes], part: str) -> int:
    """Return the bytes of data that follow a header, |BITPIX| GCOUNT (PCOUNT + product of axes)."""

    def number(key: str, default: int | None, lowest: int, highest: int) -> int:
        card = header.get(key.encode())
        written: Any = default if card is None else NUMBER.match(card)
        value = int(written[1]) if isinstance(written, re.Match) else written
        if value is None or not lowest <= value <= highest:
            said = b"missing" if card is None else card.split(b"/")[0].strip()
            raise UnreadableFile(
                f"is damaged: {key} of {part} is {said.decode('ascii', 'replace')}",
                remedy="fetch the file again",
            )
        return int(value)

    count = number("NAXIS", None, 0, 999)
    axes = [number(f"NAXIS{k}", None, 0, 2**63 - 1) for k in range(1, 1 + count)]
    bits = abs(number("BITPIX", None, -64, 64))
    if b"TFIELDS" in header and header.get(b"XTENSION", b"").startswith(b"'BINTABLE"):
        columns = number("TFIELDS", None, 0, 2**63 - 1)
        if columns > MAX_COLUMNS:
            raise FormatError(f"{part} has over {MAX_COLUMNS} columns", remedy="leave some out")
        formats = [header.get(b"TFORM%d" % k, b"") for k in range(1, columns + 1)]
        widths = [_width(each) for each in map(TABLE_FORMAT.match, formats) if each]
        if len(widths) < columns or not axes or sum(widths) != axes[0]:
            raise UnreadableFile(
                f"is damaged: the columns of {part} do not make its rows",
                remedy="fetch the file again",
            )
    if header.get(b"ZIMAGE", b"").split(b"/")[0].strip() == b"T":  # tiles that are compressed
        unpacked = [number(f"ZNAXIS{k}", None, 0, 2**63 - 1)
                    for k in range(1, 1 + number("ZNAXIS", None, 0, 999))]  # fmt: skip
        if math.prod(unpacked) * abs(number("ZBITPIX", None, -64, 64)) // 8 > MAX_UNPACKED_BYTES:
            raise UnreadableFile(
                f"{part} unpacks to more than {MAX_UNPACKED_BYTES >> 30} GB",
                remedy="store it as a plain image",
            )
    product = math.prod(axes) if axes else 0
    return bits // 8 * number("GCOUNT", 1, 0, 2**31) * (number("PCOUNT", 0, 0, 2**63 - 1) + product)


def _width(column: re.Match[bytes]) -> int:
    """Return the bytes of a column in a row, from its TFORM."""
    count = int(column[1] or 1)
    return -(-count // 8) if column[2] == b"X" else count * TABLE_BYTES[column[2]]


def verify_checksums(stream: BufferedIOBase, hdu: Any) -> None:
    """Compare CHECKSUM and DATASUM, where they stand, with the bytes as they are on disk.

    Astropy sums what it would write itself, and so misses damage to the padding.
    """
    whole, wanted = hdu.header.get("CHECKSUM"), hdu.header.get("DATASUM")
    if not (whole or wanted):
        return
    at = hdu.fileinfo()
    of_data = _sum32(stream, at["datLoc"], at["datSpan"])
    of_header = _sum32(stream, at["hdrLoc"], at["datLoc"] - at["hdrLoc"])
    total = (of_header + of_data) % 0xFFFFFFFF  # 0 stands for all ones, too
    if (whole and total) or (wanted and str(of_data) != str(wanted).strip()):
        raise UnreadableFile(
            "a CHECKSUM or DATASUM does not match",
            remedy="the file was changed or damaged: fetch it again",
        )


def _sum32(stream: BufferedIOBase, start: int, length: int) -> int:
    """Return the sum of 32-bit words in ones' complement."""
    stream.seek(start)
    total = 0
    for some in blocks(length // 4, 4):  # of whole words
        words = np.frombuffer(stream.read(4 * (some.stop - some.start)), dtype=">u4")
        total += int(words.sum(dtype=np.uint64))
    return (total - 1) % 0xFFFFFFFF + 1 if total else 0  # what overflows comes in again below
