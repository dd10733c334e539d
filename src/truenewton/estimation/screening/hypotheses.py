"""Whether a file is what it claims to be: its unit, signs, columns, labels, load and readings.

A shape costs the same forces in every file, whatever the load, and moves the sensors by the same
amount. So rows of each file under the same label (SHAPE times SIGN), minus their mean, are equal
except for noise. If those of a file are not, hypotheses are tested: another unit or sign, columns
in another order or of the other sign, other labels. One is accepted if it leaves little of the
distance to the other files.

Forces at rest identify the load of a file without any fit. With one static force for each file and
one elastic force for each label, rows are c = s_file + e_label; least squares for s of all files,
with e eliminated, needs only sums that `moments` contains (a Laplacian over the files). Files under
one load then form a cluster. If there are as many clear clusters as loads, a file in the cluster of
another load has the wrong name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import (
    MAX_NAMED_ACTUATORS,
    Finding,
    about_actuators,
)
from truenewton.estimation.readings.moments import Moments, WithinGroups
from truenewton.estimation.readings.repeats import Prints, common_labels, common_rows
from truenewton.linalg import assignment
from truenewton.records.campaign import Campaign
from truenewton.rounding import listed, significant
from truenewton.statics.arms import enabled_arms

# Distance relative to the size of a column, if it differs, and to the distance without a hypothesis
# that is accepted.
MAX_SAME_DISTANCE = 0.3


def agree(left: Any, before: Any) -> Any:
    """Return whether a hypothesis leaves little of squared distances."""
    return left < MAX_SAME_DISTANCE**2 * before


def squared_differences(rows: Array, others: Array) -> Array:
    """Return (m, k) squared distances of (m, n) rows from (k, n) others."""
    square = np.sum(rows**2, axis=1)[:, None] + np.sum(others**2, axis=1)
    return np.asarray(np.maximum(square - 2.0 * rows @ others.T, 0.0))


def clusters(distance: Array, count: int) -> NDArray[np.int64] | None:
    """Return the (files,) clusters by (files, files) distances; None if they are not clear.

    The two nearest files of different clusters are merged first (single linkage). A few lines
    suffice for a few files: importing ``scipy.cluster`` takes a fifth of a second.
    """
    member, heights = np.arange(len(distance)), dict[int, float]()
    while len(left := np.unique(member)) > 1:
        if len(left) == count:
            answer = np.searchsorted(left, member)
        apart = np.where(member[:, None] == member, np.inf, distance)
        one, other = np.unravel_index(apart.argmin(), apart.shape)
        heights[len(left)] = float(apart[one, other])
        member[member == member[other]] = member[one]
    between, within = heights.get(count, 0.0), heights.get(count + 1, np.inf)
    return answer if within < MAX_SAME_DISTANCE * between else None


def named_files(campaign: Campaign, files: Iterable[int]) -> str:
    """Return the names of the first files, and how many more there are."""
    return listed([campaign.cycles[k].name for k in files], 2)


# --- unit, sign and columns -----------------------------------------------------------------------

MIN_SHARED_LABELS = 8  # of all files: with fewer, two columns may be equal by chance
MIN_UNIT_FACTOR = 2.0  # between files in different units, in either direction


class Difference(NamedTuple):
    """A difference of a file: its columns (none: all), and the ratio of sizes."""

    code: Code
    columns: tuple[int, ...] = ()
    times: str = ""


def compare_files(campaign: Campaign, prints: Sequence[Prints]) -> tuple[Finding, ...]:
    """Return files whose FORCE or POSITION has other actuators, signs or units than elsewhere.

    The majority of the files is taken as right; between two files, or two halves, there is none.
    """
    findings = list[Finding]()
    found = dict[tuple[Difference, tuple[int, ...]], list[str]]()
    for quantity, rows in (("FORCE", common_rows(prints)), ("POSITION", _positions(campaign))):
        if rows is None or len(rows) < 2 or rows.shape[1] < MIN_SHARED_LABELS:
            continue
        if quantity == "POSITION" and not np.ptp(rows, axis=(0, 1)).any():
            findings.append(Finding(code=Code.CONSTANT_POSITION))
            continue
        centred = _centred(rows)
        flat = centred.reshape(len(rows), -1)
        typical = centred[np.median(squared_differences(flat, flat), axis=1).argmin()]
        differences = [tuple(_differences(file, typical)) for file in centred]
        right = max(dict.fromkeys(differences), key=differences.count)
        for what in dict.fromkeys(chain(*differences)):
            files = tuple(k for k, d in enumerate(differences) if (what in d) != (what in right))
            found.setdefault((what, files), []).append(quantity)
    for (what, files), quantities in found.items():
        # Where SIGN is reversed, both are: that is said by the labels.
        alone = len(quantities) == 1 and campaign.cycles[0].position is not None
        if alone or what != Difference(Code.OTHER_SIGN):
            findings.append(_said(campaign, what, files, " and ".join(quantities)))
    return tuple(findings)


def _said(campaign: Campaign, what: Difference, files: tuple[int, ...], columns: str) -> Finding:
    count, where = len(campaign.cycles), named_files(campaign, files)
    if 2 * len(files) >= count:
        where += f", or in {named_files(campaign, (k for k in range(count) if k not in files))}"
    if what.times:
        where += f", {what.times} times the others"
    if what.columns:
        where = f"{{}} in {where}"
    return about_actuators(
        campaign.layout,
        what.code,
        list(what.columns),
        where,
        many="actuators",
        detail=columns,
        size=len(files) / count,
    )


def _positions(campaign: Campaign) -> Array | None:
    """Return (files, m, n) sensor readings under labels that all files have [m], or None."""
    codes = [(c.shape * c.sign)[c.valid] for c in campaign.cycles]
    chosen, readings = common_labels(codes), []
    for cycle, of in zip(campaign.cycles, codes, strict=True):
        if cycle.position is None:
            return None
        first = np.array([np.argmax(of == label) for label in chosen], dtype=np.int64)
        readings.append(cycle.used(cycle.position, first))
    return np.stack(readings)


def _centred(rows: NDArray[Any]) -> Array:
    """Return (files, m, n) rows less the mean of each file; constant ones are exactly 0."""
    moved = rows - rows[:, :1].astype(np.float64)
    return np.asarray(moved - moved.mean(axis=1, keepdims=True)) if moved.size else moved


def _differences(rows: Array, typical: Array) -> Iterator[Difference]:
    """Yield how (m, n) rows differ from those under the same labels in another file."""
    own, size, other_size = _square(rows - typical), _square(typical), _square(rows)
    odd = np.flatnonzero(own > MAX_SAME_DISTANCE**2 * np.maximum(size, other_size))
    if not odd.size:
        return
    times = float(np.sum(rows * typical) / max(np.sum(size), 1e-300))
    if agree(_square(rows - times * typical).sum(), min(own.sum(), other_size.sum())):
        if not 1.0 / MIN_UNIT_FACTOR < abs(times) < MIN_UNIT_FACTOR:
            yield Difference(Code.OTHER_UNIT, times=significant(abs(times)))
        elif times < 0.0:
            yield Difference(Code.OTHER_SIGN)
        return
    moved = np.zeros(odd.size, dtype=np.bool_)
    if odd.size <= 1000:  # the order of more takes too long
        moved = _moved(rows[:, odd], typical[:, odd])
    if moved.any():
        few = np.count_nonzero(moved) <= MAX_NAMED_ACTUATORS
        code = Code.EXCHANGED_COLUMNS if few else Code.OTHER_ORDER
        yield Difference(code, tuple(odd[moved].tolist()))
    turned = agree(_square(rows + typical), own)[odd]
    if turned.any():
        yield Difference(Code.OTHER_SIGN, tuple(odd[turned].tolist()))


def _moved(rows: Array, typical: Array) -> NDArray[np.bool_]:
    """Return which columns of (m, n) rows are those of others among them."""
    apart = squared_differences(rows.T, typical.T)
    order, itself = assignment(apart), np.arange(len(apart))
    moved = (order != itself) & agree(apart[itself, order], apart[itself, itself])
    while not moved[order[moved]].all():  # what comes from a column that did not move is no order
        moved &= moved[order]
    return np.asarray(moved)


def _square(values: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->j", values, values))


# --- labels ---------------------------------------------------------------------------------------

MIN_RELABELLED_FRACTION = 0.3  # of the rows of a file fit other labels
MIN_SAME_SHIFT_FRACTION = 0.8  # of these are shifted alike


def mislabelled_rows(campaign: Campaign, files: Iterable[int]) -> tuple[Finding, ...]:
    """Return files whose rows fit other labels than theirs: SIGN reversed, or SHAPE renumbered.

    Only of ``files`` whose rows differ from their repeats.
    """
    rows = [cycle.used_force - cycle.used_force[cycle.paired_rows].mean(axis=0)
            for cycle in campaign.cycles]  # fmt: skip
    labels = [cycle.shape[cycle.valid] * cycle.sign[cycle.valid] for cycle in campaign.cycles]
    found = []
    for k in files:
        others = np.concatenate(rows[:k] + rows[k + 1 :])
        other_labels = np.concatenate(labels[:k] + labels[k + 1 :])
        code = _other_labels(rows[k], labels[k], others, other_labels)
        if code is not None:
            where, size = campaign.cycles[k].name, float(np.sqrt(np.mean(rows[k] ** 2)))
            found.append(Finding(code=code, where=where, size=size, unit="N"))
    return tuple(found)


def _other_labels(
    rows: Array, labels: NDArray[np.int64], others: Array, other_labels: NDArray[np.int64]
) -> Code | None:
    """Return how the labels of (m, n) rows of a file differ from those of others, or None."""
    known = np.unique(other_labels)
    # The median: one of the others may be wrong, too.
    typical = np.array([np.median(others[other_labels == label], axis=0) for label in known])
    shared = np.isin(labels, known)
    rows, labels = rows[shared], labels[shared]
    if not len(rows):
        return None
    square = squared_differences(rows, typical)
    moved = agree(square.min(axis=1), square[np.arange(len(rows)), np.searchsorted(known, labels)])
    if np.count_nonzero(moved) < max(3, MIN_RELABELLED_FRACTION * len(rows)):
        return None
    best, said = known[square.argmin(axis=1)][moved], labels[moved]
    if np.mean(best == -said) > MIN_SAME_SHIFT_FRACTION:
        return Code.SIGN_REVERSED
    shapes = np.unique(np.abs(known))
    step = np.searchsorted(shapes, np.abs(best)) - np.searchsorted(shapes, np.abs(said))
    step %= len(shapes)
    if step.any() and np.mean(step == np.bincount(step).argmax()) > MIN_SAME_SHIFT_FRACTION:
        return Code.SHAPE_OFFSET
    return Code.OTHER_LABELS


def columns_of_other_rows(campaign: Campaign, moments: Moments) -> Iterator[Finding]:
    """Yield the actuators whose FORCE lags by a row.

    The sum of a shape and its negative contains only the forces at rest, so it is the same for all
    shapes of a load. If it is not, and that of the readings one row later is, they lag.
    """
    at = {tuple(label): group for group, label in enumerate(moments.labels.tolist())}
    here, later, shapes = list[Array](), list[Array](), list[Array]()
    for load, first in {k: c for c, k in zip(campaign, campaign.load_index, strict=True)}.items():
        rows = np.column_stack([first.shape, first.sign])[first.valid].tolist()
        after = {at[load, *row]: at[load, *other] for row, other in pairwise(rows)}
        pairs = [(group, at.get((load, shape, -1), -1)) for (of, shape, sign), group in at.items()
                 if of == load and sign > 0]  # fmt: skip
        pairs = [pair for pair in pairs if after.keys() >= {*pair}]
        if not pairs:
            continue
        moved = [(after[one], after[other]) for one, other in pairs]
        single = [pair[:1] for pair in pairs]
        for found, groups in ((here, pairs), (later, moved), (shapes, single)):
            sums = moments.mean[np.array(groups)].sum(axis=1)
            found.append(np.abs(sums - np.median(sums, axis=0)))
    if sum(len(sums) for sums in here) < MIN_SHARED_LABELS:
        return
    before, left, shape = (
        np.median(np.concatenate(each), axis=0) for each in (here, later, shapes)
    )
    lagging = np.flatnonzero(agree(left**2, before**2) & ~agree(before**2, shape**2))
    if lagging.size:
        size = float(before[lagging].max())
        yield about_actuators(
            campaign.layout, Code.OTHER_ROW, lagging, many="columns", size=size, unit="N"
        )


# --- load -----------------------------------------------------------------------------------------

MAX_PLAUSIBLE_ALPHA = 5.0  # or its inverse: beyond, files do not differ by the weight
INDISTINCT_RATIO = 1.5  # of a distance to that between files of one load


def mislabelled_files(campaign: Campaign, moments: Moments) -> tuple[Finding, ...]:
    """Return files whose forces at rest are those of another load than they state."""
    if moments.within is None or len(campaign.loads) < 2 or len(campaign.cycles) < 3:
        return ()
    rest = rest_by_file(moments, moments.within)
    if rest is None:
        return ()
    distance, said = np.linalg.norm(rest[:, None] - rest, axis=2), np.array(campaign.load_index)
    for count in range(len(campaign.loads), 1, -1):  # fewer where one load stands under two names
        cluster = clusters(distance, count)
        if cluster is not None:  # of the load of most of its files
            together = np.zeros((count, len(campaign.loads)), dtype=np.int64)
            np.add.at(together, (cluster, said), 1)
            true = assignment(-together)[cluster]
            return tuple(_mislabelled(campaign, rest, distance, true))
    return ()


def _mislabelled(
    campaign: Campaign, rest: Array, distance: Array, true: NDArray[np.int64]
) -> Iterator[Finding]:
    """Yield files with the wrong load, if the weights are consistent with that."""
    said, weights = np.array(campaign.load_index), campaign.effective_weights
    there, total = np.unique(true), rest @ enabled_arms(campaign.layout)[0]
    means = {load: rest[true == load].mean(axis=0) for load in there.tolist()}
    sums = np.array([total[true == load].mean() for load in there])
    first, second = np.triu_indices(len(there), 1)
    alpha = (weights[there[first]] - weights[there[second]]) / (sums[second] - sums[first])
    alpha = np.abs(alpha)
    if not ((alpha > 1.0 / MAX_PLAUSIBLE_ALPHA) & (alpha < MAX_PLAUSIBLE_ALPHA)).all():
        return
    same = (true[:, None] == true) & (said[:, None] == said) & ~np.eye(len(said), dtype=bool)
    usual = float(np.median(distance[same])) if same.any() else np.inf
    scatter = float(np.abs(total[:, None] - total)[same].max()) if same.any() else 0.0
    named = dict[tuple[int, int], list[int]]()
    for k in np.flatnonzero(true != said).tolist():
        own, other = int(said[k]), int(true[k])
        differ = abs(float(weights[own] - weights[other]))
        if own in means or differ > 1e-6 * abs(weights[other]):
            # A load that differs little from the other lies with it: so it may be what it says.
            off = max(abs(float(total[k] - sums[there == other].item())), scatter)
            if own not in means and alpha.max() * off > MAX_SAME_DISTANCE * differ:
                continue
            yield Finding(
                code=Code.OTHER_LOAD,
                where=f"{campaign.cycles[k].name}, at rest as under {campaign.loads[other].name}",
                size=float(np.sqrt(np.mean((means[other] - rest[k]) ** 2))),
                unit="N",
            )
        elif np.median(distance[k][(true == other) & (said == other)]) < INDISTINCT_RATIO * usual:
            named.setdefault((own, other), []).append(k)
    for (own, other), files in named.items():
        one, two = (f"'{campaign.loads[load].name}'" for load in (own, other))
        yield Finding(
            code=Code.LOAD_OF_TWO_NAMES,
            where=f"{one} in {named_files(campaign, files)} is as {two} at rest",
            remedy=f"for one load, correct LOAD to {two} there, or to {one} elsewhere",
        )


def rest_by_file(moments: Moments, within: WithinGroups) -> Array | None:
    """Return (files, n) static forces of each file, without what all have in common [N].

    None if files share too few shapes to be compared.
    """
    files, labels = len(within.weight), moments.labels[:, 1] * moments.labels[:, 2]
    code = np.unique(labels, return_inverse=True)[1].ravel()
    weight = np.array([np.bincount(code, of_file) for of_file in within.weight])
    total = np.maximum(weight.sum(axis=0), 1e-300)
    share = (weight / total)[:, code] * moments.weight
    apart = within.zero[:files] + (within.weight - share) @ moments.mean
    laplacian = np.diag(weight.sum(axis=1)) - (weight / total) @ weight.T
    values, vectors = np.linalg.eigh(laplacian)
    if values[1] <= 1e-9 * values[-1]:
        return None
    return np.asarray((vectors[:, 1:] / values[1:]) @ (vectors[:, 1:].T @ apart))


# --- copies ---------------------------------------------------------------------------------------

MIN_IDENTICAL_FRACTION = 0.2  # of the rows compared that are identical
MIN_IDENTICAL_FRACTION_OF_STEPS = 0.9  # of them, if readings are multiples of a step
FINEST_NOISE = 1e-5  # relative to the forces: less may be rounding of the numbers
MIN_RATIO_TO_OTHER_FILES = 4.0  # relative to the files under one load that share the fewest


def copied_files(
    campaign: Campaign, prints: Sequence[Prints], *, in_steps: bool = False
) -> tuple[Finding, ...]:
    """Return files with the readings of others: rows of the same SHAPE and SIGN, bit by bit.

    If even files of different origin under one load repeat to the last bit, there is no noise, or
    less than rounding, and nothing is reported. ``in_steps``: rows may be equal by chance.
    """
    rows = [dict(zip(p.codes.tolist(), map(bytes, p.force), strict=True)) for p in prints]
    load, same, by_chance = campaign.load_index, dict[tuple[int, int], float](), list[float]()
    share = MIN_IDENTICAL_FRACTION_OF_STEPS if in_steps else MIN_IDENTICAL_FRACTION
    for one, other in combinations(range(len(rows)), 2):
        common = rows[one].keys() & rows[other].keys()
        alike = sum(rows[one][code] == rows[other][code] for code in common)
        if common and load[one] == load[other]:
            by_chance.append(alike / len(common))
        if alike >= max(min(2, len(common)), share * len(common), 1):
            same[one, other] = alike / len(common)
    usual = MIN_RATIO_TO_OTHER_FILES * min(by_chance) if by_chance and len(rows) > 2 else 0.0
    same = {at: alike for at, alike in same.items() if alike > usual or load[at[0]] != load[at[1]]}
    same = dict.fromkeys(_nearly_alike(campaign, prints), 1.0) | same
    return tuple(
        Finding(
            code=Code.COPIED_FILE,
            where=f"{campaign.cycles[other].name} of {campaign.cycles[one].name}",
            size=alike,
        )
        for (one, other), alike in sorted(same.items())
    )


def _nearly_alike(campaign: Campaign, prints: Sequence[Prints]) -> list[tuple[int, int]]:
    """Return pairs of files under one load that differ by much less than their noise.

    So does a file from its copy in other digits. The noise is the typical difference of other
    pairs, without the zero and the gain of each actuator; three pairs are needed to know it.
    """
    rows, load = _centred(common_rows(prints)), campaign.load_index
    if rows.shape[1] < MIN_SHARED_LABELS:
        return []
    distance = dict[tuple[int, int], float]()
    for one, other in combinations(range(len(rows)), 2):
        if load[one] == load[other]:
            apart, of = rows[other] - rows[one], rows[one]
            apart -= of * (np.sum(apart * of, axis=0) / np.maximum(_square(of), 1e-300))
            distance[one, other] = float(np.median(apart**2))  # spikes do not count
    size = FINEST_NOISE**2 * float(np.mean(rows**2)) if len(distance) > 2 else np.inf
    usual = np.quantile(list(distance.values()), 0.5) if distance else 0.0
    return [at for at, each in distance.items() if usual > size and agree(each, usual)]
