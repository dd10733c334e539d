"""What a campaign boils down to: repeats put together, then sums over shapes.

Rows with the same load, SHAPE and SIGN share their true forces, so their number, mean and scatter
hold all that they say of alpha; these merge over files, processes and machines in any order (the
update of Chan, Golub and LeVeque). From the means, everything the likelihood needs of a load is
their number, sum and second moment: one symmetric rank-k update by BLAS.

Where POSITION and the gradients are given, c becomes c (1 + COILGRAD z), and the bias magnets'
change BIASGRAD z is kept as a known part of the balance (docs/files.md). Displacements count from
the mean reading of each sensor over the cycle, taken on rows that have their opposite.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk

from truenewton.actuators import Array
from truenewton.balance import enabled_arms
from truenewton.campaign import Campaign
from truenewton.measurements import Cycle, Load

WEIGHED_NOISE = 1e-3  # of a reading that counts once [N]
ROWS_AT_ONCE = 64  # a block of rows stays in the processor's cache


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
        (g,) number of rows.
    weight
        (g,) sum of the weights of the rows; their number where no file declares its noise.
    mean
        (g, n) mean commanded force of the enabled actuators, COILGRAD taken in [N].
    known
        (g, 3) mean of what is known of the balance beforehand: A (BIASGRAD z).
    scatter
        (n,) weighted sum of squared deviations of rows from their group's mean [N^2].
    """

    loads: tuple[Load, ...]
    labels: NDArray[np.int64]
    rows: NDArray[np.int64]
    weight: Array
    mean: Array
    known: Array
    scatter: Array

    @property
    def repeats(self) -> int:
        """Rows less groups: the degrees of freedom of the scatter of one actuator."""
        return int((self.rows - 1).sum())

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


def row_weights(campaign: Campaign) -> tuple[float, ...]:
    """Return the weight of a row of each cycle: quieter readings (FORCERR) count for more.

    In units of `WEIGHED_NOISE`, so that parts of a campaign merge whatever each declares; 1 for all
    where one of the files declares nothing, since it could be anything.
    """
    if not all(cycle.force_error for cycle in campaign.cycles):
        return (1.0,) * len(campaign.cycles)
    return tuple((WEIGHED_NOISE / (cycle.force_error or 1.0)) ** 2 for cycle in campaign.cycles)


def campaign_moments(campaign: Campaign) -> Moments:
    """Return the moments of a campaign's valid rows."""
    a, weights = enabled_arms(campaign.layout), row_weights(campaign)
    parts = []
    for place, load in enumerate(campaign.loads):
        of_load = [k for k, at in enumerate(campaign.load_index) if at == place]
        cycles, load_weights = [campaign.cycles[k] for k in of_load], [weights[k] for k in of_load]
        parts.append(_load_moments(load, cycles, load_weights, a))
    return reduce(merge, parts)


def groups_of(cycle: Cycle, place: int, moments: Moments) -> NDArray[np.int64]:
    """Return (N,) the group of each valid row of a cycle whose load stands at ``place``."""
    at = np.flatnonzero(moments.labels[:, 0] == place)
    codes = 2 * moments.labels[at, 1] + (moments.labels[at, 2] > 0)
    wanted = 2 * cycle.shape[cycle.valid] + (cycle.sign[cycle.valid] > 0)
    return np.asarray(at[np.searchsorted(codes, wanted)])


def chosen_groups(moments: Moments, chosen: NDArray[np.bool_]) -> Moments:
    """Return the moments of some of the groups; the scatter stays that of all."""
    return replace(
        moments,
        labels=moments.labels[chosen],
        rows=moments.rows[chosen],
        weight=moments.weight[chosen],
        mean=moments.mean[chosen],
        known=moments.known[chosen],
    )


