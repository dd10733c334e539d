"""Files under a name that is not theirs: the load of another, SIGN or SHAPE counted otherwise.

Forces at rest tell the load of a file without any fit. With one static force for each file and one
elastic force for each SHAPE times its SIGN, rows are c = s_file + e_shape; least squares for s of
all files, e eliminated, need no more than sums that `moments` has (a Laplacian over the files).
Files under one load then lie together, those under another apart: where as many clusters as loads
stand clearly apart, a file in the cluster of another load has the wrong name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.readings.moments import Moments, WithinGroups
from truenewton.estimation.readings.row_readers import RowPrints
from truenewton.linalg import assignment
from truenewton.records.campaign import Campaign
from truenewton.rounding import listed
from truenewton.statics.arms import enabled_arms

OTHER_UNIT_FACTOR = 20.0  # times as large the readings of a file are
MAX_RELATIVE_DISTANCE = 0.3  # of the distance between loads: files of one load lie nearer together
MAX_PLAUSIBLE_ALPHA = 5.0  # alpha, or its inverse: beyond, what lies apart is not the weight
MAX_LABEL_DISTANCE = (
    0.3  # of the distance from its own label, within which a row fits that of another
)
MIN_RELABELLED_FRACTION = 0.3  # of the rows of a file that fit other labels
MIN_SAME_SHIFT_FRACTION = 0.8  # of these that moved the same way
WEIGHT_TOLERANCE = 1e-6  # of a weight, by which loads of one name differ at most
MAX_NAMED_RELABELLED = 3  # files that are named
INDISTINCT_RATIO = 1.5  # times as far as files of one load lie apart


def files_in_other_units(campaign: Campaign, prints: RowPrints) -> tuple[Finding, ...]:
    """Name files whose readings are far larger or smaller than those of the others."""
    largest = {file: float(np.median(limit)) for file, limit in prints.limit.items()}
    usual = float(np.median(list(largest.values())))
    if usual == 0.0:
        return ()
    return tuple(
        Finding(
            code=Code.OTHER_UNIT,
            detail="FORCE",
            where=f"{campaign.cycles[file].name}, {size / usual:.2g} times the others",
            size=size / usual,
            remedy="check the unit of FORCE in that file, N",
        )
        for file, size in sorted(largest.items())
        if not 1 / OTHER_UNIT_FACTOR < size / usual < OTHER_UNIT_FACTOR
    )


def mislabelled_files(campaign: Campaign, moments: Moments) -> tuple[Finding, ...]:
    """Name files whose forces at rest are those of another load than they say.

    Parameters
    ----------
    campaign, moments
        The files; their rows, none left out.
    """
    if moments.within is None or len(campaign.loads) < 2 or len(campaign.cycles) < 3:
        return ()
    rest = rest_by_file(moments, moments.within)
    if rest is None:
        return ()
    distance, said = np.linalg.norm(rest[:, None] - rest, axis=2), np.array(campaign.load_index)
    for count in range(len(campaign.loads), 1, -1):  # fewer where one load stands under two names
        cluster = clusters(distance, count)
        if cluster is not None:
            true = _load_of_clusters(cluster, said)
            return tuple(_mislabelled(campaign, rest, distance, true))
    return ()


def _load_of_clusters(cluster: NDArray[np.int64], said: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (files,) the load of each file, that of most files of its cluster."""
    together = np.zeros((cluster.max() + 1, said.max() + 1), dtype=np.int64)
    np.add.at(together, (cluster, said), 1)
    return assignment(-together)[cluster]


def _mislabelled(
    campaign: Campaign, rest: Array, distance: Array, true: NDArray[np.int64]
) -> Iterator[Finding]:
    """Name files whose load is another than they say, if the weights agree with that."""
    said, weights = np.array(campaign.load_index), campaign.effective_weights
    there = np.unique(true)
    total = rest @ enabled_arms(campaign.layout)[0]
    means = {load: rest[true == load].mean(axis=0) for load in there.tolist()}
    sums = np.array([total[true == load].mean() for load in there])
    first, second = np.triu_indices(len(there), 1)
    alpha = (weights[there[first]] - weights[there[second]]) / (sums[second] - sums[first])
    if not (
        (np.abs(alpha) > 1.0 / MAX_PLAUSIBLE_ALPHA) & (np.abs(alpha) < MAX_PLAUSIBLE_ALPHA)
    ).all():
        return
    same = (true[:, None] == true) & (said[:, None] == said) & ~np.eye(len(said), dtype=bool)
    usual = float(np.median(distance[same])) if same.any() else np.inf
    scatter = float(np.abs(total[:, None] - total)[same].max()) if same.any() else 0.0
    named = dict[tuple[int, int], list[int]]()
    for k in np.flatnonzero(true != said).tolist():
        own, other = int(said[k]), int(true[k])
        differ = abs(float(weights[own] - weights[other]))
        if own in means or differ > WEIGHT_TOLERANCE * abs(weights[other]):
            # A load that differs little from the other lies with it: so it may be what it says.
            off = max(abs(float(total[k] - sums[there == other].item())), scatter)
            if own not in means and np.abs(alpha).max() * off > MAX_RELATIVE_DISTANCE * differ:
                continue
            yield Finding(
                code=Code.OTHER_LOAD,
                where=f"{campaign.cycles[k].name}, at rest as under {campaign.loads[other].name}",
                size=float(np.sqrt(np.mean((means[other] - rest[k]) ** 2))),
                unit="N",
                remedy="correct LOAD of the file, or remove the file",
            )
        elif np.median(distance[k][(true == other) & (said == other)]) < INDISTINCT_RATIO * usual:
            named.setdefault((own, other), []).append(k)
    for (own, other), files in named.items():
        names = listed([campaign.cycles[k].name for k in files], MAX_NAMED_RELABELLED)
        one, two = (f"'{campaign.loads[load].name}'" for load in (own, other))
        yield Finding(
            code=Code.LOAD_OF_TWO_NAMES,
            where=f"{one} in {names} is as {two} at rest",
            remedy=f"let LOAD say {two} there, or {one} elsewhere, unless loads were two",
        )


