"""Moments of repeats, pooled over loads and signs, sums over shapes, and noise of a reading.

Rows with the same load, SHAPE and SIGN have the same true forces, so their number, mean and scatter
contain all their information on alpha. If POSITION and gradients are given, c becomes
c (1 + COILGRAD z), and the change of the bias magnets BIASGRAD z is a known part of the balance
(docs/files.md).

A shape takes the same elastic forces under every load, and the opposite forces with the opposite
sign. So the (g, n) means c of groups, of weights r, are linear in a few rows,

    c = X b,    X: a column for each load and sign (statics), one for each SHAPE times its SIGN

(and times the size of the displacements under that load, if POSITION shows that it is not 1). With
U spanning X, U' diag(r) U = 1, the balance depends on c only by the R rows y = U' r c, each with
the noise of one reading. The residual c - U y is noise alone if shapes repeat over loads and signs.
This is tested by

    chi^2 = sum r (c - U y)^2 / s^2,        n (g - R) degrees of freedom,

with s^2 from the repeats. Dependent readings, as those of a mirror that moves as a whole, have
fewer: with their correlation matrix C, (tr C)^2 / tr C^2 a row instead of n. If shapes do not
repeat so, every group is a row of its own, R = g.

The likelihood needs of a load only the number, sum and second moment of its rows: one symmetric
rank-k update by BLAS.

Rounding to steps q adds a variance of q^2 / 12. If the noise is as large as a step, the scatter of
repeats contains all of it. If it is smaller, readings of one shape tend to the same step, and of
sigma^2 + q^2 / 12 the scatter does not contain

    b^2 = q^2 sum over k of exp(-(2 pi k sigma / q)^2) / (2 (pi k)^2),

the mean square error of the mean by rounding (Fourier series of the sawtooth; Widrow and Kollar,
Quantization Noise, 2008), which does not decrease with the number of repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk

from truenewton.arrays import Array, blocks
from truenewton.chance import OF_EACH_KIND, chi2_sf, f_sf, normal_isf, t_isf
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.readings.rows import WEIGHED_NOISE
from truenewton.linalg import mirrored
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load


@dataclass(frozen=True, eq=False)
class ShapeSums:
    """Sums over shapes under L loads, each with its weight r; q is its known balance."""

    shapes: int  # number of distinct shapes, each with noise of its own
    weight: Array  # (L,) sum of r of each load
    force: Array  # (L, n) sum of r c
    square: Array  # (n, n) sum of r c c' over all loads
    known: Array  # (L, 3) sum of r q
    known_force: Array  # (3, n) sum of r q c' over all loads
    known_square: Array  # (3, 3) sum of r q q' over all loads


def shape_sums(mean: Array, weight: Array, known: Array, share: Array) -> ShapeSums:
    """Return the sums over shapes of (g, n) forces [N], (g,) weights r and (g, 3) known balance.

    ``share`` is (L, g) that of each load in a shape: 1 of its own; pooled rows contain several.
    """
    n = mean.shape[1]
    if (weight == weight[0]).all():
        square = dsyrk(float(weight[0]), mean.T)
    else:
        square = np.zeros((n, n), order="F")
        for some in blocks(len(mean), 8 * n):
            heavy = mean[some] * np.sqrt(weight[some])[:, None]
            square = dsyrk(1.0, heavy.T, beta=1.0, c=square, overwrite_c=True)
    square = mirrored(square).T  # in the order of C
    of_load = share * weight
    q = known * weight[:, None]
    anything = bool(q.any())
    return ShapeSums(
        shapes=int(np.count_nonzero(weight)),
        weight=np.sum(of_load * share, axis=1),
        force=of_load @ mean,
        square=square,
        known=of_load @ known,
        known_force=q.T @ mean if anything else np.zeros((3, n)),
        known_square=q.T @ known,
    )


@dataclass(frozen=True, eq=False)
class Pooling:
    """Pooled rows: (g, R) basis U of groups of (g,) weights r."""

    basis: scipy.sparse.csr_array
    weight: Array

    @property
    def count(self) -> int:
        """R."""
        return int(self.basis.shape[1])

    @cached_property
    def _transposed(self) -> scipy.sparse.csr_array:
        return self.basis.T.tocsr()

    def weighed(self, factors: Array) -> scipy.sparse.csr_array:
        """Return (k R, g) U' r f, f one of (k, g) factors after the other."""
        weighed, heavy = [self._transposed.copy() for _ in factors], self.weight * factors
        for one, weight in zip(weighed, heavy, strict=True):
            one.data *= weight[one.indices]
            one.eliminate_zeros()
        return scipy.sparse.csr_array(scipy.sparse.vstack(weighed))

    @cached_property
    def _weighed(self) -> scipy.sparse.csr_array:
        return self.weighed(np.ones((1, len(self.weight))))

    def rows(self, values: Array) -> Array:
        """Return (R, m) U' r v of (g, m) values v of the groups."""
        return np.asarray(self._weighed @ values)

    @cached_property
    def squared_lengths(self) -> Array:
        """(g,) sum of the squares of each row of U."""
        return np.asarray(self.basis.multiply(self.basis).sum(axis=1)).ravel()

    def groups(self, rows: Array) -> Array:
        """Return (g, m) U y of the groups, from (R, m) rows y."""
        return np.asarray(self.basis @ rows)


