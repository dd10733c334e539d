"""The rows of a campaign as they balance, in groups that repeat one shape under one load.

Displacements count from one reading of each sensor for all cycles of a campaign: the mean of its
cycles at rest. So alpha is that of the mean position of the mirror under all loads. Electronics may
set their zero anew with each file. If the mean of a sensor over a cycle differs from the common one
by more than its rms displacement, this sensor counts from the mean of each cycle instead; if this
holds for most sensors, all of them do.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, blocks
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle, common_rest
from truenewton.statics.arms import enabled_arms
from truenewton.statics.load import Load

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]

# -- displacements --------------------------------------------------------------------------------


def common_reference(campaign: Campaign) -> Array:
    """Return (n,) the readings from which the displacements of a campaign count [m].

    NaN for a sensor that counts from the mean of each cycle; all are NaN if no cycle has both
    POSITION and a gradient.
    """
    displaced = [cycle for cycle in campaign.cycles if is_displaced(cycle)]
    if not displaced:
        return np.full(int(campaign.layout.enabled.sum()), np.nan)
    return common_rest(displaced)


def rest_positions(campaign: Campaign) -> tuple[Array, ...] | None:
    """Return for each cycle (n,) readings from which its displacements count [m].

    They do not depend on gradients; None if a cycle has no POSITION.
    """
    if any(cycle.position is None for cycle in campaign.cycles):
        return None
    reference = common_rest(campaign.cycles)
    return tuple(_from_own_mean(reference, cycle) for cycle in campaign.cycles)


def _from_own_mean(reference: Array, cycle: Cycle) -> Array:
    """Return (n,) a reference [m], the mean of the cycle itself where it is NaN."""
    anew = np.isnan(reference)
    return np.where(anew, cycle.rest_position, reference) if anew.any() else reference


def is_displaced(cycle: Cycle) -> bool:
    """Return whether POSITION changes the balance of a cycle."""
    return cycle.position is not None and bool(cycle.coil_gradient or cycle.bias_gradient)


# -- rows as they balance -------------------------------------------------------------------------


def balanced(cycle: Cycle, a: Array, reference: Array) -> tuple[Array, Array]:
    """Return the N valid rows of a cycle as they balance, by (3, n) arms and (n,) reference [m].

    (N, n) c (1 + COILGRAD z) [N] and (N, 3) A (BIASGRAD z). Coils that have shifted by COILZ are
    displaced without POSITION, too.
    """
    force, shift = cycle.used_force, cycle.load.coil_shift or 0.0
    if cycle.position is not None and is_displaced(cycle):
        zero = _from_own_mean(reference, cycle) + shift
        z = cycle.used(cycle.position, slice(None)) - zero
    elif shift:
        z = np.full_like(force, -shift)
    else:
        return force, np.zeros((len(force), 3))
    known = (cycle.bias_gradient or 0.0) * z @ a.T
    z *= cycle.coil_gradient or 0.0  # in place: a copy takes as much memory as the data
    z += 1.0
    z *= force
    return z, known


@dataclass(frozen=True, eq=False)
class Rows:
    """The N valid rows of a campaign in the order of its files, and the g groups of them.

    Rows with the same load, SHAPE and SIGN are a group.
    """

    loads: tuple[Load, ...]
    labels: NDArray[np.int64]  # (g, 3) index of the load, SHAPE, SIGN; sorted
    # (N,) group, index of the cycle and number in it, weight, hours since the mean of all cycles
    group: NDArray[np.int64]
    file: NDArray[np.int64]
    row: NDArray[np.int64]
    weight: Array
    hour: Array
    # of each file (N_k, n) c (1 + COILGRAD z) [N], the recorded forces without a copy if z is 0;
    # and (N_k, 3) A (BIASGRAD z)
    force: tuple[Array, ...]
    known: tuple[Array, ...]
    reference: Array  # (n,) readings from which displacements count [m]

    @cached_property
    def number(self) -> NDArray[np.int64]:
        """(g,) number of rows."""
        return np.bincount(self.group)

    @cached_property
    def total(self) -> Array:
        """(g,) sum of the weights of the rows."""
        return np.bincount(self.group, self.weight).astype(np.float64, copy=False)

    @cached_property
    def distance_factor(self) -> Array:
        """(N,) factor of the squared deviation of a row from the mean of the others.

        The mean includes the row itself. With this factor, deviations have the variance of a
        reading of weight 1; it is 0 for a row without others.
        """
        weight, total, alone = self.weight, self.total[self.group], self.number[self.group] == 1
        return np.asarray(weight * total / np.where(alone, np.inf, total - weight))

    def parts(self, values: Iterable[Array]) -> Iterator[tuple[slice, Array]]:
        """Yield which of the N rows, and their values, by (N_k, m) values of each file."""
        start = 0
        for of_file in values:
            for some in blocks(len(of_file), 4 * 8 * of_file.shape[1]):  # and what is made of them
                yield slice(start + some.start, start + some.stop), of_file[some]
            start += len(of_file)

    def means(self, values: Iterable[Array], width: int) -> Array:
        """Return (g, width) means over the rows of each group, by (N_k, width) values of each file.

        Rows are added in their order, each by its weight over the largest.
        """
        heaviest, mean = self.weight.max(), np.zeros((len(self.labels), width))
        for rows, some in self.parts(values):
            group, share = self.group[rows], self.weight[rows.start] / heaviest
            for of_each in distinct(group):  # np.add.at takes four times as long
                values = some[of_each]
                mean[group[of_each]] += values if share == 1.0 else share * values
        mean *= (heaviest / self.total)[:, None]
        return mean

    @cached_property
    def mean(self) -> Array:
        """(g, n) mean force of each group [N]."""
        return self.means(self.force, len(self.reference))

    def deviations(self) -> Iterator[tuple[slice, Array, Array]]:
        """Yield which of the N rows, (m, n) means of their groups and deviations from these [N].

        The last rows come first: they are in the cache still.
        """
        for rows, force in reversed([*self.parts(self.force)]):
            mean = self.mean[self.group[rows]]
            yield rows, mean, force - mean


def rows_of(campaign: Campaign) -> Rows:
    """Return the valid rows of a campaign as they balance."""
    reference = common_reference(campaign)
    a = enabled_arms(campaign.layout)
    force, known = zip(*(balanced(cycle, a, reference) for cycle in campaign.cycles), strict=True)
    return grouped(campaign, force, known, reference)


def grouped(
    campaign: Campaign, force: tuple[Array, ...], known: tuple[Array, ...], reference: Array
) -> Rows:
    """Return the N valid rows of a campaign, with (N_k, n) forces of each file [N]; see `Rows`."""
    labels, groups = row_groups(campaign)
    counts = [len(group) for group in groups]
    return Rows(
        campaign.loads,
        labels,
        group=np.concatenate(groups),
        file=np.repeat(np.arange(len(counts)), counts),
        row=np.concatenate([np.flatnonzero(cycle.valid) for cycle in campaign.cycles]),
        weight=np.repeat(row_weights(campaign), counts),
        hour=np.concatenate(row_hours(campaign)),
        force=force,
        known=known,
        reference=reference,
    )


# -- groups ---------------------------------------------------------------------------------------


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`; 1 for all if one of the files declares no noise, since it could be
    anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def row_hours(campaign: Campaign) -> tuple[Array, ...]:
    """Return for each cycle (N,) hours of its rows that count, since the mean of all cycles."""
    first = min(cycle.date for cycle in campaign.cycles)
    times = [
        (cycle.date - first).total_seconds() / 3600 + cycle.time[cycle.valid] / 3600
        for cycle in campaign.cycles
    ]
    mean = np.mean([time.mean() for time in times])
    return tuple(time - mean for time in times)


def row_groups(campaign: Campaign) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """Return the groups of a campaign's rows.

    (g, 3) index of the load, SHAPE, SIGN, sorted; and for each cycle (N,) the group of its valid
    rows.
    """
    names = [
        np.column_stack([np.full(np.count_nonzero(c.valid), k), c.shape[c.valid], c.sign[c.valid]])
        for c, k in zip(campaign.cycles, campaign.load_index, strict=True)
    ]
    whole, ends = np.concatenate(names), np.cumsum([len(name) for name in names])[:-1]
    span = int(whole[:, 1].max()) + 1
    # Shapes may be numbered at will; a code of load, SHAPE and SIGN has to fit into 64 bits.
    if span > 2**40:
        _, first, group = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    else:
        codes = 2 * (span * whole[:, 0] + whole[:, 1]) + (whole[:, 2] > 0)
        _, first, group = np.unique(codes, return_index=True, return_inverse=True)
    return whole[first], np.split(group.ravel(), ends)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of the (N,) rows, each with at most one row of a group; mostly one of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
