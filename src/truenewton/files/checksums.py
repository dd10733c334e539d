"""CHECKSUM and DATASUM of FITS files, held against their bytes (FITS standard, appendix J)."""

from __future__ import annotations

from io import BufferedIOBase
from typing import Any

import numpy as np

from truenewton.errors import UnreadableFile
from truenewton.files.stored_rows import blocks


def verify_checksums(stream: BufferedIOBase, hdu: Any, path: str) -> None:
    """Compare CHECKSUM and DATASUM, where they stand, with the bytes as they are on disk.

    Astropy sums what it would write itself, and so misses damage to the padding.

    Raises
    ------
    UnreadableFile
        One does not match.
    """
    whole, wanted = hdu.header.get("CHECKSUM"), hdu.header.get("DATASUM")
    if not (whole or wanted):
        return
    at = hdu.fileinfo()
    of_data = _sum32(stream, at["datLoc"], at["datSpan"])
    total = _folded(_sum32(stream, at["hdrLoc"], at["datLoc"] - at["hdrLoc"]) + of_data)
    if (whole and total != 0xFFFFFFFF) or (wanted and str(of_data) != str(wanted).strip()):
        raise UnreadableFile(
            "a CHECKSUM or DATASUM does not match",
            remedy="the file was changed or damaged: fetch it again",
            path=path,
        )


def _sum32(stream: BufferedIOBase, start: int, length: int) -> int:
    """Return the sum of 32-bit words in ones' complement."""
    stream.seek(start)
    total = 0
    for some in blocks(length // 4, 4):  # of whole words
        words = np.frombuffer(stream.read(4 * (some.stop - some.start)), dtype=">u4")
        total += int(words.sum(dtype=np.uint64))
    return _folded(total)


def _folded(total: int) -> int:
    """Return a sum in ones' complement of 32 bits: what overflows comes in again below."""
    return (total - 1) % 0xFFFFFFFF + 1 if total else 0
