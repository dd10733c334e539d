"""Tables whose vectors stay in their file: where they stand there, and the table without them."""

from __future__ import annotations

from collections.abc import Mapping
from io import BufferedIOBase
from typing import Any

import numpy as np

from truenewton.files.stored_rows import StoredRows, read_rows

FITS_BLOCK = 2880  # bytes


def long_rows(hdu: Any, path: str, state: tuple[int, int]) -> dict[str, StoredRows]:
    """Return the columns of plain floating-point vectors of a binary table, by name.

    Parameters
    ----------
    hdu
        The table (astropy), its data not yet read.
    path, state
        Its file, uncompressed, and what `state_of` says of it.
    """
    rows, stride, record = hdu.header["NAXIS2"], hdu.header["NAXIS1"], hdu.columns.dtype
    if hdu.header.get("PCOUNT", 0) or record.itemsize != stride:
        return {}
    vectors = {}
    for column in hdu.columns:
        values, offset = record.fields[column.name][:2]
        plain = column.bscale is None and column.bzero is None and column.dim is None
        if plain and values.base.kind == "f" and values.shape and values.shape[0] > 1:
            vectors[column.name] = StoredRows(
                path,
                state,
                hdu.fileinfo()["datLoc"] + offset,
                stride,
                (rows, *values.shape),
                values.base.newbyteorder(">"),
            )
    return vectors


def without_columns(stream: BufferedIOBase, hdu: Any, left: Mapping[str, StoredRows]) -> Any:
    """Return a table whose columns named in ``left`` have no values; only the others are read."""
    if not left:
        return hdu
    rows, stride, start = hdu.header["NAXIS2"], hdu.header["NAXIS1"], hdu.fileinfo()["datLoc"]
    header, others, end = hdu.header.copy(), [], 0
    for number, column in enumerate(hdu.columns, 1):
        if column.name in left:
            header[f"TFORM{number}"] = f"0{column.format[-1]}"
            others.append((end, left[column.name].start - start - end))
            end = left[column.name].start - start + hdu.columns.dtype[column.name].itemsize
    others.append((end, stride - end))
    every, byte = np.arange(rows), np.dtype(np.uint8)
    data = np.concatenate(
        [read_rows(stream, start + at, stride, every, width, byte) for at, width in others], axis=1
    )
    header["NAXIS1"] = data.shape[1]
    padding = bytes(-data.size % FITS_BLOCK)
    return type(hdu).fromstring(header.tostring().encode() + data.tobytes() + padding)
