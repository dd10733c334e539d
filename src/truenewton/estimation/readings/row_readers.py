"""The second reading of the rows, shared by all that need it, and fingerprints of some rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Some of the rows of a cycle that count, m of them, which follow each other.

    Attributes
    ----------
    cycle_index, cycle
        The cycle in its campaign.
    rows, last
        Which of its rows that count; whether these are the last of them.
    force
        (m, n) commanded forces of the enabled actuators [N].
    """

    cycle_index: int
    cycle: Cycle
    rows: slice
    last: bool
    force: Array

    @cached_property
    def position(self) -> Array:
        """(m, n) readings of the sensors [m], read on first use."""
        if self.cycle.position is None:
            raise ValueError(f"{self.cycle!r} holds no POSITION")
        return self.cycle.used(self.cycle.position, self.rows)


RowReader = Callable[[RowBlock], None]


def read_rows(campaign: Campaign, readers: Sequence[RowReader]) -> None:
    """Read the rows that count once: cycle after cycle, some megabytes at a time."""
    for k, cycle in enumerate(campaign.cycles):
        count = int(cycle.valid.sum())
        for rows in cycle.used_blocks():
            block = RowBlock(k, cycle, rows, rows.stop == count, cycle.used(cycle.force, rows))
            for take in readers:
                take(block)


def common_labels(codes: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return (m,) some of the labels that all files have, given (N,) those of the rows of each."""
    return _some(reduce(np.intersect1d, codes))


def _some(labels: NDArray[np.int64], most: int = 16) -> NDArray[np.int64]:
    """Return at most so many of (m,) labels, evenly from the first to the last."""
    last = len(labels) - 1
    return labels[np.unique(np.linspace(0, last, most if last >= 0 else 0).astype(np.int64))]


class RowPrints:
    """Fingerprints of one row of each file under some labels, SHAPE times SIGN.

    Parameters
    ----------
    codes
        (g,) labels of the groups of rows.

    Attributes
    ----------
    labels
        (m,) those of which prints are taken.
    taken
        Digests by file and label.
    longest
        By file (n,) how many rows after each other repeat the reading before, bit by bit.
    limit, at_limit
        By file (n,) the largest magnitude of a reading [N], and how many of the rows have it.
    readings
        (n,) those of some of the rows [N], by file and label.
    of_first
        (n,) readings of the rows of one file [N].
    """

    def __init__(self, codes: NDArray[np.int64]) -> None:
        self.labels = _some(np.unique(codes), 48)
        self._kept = {*_some(self.labels).tolist()}  # rows of each file that are kept
        self._before = dict[int, Array]()
        self.taken: dict[tuple[int, int], bytes] = {}
        self._run: dict[int, NDArray[np.int64]] = {}
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
        """Return the number of rows of a file of which prints were taken."""
        return sum(of == file for of, _ in self.taken)

    def take(self, file: int, codes: NDArray[np.int64], force: Array) -> None:
        """Take the prints of (m, n) rows of a file [N], which have (m,) of the labels."""
        for code, readings in zip(codes.tolist(), force, strict=True):
            key = file, code
            if key in self.taken:
                continue
            if code in self._kept:
                self.readings[key] = readings.astype(np.float32)
            self.taken[key] = hashlib.sha1(readings.tobytes(), usedforsecurity=False).digest()
            if file not in self._before:
                self._run[file], self.longest[file] = np.zeros((2, len(readings)), np.int64)
                self.at_limit[file] = np.zeros(len(readings), np.int64)
                self.limit[file] = np.zeros(len(readings))
            else:
                run = np.where(readings == self._before[file], self._run[file] + 1, 0)
                self._run[file], self.longest[file] = run, np.maximum(self.longest[file], run)
            self._before[file], size, limit = readings.copy(), np.abs(readings), self.limit[file]
            at_limit = self.at_limit[file] + (size == limit)
            self.at_limit[file] = np.where(size > limit, 1, at_limit)
            self.limit[file] = np.maximum(size, limit)
            if file == next(iter(self._before)):
                self.of_first.append(self._before[file])