def each_by_itself(weight: Array) -> Pooling:
    """Return a row for each group, none for those of weight 0."""
    counted = np.flatnonzero(weight)
    values = (1.0 / np.sqrt(weight[counted]), (counted, np.arange(counted.size)))
    return Pooling(scipy.sparse.csr_array(values, shape=(weight.size, counted.size)), weight)


def over_loads_and_signs(labels: NDArray[np.int64], weight: Array, size: Array) -> Pooling:
    """Return the rows of groups whose shapes repeat over loads and signs.

    By (g, 3) labels as in `Moments`, (g,) weights r, 0 of groups that do not count, and the (g,)
    sizes of their shapes, 1 under the first load.
    """
    g, on = len(labels), np.flatnonzero(weight)
    _, shape = np.unique(labels[on, 1], return_inverse=True)
    _, statics = np.unique(2 * labels[on, 0] + (labels[on, 2] > 0), return_inverse=True)
    sign = labels[on, 2] * size[on]
    r = weight[on]
    of_shape = scipy.sparse.csr_array((sign, (on, shape.ravel())), shape=(g, shape.max() + 1))
    of_statics = np.zeros((g, statics.max() + 1))
    of_statics[on, statics.ravel()] = 1.0
    # The statics without their part in the shapes; both orthonormal in r.
    total = np.bincount(shape.ravel(), weights=r * sign**2)
    told = of_shape.T @ (weight[:, None] * of_statics) / total[:, None]
    apart = of_statics - of_shape @ told
    values, vectors = np.linalg.eigh(apart.T @ (weight[:, None] * apart))
    counted = values > 1e-9 * r.sum()  # but for rounding
    rest = apart @ (vectors[:, counted] / np.sqrt(values[counted]))
    parts = [of_shape / np.sqrt(total), scipy.sparse.csr_array(rest)]
    return Pooling(scipy.sparse.hstack(parts, format="csr"), weight)


