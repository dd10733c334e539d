"""Effects on readings, g = h(row) e(group, actuator), summed over blocks of actuators.

An effect changes a reading by its size times g, where h is one of K functions of the row and e a
field. All that its tests need is linear or quadratic in e. So one pass over the means of groups
gives it for all h of several fields; for effects that all actuators share it gives sums over
actuators, a force and two torques of each group. No array of all groups is made, since the means
are as large as the distinct shapes of a campaign, and each block stays in the cache.

Effects on single actuators, for example a driver that fails: what pooled rows leave of its readings
gives chi^2 = U_t' M_tt^-1 U_t of each actuator. Only actuators that stand out get
parameters; otherwise the error of every actuator would grow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_sf
from truenewton.estimation.effects.derivative import (
    Derivative,
    FittedRows,
    OfEach,
    Some,
    chi2_of_each,
)
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, WithinGroups

CHANCE_OF_ANY_ACTUATOR = 1e-2 * OF_EACH_KIND  # that any actuator of a sound mirror is chosen


@dataclass(frozen=True, eq=False)
class Field:
    """A field e, and K functions h of a row by which readings may change along it."""

    # Makes (g, b) e of some actuators from their (g, b) c^ as recorded [N]; (g, 1) if it is the
    # same for all
    values: Callable[[Some, Array], Array]
    first: Array  # (K, g) weighted sums of h over the rows of each group
    # Number of functions, the first ones, that differ within a group (`moments.WithinGroups`)
    within: int = 0
    each: int = 0  # number of functions, the first ones, whose sums are needed of each actuator
    # Whether e is -c^, and -c_mean within a group; then noise biases the score. Otherwise e is 1
    # within a group.
    gain: bool = False

    def at(self, fit: FittedRows, some: Some = slice(None)) -> Array:
        """Return (g, b) or (g, 1) e of some actuators."""
        return self.values(some, fit.recorded(some))

    def mean(self, moments: Moments) -> Array:
        """Return (K, g) mean h of the rows of each group."""
        return np.asarray(self.first / np.where(moments.weight > 0, moments.weight, 1.0))

    def own(self, within: WithinGroups, some: Some = slice(None)) -> Array:
        """Return (g, b) or (g, 1) e by which the rows of a group differ."""
        return -within.mean[:, some] if self.gain else np.ones((len(within.mean), 1))

    def sums(self, within: WithinGroups) -> Array:
        """Return the (files + 1, n) weighted sums of h (c - c_mean) e."""
        return -within.gain if self.gain else within.zero


def functions_with(moments: Moments, of_groups: Array) -> Array:
    """Return first moments of the h by file and by hour, then of (K, g) that groups share."""
    of_rows = moments.within.first * (moments.weight > 0)
    return np.vstack([of_rows, of_groups * moments.weight])


@dataclass(frozen=True, eq=False)
class FieldSums:
    """Sums over the rows of a fit, of a field with K functions h of k different means."""

    field: Field  # the field
    # (K,) which of the k means a function has: those of several files are often the same
    kind: NDArray[np.intp]
    jacobian: Array  # (R, 3, k) J of parameters that all actuators share
    # (K,) and (K, K) of what pooled rows leave, of such parameters
    score: Array
    information: Array
    # (each, n) and (each, each, n) of parameters of each actuator
    each_score: Array
    each_information: Array
    # (k, k, n) sums over the R rows of products of U' r h e, and (3, k, n) of S^-1/2 rho times U' r
    # h e, of the means of the first ``each`` functions
    each_square: Array
    each_pull: Array


def field_sums(fit: FittedRows, fields: Sequence[Field]) -> list[FieldSums]:
    """Return the sums of some fields, in one pass over blocks of actuators."""
    passes = [_FieldPass(fit, one) for one in fields]
    step = max(1, 2**17 // len(fit.moments.mean))
    for start in range(0, fit.problem.n, step):
        some = slice(start, min(start + step, fit.problem.n))
        recorded, apart = fit.recorded_and_apart(some)
        for one in passes:
            one.add(some, recorded, apart)
    return [one.result() for one in passes]


class _FieldPass:
    """Sums of one field over the blocks of actuators so far.

    Between groups e is that of the fit; within a group it is `Field.own`.
    """

    def __init__(self, fit: FittedRows, field: Field) -> None:
        self.fit, self.field, self.weights = fit, field, 1.0 / fit.problem.noise.variance
        moments, n, g = fit.moments, fit.problem.n, len(fit.moments.mean)
        kinds: dict[bytes, int] = {}
        means = field.mean(moments)
        self.kind = np.array([kinds.setdefault(h.tobytes(), len(kinds)) for h in means])
        self.mean = np.array([np.frombuffer(h) for h in kinds])
        self.within = moments.counted_within
        self.pool = moments.pooling.weighed(self.mean)
        k = 1 + int(self.kind[: field.each].max(initial=-1))  # kinds that are needed of each
        self.first = self.mean[:k] * moments.weight
        self.told, self.square, self.own_square = np.zeros((3, g))
        self.pulled, self.between = np.zeros((g, 3)), np.zeros((len(kinds), len(kinds)))
        self.each_score, self.each_pull = np.zeros((k, n)), np.zeros((3, k, n))
        self.each_square = np.zeros((k, k, n))
        self.each_information = np.zeros((field.each, field.each, n))

    def add(self, some: slice, recorded: Array, apart: Array | None) -> None:
        """Add a block of actuators, from (g, b) c^ and what pooled rows leave of the means [N]."""
        fit, k = self.fit, len(self.first)
        e = self.field.values(some, recorded)
        weights, arms = self.weights[some], fit.scaled_arms[:, some]
        if apart is not None:
            off = e * apart
            self.told += off @ weights
            self.each_score[:, some] = -(self.first @ off)
        if e.shape[1] == 1:  # the same for all actuators: once
            if some.start:
                return
            some = slice(None)
            weights = self.weights.sum(keepdims=True)
            arms = fit.scaled_arms.sum(axis=1, keepdims=True)
        self.pulled += e @ arms.T
        rows = (self.pool @ e).reshape(len(self.mean), -1, e.shape[1])
        square = np.einsum("krb,lrb->klb", rows, rows)
        self.between += square @ weights
        if k:
            pull = fit.white_rho.reshape(-1, 3).T @ rows[:k]
            self.each_square[:, :, some] = square[:k, :k]
            self.each_pull[:, :, some] = np.moveaxis(pull, 1, 0)
        if apart is not None:
            self._add_structure(some, e, weights)

    def _add_structure(self, some: slice, e: Array, weights: Array) -> None:
        """Add the information of what pooled rows leave; e is overwritten."""
        each = self.field.each
        spread = np.square(e, out=e)
        self.square += spread @ weights
        if self.field.within:
            own = np.square(self.field.own(self.within, some))
            self.own_square += own @ weights
            spread -= own
        if not each:
            return
        kind = self.kind[:each]
        between = np.stack([(h * self.first) @ spread for h in self.mean[: len(self.first)]])
        information = between[kind][:, kind]
        if self.field.within:
            information += _second(self.within, own)[:each, :each]
        self.each_information[:, :, some] = information

    def result(self) -> FieldSums:
        """Return the sums over all actuators."""
        fit, field, kind = self.fit, self.field, self.kind
        noise, each = fit.problem.noise.variance, self.kind[: self.field.each]
        first, within, w = field.first, self.within, slice(0, field.within)
        score, information = np.zeros(len(first)), np.zeros((len(first),) * 2)
        each_score = self.each_score[each]
        if fit.independent:
            mean = self.mean[kind]
            score -= first @ self.told
            information += (mean * self.square) @ first.T - self.between[kind][:, kind]
            self.each_information -= self.each_square[each][:, each]
            if field.within:
                information[w, w] += _second(within, self.own_square[:, None])[:, :, 0]
                information[w, w] -= (mean[w] * self.own_square) @ first[w].T
                sums = field.sums(within)
                score[w] -= sums @ self.weights
                each_score -= sums[: field.each]
        jacobian = -(self.pool @ self.pulled).reshape(len(self.mean), -1, 3)
        return FieldSums(
            field, kind, np.moveaxis(jacobian, 0, 2), score, information, each_score / noise,
            self.each_information / noise, self.each_square, self.each_pull,
        )  # fmt: skip


def _products(within: WithinGroups, index: int) -> Array:
    """Return (files + 1, g) weighted sums of h times one of the h."""
    files = len(within.weight)
    if index == files:
        return np.vstack([within.hour, within.square])
    products = np.zeros_like(within.first)
    products[index], products[files] = within.weight[index], within.hour[index]
    return products


def _second(within: WithinGroups, values: Array) -> Array:
    """Return (files + 1, files + 1, b) weighted sums of products of two h, times (g, b)."""
    files = np.arange(len(within.weight))
    sums = np.zeros((len(files) + 1, len(files) + 1, values.shape[1]))
    sums[files, files] = within.weight @ values
    sums[files, -1] = sums[-1, files] = within.hour @ values
    sums[-1, -1] = within.square @ values
    return sums


def from_mean(weight: Array) -> Array:
    """Return (K, K) mix of sizes that count from their mean, of (K,) weights.

    So alpha stays that of the whole campaign, and none of its error is that of the mean.
    """
    k = len(weight)
    return np.asarray(np.eye(k) - np.outer(np.ones(k), weight / weight.sum()))


def derivative_of(
    fit: FittedRows,
    sums: FieldSums,
    functions: slice = slice(0, 1),
    *,
    each: bool = False,
    mix: Array | None = None,
    actuators: NDArray[np.intp] | None = None,
    direction: Array | None = None,
) -> Derivative:
    """Return the derivative with respect to parameters theta of an effect on readings.

    K of the field's functions have sizes, (K, n) mix theta, by a (K, K) mix, for example of
    `from_mean`; the identity if None. With ``each``, every actuator, or each of those with the
    indices ``actuators``, has sizes of its own, theta (K, n); otherwise all share (K, 1). Along an
    (n,) ``direction`` of sizes of each actuator they have a spread of their own.
    """
    n, k = fit.problem.n, functions.stop - functions.start
    mix = np.eye(k) if mix is None else mix
    some = slice(None) if actuators is None else actuators
    trace = mix.T @ sums.field.first[functions] @ fit.moments.pooling.squared_lengths

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        size = np.zeros((k, n))
        size[:, some] = mix @ theta.reshape(k, -1)
        return problem, _removed(fit, before, sums.field, functions, size)

    def spurious() -> tuple[Array, float]:
        if not each:
            return np.outer(trace, fit.spurious_by_all), 0.0
        return (trace[:, None, None] * fit.spurious_by_each(some)).reshape(-1, n), 0.0

    biased = spurious if sums.field.gain else None
    kinds = np.eye(sums.jacobian.shape[2])[sums.kind[functions]].T @ mix
    if not each:
        return Derivative(
            k,
            remove,
            jacobian=sums.jacobian @ kinds,
            score=mix.T @ sums.score[functions],
            information=mix.T @ sums.information[functions, functions] @ mix,
            spurious=biased,
        )
    of_each = _of_each(fit, sums, functions, mix, some, kinds)
    return Derivative(
        len(of_each.score),
        remove,
        of_each=of_each,
        score=(mix.T @ sums.each_score[functions])[:, some].ravel(),
        information=_mixed(mix, sums.each_information[functions, functions])[:, :, some],
        spurious=biased,
        actuators=actuators,
        direction=direction,
    )


def _of_each(
    fit: FittedRows, sums: FieldSums, functions: slice, mix: Array, some: Some, kinds: Array
) -> OfEach:
    """Return J of sizes of each actuator, or of ``some``; ``kinds`` of functions are mixed, too."""
    arms = fit.scaled_arms[:, some]
    pulled, k = fit.root @ arms, len(mix)
    kinds = kinds[: len(sums.each_square)]
    pull = kinds.T @ sums.each_pull[:, :, some]
    square = np.einsum("ak,abn,bk->kn", kinds, sums.each_square[:, :, some], kinds, optimize=True)

    def rows() -> Array:
        h = mix.T @ sums.field.mean(fit.moments)[functions]
        values = sums.field.at(fit, some)
        made = np.empty((len(fit.fitted_rows), k, arms.shape[1]))
        weighed = (fit.moments.pooling.weighed(h) @ values).reshape(k, len(made), -1)
        made[:] = np.moveaxis(weighed, 0, 1)
        return made.reshape(len(made), -1)

    return OfEach(
        arms=-np.tile(arms, k),
        rows=rows,
        score=-np.sum(pulled[:, None] * pull, axis=0).ravel(),
        whole=(np.sum(pulled**2, axis=0) * square).ravel(),
    )


def _mixed(mix: Array, values: Array) -> Array:
    """Return (K, K, n) mix' v mix of values v of each actuator."""
    return np.asarray(np.einsum("kl,kmn,mo->lon", mix, values, mix, optimize=True))


