"""Rows that lie far from their repeats, left out; and what one reading of the rows leaves behind.

A row is far whose reading of one actuator lies far from the mean of the others of its group. The
worst row of each group goes first, the scatter is taken anew, until none is left; where only two
rows disagree neither can be trusted and both go. The threshold lets a sound campaign lose a row
once in a hundred campaigns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.moments import Moments
from truenewton.estimation.multiple_tests import FALSE_ALARM
from truenewton.estimation.outliers import without
from truenewton.estimation.repeats import BlockRows, RepeatSums
from truenewton.records.campaign import Campaign

MEDIAN_ROWS = 200  # which tell the noise to 8 per cent
QUARTILE = scipy.stats.norm.isf(0.25)  # median of |z|


@dataclass(frozen=True, eq=False)
class Sifted:
    """A campaign whose rows were read once, and those that do not belong left out.

    Attributes
    ----------
    campaign, sound
        As it was given; with the rows rejected marked as not valid.
    rejected
        The rows that lie far from their repeats.
    moments
        Of the sound rows.
    samples
        (m, n) deviations of some repeated rows from the others of their groups, at weight 1 [N], in
        some parts.
    """

    campaign: Campaign
    sound: Campaign
    rejected: tuple[RejectedRow, ...]
    moments: Moments
    samples: tuple[Array, ...]


def sift(campaign: Campaign) -> Sifted:
    """Read a campaign and leave out rows that lie far from their repeats.

    FORCE is read once, and once more what stands in the same blocks as rows left out; all of it
    where the mean of POSITION, or two lone repeats, went with them.

    Raises
    ------
    TooManyOutliers
        A cycle would lose all its rows.
    """
    sums, sound, rejected = RepeatSums(campaign), campaign, list[RejectedRow]()
    while worst := _leave_out_worst(sums):
        rejected += worst
        sound = without(sound, worst)
        if sums.stale:
            del sums  # there is no room for two where the mirror is large
            sums = RepeatSums(sound)
    return Sifted(campaign, sound, tuple(rejected), sums.moments, tuple(sums.samples))


def campaign_moments(campaign: Campaign, reference: Array | None = None) -> Moments:
    """Return the moments of all rows of a campaign that count, whatever they hold.

    Parameters
    ----------
    campaign
        The campaign, or a part of it.
    reference
        (n,) readings from which displacements count [m]: of a part the `common_reference` of the
        whole campaign, else no `merge` is exact. Where it is NaN, a part must hold whole cycles.
    """
    return RepeatSums(campaign, reference).moments


def _leave_out_worst(sums: RepeatSums) -> list[RejectedRow]:
    """Leave out the worst row of each group that has one too far out; both rows of a pair."""
    moments, rejected = sums.moments, list[RejectedRow]()
    if moments.repeats < 2:
        return rejected
    noise, robust = np.sqrt(moments.scatter / moments.repeats), _robust(sums.samples)
    # The median is less sure than the scatter: it counts where spikes have swollen that.
    noise = np.where(noise > 1.5 * robust, robust, noise)
    tests = moments.rows.sum() * len(noise)
    limit = scipy.stats.t.isf(FALSE_ALARM / 2 / tests, moments.repeats - 1)
    suspicious = np.flatnonzero((sums.furthest > limit * noise).any(axis=1))
    if suspicious.size:  # noise of rounding
        noise = np.maximum(noise, 1e-12 * max(moments.mean.max(), -moments.mean.min()))
    for block in suspicious.tolist():
        read = sums.read(block)
        if worst := _worst_rows(sums, block, read, noise, limit):
            sums.leave_out(block, read, worst)
            rejected += worst
    return rejected


def _worst_rows(
    sums: RepeatSums, block: int, read: list[BlockRows], noise: Array, limit: float
) -> list[RejectedRow]:
    """Return the worst row of each group of a block that has one too far out; or a pair."""
    ids = sums.campaign.layout.id[sums.campaign.layout.enabled]
    worst: dict[int, RejectedRow] = {}
    pairs: list[RejectedRow] = []
    for part in read:
        sigmas = np.abs(sums.deviations(block, part)) / noise
        group, number, rows = sums.group(block, part), sums.number(block, part), sums.row(part)
        for at in np.flatnonzero(sigmas.max(axis=1, initial=0.0) > limit).tolist():
            i, g = int(sigmas[at].argmax()), int(group[at])
            far = float(sigmas[at, i])
            row = RejectedRow(part.cycle_index, int(rows[at]), int(ids[i]), far, "repeats")
            if number[at] == 2:
                pairs.append(row)
            elif g not in worst or worst[g].sigmas < far:
                worst[g] = row
    return [*worst.values(), *pairs]


def _robust(samples: Sequence[Array]) -> Array:
    """Return (n,) noise of a reading that an actuator's spikes cannot swell: from the median."""
    stride = max(1, sum(map(len, samples)) // MEDIAN_ROWS)
    some = np.concatenate([sample[::stride] for sample in samples]).T
    ordered = np.sort(np.abs(some))  # faster than np.median
    count = ordered.shape[1]
    middle = slice((count - 1) // 2, count // 2 + 1)
    return np.asarray(ordered[:, middle].mean(axis=1) / QUARTILE)