@dataclass(frozen=True, eq=False)
class WithinGroups:
    """Differences of the rows of one group by file and by hour, files + 1 functions h of a row.

    For each file h is 1 in it and 0 elsewhere; the last h is the hours since the mean of all rows.
    """

    # (files, g) sums of the weights and of the weighted hours of the rows of each group, by file
    weight: Array
    hour: Array
    square: Array  # (g,) weighted sum of the squared hours
    mean: Array  # (g, n) c_mean, as the rows have it [N]
    # (files + 1, n) weighted sums over all rows of h (c - c_mean) [N], and of the same times c_mean
    zero: Array
    gain: Array

    @cached_property
    def first(self) -> Array:
        """(files + 1, g) weighted sums of h."""
        return np.vstack([self.weight, self.hour.sum(axis=0)])


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of the groups of rows that repeat one shape."""

    loads: tuple[Load, ...]  # the L loads
    labels: NDArray[np.int64]  # (g, 3) index of the load, SHAPE, SIGN; sorted
    rows: NDArray[np.int64]  # (g,) number of rows; 0, as its weight, for a group that is left out
    # (g,) sum of the weights of the rows; their number where no file declares its noise
    weight: Array
    mean: Array  # (g, n) mean commanded force of the enabled actuators, COILGRAD taken in [N]
    known: Array  # (g, 3) mean of the known part of the balance: A (BIASGRAD z)
    scatter: Array  # (n,) weighted sum of squared deviations of rows from their group's mean [N^2]
    # (n,) readings from which displacements count [m]; NaN where from the mean of each cycle
    reference: Array
    within: WithinGroups  # differences of the rows of one group by file and by hour
    pooled: bool = False  # whether shapes repeat over loads and signs as well
    # (g, n) mean displacement of each sensor [m]; None without POSITION
    displacement: Array | None = None
    step: Array | float = 0.0  # (n,) of which readings are multiples [N], or 0
    by_force: float = 0.0  # share of the variance of the noise that is in proportion to c^2

    def with_forces(self, **changes: Any) -> Moments:
        """Return the moments of the same rows with other forces."""
        changed = replace(self, **changes)
        for name in ("pooling", "of_load", "sizes", "size_of_groups"):
            if name in self.__dict__:  # it does not depend on forces, and takes long
                changed.__dict__[name] = self.__dict__[name]
        return changed

    def noise_along(self, power: int) -> float:
        """Return the variance of the noise along c^power, relative to that of uniform noise."""
        square = self.mean**2
        weight = self.weight[:, None] * square**power
        relative = square / np.maximum(self.weight @ square / self.weight.sum(), 1e-300)
        return 1.0 + self.by_force * (float(np.sum(weight * relative) / np.sum(weight)) - 1.0)

    @cached_property
    def groups(self) -> int:
        """Number of groups that are not left out."""
        return int(np.count_nonzero(self.rows))

    @cached_property
    def repeats(self) -> int:
        """Rows less groups: the degrees of freedom of the scatter of one actuator."""
        return int(self.rows.sum()) - self.groups

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, RMS over actuators [N]; NaN if nothing repeats."""
        if not self.repeats:
            return float("nan")
        return float(np.sqrt(self.scatter.mean() / self.repeats * self.typical_variance))

    @cached_property
    def typical_variance(self) -> float:
        """Variance of a typical row over that of a row of weight 1."""
        return float(self.rows.sum() / self.weight.sum())

    @cached_property
    def rounding(self) -> Array | float:
        """(n,) variance of rounding, in terms of a reading of weight 1 [N^2]."""
        return np.square(self.step) / 12 / self.typical_variance

    @cached_property
    def counted_within(self) -> WithinGroups:
        """``within`` of the groups that are not left out; sums over all rows stay."""
        within, counted = self.within, self.weight > 0
        weight, hour, square = (
            values * counted for values in (within.weight, within.hour, within.square)
        )
        return replace(within, weight=weight, hour=hour, square=square)

    @property
    def squares(self) -> Array:
        """(n,) sum of r c^2 over groups, without a copy of all means."""
        return np.asarray(np.einsum("g,gi,gi->i", self.weight, self.mean, self.mean))

    @cached_property
    def sums(self) -> ShapeSums:
        """The sums over groups, or over the rows that they are pooled to; taken once."""
        of_load = self.of_load
        if not self.pooled:
            return shape_sums(self.mean, self.weight, self.known, of_load.T)
        pooling = self.pooling
        mean, known, share = map(pooling.rows, (self.mean, self.known, of_load))
        return shape_sums(mean, np.ones(pooling.count), known, share.T)

    @cached_property
    def of_load(self) -> Array:
        """(g, L) 1 if a group is under a load, otherwise 0."""
        return np.asarray(self.labels[:, :1] == np.arange(len(self.loads)), dtype=np.float64)

    @cached_property
    def sizes(self) -> tuple[Array, Array]:
        """(L,) size of the shapes under each load by POSITION, and its variance.

        Relative to the first load; 1 unless it differs from that by four standard errors.
        """
        size, variance = np.ones((2, len(self.loads)))
        variance[0] = 0.0
        z, signed = self.displacement, self.labels[:, 1] * self.labels[:, 2]
        for load_index in range(1, len(self.loads)):
            both = np.intersect1d(signed[self.labels[:, 0] == 0],
                                  signed[self.labels[:, 0] == load_index])  # fmt: skip
            if z is None or both.size < 2:
                continue
            first, other = (
                z[(self.labels[:, 0] == k) & np.isin(signed, both)] for k in (0, load_index)
            )
            first, other = first - first.mean(axis=0), other - other.mean(axis=0)
            square = np.sum(first**2, axis=1)
            moved = square > 1e-3 * square.max()
            if not moved.any():
                continue
            ratios = np.sum(first * other, axis=1)[moved] / square[moved]
            ratio = float(np.median(ratios))  # a file may contain wrong shapes
            spread = float(np.median(np.abs(ratios - ratio))) / normal_isf(0.25)  # median of |z|
            variance[load_index] = 0.5 * np.pi * spread**2 / len(ratios)
            if abs(ratio - 1.0) > 4 * np.sqrt(variance[load_index]):
                size[load_index] = ratio
        return size, variance

    @cached_property
    def size_of_groups(self) -> Array:
        """(g,) size of the shape of each group by POSITION, relative to that under the first load.

        That of its load, unless both signs of the shape show another by more than chance.
        """
        z, labels = self.displacement, self.labels.tolist()
        size, at = self.sizes[0][self.labels[:, 0]], {tuple(x): g for g, x in enumerate(labels)}
        for load in range(1, len(self.loads) if z is not None else 1):
            both = [
                [at[k, shape, sign] for k in (0, load) for sign in (1, -1)]
                for of, shape, sign in labels
                if of == load and sign > 0
                and {(0, shape, 1), (0, shape, -1), (load, shape, -1)} <= at.keys()
            ]  # fmt: skip
            if len(both) < 2 or z is None:
                continue
            groups = np.array(both).reshape(-1, 2, 2)  # first or other load, sign
            moved = z[groups] - z[groups].mean(axis=(0, 2))[:, None]
            square = np.maximum(np.sum(moved[:, 0] ** 2, axis=2), 1e-300)
            ratio = np.sum(moved[:, 0] * moved[:, 1], axis=2) / square
            length = np.sqrt(square.mean(axis=1))
            half = np.abs(ratio[:, 0] - ratio[:, 1]) / 2 * length
            noise = float(np.median(half)) / normal_isf(0.25)  # median of |z|
            apart = np.abs(ratio.mean(axis=1) - self.sizes[0][load]) * length
            other = apart > t_isf(OF_EACH_KIND / 2 / len(both), len(both)) * noise
            other &= length > 0.03 * length.max()  # the others hardly move
            size[groups[other, 1]] = ratio.mean(axis=1)[other, None]
        return size

    @cached_property
    def pooling(self) -> Pooling:
        """The pooled rows, or a row for each group."""
        if self.pooled:
            return over_loads_and_signs(self.labels, self.weight, self.size_of_groups)
        return each_by_itself(self.weight)