def _removed(
    fit: FittedRows, moments: Moments, field: Field, functions: slice, size: Array
) -> Moments:
    """Return moments without an effect of (K, n) sizes of some functions of a field."""
    within = moments.within
    shift = field.mean(moments)[functions].T @ size
    mean = moments.mean - shift * field.at(fit)
    if functions.start >= field.within:
        return replace(moments, mean=mean)
    own, sums = field.own(within), field.sums(within)
    sizes = np.zeros((len(within.first), size.shape[1]))
    sizes[functions] = size
    scatter = moments.scatter - 2.0 * np.sum(size * sums[functions], axis=0)
    zeros, gains = within.zero.copy(), within.gain.copy()
    counted = moments.counted_within
    for index, first in enumerate(counted.first):
        apart = (_products(counted, index).T @ sizes - first[:, None] * shift) * own
        zeros[index] -= apart.sum(axis=0)
        gains[index] -= np.sum(apart * within.mean, axis=0)
        scatter += sizes[index] * np.sum(apart * own, axis=0)
    within = replace(within, zero=zeros, gain=gains)
    return replace(moments, mean=mean, scatter=np.maximum(scatter, 0.0), within=within)


def standing_out(sums: FieldSums, functions: slice, mix: Array) -> NDArray[np.intp]:
    """Return indices of actuators with scores beyond chance, of functions with a (K, K) mix."""
    information = _mixed(mix, sums.each_information[functions, functions])
    if not information.any():
        return np.empty(0, dtype=np.intp)
    chance = chi2_sf(*chi2_of_each(mix.T @ sums.each_score[functions], information))
    return np.flatnonzero(chance < CHANCE_OF_ANY_ACTUATOR / len(chance))
