"""Rows of a table that stay in their file and are read in blocks whenever they are used."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import UnreadableFile

BLOCK_BYTES = 2**24  # of the rows that are taken at once
MAX_STRIDE = 4  # times a column's own width; beyond it the rest of a row is skipped, not read


def blocks(rows: int, row_bytes: int) -> list[slice]:
    """Cut rows into slices of `BLOCK_BYTES` at most, of one row at least."""
    step = max(1, BLOCK_BYTES // max(row_bytes, 1))
    return [slice(start, min(start + step, rows)) for start in range(0, rows, step)]


def runs(rows: NDArray[np.int64]) -> Iterator[slice]:
    """Cut (m,) numbers of rows into slices of those that follow each other."""
    edges = (np.flatnonzero(np.diff(rows) != 1) + 1).tolist()
    if len(rows):
        yield from map(slice, [0, *edges], [*edges, len(rows)])


def state_of(file: BufferedIOBase) -> tuple[int, int]:
    """Return size and time of change [ns] of an open file, which show whether it has changed."""
    status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


@dataclass(frozen=True, eq=False)
class StoredRows:
    """Vectors of one column, (N, n), left in an uncompressed file.

    Indexed by rows like an array, it gives float64 in SI units; ``np.asarray`` gives all of it.
    It uses reads and no memory map, whose pages would count as memory of this process.
    """

    path: str
    state: tuple[int, int]  # `state_of` the file when it was verified
    start: int  # bytes before the first vector
    stride: int  # bytes from one vector to the next
    shape: tuple[int, int]  # (N, n)
    stored: np.dtype[Any]  # type and byte order in the file
    in_unit: Callable[[Array], Array] = np.asarray  # converts stored values to the unit wanted
    chosen: NDArray[np.int64] | None = None  # (n,) which values of each vector; None for all
    # Results of `largest_in_rows`, by the bytes of its ``columns``, so that rows are read once.
    largest: dict[bytes, Array] = field(default_factory=dict, init=False, repr=False)

    dtype = np.dtype(np.float64)
    ndim = 2

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: int | slice | NDArray[Any] | list[int]) -> Array:
        at = np.arange(len(self))[rows]
        every = np.atleast_1d(at)
        try:
            with Path(self.path).open("rb") as file:
                values = self.values(file, every)
                changed = state_of(file) != self.state
        except UnreadableFile:
            raise
        except EOFError:
            changed = True
        except OSError as error:
            raise UnreadableFile(
                f"cannot be read any more ({error.strerror or error})",
                remedy="read the campaign again",
                path=self.path,
            ) from error
        if changed:
            raise UnreadableFile(
                "was changed while it was in use", remedy="read the campaign again", path=self.path
            )
        if self.chosen is not None:
            values = values[:, self.chosen - self.chosen[0]]
        values = self.in_unit(values.astype(np.float64, copy=False))
        return values if at.ndim else np.asarray(values[0])

    @property
    def span(self) -> tuple[int, int]:
        """First and last + 1 of the chosen values in a stored vector."""
        if self.chosen is None:
            return 0, self.shape[1]
        return int(self.chosen[0]), int(self.chosen[-1]) + 1

    def values(self, file: BufferedIOBase, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Read the `span` of some rows of the file, (rows, span); EOFError if it has changed."""
        first, end = self.span
        start = self.start + first * self.stored.itemsize
        return read_rows(file, start, self.stride, rows, end - first, self.stored)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("rows in a file become an array by copying only")
        return np.asarray(self[:], dtype=dtype)


Rows = Array | StoredRows


def columns_of(values: Rows, columns: NDArray[np.bool_]) -> Rows:
    """Return some columns, (N, n_chosen); stored rows stay in their file."""
    if not isinstance(values, StoredRows):
        return values[:, columns]
    at = np.flatnonzero(columns)
    chosen = at if values.chosen is None else values.chosen[at]
    some = replace(values, shape=(len(values), chosen.size), chosen=chosen)
    known = ((np.frombuffer(key, dtype=bool), found) for key, found in values.largest.items())
    some.largest.update((of[columns].tobytes(), v) for of, v in known if not (of & ~columns).any())
    return some


def largest_in_rows(values: Rows, columns: NDArray[np.bool_]) -> Array:
    """Return (N,) the largest magnitude of some columns in each row; NaN if one is NaN."""
    known = values.largest if isinstance(values, StoredRows) else {}
    key = columns.tobytes()
    if key not in known:
        largest = np.empty(len(values))
        for some in blocks(len(values), 8 * values.shape[1]):
            size = np.abs(values[some])
            largest[some] = (size if columns.all() else size[:, columns]).max(axis=1, initial=0.0)
        known[key] = largest
    return known[key]


def read_rows(
    file: BufferedIOBase,
    start: int,
    stride: int,
    at: NDArray[np.int64],
    width: int,
    stored: np.dtype[Any],
) -> NDArray[Any]:
    """Read (rows, width) values of a column, in native byte order; EOFError if the file is shorter.

    ``start`` and ``stride`` are the bytes before the column in row 0, and from row to row; ``at``
    are (rows,) numbers of rows, of which consecutive ones are read together.
    """
    values = np.empty((len(at), width), dtype=stored.newbyteorder("="))
    size = width * stored.itemsize
    if not size:
        return values
    together = 1 if stride > (MAX_STRIDE + 1) * size else max(1, BLOCK_BYTES // max(stride, 1))
    raw = bytearray(min(together, max(len(at), 1)) * stride + size)
    for run in runs(at):
        for row in range(run.start, run.stop, together):
            rows = min(together, run.stop - row)
            span = (rows - 1) * stride + size
            file.seek(start + int(at[row]) * stride)
            if file.readinto(memoryview(raw)[:span]) != span:
                raise EOFError
            values[row : row + rows] = np.ndarray(
                (rows, width), stored, buffer=raw, strides=(stride, stored.itemsize)
            )
    return values


FITS_BLOCK = 2880  # bytes


def long_rows(hdu: Any, path: str, state: tuple[int, int]) -> dict[str, StoredRows]:
    """Return the columns of plain floating-point vectors of a binary table (astropy), by name."""
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
