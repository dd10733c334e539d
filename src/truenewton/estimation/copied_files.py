"""Files that are copies of others, as a whole or in part: readings never repeat to the last bit."""

from __future__ import annotations

from itertools import combinations

from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.row_prints import RowPrints
from truenewton.records.campaign import Campaign

SHARE = 0.2  # of the rows compared that are identical
NEARLY_ALL = 0.9  # of them, where readings come in steps
FEWEST = 2  # rows
BY_CHANCE = 4.0  # times as many as between those files under one load that share the fewest


def copied_files(
    campaign: Campaign, prints: RowPrints, *, in_steps: bool = False
) -> tuple[Finding, ...]:
    """Name files that hold the readings of others: rows of the same SHAPE and SIGN, bit by bit.

    Of files under one load nothing is said where even those of different origin repeat to the last
    bit: then there is no noise, or less than rounding hides.

    Parameters
    ----------
    campaign, prints
        The files; prints of their rows.
    in_steps
        Whether readings come in steps, so that rows may be alike by chance.
    """
    cycles = campaign.cycles
    rows: list[dict[int, bytes]] = [{} for _ in cycles]
    for (file, code), readings in prints.taken.items():
        rows[file][code] = readings
    same, by_chance = dict[tuple[int, int], float](), list[float]()
    share = NEARLY_ALL if in_steps else SHARE
    for one, other in combinations(range(len(cycles)), 2):
        common = rows[one].keys() & rows[other].keys()
        alike = sum(rows[one][code] == rows[other][code] for code in common)
        if common and campaign.load_index[one] == campaign.load_index[other]:
            by_chance.append(alike / len(common))
        if alike >= max(min(FEWEST, len(common)), share * len(common), 1):
            same[one, other] = alike / len(common)
    if by_chance and len(cycles) > 2 and not _one_file(campaign, same):
        usual = BY_CHANCE * min(by_chance)
        same = {
            (one, other): alike
            for (one, other), alike in same.items()
            if alike > usual or campaign.load_index[one] != campaign.load_index[other]
        }
    return tuple(
        Finding(
            code=Code.COPIED_FILE,
            where=f"{cycles[other].name} of {cycles[one].name}",
            size=alike,
            remedy="restore the original of the copy, or remove it",
        )
        for (one, other), alike in same.items()
    )


def _one_file(campaign: Campaign, same: dict[tuple[int, int], float]) -> bool:
    """Tell whether files are the same to the last byte, as those without noise are not."""
    source = [cycle.source for cycle in campaign.cycles]
    return any(
        (a := source[k]) is not None and (b := source[j]) is not None and a.sha256 == b.sha256
        for k, j in same
    )
