"""What effects on readings do: g = h(row) e(group, actuator), a block of actuators after the other.

K functions h of a row, and a field e. All that depends on actuators is linear or square in e, so
one pass over the means of groups tells it for all h: for effects that all actuators share, sums
over actuators, three numbers and a vector a group. No array of all groups is made, since the means
are as large as a campaign's distinct shapes, and what is made stays in the cache.

Effects on readings with fewer parameters: of single actuators, or counted from their mean.

A driver fails, a coil loses turns: actuator by actuator, what pooled rows leave of the readings
tells, by U_t' M_tt^-1 U_t of its parameters, chi^2 (`score_test`). Those that stand out have
parameters, the others none, so that alpha is no less sure for what might have happened to them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_sf
from truenewton.estimation.effects.derivative import (
    Derivative,
    FittedRows,
    OfEach,
    without_direction,
)
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, WithinGroups


@dataclass(frozen=True, eq=False)
class RowFunctions:
    """K functions h of a row, on which an effect on readings depends.

    Attributes
    ----------
    first
        (K, g) weighted sums of h over the rows of each group.
    within
        How many of them, the first, are those of `moments.WithinGroups`; the others are the same
        for all rows of a group.
    """

    first: Array
    within: int = 0


def always(moments: Moments) -> RowFunctions:
    """Return the one that is 1 in all rows."""
    return RowFunctions(moments.weight[None])


def row_functions(moments: Moments, of_groups: Array) -> RowFunctions:
    """Return those by which rows of one group differ, then (K, g) that groups have as a whole."""
    first = moments.within.first * (moments.weight > 0)
    return RowFunctions(np.vstack([first, of_groups * moments.weight]), len(first))


@dataclass(frozen=True)
class Field:
    """E of an effect on readings.

    Attributes
    ----------
    name
        By which it is known.
    values
        Makes (g, b) e of some actuators at a fit; (g, 1) where it is the same for all.
    gain
        Whether e is -c^, which noise reaches, and -c_mean where rows of one group differ; else it
        is 1 there.
    """

    name: str
    values: Callable[[FittedRows, slice], Array]
    gain: bool = False

    def own(self, within: WithinGroups, some: slice = slice(None)) -> Array:
        """Return (g, b) e as the rows of a group have it, or (g, 1)."""
        return -within.mean[:, some] if self.gain else np.ones((len(within.mean), 1))

    def sums(self, within: WithinGroups) -> Array:
        """Return the (files + 1, n) weighted sums of h (c - c_mean) e."""
        return -within.gain if self.gain else within.zero


ZERO = Field("zero", lambda fit, _: np.ones((len(fit.moments.mean), 1)))
GAIN = Field("gain", lambda fit, some: -fit.recorded(some), gain=True)


@dataclass(frozen=True, eq=False)
class OnReadings:
    """What an effect on readings does, for K functions h, for the first k with a size of each.

    Attributes
    ----------
    functions, field
        Its h and e.
    jacobian
        (R, 3, K) J, were its parameters those of all actuators.
    score, information
        (K,) and (K, K) of what pooled rows leave, then.
    each_score, each_information
        (k, n) and (k, k, n) of each actuator.
    each_square, each_pull
        (k, k, n) sums over the R rows of products of U' r h e, and (3, k, n) of the same times
        S^-1/2 rho.
    """

    functions: RowFunctions
    field: Field
    jacobian: Array
    score: Array
    information: Array
    each_score: Array
    each_information: Array
    each_square: Array
    each_pull: Array


def on_readings(fit: FittedRows, functions: RowFunctions, field: Field, k: int = 0) -> OnReadings:
    """Return what an effect on readings does; of the first k functions actuator by actuator.

    Between groups e is taken at the fit; within them, where a gain changes, it is -c_mean.
    """
    moments, n, first, within = fit.moments, fit.problem.n, functions.first, fit.moments.within
    g, mean = first.shape[1], means(moments, functions)
    # Of several files they are often the same: then all groups of a load have rows of each.
    kinds: dict[bytes, int] = {}
    kind = np.array([kinds.setdefault(h.tobytes(), len(kinds)) for h in mean])
    pools = [moments.pooling.weighed(np.frombuffer(h)) for h in kinds]
    told, square, own_square, pulled = np.zeros(g), np.zeros(g), np.zeros(g), np.zeros((g, 3))
    between = np.zeros((len(kinds), len(kinds)))
    each_score, each_pull = np.zeros((k, n)), np.zeros((3, k, n))
    each_information, each_square = np.zeros((2, k, k, n))
    white_rho, weights = fit.white_rho.reshape(-1, 3), 1.0 / fit.problem.noise.variance
    for some in blocks_of_actuators(fit):
        e = field.values(fit, some)
        if fit.independent:
            off = e * fit.apart(some)
            told += off @ weights[some]
            if k:
                each_score[:, some] = -(first[:k] @ off)
        weigh, arms = weights[some], fit.scaled_arms[:, some]
        if e.shape[1] == 1:  # the same for all actuators: once
            if some.start:
                continue
            some = slice(None)
            weigh = weights.sum(keepdims=True)
            arms = fit.scaled_arms.sum(axis=1, keepdims=True)
        pulled += e @ arms.T
        rows = np.stack([pool @ e for pool in pools])  # (kinds, R, b)
        flat = (len(kinds), -1)
        between += (rows * weigh).reshape(flat) @ rows.reshape(flat).T
        if k:
            mine = rows[kind[:k]]
            each_square[:, :, some] = np.einsum("krb,lrb->klb", mine, mine)
            each_pull[:, :, some] = np.moveaxis(white_rho.T @ mine, 1, 0)
        if not fit.independent:
            continue
        e_squared = np.square(e, out=e)
        square += e_squared @ weigh
        own = field.own(within, some) ** 2 if functions.within else None
        if own is not None:
            own_square += own @ weigh
        if k:
            spread = np.stack([(mean[:k] * h) @ e_squared for h in first[:k]])
            if own is not None:
                spread += _apart(moments, functions, k, own)
            each_information[:, :, some] = spread
    noise = fit.problem.noise.variance
    score, information = np.zeros(len(first)), np.zeros((len(first),) * 2)
    if fit.independent:
        each_information -= each_square
        score -= first @ told
        information += (mean * square) @ first.T - between[kind][:, kind]
        if functions.within:
            information += _apart(moments, functions, len(first), own_square[:, None])[:, :, 0]
            sums = field.sums(within)
            score[: functions.within] -= sums @ weights
            if k:
                each_score -= sums[:k]
    jacobian = np.stack([pool @ pulled for pool in pools], axis=2)[:, :, kind]
    return OnReadings(
        functions, field, -jacobian, score, information, each_score / noise,
        each_information / noise, each_square, each_pull,
    )  # fmt: skip


def blocks_of_actuators(fit: FittedRows) -> Iterator[slice]:
    """Cut actuators into slices whose groups stay in the cache."""
    step = max(1, 2**17 // len(fit.moments.mean))
    for start in range(0, fit.problem.n, step):
        yield slice(start, min(start + step, fit.problem.n))


def means(moments: Moments, functions: RowFunctions) -> Array:
    """Return (K, g) mean h of the rows of each group."""
    return np.asarray(functions.first / np.where(moments.weight > 0, moments.weight, 1.0))


def _apart(moments: Moments, functions: RowFunctions, k: int, own: Array) -> Array:
    """Return sums of products of the first k h, less those of their means, times (g, b) values.

    (k, k, b); 0 for those that are the same for all rows of a group.
    """
    apart, some = np.zeros((k, k, own.shape[1])), min(k, functions.within)
    mean, counted = means(moments, functions)[:some], moments.weight > 0
    for row in range(some):
        products = moments.within.products(row)[:some] * counted - mean * functions.first[row]
        apart[row, :some] = products @ own
    return apart


@dataclass(frozen=True, eq=False)
class Sizes:
    """What sizes of an effect on readings its parameters theta are: (K, n) mix theta.

    Attributes
    ----------
    functions
        Those of its functions that have sizes.
    each
        Whether each actuator has sizes of its own, theta (K, n); else all share them, theta (K, 1).
    mix
        (K, K), as of `from_mean`; the identity if None.
    actuators
        Indices of the only ones that have sizes, if each has its own; None for all.
    direction
        (n,) sizes of each along which nothing happens, if there is such a one.
    """

    functions: slice = field(default_factory=lambda: slice(0, 1))
    each: bool = False
    mix: Array | None = None
    actuators: NDArray[np.intp] | None = None
    direction: Array | None = None


def from_mean(weight: Array) -> Array:
    """Return (K, K) mix of sizes that count from their mean, of (K,) weights.

    So alpha stays that of the whole campaign, and none of its error is that of the mean.
    """
    k = len(weight)
    return np.asarray(np.eye(k) - np.outer(np.ones(k), weight / weight.sum()))


def derivative_of(fit: FittedRows, effect: OnReadings, sizes: Sizes) -> Derivative:
    """Return the derivative of an effect on readings by its sizes, in the order (K, actuators)."""
    chosen, n = sizes.functions, fit.problem.n
    k = chosen.stop - chosen.start
    mix = np.eye(k) if sizes.mix is None else sizes.mix
    some = slice(None) if sizes.actuators is None else sizes.actuators
    trace = mix.T @ effect.functions.first[chosen] @ fit.moments.pooling.squared_lengths

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        if sizes.direction is not None:
            theta = without_direction(theta, sizes.direction)
        size = np.zeros((k, n))
        size[:, some] = mix @ theta.reshape(k, -1)
        return problem, without(fit, before, effect, chosen, size)

    def feigns() -> tuple[Array, float]:
        if not sizes.each:
            return np.outer(trace, fit.feigned_by_all), 0.0
        return (trace[:, None, None] * fit.feigned_by_each(some)).reshape(-1, n), 0.0

    feigned = feigns if effect.field.gain else None
    if not sizes.each:
        return Derivative(
            k,
            remove,
            jacobian=effect.jacobian[:, :, chosen] @ mix,
            score=mix.T @ effect.score[chosen],
            information=mix.T @ effect.information[chosen, chosen] @ mix,
            feigns=feigned,
        )
    arms = fit.scaled_arms[:, some]
    pulled = fit.root @ arms
    pull = mix.T @ effect.each_pull[:, chosen][:, :, some]
    square = np.einsum("kkn->kn", mixed(mix, effect.each_square[chosen, chosen][:, :, some]))

    def rows() -> Array:
        h = mix.T @ means(fit.moments, effect.functions)[chosen]
        values = effect.field.values(fit, slice(None))[:, some]
        made = np.empty((len(fit.fitted_rows), k, arms.shape[1]))
        for index, one in enumerate(h):
            made[:, index] = fit.moments.pooling.weighed(one) @ values
        return made.reshape(len(made), -1)

    return Derivative(
        k * arms.shape[1],
        remove,
        of_each=OfEach(
            arms=-np.tile(arms, k),
            rows=rows,
            score=-np.sum(pulled[:, None] * pull, axis=0).ravel(),
            whole=(np.sum(pulled**2, axis=0) * square).ravel(),
        ),
        score=(mix.T @ effect.each_score[chosen])[:, some].ravel(),
        information=mixed(mix, effect.each_information[chosen, chosen])[:, :, some],
        feigns=feigned,
        actuators=sizes.actuators,
        direction=sizes.direction,
    )


def mixed(mix: Array, values: Array) -> Array:
    """Return (K, K, n) mix' v mix of values v of each actuator."""
    return np.asarray(np.einsum("kl,kmn,mo->lon", mix, values, mix, optimize=True))


