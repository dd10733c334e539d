"""Files that are copies of others, as a whole or in part: readings never repeat to the last bit."""

from __future__ import annotations

import hashlib
from collections import Counter
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import FoundEffect
from truenewton.records.campaign import Campaign

SHARE = 0.2  # of the rows compared that are identical
PRINTED = 48  # labels whose rows are compared
FEWEST = 2  # rows


class RowPrints:
    """Readings of one row of each file under some labels, SHAPE times SIGN, as digests.

    Parameters
    ----------
    codes
        (g,) labels of the groups of rows.

    Attributes
    ----------
    taken
        By file and label.
    """

    def __init__(self, codes: NDArray[np.int64]) -> None:
        labels = np.unique(codes)
        some = np.unique(np.linspace(0, len(labels) - 1, PRINTED).astype(np.int64))
        self._codes, self._chosen = codes, np.isin(codes, labels[some])
        self.taken: dict[tuple[int, int], bytes] = {}

    def take(self, file: int, groups: NDArray[np.int64], force: Array) -> None:
        """Take the prints of (m, n) rows of a file [N], which stand in (m,) groups."""
        for row in np.flatnonzero(self._chosen[groups]).tolist():
            digest = hashlib.sha1(force[row].tobytes(), usedforsecurity=False).digest()
            self.taken.setdefault((file, int(self._codes[groups[row]])), digest)


def copied_files(campaign: Campaign, prints: RowPrints) -> tuple[FoundEffect, ...]:
    """Name files that hold the readings of others: rows of the same SHAPE and SIGN, bit by bit.

    Nothing is said where even files of different origin repeat to the last bit: then there is no
    noise.

    Parameters
    ----------
    campaign, prints
        The files; prints of their rows.
    """
    cycles = campaign.cycles
    rows: list[dict[int, bytes]] = [{} for _ in cycles]
    for (file, code), readings in prints.taken.items():
        rows[file][code] = readings
    same = {}
    for one, other in combinations(range(len(cycles)), 2):
        common = rows[one].keys() & rows[other].keys()
        alike = sum(rows[one][code] == rows[other][code] for code in common)
        if alike >= max(min(FEWEST, len(common)), SHARE * len(common), 1):
            same[one, other] = alike / len(common)
    together = Counter(k == j for k, j in combinations(campaign.load_index, 2))[True]
    within = sum(campaign.load_index[k] == campaign.load_index[j] for k, j in same)
    if len(cycles) > 2 and 0 < together == within and not _one_file(campaign, same):
        return ()
    return tuple(
        FoundEffect(
            name="copy of another file",
            where=f"{cycles[other].name} of {cycles[one].name}",
            probability=0.0,
            size=share,
            unit="",
            corrected=False,
            remedy="leave the copy out: it holds no reading of its own",
        )
        for (one, other), share in same.items()
    )


def _one_file(campaign: Campaign, same: dict[tuple[int, int], float]) -> bool:
    """Tell whether files are the same to the last byte, as those without noise are not."""
    source = [cycle.source for cycle in campaign.cycles]
    return any(
        (a := source[k]) is not None and (b := source[j]) is not None and a.sha256 == b.sha256
        for k, j in same
    )