def rest_by_file(moments: Moments, within: WithinGroups) -> Array | None:
    """Return (files, n) static forces of each file but for what is common to all [N].

    None where files share too few shapes to be compared.
    """
    files = len(within.weight)
    code = _codes(moments.labels)
    weight = np.zeros((files, int(code.max()) + 1))
    for row, of_file in zip(weight, within.weight, strict=True):
        row += np.bincount(code, of_file, len(row))
    total = np.maximum(weight.sum(axis=0), 1e-300)
    share = (weight / total)[:, code] * moments.weight
    apart = within.zero[:files] + (within.weight - share) @ moments.mean
    laplacian = np.diag(weight.sum(axis=1)) - (weight / total) @ weight.T
    values, vectors = np.linalg.eigh(laplacian)
    if values[1] <= 1e-9 * values[-1]:
        return None
    return np.asarray((vectors[:, 1:] / values[1:]) @ (vectors[:, 1:].T @ apart))


def _codes(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (g,) which SHAPE and SIGN, counted from 0."""
    _, shape = np.unique(labels[:, 1], return_inverse=True)
    return np.asarray(np.unique(2 * shape.ravel() + (labels[:, 2] > 0), return_inverse=True)[1])


def clusters(distance: Array, count: int) -> NDArray[np.int64] | None:
    """Return (files,) cluster of each of the files, so many in all; None where none is clear.

    Of two that are merged the nearest are first (single linkage), by (files, files) distances.
    """
    member, heights = np.arange(len(distance)), []
    while len(left := np.unique(member)) > 1:
        if len(left) == count:
            answer = np.searchsorted(left, member)
        apart = np.where(member[:, None] == member, np.inf, distance)
        one, other = np.unravel_index(apart.argmin(), apart.shape)
        heights.append((len(left), float(apart[one, other])))
        member[member == member[other]] = member[one]
    between = dict(heights).get(count, 0.0)
    within = dict(heights).get(count + 1, np.inf)
    return answer if within < MAX_RELATIVE_DISTANCE * between else None


def mislabelled_rows(campaign: Campaign, files: Iterable[int]) -> tuple[Finding, ...]:
    """Name files whose rows fit other labels than theirs: SIGN reversed, or SHAPE counted anew.

    Parameters
    ----------
    campaign
        The files, in memory; else nothing is said.
    files
        Which of them to look at: their rows lie far from their repeats.
    """
    suspicious = list(files)
    if not suspicious or not all(isinstance(c.force, np.ndarray) for c in campaign.cycles):
        return ()
    rows = [cycle.used_force - cycle.used_force[cycle.paired_rows].mean(axis=0)
            for cycle in campaign.cycles]  # fmt: skip
    codes = [cycle.shape[cycle.valid] * cycle.sign[cycle.valid] for cycle in campaign.cycles]
    found = []
    for k in suspicious:
        others = [j for j in range(len(rows)) if j != k]
        code = _other_labels(rows[k], codes[k], [rows[j] for j in others],
                             [codes[j] for j in others])  # fmt: skip
        if code is not None:
            found.append(
                Finding(
                    code=code,
                    where=campaign.cycles[k].name,
                    size=float(np.sqrt(np.mean(rows[k] ** 2))),
                    unit="N",
                    remedy="correct SHAPE and SIGN of the file, or leave it out",
                )
            )
    return tuple(found)


def _other_labels(
    rows: Array,
    codes: NDArray[np.int64],
    other_rows: list[Array],
    other_codes: list[NDArray[np.int64]],
) -> Code | None:
    """Return how rows of one file are labelled otherwise than those of others, if they are."""
    known = np.unique(np.concatenate(other_codes))
    typical = np.empty((len(known), rows.shape[1]))
    for at, code in enumerate(known):  # the median: one of the others may be wrong, too
        same = [r[c == code] for r, c in zip(other_rows, other_codes, strict=True)]
        typical[at] = np.median(np.concatenate(same), axis=0)
    shared = np.isin(codes, known)
    rows, codes = rows[shared], codes[shared]
    if not len(rows):
        return None
    square = np.sum(rows**2, axis=1)[:, None] + np.sum(typical**2, axis=1) - 2 * rows @ typical.T
    square = np.maximum(square, 0.0)
    own = square[np.arange(len(rows)), np.searchsorted(known, codes)]
    moved = square.min(axis=1) < MAX_LABEL_DISTANCE**2 * own
    if np.count_nonzero(moved) < max(3, MIN_RELABELLED_FRACTION * len(rows)):
        return None
    best, said = known[square.argmin(axis=1)][moved], codes[moved]
    if np.mean(best == -said) > MIN_SAME_SHIFT_FRACTION:
        return Code.SIGN_REVERSED
    shapes = np.unique(np.abs(known))
    step = np.searchsorted(shapes, np.abs(best)) - np.searchsorted(shapes, np.abs(said))
    step %= len(shapes)
    if step.any() and np.mean(step == np.bincount(step).argmax()) > MIN_SAME_SHIFT_FRACTION:
        return Code.SHAPE_OFFSET
    return Code.OTHER_LABELS
