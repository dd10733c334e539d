"""Readings that stand still: frozen, for a while or all the time, or cut off at a limit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding, about_actuators
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.estimation.screening.hypotheses import named_files
from truenewton.records.campaign import Campaign

MIN_FROZEN_ROWS = 3  # rows
MIN_FROZEN_FRACTION = 0.1  # of the rows of a file, one after the other
MAX_FROZEN_ACTUATORS = (
    0.03  # of the actuators: where more readings stand still, shapes do not reach them
)


def frozen_readings(campaign: Campaign, prints: RowPrints) -> Iterator[Finding]:
    """Name readings that do not change from shape to shape in a file, where the others do.

    One that is the same in all files is `inputs.constant_actuators`'.
    """
    whole = [prints.longest[file] == prints.rows(file) - 1 for file in prints.longest]
    constant = np.logical_and.reduce(whole)
    for file, longest in sorted(prints.longest.items()):
        name, still = campaign.cycles[file].name, _stand_still(prints, file)
        share, frozen = longest / prints.rows(file), np.flatnonzero(still & ~constant)
        if still.all() and not constant.all():
            where, size = f"all actuators in {name}", float(share.min())
            yield Finding(code=Code.FROZEN_READINGS, where=where, size=size)
        elif frozen.size <= max(1, MAX_FROZEN_ACTUATORS * still.size):
            for i in frozen.tolist():
                where, size = f"{{}} in {name}", float(share[i])
                yield about_actuators(campaign.layout, Code.FROZEN_READING, [i], where, size=size)


def _stand_still(prints: RowPrints, file: int) -> NDArray[np.bool_]:
    """Tell which of (n,) readings of a file stand still, but not at a limit of several."""
    longest, common = prints.longest[file], _at_common_limit(prints, file)
    at_limit = common & (np.count_nonzero(common) > 1) & (prints.at_limit[file] > longest)
    least = max(MIN_FROZEN_ROWS, MIN_FROZEN_FRACTION * prints.rows(file))
    return np.asarray((longest >= least) & ~at_limit)


def _at_common_limit(prints: RowPrints, file: int) -> NDArray[np.bool_]:
    """Tell which of (n,) readings of a file reach the largest of all."""
    limit = prints.limit[file]
    return np.asarray(limit == limit.max(initial=0.0))


def clipped_readings(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Name readings that end at a limit, which several shapes reach to the last bit.

    A limit is no fault where the force ends there as well: it is one where data do not fit.
    """
    clipped, largest = np.zeros(int(campaign.layout.enabled.sum()), dtype=bool), 0.0
    for file, limit in prints.limit.items():
        count, common = prints.at_limit[file], _at_common_limit(prints, file)
        here = (count >= MIN_FROZEN_ROWS) | (common & (count[common].sum() >= MIN_FROZEN_ROWS))
        here &= (limit > 0.0) & ~_stand_still(prints, file)
        clipped |= here
        largest = max(largest, float(limit[here].max(initial=0.0)))
    if not clipped.any() or _few_valued(prints):
        return ()
    where, size = f"{{}}, at {largest:.4g} N", float(clipped.mean())
    return (about_actuators(campaign.layout, Code.CLIPPED_READINGS, clipped, where, size=size),)


def _few_valued(prints: RowPrints) -> bool:
    """Tell whether readings have but few values, as where shapes are commanded in levels."""
    ordered = np.sort(np.abs(prints.of_first), axis=0)
    rest = ordered < ordered[-1:]
    distinct = (np.diff(ordered, axis=0) > 0.0) & rest[1:]
    return bool(np.median(distinct.sum(axis=0) / np.maximum(rest.sum(axis=0), 1)) < 0.5)


def still_sensors(campaign: Campaign) -> NDArray[np.bool_]:
    """Tell which of (files, n) sensors read the same in all rows of a file.

    Not where all do: none may have been read, which is `compare_files`'.
    """
    still = [
        (cycle.stroke == 0.0)
        & (cycle.position is not None)
        & (np.count_nonzero(cycle.valid) >= MIN_FROZEN_ROWS)
        for cycle in campaign.cycles
    ]
    return np.array([each & ~each.all() for each in still])


def frozen_sensors(campaign: Campaign) -> Iterator[Finding]:
    """Name sensors that read the same in all rows of a file."""
    still = still_sensors(campaign)
    for pattern in dict.fromkeys(map(tuple, still.T[still.any(axis=0)].tolist())):
        files = np.array(pattern)
        where, remedy = "POSITION of {} is the same in all rows", ""
        if files.all():
            remedy = "have its electronics looked at: it counts as if it did not move, and no"
            remedy += " stiffness can be had of it"
        else:
            where += f" of {named_files(campaign, np.flatnonzero(files))}"
        which = (files == still.T).all(axis=1)
        size = float(np.mean(files))
        yield about_actuators(
            campaign.layout, Code.FROZEN_SENSOR, which, where, size=size, remedy=remedy
        )