def _load_moments(
    load: Load, cycles: Sequence[Cycle], weights: Sequence[float], a: Array
) -> Moments:
    """Return the moments of the cycles of one load, each row of a cycle with its weight."""
    names = [np.stack([c.shape[c.valid], c.sign[c.valid]], axis=1) for c in cycles]
    unique, member = np.unique(np.concatenate(names), axis=0, return_inverse=True)
    members = np.split(member.ravel(), np.cumsum([len(name) for name in names])[:-1])
    groups, n = len(unique), a.shape[1]
    rows, weight = np.zeros(groups, dtype=np.int64), np.zeros(groups)
    mean, known, scatter = np.zeros((groups, n)), np.zeros((groups, 3)), np.zeros(n)
    for cycle, group, w in zip(cycles, members, weights, strict=True):
        force, balance = balanced_rows(cycle, a)
        for some in _distinct(group):
            for start in range(0, len(some), ROWS_AT_ONCE):
                chosen = some[start : start + ROWS_AT_ONCE]
                at = group[chosen]
                share = w / (weight[at] + w)
                apart = force[chosen] - mean[at]
                scatter += np.einsum("g,gi,gi->i", weight[at] * share, apart, apart)
                apart *= share[:, None]
                mean[at] += apart
                known[at] += share[:, None] * (balance[chosen] - known[at])
                weight[at] += w
                rows[at] += 1
    labels = np.column_stack([np.zeros(groups, dtype=np.int64), unique])
    return Moments((load,), labels, rows, weight, mean, known, scatter)


def balanced_rows(cycle: Cycle, a: Array) -> tuple[Array, Array]:
    """Return c (1 + COILGRAD z), (N, n), and A (BIASGRAD z), (N, 3), of the valid rows."""
    force = cycle.used_force
    if cycle.position is None:
        return force, np.zeros((len(force), 3))
    z = cycle.position[cycle.valid][:, cycle.layout.enabled]
    z = z - z[_paired(cycle)].mean(axis=0)
    if cycle.coil_gradient:
        force = force * (1.0 + cycle.coil_gradient * z)
    return force, (cycle.bias_gradient or 0.0) * z @ a.T


def _paired(cycle: Cycle) -> NDArray[np.bool_]:
    """Return (N,) true for valid rows whose opposite is valid too; all rows where none has one.

    Their mean is the flat mirror, whatever rows are missing.
    """
    code = cycle.sign[cycle.valid] * cycle.shape[cycle.valid]
    paired = np.isin(-code, code)
    return paired if paired.any() else np.ones_like(paired)


def _distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of rows in none of which a group stands twice; mostly one set of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]


def merge(one: Moments, other: Moments) -> Moments:
    """Put the moments of two sets of rows of one campaign together.

    Loads are told apart by name; the order in which parts are merged changes rounding only.
    """
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
    share = other.weight / (weight[second] + other.weight)
    apart = other.mean - mean[second]
    scatter = one.scatter + other.scatter + (weight[second] * share) @ apart**2
    mean[second] += share[:, None] * apart
    known[second] += share[:, None] * (other.known - known[second])
    weight[second] += other.weight
    rows[second] += other.rows
    return Moments(loads, labels, rows, weight, mean, known, scatter)


def _relabelled(moments: Moments, loads: tuple[Load, ...]) -> NDArray[np.int64]:
    keys = [load.key for load in loads]
    places = np.array([keys.index(load.key) for load in moments.loads])
    return np.column_stack([places[moments.labels[:, 0]], moments.labels[:, 1:]])


@dataclass(frozen=True, eq=False)
class LoadSums:
    """Sums over the shapes of one load, each counted with its weight r.

    Attributes
    ----------
    shapes
        Number of distinct shapes: each brings its own noise.
    weight
        Sum of r.
    force
        (n,) sum of r c.
    square
        (n, n) sum of r c c'.
    known, known_force, known_square
        (3,), (3, n) and (3, 3) sums of r q, r q c', r q q' of the balance known beforehand.
    """

    shapes: int
    weight: float
    force: Array
    square: Array
    known: Array
    known_force: Array
    known_square: Array


def load_sums(mean: Array, weight: Array, known: Array) -> LoadSums:
    """Return the sums over (g, n) means with (g,) weights and (g, 3) known balance."""
    heavy = mean * np.sqrt(weight)[:, None]
    square = dsyrk(1.0, heavy.T)  # the upper triangle of heavy' heavy
    square = square + np.triu(square, 1).T
    q = known * weight[:, None]
    return LoadSums(
        shapes=len(mean),
        weight=float(weight.sum()),
        force=weight @ mean,
        square=square,
        known=q.sum(axis=0),
        known_force=q.T @ mean,
        known_square=q.T @ known,
    )


def sums_by_load(moments: Moments, loads: int) -> tuple[LoadSums, ...]:
    """Return the sums of each load of a campaign."""
    starts = np.searchsorted(moments.labels[:, 0], np.arange(loads + 1))
    blocks = [slice(start, end) for start, end in pairwise(starts.tolist())]
    return tuple(load_sums(moments.mean[b], moments.weight[b], moments.known[b]) for b in blocks)
