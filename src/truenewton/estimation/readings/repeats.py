"""What rows that repeat one shape show: moments and scatter, and fingerprints of some rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.readings.moments import Moments, WithinGroups, rounding_steps
from truenewton.estimation.readings.rows import Rows
from truenewton.records.campaign import Campaign

MAX_SAMPLES = 1000  # deviations that are kept: they give a variance of three degrees to 3 %


class Scatter(NamedTuple):
    """Deviations of rows from the mean of the others of their group, at weight 1 [N]."""

    furthest: Array  # (n,) the largest
    samples: Array  # (m, n) those of some rows


def moments_of(rows: Rows, step: Array | float = 0.0) -> tuple[Moments, Scatter]:
    """Return the moments of rows, whose readings are multiples of (n,) steps [N], and scatter."""
    files, (groups, n) = len(rows.force), rows.mean.shape
    weight, hour = np.zeros((2, files, groups))
    np.add.at(weight, (rows.file, rows.group), rows.weight)
    np.add.at(hour, (rows.file, rows.group), rows.weight * rows.hour)
    square = np.zeros(groups)
    np.add.at(square, rows.group, rows.weight * rows.hour**2)
    scatter, furthest = np.zeros((2, n))
    zero, gain = np.zeros((2, files + 1, n))
    stride = max(1, len(rows.group) // MAX_SAMPLES)
    sampled = (np.arange(len(rows.group)) - np.searchsorted(rows.file, rows.file)) % stride == 0
    sampled &= rows.distance_factor > 0.0
    samples, taken = np.empty((np.count_nonzero(sampled), n)), 0
    for some, mean, apart in rows.deviations():
        heavy, k, factor = rows.weight[some], rows.file[some.start], rows.distance_factor[some]
        for sums, values in ((zero, apart), (gain, apart * mean)):
            sums[k] += heavy @ values
            sums[-1] += (heavy * rows.hour[some]) @ values
        chosen = np.flatnonzero(sampled[some])
        samples[taken : taken + len(chosen)] = apart[chosen] * np.sqrt(factor[chosen])[:, None]
        taken += len(chosen)
        apart *= apart
        scatter += heavy @ apart
        apart *= factor[:, None]
        np.maximum(furthest, apart.max(axis=0), out=furthest)
    moments = Moments(
        loads=rows.loads,
        labels=rows.labels,
        rows=rows.number,
        weight=rows.total,
        mean=rows.mean,
        known=rows.means(rows.known, 3),
        scatter=scatter,
        reference=rows.reference,
        within=WithinGroups(weight, hour, square, rows.mean, zero, gain),
        step=step,
    )
    return moments, Scatter(np.sqrt(furthest), samples)


# -- fingerprints of some rows ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Prints:
    """One row of a file under each of some labels, as recorded, in the order of the file.

    They show copies and rounding: corrected for displacements, no row repeats to
    the last bit.
    """

    codes: NDArray[np.int64]  # (m,) labels, SHAPE times SIGN
    force: Array  # (m, n) [N]


def prints_of(campaign: Campaign) -> tuple[Prints, ...]:
    """Return the prints of each file; a file may have none of the labels."""
    codes = [(cycle.shape * cycle.sign)[cycle.valid] for cycle in campaign.cycles]
    labels, prints = _some(np.unique(np.concatenate(codes)), 48), list[Prints]()
    for cycle, of_file in zip(campaign.cycles, codes, strict=True):
        first = np.sort(np.unique(of_file, return_index=True)[1])
        first = first[np.isin(of_file[first], labels)]
        prints.append(Prints(of_file[first], cycle.used(cycle.force, first)))
    return tuple(prints)


def step_of(prints: Sequence[Prints]) -> Array:
    """Return (n,) the step of which the readings are multiples [N], or 0; by the first file."""
    return rounding_steps([*next(each.force for each in prints if each.codes.size)])


def common_rows(prints: Sequence[Prints]) -> NDArray[np.float32]:
    """Return (files, m, n) readings under some of the labels that all files have [N]."""
    kept = _some(np.unique(np.concatenate([each.codes for each in prints])))
    chosen = common_labels([each.codes[np.isin(each.codes, kept)] for each in prints])
    at = [[np.flatnonzero(each.codes == code)[0] for code in chosen] for each in prints]
    rows = [each.force[np.array(some, dtype=int)] for each, some in zip(prints, at, strict=True)]
    return np.array(rows, dtype=np.float32)


def common_labels(codes: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return (m,) some of the labels that all files have, given (N,) those of the rows of each."""
    return _some(reduce(np.intersect1d, codes))


def _some(labels: NDArray[np.int64], most: int = 16) -> NDArray[np.int64]:
    """Return at most so many of (m,) labels, evenly from the first to the last."""
    last = len(labels) - 1
    return labels[np.unique(np.linspace(0, last, most if last >= 0 else 0).astype(np.int64))]
