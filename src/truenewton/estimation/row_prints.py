"""Prints of some rows: that copies of them are known, readings that freeze, and rounding."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from functools import partial, reduce

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.block_rows import BlockRows

PRINTED = 48  # labels whose rows are looked at
KEPT = 16  # labels whose rows are kept, of each file


def common_labels(codes: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return (m,) some of the labels that all files have, given (N,) those of the rows of each."""
    return _some(reduce(np.intersect1d, codes), KEPT)


def _some(labels: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return so many of (m,) labels at most, from the first to the last."""
    return labels[np.unique(np.linspace(0, max(len(labels) - 1, 0), most).astype(np.int64))]


class RowPrints:
    """Readings of one row of each file under some labels, SHAPE times SIGN.

    Attributes
    ----------
    taken
        Digests by file and label.
    longest
        By file (n,) how many rows after each other repeat the reading before, bit by bit.
    limit, at_limit
        By file (n,) the largest magnitude of a reading [N], and how many of the rows have it.
    readings
        (n,) those of some of the rows [N], by file and label.
    of_first
        (n,) readings of the rows of the first file [N].
    """

    def __init__(self) -> None:
        self.taken: dict[tuple[int, int], bytes] = {}
        self.longest: dict[int, NDArray[np.int64]] = {}
        self.limit: dict[int, Array] = {}
        self.at_limit: dict[int, NDArray[np.int64]] = {}
        self.of_first: list[Array] = []
        self.readings: dict[tuple[int, int], NDArray[np.float32]] = {}

    def common_rows(self) -> NDArray[np.float32]:
        """Return (files, m, n) readings under the labels that all files have [N]."""
        files = range(1 + max(file for file, _ in self.taken))
        codes = [np.array([code for of, code in self.readings if of == file]) for file in files]
        chosen = common_labels(codes).tolist()
        return np.array([[self.readings[file, code] for code in chosen] for file in files])

    def rows(self, file: int) -> int:
        """Return how many rows of a file were looked at."""
        return sum(of == file for of, _ in self.taken)

    def take(self, file: int, codes: NDArray[np.int64], force: Array, kept: set[int]) -> None:
        """Take the prints of the rows of a file.

        Parameters
        ----------
        file
            Which one.
        codes, force
            (m,) labels; (m, n) readings [N].
        kept
            Labels whose readings are kept.
        """
        run = np.zeros(force.shape[1], np.int64)
        self.longest[file] = run
        for row, (code, readings) in enumerate(zip(codes.tolist(), force, strict=True)):
            if code in kept:
                self.readings[file, code] = readings.astype(np.float32)
            digest = hashlib.sha1(readings.tobytes(), usedforsecurity=False).digest()
            self.taken[file, code] = digest
            if row:
                run = np.where(readings == force[row - 1], run + 1, 0)
                self.longest[file] = np.maximum(self.longest[file], run)
        size = np.abs(force)
        self.limit[file] = size.max(axis=0)
        self.at_limit[file] = np.count_nonzero(size == self.limit[file], axis=0)
        if file == 0:
            self.of_first = list(force)


def printed(codes: NDArray[np.int64]) -> Callable[[tuple[BlockRows, NDArray[np.int64]]], RowPrints]:
    """Return what takes the prints of rows of one file, given (g,) labels of all groups.

    It takes rows that stand in no group twice, and their (m,) labels.
    """
    labels = _some(np.unique(codes), PRINTED)
    return partial(_prints_of, labels=labels, kept=_some(labels, KEPT))


def _prints_of(
    rows: tuple[BlockRows, NDArray[np.int64]],
    labels: NDArray[np.int64],
    kept: NDArray[np.int64],
) -> RowPrints:
    every, codes = rows
    chosen, prints = np.isin(codes, labels), RowPrints()
    if chosen.any():
        force = every.without(~chosen).read()[0]
        prints.take(every.cycle_index, codes[chosen], force, {*kept.tolist()})
    return prints


def together(files: Iterable[RowPrints]) -> RowPrints:
    """Put the prints of all files together."""
    every = RowPrints()
    for prints in files:
        every.taken |= prints.taken
        every.longest |= prints.longest
        every.limit |= prints.limit
        every.at_limit |= prints.at_limit
        every.readings |= prints.readings
        every.of_first += prints.of_first
    return every