def without(
    fit: FittedRows, moments: Moments, effect: OnReadings, chosen: slice, size: Array
) -> Moments:
    """Return moments without an effect on readings of (K, n) sizes of some functions."""
    functions, field, counted = effect.functions, effect.field, moments.weight > 0
    shift = means(moments, functions)[chosen].T @ size
    mean, within = moments.mean - shift * field.values(fit, slice(None)), moments.within
    if chosen.start >= functions.within:
        return replace(moments, mean=mean)
    own, sums = field.own(within), field.sums(within)
    sizes = np.zeros((len(within.first), size.shape[1]))
    sizes[chosen] = size
    scatter = moments.scatter - 2.0 * np.sum(size * sums[chosen], axis=0)
    zeros, gains = within.zero.copy(), within.gain.copy()
    for index, first in enumerate(within.first):
        together = within.products(index) * counted
        apart = (together.T @ sizes - (first * counted)[:, None] * shift) * own
        zeros[index] -= apart.sum(axis=0)
        gains[index] -= np.sum(apart * within.mean, axis=0)
        scatter += sizes[index] * np.sum(apart * own, axis=0)
    within = replace(within, zero=zeros, gain=gains)
    return replace(moments, mean=mean, scatter=np.maximum(scatter, 0.0), within=within)


CHANCE_OF_ANY_ACTUATOR = 1e-2 * OF_EACH_KIND  # that any actuator of a sound mirror is chosen
MIN_DIRECTION_INFORMATION = 1e-4  # of the largest information: directions that the data hold


def chi2_of_each(score: Array, information: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return (n,) chi^2 of (K, n) scores of (K, K, n) information, and their freedom."""
    values, vectors = np.linalg.eigh(np.moveaxis(information, 2, 0))
    held = values > MIN_DIRECTION_INFORMATION * values.max()
    along = np.einsum("nab,an->nb", vectors, score)
    each = np.where(held, along**2 / np.where(held, values, 1.0), 0.0)
    return np.sum(each, axis=1), np.count_nonzero(held, axis=1)


def standing_out(effect: OnReadings, chosen: slice, mix: Array) -> NDArray[np.intp]:
    """Return whose scores chance does not make, of some functions with a (K, K) mix of sizes."""
    information = mixed(mix, effect.each_information[chosen, chosen])
    if not information.any():
        return np.empty(0, dtype=np.intp)
    chance = chi2_sf(*chi2_of_each(mix.T @ effect.each_score[chosen], information))
    return np.flatnonzero(chance < CHANCE_OF_ANY_ACTUATOR / len(chance))
