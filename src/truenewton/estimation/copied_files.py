"""Files that are copies of others, as a whole or in part: readings never repeat to the last bit."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np

from truenewton.estimation.diagnosis import FoundEffect
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle

LABELS = 48  # SHAPE times SIGN whose rows are compared
SHARE = 0.2  # of these that are identical
FEWEST = 2  # rows


def copied_files(campaign: Campaign) -> tuple[FoundEffect, ...]:
    """Name files that hold the readings of others: rows of the same SHAPE and SIGN, bit by bit.

    Nothing is said where even files of different origin repeat to the last bit: then there is no
    noise.
    """
    cycles = campaign.cycles
    codes = np.unique(np.concatenate([c.shape[c.valid] * c.sign[c.valid] for c in cycles]))
    chosen = codes[np.unique(np.linspace(0, len(codes) - 1, LABELS).astype(np.int64))]
    rows = [_rows_of(cycle, chosen.tolist()) for cycle in cycles]
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


def _rows_of(cycle: Cycle, chosen: list[int]) -> dict[int, bytes]:
    """Return the readings of the first row of each chosen SHAPE times SIGN."""
    codes = cycle.shape[cycle.valid] * cycle.sign[cycle.valid]
    labels, first = np.unique(codes, return_index=True)
    wanted = np.isin(labels, chosen)
    order = np.argsort(first[wanted])
    rows = cycle.used(cycle.force, first[wanted][order])
    return {
        int(code): np.ascontiguousarray(row).tobytes()
        for code, row in zip(labels[wanted][order], rows, strict=True)
    }
