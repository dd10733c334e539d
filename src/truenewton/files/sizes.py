"""What the headers of a FITS file say of its size, before anything is read by it.

A damaged header may declare 2^63 axes, rows or columns, over which a FITS reader works for minutes
or asks for all memory. FITS Standard 4.0, sections 3.1, 4.4 and 7.3.
"""

from __future__ import annotations

import math
import re
from io import BufferedIOBase
from typing import Any

from truenewton.errors import FormatError, UnreadableFile
from truenewton.files.opening import MOST_UNPACKED

BLOCK, CARD = 2880, 80  # bytes
MOST_BLOCKS = 2000  # of one header: 72,000 cards
MOST_COLUMNS = 999  # the standard's limit
TABLE_BYTES = {b"L": 1, b"B": 1, b"A": 1, b"I": 2, b"J": 4, b"E": 4,
               b"K": 8, b"D": 8, b"C": 8, b"P": 8, b"M": 16, b"Q": 16}  # fmt: skip
TABLE_FORMAT = re.compile(rb"\s*'\s*(\d{0,18})([LXBIJKAEDCMPQ])")
NUMBER = re.compile(rb"\s*([+-]?\d{1,19})\s*(?:/|$)")


def check_sizes(stream: BufferedIOBase, path: str) -> None:
    """Refuse a file whose headers declare more than there is in it.

    Raises
    ------
    UnreadableFile
        A header without an end, sizes that the file does not have.
    FormatError
        A table of over 999 columns.
    """
    end = stream.seek(0, 2)
    start, index = 0, 0
    while start + BLOCK <= end:
        stream.seek(start)
        header = _header(stream, path)
        part = (
            header.get(b"EXTNAME", b"").partition(b"/")[0].strip(b" '").decode("ascii", "replace")
        )
        part = part or f"part {index}"
        size = _data_size(header, part, path)
        start = stream.tell() + -(-size // BLOCK) * BLOCK
        if stream.tell() + size > end:
            raise UnreadableFile(
                f"is truncated, or damaged: {part} declares {size} bytes of data, and"
                f" {end - stream.tell()} follow",
                remedy="fetch it again",
                path=path,
            )
        index += 1
    stream.seek(0)


def _header(stream: BufferedIOBase, path: str) -> dict[bytes, bytes]:
    """Return what stands behind each keyword of the header that begins here."""
    values: dict[bytes, bytes] = {}
    for _ in range(MOST_BLOCKS):
        block = stream.read(BLOCK)
        for first in range(0, len(block), CARD):
            card = block[first : first + CARD]
            if card.rstrip() == b"END":
                return values
            values.setdefault(card[:8].rstrip(), card[10:])
        if len(block) < BLOCK:
            break
    raise UnreadableFile(
        "is damaged: a header does not end", remedy="fetch the file again", path=path
    )


def _data_size(header: dict[bytes, bytes], part: str, path: str) -> int:
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
                path=path,
            )
        return int(value)

    count = number("NAXIS", None, 0, 999)
    axes = [number(f"NAXIS{k}", None, 0, 2**63 - 1) for k in range(1, 1 + count)]
    bits = abs(number("BITPIX", None, -64, 64))
    if b"TFIELDS" in header and header.get(b"XTENSION", b"").startswith(b"'BINTABLE"):
        columns = number("TFIELDS", None, 0, 2**63 - 1)
        if columns > MOST_COLUMNS:
            raise FormatError(
                f"{part} has over {MOST_COLUMNS} columns",
                remedy="leave some out",
                path=path,
            )
        formats = [header.get(b"TFORM%d" % k, b"") for k in range(1, columns + 1)]
        widths = [_width(each) for each in map(TABLE_FORMAT.match, formats) if each]
        if len(widths) < columns or not axes or sum(widths) != axes[0]:
            raise UnreadableFile(
                f"is damaged: the columns of {part} do not make its rows",
                remedy="fetch the file again",
                path=path,
            )
    if header.get(b"ZIMAGE", b"").split(b"/")[0].strip() == b"T":  # tiles that are compressed
        unpacked = [number(f"ZNAXIS{k}", None, 0, 2**63 - 1)
                    for k in range(1, 1 + number("ZNAXIS", None, 0, 999))]  # fmt: skip
        if math.prod(unpacked) * abs(number("ZBITPIX", None, -64, 64)) // 8 > MOST_UNPACKED:
            raise UnreadableFile(
                f"{part} unpacks to more than {MOST_UNPACKED >> 30} GB",
                remedy="store it as a plain image",
                path=path,
            )
    product = math.prod(axes) if axes else 0
    return bits // 8 * number("GCOUNT", 1, 0, 2**31) * (number("PCOUNT", 0, 0, 2**63 - 1) + product)


def _width(column: re.Match[bytes]) -> int:
    """Return the bytes of a column in a row, from its TFORM."""
    count = int(column[1] or 1)
    return -(-count // 8) if column[2] == b"X" else count * TABLE_BYTES[column[2]]
