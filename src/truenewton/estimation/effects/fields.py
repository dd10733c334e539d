"""Effects on readings, g_ri = sum over k of h_k(r) e_ri: fields e times functions h of a row.

Whatever an effect changes in the readings is a sum of the same columns h e: a gain by file is the
field e = -c^ times a function that is 1 in one file, a zero that drifts is e = 1 times the hours.
So the sums over the rows of all pairs of columns, of each actuator, contain all that effects and
combinations of effects need. They are taken once at a fit, in one pass over the readings.

Rows of one group differ by their functions, and by fields of their own that are -c_mean and 1. With
q the columns of an actuator and U its pooled rows (`moments.Pooling`), the residual of the means
has on sizes of columns the score and the information

    -sum of q (c - U y) / s^2,          (sum of r q q' - (U' r q)' (U' r q)) / s^2

of each actuator. Some actuators are taken at a time: no array of all readings is made, since the
means are as large as the distinct shapes of a campaign, and each block stays in the cache.

Effects on single actuators, for example a driver that fails: what pooled rows leave of its readings
gives chi^2 = U_t' M_tt^-1 U_t of each actuator. Only actuators that stand out get parameters;
otherwise the error of every actuator would grow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chi2_sf
from truenewton.estimation.effects.derivative import (
    Columns,
    Derivative,
    FittedRows,
    OfEach,
    Some,
    mixed,
)
from truenewton.estimation.effects.score_test import chi2_of_each
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


def columns_of(fit: FittedRows, fields: dict[str, Field], before: Columns | None = None) -> Columns:
    """Return the sums over the rows of a fit of the columns of some fields, by name.

    Only scores are new if those of a fit nearby are given: products of columns are the same there.
    """
    of_all = _Pass(fit, fields, before)
    step = max(1, 2**17 // len(fit.moments.mean))
    for start in range(0, fit.problem.n, step):
        of_all.add(slice(start, min(start + step, fit.problem.n)))
    return of_all.result()


class _Pass:
    """Sums over the blocks of actuators so far.

    Functions with the same means over groups, as those of several files often have, share a kind.
    """

    def __init__(self, fit: FittedRows, fields: dict[str, Field], before: Columns | None) -> None:
        self.fit, self.fields, moments, n = fit, fields, fit.moments, fit.problem.n
        self.before = before
        self.within, self.slices = moments.counted_within, dict[str, slice]()
        kinds: dict[tuple[str, bytes], int] = {}
        kind = list[int]()
        for name, field in fields.items():
            means = field.mean(moments)
            self.slices[name] = slice(len(kind), len(kind) + len(means))
            kind += [kinds.setdefault((name, h.tobytes()), len(kinds)) for h in means]
        self.kind, self.field_of = np.array(kind), [name for name, _ in kinds]
        self.mean = np.array([np.frombuffer(h) for _, h in kinds])
        self.pool = {
            name: moments.pooling.weighed(self.mean[self._of(name)]) for name in self.fields
        }
        count, k = len(kind), len(kinds)
        self.score = np.zeros((count, n))
        self.pulled, self.pull = np.zeros((k, len(fit.fitted_rows), 3)), np.zeros((3, k, n))
        if before is None:
            self.gram, self.square = np.zeros((count, count, n)), np.zeros((k, k, n))
            self.own = np.zeros((count, count, n))

    def _of(self, name: str) -> slice:
        """Return which kinds a field has."""
        first = self.field_of.index(name)
        return slice(first, first + self.field_of.count(name))

    def add(self, some: slice) -> None:
        """Add a block of actuators."""
        fit, b = self.fit, some.stop - some.start
        recorded, apart = fit.recorded_and_apart(some)
        values = {name: field.values(some, recorded) for name, field in self.fields.items()}
        rows = np.empty((len(self.mean), len(fit.fitted_rows), b))
        for name, e in values.items():
            of = self._of(name)
            rows[of] = (self.pool[name] @ e).reshape(of.stop - of.start, -1, e.shape[1])
        self.pulled += rows @ fit.scaled_arms[:, some].T
        if self.before is None:
            self.square[:, :, some] = np.einsum("krb,lrb->klb", rows, rows, optimize=True)
        pull = fit.white_rho.reshape(-1, 3).T @ rows
        self.pull[:, :, some] = np.moveaxis(pull, 1, 0)
        if apart is not None:
            self._add_residual(some, values, apart)

    def _add_residual(self, some: slice, values: dict[str, Array], apart: Array) -> None:
        """Add what pooled rows leave, from (g, b) residuals of the means [N]."""
        noise = self.fit.problem.noise.variance[some]
        weight = self.fit.moments.weight
        for name, field in self.fields.items():
            of, w = self._of(name), field.within
            off = (self.mean[of] * weight) @ (values[name] * apart)
            score = -off[self.kind[self.slices[name]] - of.start]
            score[:w] -= field.sums(self.within)[:w, some]
            self.score[self.slices[name], some] = score / noise
        if self.before is None:
            self._add_products(some, values, noise)

    def _add_products(self, some: slice, values: dict[str, Array], noise: Array) -> None:
        """Add the products of columns, by (g, b) or (g, 1) values of the fields."""
        names, weight = list(values), self.fit.moments.weight
        between = -self.square[:, :, some]
        for first, name in enumerate(names):
            of = self._of(name)
            for other in names[first:]:
                to, product = self._of(other), values[name] * values[other]
                pairs = (self.mean[of] * weight)[:, None] * self.mean[to]
                both = (pairs.reshape(-1, len(weight)) @ product).reshape(*pairs.shape[:2], -1)
                between[of, to] += both
                if other != name:
                    between[to, of] += both.swapaxes(0, 1)
        inside = [name for name in names if self.fields[name].within]
        for first, name in enumerate(inside):
            for other in inside[first:]:
                own = self._own(some, self.fields[name], self.fields[other])
                at, to = (
                    slice(self.slices[one].start, self.slices[one].start + len(own))
                    for one in (name, other)
                )
                self.own[at, to, some] = own
                self.own[to, at, some] = own.swapaxes(0, 1)
        gram = between[self.kind][:, self.kind] + self.own[:, :, some]
        self.gram[:, :, some] = gram / noise

    def _own(self, some: slice, field: Field, other: Field) -> Array:
        """Return (K, K, b) or (K, K, 1) sums within groups, of two fields."""
        within = self.within
        own = field.own(within, some) * other.own(within, some)
        mean = field.mean(self.fit.moments)[: field.within]
        pairs = mean[:, None] * other.first[: other.within]
        by_mean = pairs.reshape(-1, pairs.shape[2]) @ own
        return np.asarray(_second(within, own) - by_mean.reshape(*pairs.shape[:2], -1))

    def result(self) -> Columns:
        """Return the sums over all actuators."""
        jacobian, noise = -np.moveaxis(self.pulled, 0, 2), self.fit.problem.noise.variance
        if self.before is not None:
            before = self.before
            gram = before.gram * (before.noise / noise)
            return replace(
                before, score=self.score, gram=gram, jacobian=jacobian, pull=self.pull, noise=noise
            )
        products = self.gram, self.own, self.square
        return Columns(self.slices, self.kind, self.score, *products, jacobian, self.pull, noise)


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
    columns: Columns,
    field: tuple[str, Field],
    functions: slice = slice(0, 1),
    *,
    each: bool = False,
    mix: Array | None = None,
    actuators: NDArray[np.intp] | None = None,
    direction: Array | None = None,
) -> Derivative:
    """Return the derivative with respect to parameters theta of an effect on readings.

    K of the functions of a field, with its name, have sizes (K, n) mix theta, by a (K, m) mix, for
    example of `from_mean`; the identity if None. With ``each``, every actuator, or each of those
    with the indices ``actuators``, has sizes of its own, theta (m, n); otherwise all share (m, 1).
    Along an (n,) ``direction`` of sizes of each actuator they have a spread of their own.
    """
    name, one = field
    n, k = fit.problem.n, functions.stop - functions.start
    mix = np.eye(k) if mix is None else mix
    some = slice(None) if actuators is None else actuators
    trace = mix.T @ one.first[functions] @ fit.moments.pooling.squared_lengths
    start = columns.slices[name].start
    weights = np.zeros((len(columns.kind), mix.shape[1]))
    weights[start + functions.start : start + functions.stop] = mix

    def spurious() -> tuple[Array, float]:
        if not each:
            return np.outer(trace, fit.spurious_by_all), 0.0
        return (trace[:, None, None] * fit.spurious_by_each(some)).reshape(-1, n), 0.0

    of_each, jacobian = None, None
    kinds = np.eye(columns.jacobian.shape[2])[columns.kind].T @ weights
    if each:
        of_each = _of_each(fit, columns, one, functions, mix, some, kinds)
    else:
        jacobian = columns.jacobian @ kinds
    return Derivative(
        mix.shape[1] * (len(np.arange(n)[some]) if each else 1),
        jacobian=jacobian,
        of_each=of_each,
        columns=columns,
        weights=weights,
        spurious=spurious if one.gain else None,
        actuators=actuators,
        direction=direction,
    )


def _of_each(
    fit: FittedRows,
    columns: Columns,
    field: Field,
    functions: slice,
    mix: Array,
    some: Some,
    kinds: Array,
) -> OfEach:
    """Return J of sizes of each actuator, or of ``some``, by (k, m) sizes of the kinds."""
    arms = fit.scaled_arms[:, some]
    pulled, m = fit.root @ arms, mix.shape[1]
    pull = kinds.T @ columns.pull[:, :, some]
    square = np.einsum("ak,abn,bk->kn", kinds, columns.square[:, :, some], kinds, optimize=True)

    def rows() -> Array:
        h = mix.T @ field.mean(fit.moments)[functions]
        values = field.at(fit, some)
        made = np.empty((len(fit.fitted_rows), m, arms.shape[1]))
        weighed = (fit.moments.pooling.weighed(h) @ values).reshape(m, len(made), -1)
        made[:] = np.moveaxis(weighed, 0, 1)
        return made.reshape(len(made), -1)

    return OfEach(
        arms=-np.tile(arms, m),
        rows=rows,
        score=-np.sum(pulled[:, None] * pull, axis=0).ravel(),
        whole=(np.sum(pulled**2, axis=0) * square).ravel(),
    )


def without(
    fit: FittedRows, columns: Columns, fields: dict[str, Field], moments: Moments, size: Array
) -> Moments:
    """Return moments without columns of (K, n) sizes, of the fields at a fit."""
    mean, within = moments.mean.copy(), moments.within
    step = max(1, 2**17 // len(mean))
    used = [name for name in fields if size[columns.slices[name]].any()]
    for start in range(0, fit.problem.n, step):
        some = slice(start, min(start + step, fit.problem.n))
        recorded = fit.recorded(some)
        for name in used:
            shift = fields[name].mean(moments).T @ size[columns.slices[name], some]
            mean[:, some] -= shift * fields[name].values(some, recorded)
    if not columns.own.any():
        return moments.with_forces(mean=mean)
    # Sums within groups, of the first functions of the fields, are quadratic in the sizes.
    changed = np.einsum("kln,ln->kn", columns.own, size)
    scatter = moments.scatter + np.einsum("kn,kn->n", size, changed)
    for name in used:
        if w := fields[name].within:
            at = slice(columns.slices[name].start, columns.slices[name].start + w)
            scatter -= 2.0 * np.sum(size[at] * fields[name].sums(within)[:w], axis=0)
    zero, gain = (columns.slices[name].start for name in ("zero", "gain"))
    w = len(within.zero)
    within = replace(
        within,
        zero=within.zero - changed[zero : zero + w],
        gain=within.gain + changed[gain : gain + w],
    )
    return moments.with_forces(mean=mean, scatter=np.maximum(scatter, 0.0), within=within)


def standing_out(columns: Columns, functions: slice, mix: Array) -> NDArray[np.intp]:
    """Return indices of actuators with scores beyond chance, of columns with a (K, m) mix."""
    information = mixed(mix, columns.gram[functions, functions], mix)
    if not information.any():
        return np.empty(0, dtype=np.intp)
    chance = chi2_sf(*chi2_of_each(mix.T @ columns.score[functions], information))
    return np.flatnonzero(chance < CHANCE_OF_ANY_ACTUATOR / len(chance))
