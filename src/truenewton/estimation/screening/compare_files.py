"""Files compared with each other: columns that differ from those of the others, and copies.

Columns of a file that are not those of the others: exchanged, of other sign, in another unit.

A shape costs the same forces in every file, whatever hangs on the mirror, and moves the sensors by
as much. So some rows of each file, under the same labels (SHAPE times SIGN) in all and their mean
taken off, are alike but for noise; and a column that is not like its own in the other files, but
like another one, or like its own turned round, says what happened to that file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.row_readers import RowPrints, common_labels
from truenewton.estimation.screening.file_labels import clusters
from truenewton.linalg import assignment
from truenewton.records.campaign import Campaign
from truenewton.rounding import listed, named, significant

MIN_SHARED_LABELS = 8  # labels that all files share: of fewer, two columns may be alike by chance
MIN_COLUMN_DIFFERENCE = (
    0.3  # of a column's size, beyond which it is not what it is in the other files
)
MAX_REMAINING_DIFFERENCE = 0.3  # of that distance, which the right column leaves at most
MAX_ORDERED_COLUMNS = 1000  # columns that are put in order
MIN_GROUP_DIFFERENCE = 0.02  # of their size two lots of files differ
MIN_DIFFERENCE_OF_REPEATING_FILES = (
    0.08  # where each file repeats, and nothing but the balance speaks against them
)
MIN_UNIT_FACTOR = 2.0  # times as large, or as small, as the others a file is in another unit
MAX_NAMED_ACTUATORS, MAX_NAMED_FILES = 4, 2  # actuators, and files, that are named one by one


class Difference(NamedTuple):
    """How columns of a file differ from those of another one.

    Attributes
    ----------
    code, remedy
        What it is; what to do, the column still to be named.
    actuators
        Which of those that take part; none where it is all of them.
    times
        How much larger the file is.
    """

    code: Code
    remedy: str
    actuators: tuple[int, ...] = ()
    times: str = ""


FROZEN_SENSOR = Finding(
    code=Code.CONSTANT_POSITION,
    remedy="leave the column out where no sensors were read; then COILGRAD, BIASGRAD are not used",
)
REVERSED_COLUMN = Difference(
    Code.OTHER_SIGN, "turn the sign of {} in that file, put its rows in order, or leave it out"
)


def compare_files(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Name files whose FORCE or POSITION stands for other actuators, signs or units than elsewhere.

    What most files say is taken for right; of two files, or two halves, nobody can tell.

    Parameters
    ----------
    campaign, prints
        The files; some of their rows.
    """
    if len(campaign.cycles) < 2:
        return ()
    found, still = dict[tuple[Difference, tuple[int, ...]], list[str]](), tuple[Finding, ...]()
    for quantity, rows in (("FORCE", prints.common_rows()), ("POSITION", positions(campaign))):
        if rows is None or rows.shape[1] < MIN_SHARED_LABELS:
            continue
        if quantity == "POSITION" and not np.ptp(rows, axis=(0, 1)).any():
            still = (FROZEN_SENSOR,)
            continue
        rows = rows - rows[:, :1].astype(np.float64)  # what stands still is 0 exactly
        differences = _from_the_most_typical(rows - rows.mean(axis=1, keepdims=True))
        right = max(dict.fromkeys(differences), key=differences.count)
        for what in dict.fromkeys(chain(*differences)):
            files = tuple(k for k, d in enumerate(differences) if (what in d) != (what in right))
            found.setdefault((what, files), []).append(quantity)
    return still + tuple(
        _effect(campaign, what, files, quantities)
        for (what, files), quantities in found.items()
        if what != REVERSED_COLUMN or _not_by_sign(campaign, quantities)
    )


def unlike_files(
    campaign: Campaign, prints: RowPrints, least: float = MIN_GROUP_DIFFERENCE
) -> tuple[Finding, ...]:
    """Name the fewer of files that fall apart in two lots, as those of two mirrors or days do.

    Parameters
    ----------
    campaign, prints
        The files; some of their rows.
    least
        Of their size by which the lots differ.
    """
    rows = prints.common_rows()
    if len(rows) < 3 or rows.shape[1] < MIN_SHARED_LABELS:
        return ()
    rows = rows - rows.mean(axis=1, keepdims=True, dtype=np.float64)
    distance = np.zeros((len(rows), len(rows)))
    for one, other in combinations(range(len(rows)), 2):
        distance[one, other] = distance[other, one] = _apart(rows[one], rows[other])
    lot = clusters(distance, 2)
    if lot is None or distance[lot[:, None] != lot].min() < least:
        return ()
    fewer = lot == np.bincount(lot).argmin()
    names = np.array([cycle.name for cycle in campaign.cycles])
    return (
        Finding(
            code=Code.TWO_MIRRORS,
            where=f"{listed(names[fewer], MAX_NAMED_FILES)} against"
            f" {listed(names[~fewer], MAX_NAMED_FILES)}",
            size=float(fewer.mean()),
            remedy="calibrate together what was taken of one mirror with the same shapes, and no"
            " actuator replaced in between; or mark rows as not VALID in which the load was not on",
        ),
    )


def _apart(rows: Array, others: Array) -> float:
    """Return how far the columns of (m, n) rows typically lie from others, in terms of their size.

    A gain that rows have as a whole does not count, nor what few columns do.
    """
    gain = float(np.sum(rows * others) / max(np.sum(others**2), 1e-300))
    size = np.maximum(_square(gain * others), 1e-300)
    return float(np.sqrt(np.median(_square(rows - gain * others) / size)))