def chosen_groups(moments: Moments, chosen: NDArray[np.bool_]) -> Moments:
    """Return moments in which only the (g,) chosen groups count; scatter stays that of all.

    The others keep their place and lose their rows and weight, so that no mean is copied.
    """
    rows, weight = np.where(chosen, moments.rows, 0), np.where(chosen, moments.weight, 0.0)
    return replace(moments, rows=rows, weight=weight)


# -- rounding to steps, as of a converter ----------------------------------------------------------

_SIGMA = np.linspace(0.0, 1.0, 101)  # of a step
_K = np.arange(1, 200)[:, None]
_HIDDEN = np.sum(np.exp(-((2 * np.pi * _K * _SIGMA) ** 2)) / (2 * (np.pi * _K) ** 2), axis=0)


def rounding_steps(readings: Sequence[Array]) -> Array:
    """Return (n,) the step of which readings of some shapes, (n,) each, are multiples [N], or 0.

    They may have an offset. By Euclid's algorithm from the smallest gaps between readings, in which
    rounding of stored numbers grows least; larger gaps then refine it.
    """
    if len(readings) < 12:  # too few gaps to recognise a step
        return np.zeros(len(readings[0]) if readings else 0)
    ordered = np.sort(readings, axis=0)
    apart = ordered[1:] - ordered[0]
    # Finer steps are rounding of the computer.
    finest = 1e-6 * np.maximum(np.abs(readings).max(axis=0), 1e-300)
    gaps = np.diff(ordered, axis=0)
    gaps = np.sort(np.where(gaps > finest, gaps, np.inf), axis=0)
    step = np.where(np.isfinite(gaps[0]), gaps[0], 0.0)
    for gap in gaps[1:8]:
        other = np.where(np.isfinite(gap), gap, 0.0)
        while (other > finest).any():
            ended, rest = other <= finest, np.abs(_off(step, other))
            step, other = np.where(ended, step, other), np.where(ended, 0.0, rest)
    for span in np.sort([*gaps, *apart], axis=0):
        count = np.round(np.divide(span, step, out=np.zeros_like(span), where=step > finest))
        multiple = (count > 0) & np.isfinite(span) & (np.abs(_off(span, step)) <= 0.1 * step)
        step = np.divide(span, count, out=step.copy(), where=multiple)
    step = _exact(step, apart, finest)
    if (step > 0.0).any():  # converters are usually of one type
        step = np.maximum(
            step, _exact(np.where(step > 0.0, 0.0, np.median(step[step > 0.0])), apart, finest)
        )
    return step


