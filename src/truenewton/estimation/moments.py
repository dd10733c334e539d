"""What a campaign boils down to: repeats put together, then sums over shapes.

Rows with the same load, SHAPE and SIGN share their true forces, so their number, mean and scatter
hold all that they say of alpha; these merge over files, processes and machines in any order (the
update of Chan, Golub and LeVeque). From the means, everything the likelihood needs of a load is
their number, sum and second moment: one symmetric rank-k update by BLAS.

Where POSITION and the gradients are given, c becomes c (1 + COILGRAD z), and the bias magnets'
change BIASGRAD z is kept as a known part of the balance (docs/files.md). Displacements count from
one reading of each sensor for the whole campaign (`displaced_rows.common_reference`): parts of one
that shall merge must be given it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import CampaignMismatch
from truenewton.estimation.displaced_rows import (
    BalancedRows,
    DistinctRows,
    common_reference,
    distinct,
)
from truenewton.estimation.shape_sums import ShapeSums, shape_sums
from truenewton.files.stored_rows import BLOCK_BYTES
from truenewton.linalg import ROWS_AT_ONCE
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle
from truenewton.statics.arms import enabled_arms
from truenewton.statics.load import Load

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]


@dataclass(frozen=True, eq=False)
class Moments:
    """Groups of rows that repeat one shape.

    Attributes
    ----------
    loads
        The L loads.
    labels
        (g, 3) place of the load, SHAPE, SIGN; sorted.
    rows
        (g,) number of rows; 0, as its weight, for a group that is left out.
    weight
        (g,) sum of the weights of the rows; their number where no file declares its noise.
    mean
        (g, n) mean commanded force of the enabled actuators, COILGRAD taken in [N].
    known
        (g, 3) mean of what is known of the balance beforehand: A (BIASGRAD z).
    scatter
        (n,) weighted sum of squared deviations of rows from their group's mean [N^2].
    furthest
        (n,) largest distance of a row from its group's mean, as seen from the rest of the group
        and divided by its noise over that of a row of weight 1 [N]; infinite where groups have
        been merged, so that nobody knows.
    reference
        (n,) readings from which displacements count [m]; NaN where from the mean of each cycle.
    """

    loads: tuple[Load, ...]
    labels: NDArray[np.int64]
    rows: NDArray[np.int64]
    weight: Array
    mean: Array
    known: Array
    scatter: Array
    furthest: Array
    reference: Array

    @property
    def groups(self) -> int:
        """Number of groups that are not left out: of distinct shapes, each with its own noise."""
        return int(np.count_nonzero(self.rows))

    @property
    def repeats(self) -> int:
        """Rows less groups: the degrees of freedom of the scatter of one actuator."""
        return int(self.rows.sum()) - self.groups

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, RMS over actuators [N]; NaN if nothing repeats."""
        if not self.repeats:
            return float("nan")
        return float(np.sqrt(self.scatter.mean() / self.repeats * self.typical_variance))

    @property
    def typical_variance(self) -> float:
        """Variance of a typical row in terms of one of weight 1."""
        return float(self.rows.sum() / self.weight.sum())

    @cached_property
    def sums(self) -> ShapeSums:
        """The sums over groups; taken once."""
        load = self.labels[:, 0]
        return shape_sums(self.mean, self.weight, self.known, load, len(self.loads))


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`, so that parts of a campaign merge whatever each declares; 1 for all
    where one of the files declares nothing, since it could be anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def campaign_moments(campaign: Campaign, reference: Array | None = None) -> Moments:
    """Return the moments of a campaign's valid rows.

    Groups are worked through in the order in which they come, so that rows are read where they
    stand; a block after the other, so that all rows of a group are in the cache, and of those on
    disk no more in memory, while their mean and then their deviations from it are taken.

    Parameters
    ----------
    campaign
        The campaign, or a part of it.
    reference
        (n,) readings from which displacements count [m]: of a part `common_reference` of the whole
        campaign, else no `merge` can be exact; that of ``campaign`` unless told. Where it is NaN,
        a part must hold whole cycles.
    """
    reference = common_reference(campaign) if reference is None else reference
    a, n = enabled_arms(campaign.layout), int(campaign.layout.enabled.sum())
    names = [
        np.column_stack([np.full(int(c.valid.sum()), place), c.shape[c.valid], c.sign[c.valid]])
        for c, place in zip(campaign.cycles, campaign.load_index, strict=True)
    ]
    labels, first, member = _unique(np.concatenate(names))
    coming = np.argsort(first)  # groups, as they come
    place = np.argsort(coming)
    members = np.split(place[member], np.cumsum([len(name) for name in names])[:-1])
    layers = [
        DistinctRows(rows, some, group[some], weight_of_row)
        for cycle, group, weight_of_row in zip(
            campaign.cycles, members, row_weights(campaign), strict=True
        )
        for rows in [BalancedRows(cycle, a, reference)]
        for some in distinct(group)
    ]
    groups = len(labels)
    number, weight = np.zeros(groups, dtype=np.int64), np.zeros(groups)
    for layer in layers:
        number[layer.group] += 1
        weight[layer.group] += layer.weight
    weights = {layer.weight for layer in layers}
    heaviest = max(weights)
    # A mean holds the row itself: seen from the others it lies further out. 0 without others.
    others = {w: np.where(weight > w, weight - w, np.inf) for w in weights}
    further = {w: w * weight / others[w] for w in weights}
    uneven = {w: bool((further[w] != further[w][0]).any()) for w in weights}
    mean, known = np.empty((groups, n)), np.zeros((groups, 3))
    scatter, furthest = np.zeros(n), np.zeros(n)
    at_once = int(np.clip(BLOCK_BYTES // (8 * n * number.max()), 1, ROWS_AT_ONCE))
    for start in range(0, groups, at_once):
        block = slice(start, min(start + at_once, groups))
        read = [part for layer in layers if (part := layer.within(block)) is not None]
        centre, balanced = np.zeros((block.stop - start, n)), np.zeros((block.stop - start, 3))
        for at, force, balance, w in read:
            share = w / heaviest
            centre[at] += force if share == 1.0 else share * force
            if balance is not None:
                balanced[at] += w * balance
        centre *= (heaviest / weight[block])[:, None]
        mean[coming[block]] = centre
        known[coming[block]] = balanced / weight[block, None]
        for at, force, _, w in reversed(read):  # the last are in the cache still
            apart = force - centre[at]
            apart *= apart
            scatter += w * (np.ones(len(apart)) @ apart)
            if uneven[w]:
                apart *= further[w][block][at][:, None]
                np.maximum(furthest, apart.max(axis=0), out=furthest)
            else:
                np.maximum(furthest, apart.max(axis=0) * further[w][0], out=furthest)
    loads, furthest = campaign.loads, np.sqrt(furthest)
    number, weight = number[place], weight[place]
    return Moments(loads, labels, number, weight, mean, known, scatter, furthest, reference)


def _unique(
    labels: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the sorted distinct (place, SHAPE, SIGN), the first row and which of them each has."""
    span = int(labels[:, 1].max()) + 1
    if span > 2**40:  # shapes may be numbered at will
        unique, first, member = np.unique(labels, axis=0, return_index=True, return_inverse=True)
        return unique, first, member.ravel()
    codes = 2 * (span * labels[:, 0] + labels[:, 1]) + (labels[:, 2] > 0)
    _, first, member = np.unique(codes, return_index=True, return_inverse=True)
    return labels[first], first, member.ravel()


def groups_of(cycle: Cycle, place: int, moments: Moments) -> NDArray[np.int64]:
    """Return (N,) the group of each valid row of a cycle whose load stands at ``place``."""
    at = np.flatnonzero(moments.labels[:, 0] == place)
    codes = 2 * moments.labels[at, 1] + (moments.labels[at, 2] > 0)
    wanted = 2 * cycle.shape[cycle.valid] + (cycle.sign[cycle.valid] > 0)
    return np.asarray(at[np.searchsorted(codes, wanted)])


def chosen_groups(moments: Moments, chosen: NDArray[np.bool_]) -> Moments:
    """Return moments in which only the (g,) chosen groups count; scatter stays that of all.

    The others keep their place and lose their rows and weight, so that no mean is copied.
    """
    rows, weight = np.where(chosen, moments.rows, 0), np.where(chosen, moments.weight, 0.0)
    return replace(moments, rows=rows, weight=weight)


def merge(one: Moments, other: Moments) -> Moments:
    """Put the moments of two sets of rows of one campaign together.

    Loads are told apart by name; the order in which parts are merged changes rounding only.

    Raises
    ------
    CampaignMismatch
        Their displacements count from different readings.
    """
    if not np.array_equal(one.reference, other.reference, equal_nan=True):
        raise CampaignMismatch(
            "the displacements of the two parts count from different readings",
            remedy="give campaign_moments of every part the common_reference of the whole campaign",
        )
    loads = tuple({load.key: load for load in (*one.loads, *other.loads)}.values())
    loads = tuple(sorted(loads, key=lambda load: (load.added != 0.0, load.tilt != 0.0, load.key)))
    both = np.concatenate([_relabelled(one, loads), _relabelled(other, loads)])
    labels, member = np.unique(both, axis=0, return_inverse=True)
    first, second = np.split(member.ravel(), [len(one.labels)])
    groups, n = len(labels), one.mean.shape[1]
    rows, weight = np.zeros(groups, dtype=np.int64), np.zeros(groups)
    mean, known = np.zeros((groups, n)), np.zeros((groups, 3))
    rows[first], weight[first], mean[first], known[first] = (
        one.rows, one.weight, one.mean, one.known,
    )  # fmt: skip
    total = weight[second] + other.weight
    share = other.weight / np.where(total > 0.0, total, 1.0)
    apart = other.mean - mean[second]
    scatter = one.scatter + other.scatter + (weight[second] * share) @ apart**2
    mean[second] += share[:, None] * apart
    known[second] += share[:, None] * (other.known - known[second])
    weight[second] += other.weight
    rows[second] += other.rows
    apart_still = len(labels) == len(one.labels) + len(other.labels)
    furthest = np.maximum(one.furthest, other.furthest) if apart_still else np.full(n, np.inf)
    return Moments(loads, labels, rows, weight, mean, known, scatter, furthest, one.reference)


def _relabelled(moments: Moments, loads: tuple[Load, ...]) -> NDArray[np.int64]:
    keys = [load.key for load in loads]
    places = np.array([keys.index(load.key) for load in moments.loads])
    return np.column_stack([places[moments.labels[:, 0]], moments.labels[:, 1:]])