def positions(campaign: Campaign) -> Array | None:
    """Return (files, m, n) readings of sensors under labels that all files have [m], or None."""
    codes = [(c.shape * c.sign)[c.valid] for c in campaign.cycles]
    chosen, readings = common_labels(codes), []
    for cycle, of in zip(campaign.cycles, codes, strict=True):
        if cycle.position is None:
            return None
        first = np.array([np.argmax(of == label) for label in chosen], dtype=np.int64)
        readings.append(cycle.used(cycle.position, first))
    return np.stack(readings)


def _not_by_sign(campaign: Campaign, quantities: list[str]) -> bool:
    """Tell whether it is not SIGN that is reversed, which turns both FORCE and POSITION."""
    return len(quantities) == 1 and campaign.cycles[0].position is not None


def _from_the_most_typical(rows: Array) -> list[tuple[Difference, ...]]:
    """Return how each of (files, m, n) rows differs from the file that is most like the others."""
    flat = rows.reshape(len(rows), -1)
    square = np.sum(flat**2, axis=1)
    distance = square[:, None] + square - 2.0 * flat @ flat.T
    typical = rows[np.median(distance, axis=1).argmin()]
    return [tuple(_differences(file, typical)) for file in rows]


def _differences(rows: Array, typical: Array) -> Iterator[Difference]:
    """Yield how (m, n) rows differ from those under the same labels in another file."""
    own, size = _square(rows - typical), _square(typical)
    odd = np.flatnonzero(own > MIN_COLUMN_DIFFERENCE**2 * np.maximum(size, _square(rows)))
    if not odd.size:
        return
    times = float(np.sum(rows * typical) / max(np.sum(size), 1e-300))
    left = _square(rows - times * typical).sum()
    if left < MAX_REMAINING_DIFFERENCE**2 * min(
        own.sum(), _square(rows).sum()
    ):  # the file as a whole
        if not 1.0 / MIN_UNIT_FACTOR < abs(times) < MIN_UNIT_FACTOR:
            remedy = "correct the unit of {} in that file"
            yield Difference(Code.OTHER_UNIT, remedy, times=significant(abs(times)))
        elif times < 0.0:
            yield REVERSED_COLUMN
        return
    moved = (
        _moved(rows, typical, odd)
        if odd.size <= MAX_ORDERED_COLUMNS
        else np.empty(0, dtype=np.int64)
    )
    if moved.size:
        what = Code.EXCHANGED_COLUMNS if moved.size <= MAX_NAMED_ACTUATORS else Code.OTHER_ORDER
        remedy = "put the columns of {} in that file in the order of ACTUATORS, or leave it out"
        yield Difference(what, remedy, tuple(moved.tolist()))
    turned = odd[_square(rows + typical)[odd] < MAX_REMAINING_DIFFERENCE**2 * own[odd]]
    if turned.size:
        remedy = "look at its plug; turn the sign of {} of the actuator in that file; if there are"
        remedy += " several, its rows may be in another order than SHAPE and SIGN"
        yield Difference(REVERSED_COLUMN.code, remedy, tuple(turned.tolist()))


def _moved(rows: Array, typical: Array, odd: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return which of some columns are those of others among them."""
    one, other = rows[:, odd], typical[:, odd]
    apart = _square(one)[:, None] + _square(other) - 2.0 * one.T @ other
    order = assignment(np.maximum(apart, 0.0))
    itself = np.arange(len(odd))
    cured = (order != itself) & (
        apart[itself, order] < MAX_REMAINING_DIFFERENCE**2 * apart[itself, itself]
    )
    while not cured[order[cured]].all():  # what comes from a column that did not move is no order
        cured &= cured[order]
    return np.asarray(odd[cured])


def _square(values: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->j", values, values))


def _effect(
    campaign: Campaign, what: Difference, files: tuple[int, ...], quantities: list[str]
) -> Finding:
    cycles, column = campaign.cycles, " and ".join(quantities)
    where, actuators = listed([cycles[k].name for k in files], MAX_NAMED_FILES), tuple[int, ...]()
    if 2 * len(files) >= len(cycles):
        others = [cycle.name for k, cycle in enumerate(cycles) if k not in files]
        where += f", or in {listed(others, MAX_NAMED_FILES)}"
    if what.times:
        where += f", {what.times} times the others"
    if what.actuators:
        ids = campaign.layout.id[campaign.layout.enabled]
        actuators = tuple(ids[list(what.actuators)].tolist())
        which = f"{len(actuators)} of {len(ids)} actuators"
        if len(actuators) <= MAX_NAMED_ACTUATORS:
            which = named("actuator", list(actuators), MAX_NAMED_ACTUATORS)
        where = f"{which} in {where}"
    return Finding(
        code=what.code,
        detail=column,
        where=where,
        actuators=actuators,
        size=len(files) / len(cycles),
        remedy=what.remedy.format(column),
    )


MIN_IDENTICAL_FRACTION = 0.2  # of the rows compared that are identical
MIN_IDENTICAL_FRACTION_OF_STEPS = 0.9  # of them, where readings come in steps
MIN_COMPARED_ROWS = 2  # rows
MIN_RATIO_TO_OTHER_FILES = (
    4.0  # times as many as between those files under one load that share the fewest
)


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
    share = MIN_IDENTICAL_FRACTION_OF_STEPS if in_steps else MIN_IDENTICAL_FRACTION
    for one, other in combinations(range(len(cycles)), 2):
        common = rows[one].keys() & rows[other].keys()
        alike = sum(rows[one][code] == rows[other][code] for code in common)
        if common and campaign.load_index[one] == campaign.load_index[other]:
            by_chance.append(alike / len(common))
        if alike >= max(min(MIN_COMPARED_ROWS, len(common)), share * len(common), 1):
            same[one, other] = alike / len(common)
    if by_chance and len(cycles) > 2 and not _one_file(campaign, same):
        usual = MIN_RATIO_TO_OTHER_FILES * min(by_chance)
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