def _exact(step: Array, apart: Array, finest: Array) -> Array:
    """Return (n,) steps, 0 if (m, n) distances are no multiples of them."""
    exact = (np.abs([_off(span, step) for span in apart]) <= 0.02 * step).all(axis=0)
    return np.where(exact & (step > finest), step, 0.0)


def _off(values: Array, steps: Array) -> Array:
    """Return (n,) differences of values from the nearest multiple of steps."""
    finite = (steps > 0.0) & np.isfinite(values)
    whole = np.divide(values, steps, out=np.zeros_like(values), where=finite)
    return np.where(finite, values, 0.0) - steps * np.round(whole)


def hidden_variance(step: Array, seen: Array) -> Array:
    """Return b^2 [N^2], from (n,) steps [N] and the variance of a reading among its repeats."""
    square = np.maximum(step, 1e-150) ** 2
    of_repeats = _SIGMA**2 + 1 / 12 - _HIDDEN
    ratio = np.divide(seen, square, out=np.full_like(square, np.inf), where=step > 0.0)
    hidden = square * np.interp(ratio, of_repeats, _HIDDEN, right=0.0)
    return np.asarray(np.where(step > 0.0, hidden, 0.0))


# -- noise of one reading, and whether shapes repeat over loads and signs --------------------------

MIN_REPEATS = 30  # for a noise of each actuator: known to 13 %


@dataclass(frozen=True, eq=False)
class Noise:
    """Variance of one reading of weight 1, and its source."""

    variance: Array  # (n,) [N^2]
    source: NoiseSource  # if the minimum, only its shape is known, and the fit gives its size
    # part that reaches the balance, relative to independent actuators: less than 1 if the mirror's
    # own motion makes part of it, more if many actuators share noise
    share: float = 1.0
    share_freedom: float = np.inf  # degrees of freedom of the share
    hidden: Array | float = 0.0  # (n,) part that repeats do not show: common rounding [N^2]
    least: float = 0.0  # variance below which it is not distinguished from rounding [N^2]

    @cached_property
    def in_balance(self) -> Array:
        """(n,) variance of one reading in the balance [N^2]."""
        return self.seen * self.share + self.hidden

    @cached_property
    def seen(self) -> Array:
        """(n,) variance of one reading among its repeats [N^2]."""
        return self.variance - self.hidden


def reading_noise(campaign: Campaign, moments: Moments) -> Noise:
    """Return the noise of a reading: from repeats, as declared, or from the minimum."""
    n = moments.mean.shape[1]
    # A millionth of the forces, not from the sums, which cost a product of matrices. Less is not
    # distinguished from rounding, in which the weights would be lost.
    least = float(1e-12 * moments.squares.sum() / n / moments.weight.sum())
    if moments.repeats:
        each = moments.scatter / moments.repeats
        if moments.repeats < MIN_REPEATS:
            each = np.full(n, each.mean())
        each = np.maximum(each, least)
        hidden = _hidden(moments, each)
        return Noise(each + hidden, NoiseSource.REPEATS, hidden=hidden, least=least)
    if all(c.force_error for c in campaign.cycles):
        # Who declares less than rounding makes has not declared it.
        declared = np.full(n, WEIGHED_NOISE**2)
        rounding = np.where(declared < moments.rounding, moments.rounding, 0.0)
        return Noise(declared + rounding, NoiseSource.DECLARED, least=least)
    return Noise(np.full(n, least), NoiseSource.MINIMUM, least=least)


