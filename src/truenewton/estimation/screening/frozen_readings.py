"""Readings that stand still: frozen, for a while or all the time, or cut off at a limit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.records.campaign import Campaign
from truenewton.rounding import listed, named

MIN_FROZEN_ROWS = 3  # rows
MIN_FROZEN_FRACTION = 0.1  # of the rows of a file, one after the other
MAX_FROZEN_ACTUATORS = (
    0.03  # of the actuators: where more readings stand still, shapes do not reach them
)
MAX_NAMED_FROZEN = 3  # actuators that are named


def frozen_readings(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Name readings that do not change from shape to shape in a file, where the others do.

    One that is the same in all files is `odd_actuators.constant_actuators`'.
    """
    return tuple(_frozen(campaign, prints))


def _frozen(campaign: Campaign, prints: RowPrints) -> Iterator[Finding]:
    ids = campaign.layout.id[campaign.layout.enabled]
    whole = [prints.longest[file] == prints.rows(file) - 1 for file in prints.longest]
    constant = np.logical_and.reduce(whole)
    for file, longest in sorted(prints.longest.items()):
        name, still = campaign.cycles[file].name, _stand_still(prints, file)
        share = longest / prints.rows(file)
        if still.all() and not constant.all():
            yield _effect(
                Code.FROZEN_READINGS,
                f"all actuators in {name}",
                float(share.min()),
                "leave the file out, or mark the rows that repeat the one before as not VALID",
            )
        elif np.count_nonzero(still & ~constant) <= max(1, MAX_FROZEN_ACTUATORS * len(ids)):
            for i in np.flatnonzero(still & ~constant):
                yield _effect(
                    Code.FROZEN_READING,
                    f"actuator {ids[i]} in {name}",
                    float(share[i]),
                    "leave the file out, or mark the rows in which it stands still as not VALID;"
                    " have its electronics looked at",
                    (int(ids[i]),),
                )


def still_sensors(campaign: Campaign) -> NDArray[np.bool_]:
    """Tell which of (files, n) sensors read the same in all rows of a file; () are read nowhere.

    Not where all do: none may have been read, which is `files_apart`'s.
    """
    n = int(campaign.layout.enabled.sum())
    still = [
        cycle.stroke == 0.0
        if cycle.position is not None and np.count_nonzero(cycle.valid) >= MIN_FROZEN_ROWS
        else np.zeros(n, dtype=np.bool_)
        for cycle in campaign.cycles
    ]
    return np.array([each & ~each.all() for each in still])


def frozen_sensors(campaign: Campaign) -> tuple[Finding, ...]:
    """Name sensors that read the same in all rows of a file."""
    still, ids = still_sensors(campaign), campaign.layout.id[campaign.layout.enabled]
    found = dict[tuple[int, ...], list[int]]()
    for i in np.flatnonzero(still.any(axis=0)).tolist():
        found.setdefault(tuple(np.flatnonzero(still[:, i]).tolist()), []).append(int(ids[i]))
    return tuple(
        _effect(
            Code.FROZEN_SENSOR,
            f"POSITION of {named('actuator', actuators, MAX_NAMED_FROZEN)} is the same in all rows"
            + (
                ""
                if len(files) == len(still)
                else f" of {listed(_names(campaign, files), MAX_NAMED_FROZEN)}"
            ),
            len(files) / len(still),
            "have its electronics looked at: it counts as if it did not move, and no stiffness can"
            " be had of it"
            if len(files) == len(still)
            else "have its electronics looked at, and leave the files out where POSITION is needed",
            tuple(actuators),
        )
        for files, actuators in found.items()
    )


def _names(campaign: Campaign, files: Sequence[int]) -> list[str]:
    return [campaign.cycles[k].name for k in files]


def _stand_still(prints: RowPrints, file: int) -> NDArray[np.bool_]:
    """Tell which of (n,) readings of a file stand still, but not at a limit of several."""
    longest, limit = prints.longest[file], prints.limit[file]
    common = limit == limit.max(initial=0.0)
    at_limit = common & (np.count_nonzero(common) > 1) & (prints.at_limit[file] > longest)
    return np.asarray(
        (longest >= max(MIN_FROZEN_ROWS, MIN_FROZEN_FRACTION * prints.rows(file))) & ~at_limit
    )


def clipped_readings(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Name readings that end at a limit, which several shapes reach to the last bit.

    A limit is no fault where the force ends there as well: it is one where data do not fit.
    """
    ids = campaign.layout.id[campaign.layout.enabled]
    clipped, largest = np.zeros(len(ids), dtype=bool), 0.0
    for file, limit in prints.limit.items():
        count, common = prints.at_limit[file], limit == limit.max(initial=0.0)
        here = (count >= MIN_FROZEN_ROWS) | (common & (count[common].sum() >= MIN_FROZEN_ROWS))
        here &= (limit > 0.0) & ~_stand_still(prints, file)
        clipped |= here
        largest = max(largest, float(limit[here].max(initial=0.0)))
    if not clipped.any() or _few_valued(prints):
        return ()
    return (
        _effect(
            Code.CLIPPED_READINGS,
            f"{named('actuator', ids[clipped].tolist(), MAX_NAMED_FROZEN)}, at {largest:.4g} N",
            float(clipped.mean()),
            "use smaller shapes, or mark the rows that reach the limit as not VALID",
            tuple(ids[clipped].tolist()),
        ),
    )


def _few_valued(prints: RowPrints) -> bool:
    """Tell whether readings have but few values, as where shapes are commanded in levels."""
    ordered = np.sort(np.abs(prints.of_first), axis=0)
    rest = ordered < ordered[-1:]
    distinct = (np.diff(ordered, axis=0) > 0.0) & rest[1:]
    return bool(np.median(distinct.sum(axis=0) / np.maximum(rest.sum(axis=0), 1)) < 0.5)


def _effect(
    code: Code, where: str, size: float, remedy: str, actuators: tuple[int, ...] = ()
) -> Finding:
    return Finding(code=code, where=where, actuators=actuators, size=size, remedy=remedy)
