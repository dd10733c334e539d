"""Raw samples, averaged to the rows of a cycle, some megabytes at a time.

Consecutive samples with the same SHAPE and SIGN are one row, their mean. Samples with SHAPE 0, or
that are not VALID, are taken between shapes and are not used. Samples of a control loop are
correlated, so the error of their mean is not their scatter over the root of their number: it is
estimated from the means of eight batches of each row (a bench uses four).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BufferedIOBase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.files import stored_rows
from truenewton.files.stored_rows import (
    Rows,
    StoredRows,
    columns_of,
    largest_in_rows,
    runs,
    state_of,
)

BATCHES = 8  # of a row; if it has fewer samples, each is a batch


@dataclass(frozen=True, eq=False)
class SampleMeans:
    """Means of the samples of each of N rows.

    Attributes
    ----------
    first, number
        (N,) first sample of each row, and how many.
    mean, variance
        (N, n) mean of the samples, and variance of one of them; NaN for single samples.
    of_mean
        (N, n) variance of the mean, from its batches; NaN for single samples.
    """

    first: NDArray[np.int64]
    number: NDArray[np.int64]
    mean: Array
    variance: Array
    of_mean: Array


@dataclass(frozen=True, eq=False)
class AveragedRows(StoredRows):
    """Means of samples that stay in their file, (N, n): averaged whenever they are used.

    ``samples`` are (m, n), converted; ``first`` and ``number`` as of `SampleMeans`.
    """

    samples: StoredRows = field(kw_only=True)
    first: NDArray[np.int64] = field(kw_only=True)
    number: NDArray[np.int64] = field(kw_only=True)

    def values(self, file: BufferedIOBase, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Average the `span` of some rows, (rows, span)."""
        if state_of(file) != self.state:
            raise EOFError
        spanned = np.zeros(self.samples.shape[1], dtype=bool)
        spanned[slice(*self.span)] = True
        samples = columns_of(self.samples, spanned)
        values = np.empty((len(rows), samples.shape[1]))
        for run in runs(rows):
            some = rows[run]
            values[run] = sample_means(samples, self.first[some], self.number[some]).mean
        return values


def left_in_file(samples: Rows, means: SampleMeans, counted: Iterable[NDArray[np.bool_]]) -> Rows:
    """Return the means of (m, n) samples in a file as rows that stay there, others as an array.

    The largest of each row is kept for each (n,) columns of ``counted``.
    """
    if not isinstance(samples, StoredRows):
        return means.mean
    rows = AveragedRows(
        samples.path, samples.state, 0, 0, means.mean.shape, samples.dtype,
        samples=samples, first=means.first, number=means.number,
    )  # fmt: skip
    rows.largest.update((of.tobytes(), largest_in_rows(means.mean, of)) for of in counted)
    return rows


def rows_of_samples(
    shape: NDArray[np.int64], sign: NDArray[np.int64], valid: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (N,) first sample and number of samples of each row, of (m,) samples."""
    counts = valid & (shape > 0)
    label = np.where(counts, 2 * shape + (sign > 0), 0)
    first = np.flatnonzero(np.diff(label, prepend=label[:1] - 1))
    number = np.diff(first, append=len(label))
    some = counts[first]
    if not some.any():
        raise FormatError(
            "SAMPLES has no valid sample of a shape",
            remedy="count shapes from 1 in SHAPE; 0 is for samples between shapes",
        )
    return first[some], number[some]


def sample_means(values: Rows, first: NDArray[np.int64], number: NDArray[np.int64]) -> SampleMeans:
    """Average (m, n) samples; ``first`` and ``number`` (N,) as of `rows_of_samples`."""
    n = values.shape[1]
    batches = np.minimum(BATCHES, number)
    mean, within, between = np.zeros((3, len(first), n))
    count = np.zeros(len(first))
    for of_row, start, size in _batches(first, number, batches, 8 * n):
        begin, end = int(start[0]), int(start[-1] + size[-1])
        some = values[begin:end]
        edges = np.column_stack([start, start + size]).ravel() - begin
        edges = edges[:-1] if edges[-1] == len(some) else edges
        part = np.add.reduceat(some, edges, axis=0)[::2] / size[:, None]
        inside = np.repeat(np.arange(len(size)), size)
        at = np.arange(len(inside)) + np.repeat(start - begin - np.cumsum(size) + size, size)
        apart = some[at] - part[inside]
        apart *= apart
        scatter = np.add.reduceat(apart, np.cumsum(size) - size, axis=0)
        turn = np.arange(len(of_row)) - np.searchsorted(of_row, of_row)
        for k in range(int(turn.max()) + 1):  # a batch of every row at a time
            these = turn == k
            row, weight = of_row[these], size[these].astype(np.float64)
            total = count[row] + weight
            step = part[these] - mean[row]
            mean[row] += (weight / total)[:, None] * step
            between[row] += (count[row] * weight / total)[:, None] * step**2
            within[row] += scatter[these]
            count[row] = total
    lone = number[:, None] < 2
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.where(lone, np.nan, (within + between) / (number[:, None] - 1))
        of_mean = np.where(lone, np.nan, between / ((batches - 1) * number)[:, None])
    return SampleMeans(first, number, mean, variance, of_mean)


def _batches(
    first: NDArray[np.int64], number: NDArray[np.int64], batches: NDArray[np.int64], wide: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the batches that are read at once: their rows, first samples and numbers."""
    of_row = np.repeat(np.arange(len(first)), batches)
    k = np.arange(len(of_row)) - np.repeat(np.cumsum(batches) - batches, batches)
    edges = [(k + more) * number[of_row] // batches[of_row] for more in (0, 1)]
    start, size = first[of_row] + edges[0], edges[1] - edges[0]
    most = max(1, stored_rows.BLOCK_BYTES // wide)
    begin = 0
    while begin < len(of_row):
        end = int(np.searchsorted(start + size, start[begin] + most, side="right"))
        end = max(end, begin + 1)
        yield of_row[begin:end], start[begin:end], size[begin:end]
        begin = end