def _hidden(moments: Moments, each: Array) -> Array:
    """Return (n,) variance of rounding that all rows of a group have in common [N^2].

    As that of a row of weight 1, of which the mean of a group has as many as there are repeats.
    """
    typical = moments.typical_variance
    repeats = moments.rows.sum() / moments.groups
    hidden = hidden_variance(np.broadcast_to(moments.step, each.shape), each * typical)
    return np.asarray(hidden * repeats / typical)


@dataclass(frozen=True)
class Structure:
    """Whether shapes repeat over loads and signs."""

    chi2: float  # of the residuals of the means of groups, in terms of the noise of repeats
    degrees_of_freedom: float
    probability: float  # of a larger chi2 by chance

    @property
    def reduced(self) -> float:
        """chi2 over degrees of freedom."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def structure_of(moments: Moments, noise: Noise, samples: Array) -> Structure:
    """Test whether shapes repeat over loads and signs.

    ``samples`` are (m, n) deviations of some rows from their repeats [N], which show
    how far readings depend on each other.
    """
    pooling = (moments if moments.pooled else replace(moments, pooled=True)).pooling
    # Of what is left the squares alone: every mean less its part in the rows needs their room.
    left = np.maximum(moments.squares - np.sum(pooling.rows(moments.mean) ** 2, axis=0), 0.0)
    chi2 = float(left @ (1.0 / noise.variance))
    independent = independent_readings(samples, len(noise.variance))
    if moments.by_force:  # few readings then have most of the noise
        independent /= 1.0 + moments.by_force * (moments.noise_along(1) - 1.0)
    freedom = (moments.groups - pooling.count) * independent
    chi2 *= independent / len(noise.variance)
    if noise.source == NoiseSource.REPEATS:
        chi2 *= max(1.0 - 2.0 / moments.repeats, 0.0)  # 1 / s^2 of each is too large by as much
        known = moments.repeats * independent
        probability = f_sf(chi2 / max(freedom, 1.0), freedom, known)
    else:
        probability = chi2_sf(chi2, freedom)
    return Structure(chi2, freedom, float(probability) if freedom > 0 else 1.0)


def independent_readings(samples: Array, n: int) -> float:
    """Return the effective number of independent readings, by (m, n) samples."""
    m = len(samples)
    if m < 2:
        return float(n)
    size = np.sqrt(np.mean(samples**2, axis=0))  # 0 where rounding hides all noise
    scaled = np.divide(samples, size, out=np.zeros_like(samples), where=size > 0.0)
    # (tr C)^2 / tr C^2, less what chance alone makes of C between m rows; in single precision
    scaled = scaled.astype(np.float32)
    correlated = scaled @ scaled.T if m < n else scaled.T @ scaled
    square = float(np.vdot(correlated, correlated)) / m**2
    return float(np.clip(n**2 / max(square - n * (n - 1) / m, 1.0), 1.0, n))


def pooled_where_it_fits(
    moments: Moments, noise: Noise, samples: Array
) -> tuple[Moments, Structure | None]:
    """Return the moments, pooled over loads and signs if shapes repeat so, and the test.

    ``samples`` as in `structure_of`, (m, n) [N]. The test is None if the noise of a reading is not
    known or only rounding, or if there is nothing to pool.
    """
    rounding = bool(np.any(noise.variance <= noise.least))
    if noise.source == NoiseSource.MINIMUM or rounding:
        return moments, None
    pooled = replace(moments, pooled=True)
    structure = structure_of(pooled, noise, samples)
    if structure.degrees_of_freedom <= 0:
        return moments, None
    return (pooled if structure.probability > LIMITS.fit_probability else moments), structure
