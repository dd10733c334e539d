"""Noise of a stiffness matrix, from its residuals, and the errors of the fits that it causes.

If modes were driven, noise is one of modes (`BinnedNoise`): the modes, stiffest first, are in bins
of equal number. Residuals of a pair of bins have one variance: their mean square over 1 less the
mean leverage.

If elements were measured one by one, the noise of each is equal in all, proportional to it, or
both, and differs between sensors,

    V_ij = c_j (a^2 + p^2 k_ij^2)

The true forces at the magnets, K = D_alpha K_c (H D_g)^-1, differ from their transpose by noise
whose variance is linear in the V of a row, and by the effect of errors of the sensors' offsets.
a^2, p^2, c and the size of the latter are the most likely for all pairs, as if these were
independent; one factor of each actuator, alpha times gain, is free. The more likely of the two
kinds of noise is used. White noise makes both equally likely; any other noise prefers the one in
which it is uncorrelated.

A fit weighs residuals of modes as if they were independent. Noise of elements is not: proportional
noise is near the diagonal, and all modes share it. To first order the error of a fit is -C s(E),
with its covariance C and the score s of noise E, whatever the weights. So noise of elements is
drawn, the same for all fits, and the errors are counted. For noise of modes the covariance of the
fit is that of its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.acceptance import errors_of_sensors
from truenewton.estimation.reciprocity.information import (
    Leverage,
    Residuals,
    States,
    Weights,
    equal_bins,
    in_single,
    score,
    to_single,
)
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.sensor_model import (
    OFFSETS,
    Kind,
    Places,
    Request,
    SensorModel,
    Values,
    sensors_at,
)
from truenewton.linalg import factor_of, inverse_of_positive

# Variance of rigid motions relative to the quietest pair with the same mode: gains and offsets of a
# small mirror can fit rigid motions without residuals.
MIN_RIGID_VARIANCE = 0.01


@dataclass(eq=False)
class BinnedNoise:
    """States of a stiffness, and their noise according to the last residuals."""

    stiffness: Array  # (n, n) K_c, of the modes that are used alone [N/m]
    readings: Array  # (n, m) V, stiffest first
    balance: bool = False  # whether only statics count
    leverage: Leverage | None = field(default=None)  # of the last fit
    latest: tuple[Values, States] | None = field(default=None)  # last unknowns and states

    def told(self, leverage: Leverage) -> None:
        """Store the leverages of a fit."""
        self.leverage = leverage

    def __call__(self, places: Places, values: Values, seen: SensorModel) -> tuple[States, Weights]:
        """Return states and weights at given values."""
        states = self.states(places, values, seen)
        weights = self.weights(states)
        return states, weights.of_balance if self.balance else weights

    def states(self, places: Places, values: Values, seen: SensorModel) -> States:
        """Return the states, with orthonormal Q and any W'W."""
        true = values.alpha[:, None] * self.stiffness
        if self.latest is not None and values.same_sensors(self.latest[0]):
            states = self.latest[1]  # alpha alone changes, and with it the forces
            forces, rigid_forces = true @ states.readings, true @ states.rigid_readings
            return replace(states, forces=forces, rigid_forces=rigid_forces)
        rigid, triangle = np.linalg.qr(places.rigid)
        turn = np.linalg.inv(triangle)
        rigid_readings = places.rigid_readings(values) @ turn
        moved = seen.motion @ (values.gain[:, None] * self.readings)
        apart = moved - rigid @ (rigid.T @ moved)
        displaced = _dual(apart)
        basis = np.linalg.qr(rigid_readings)[0]
        dual = _dual(self.readings - basis @ (basis.T @ self.readings))
        states = States(
            readings=self.readings,
            forces=true @ self.readings,
            displacements=moved,
            rigid_readings=rigid_readings,
            rigid_forces=true @ rigid_readings,
            turn=turn,
            rigid=rigid,
            displaced=displaced,
            balancing=rigid - displaced @ (moved.T @ rigid),
            dual=dual,
        )
        self.latest = (values, states)
        return states

    def weights(self, states: States) -> Weights:
        """Return weights from the residuals and from the leverages of the last fit."""
        left = states.residuals
        bins = equal_bins(states.count, min(12, states.count // 8))
        sizes = np.array([some.stop - some.start for some in bins])
        starts = [some.start for some in bins]
        pairs = np.outer(sizes, sizes) - np.diag(sizes)
        taken = self.leverage or Leverage(
            np.zeros((3, len(bins))), np.zeros((len(bins), 3)), np.zeros((len(bins),) * 2)
        )
        square = np.add.reduceat(
            np.add.reduceat(left.reciprocity**2, starts, axis=0), starts, axis=1
        )
        # of the diagonal bins half the pairs; off it the leverage of a pair of bins stands whole
        of_pair = taken.reciprocity * (1.0 + np.eye(len(bins)))
        variance = square / _left(pairs, of_pair)
        statics = np.add.reduceat(left.statics**2, starts, axis=1) / _left(sizes, taken.statics)
        rigid = np.add.reduceat(left.rigid**2, starts, axis=0) / _left(sizes[:, None], taken.rigid)
        # Gains alone can explain a rigid motion: each of the three has too little of its own.
        rigid = np.repeat(rigid.mean(axis=1, keepdims=True), 3, axis=1)
        variance = np.maximum(variance, (1e-12) ** 2 * np.mean(np.diagonal(left.work) ** 2))
        if sizes.min() < 20:  # too few for a noise of each of the three equations
            statics = np.repeat(statics.mean(axis=0, keepdims=True), 3, axis=0)
        least = MIN_RIGID_VARIANCE * variance.min(axis=0)
        statics, rigid = np.maximum(statics, least), np.maximum(rigid, least[:, None])
        return Weights(
            statics=np.repeat(1.0 / statics, sizes, axis=1),
            rigid=np.repeat(1.0 / rigid, sizes, axis=0),
            reciprocity=1.0 / variance,
            bins=bins,
            share=shares(variance, sizes),
        )


def shares(variance: Array, sizes: NDArray[np.int64]) -> Array:
    """Return (m, m) variances of T over those of A, by (b, b) variances of A between bins.

    The variance of T_lm is r_l c_m: so those of T_lm and T_ml have the sum of A, and the product of
    the bins of l and m by themselves. The force of the noisier state has more.
    """
    own = np.diag(variance)
    half = 0.5 * variance
    apart = np.sqrt(np.maximum(half**2 - 0.25 * np.outer(own, own), 0.0))
    share = (half + np.where(own > own[:, None], apart, -apart)) / variance
    return np.asarray(np.repeat(np.repeat(share, sizes, axis=0), sizes, axis=1))


def _dual(basis: Array) -> Array:
    """Return (n, m) D in the span of a basis B, D'B = 1."""
    return np.asarray(scipy.linalg.solve(basis.T @ basis, basis.T, assume_a="pos").T)


def _left(count: Array, taken: Array) -> Array:
    """Return the number of residuals less those taken by a fit.

    At least 1 in 20: with fewer, too little would be left to determine the noise.
    """
    return np.asarray(count * (1.0 - np.minimum(taken / count, 0.95)))


PRIOR_RESIDUALS = 4.0  # weight of the other sensors' noise in that of one


def element_variance(stiffness: Array, fit: Fit, places: Places) -> Array | None:
    """Return (n, n) variances of the elements of an (n, n) K_c [(N/m)^2]; None for noise of modes.

    For sensors at the fitted offsets or at their magnets, whichever is more likely; the residuals
    at fitted offsets lack what these absorbed.
    """
    at_magnets = replace(fit.values, offset=np.zeros_like(fit.values.offset))
    ways = [sensors_at(places, at_magnets, slopes=False)]
    if fit.asked.offset_spread:
        ways.append(sensors_at(places, fit.values, slopes=True))
    found, start = list[tuple[Array, float]](), None
    for seen in ways:
        variance, cost, start = _likeliest(stiffness, fit, seen, start)
        found.append((variance, cost))
    if min(cost for _, cost in found) > cost_of_modes(fit):  # judged by the same residuals
        return None
    if len(found) > 1 and found[0][1] < found[1][1] + _cost_of_offsets(fit):
        return found[0][0]
    return found[-1][0]


def _cost_of_offsets(fit: Fit) -> float:
    """Return what the fitted offsets reduce the cost by, were the sensors at their magnets.

    Twice their effective number over that of the pairs (Akaike).
    """
    n = len(fit.values.log_alpha)
    held = sum(float(np.trace(fit.covariance_of(kind))) for kind in OFFSETS)
    return 2.0 * (2 * n - held / fit.asked.offset_spread**2) / (0.5 * n * (n - 1))


def _likeliest(
    stiffness: Array, fit: Fit, seen: SensorModel, start: Array | None
) -> tuple[Array, float, Array]:
    """Return variances for given sensors, their cost, and the logarithms of their parameters.

    Steps are those of a minorant of the likelihood, in which no variance becomes negative (Zhou et
    al., J. Comput. Graph. Stat. 28, 350, 2019). Two of them give the length of a third (SQUAREM:
    Varadhan and Roland, Scand. J. Stat. 35, 335, 2008).
    """
    n, alpha = len(stiffness), fit.values.alpha
    back = np.linalg.inv(seen.motion * fit.values.gain)
    true = alpha[:, None] * stiffness @ back
    apart, whole = true - true.T, 0.5 * (true + true.T)
    pairs = np.asarray(fit.equations[2])
    left = float(_left(pairs, np.asarray(max(0.0, fit.parameters[2] - n))) / pairs)  # by the fit
    mixed = np.asarray(back**2)
    own, mean = alpha[:, None] ** 2, float(np.mean(stiffness**2))
    least, share = 1e-24 * mean, 1e-6  # so that logarithms stay bounded
    alone = np.count_nonzero(mixed) == n  # each sensor sees its own magnet alone
    proportional, moved = own * stiffness**2 / mean, _by_offsets(true @ seen.motion, fit, seen)
    off = bool(moved.any())

    def by_mixing(each: Array, mixed: Array) -> Array:
        return np.asarray(each * np.diag(mixed) if alone else each @ mixed)

    def stepped(logs: Array) -> tuple[Array, float, Array]:
        """Return log a^2, p^2, the offsets' part and c after a step; cost and gain of the first."""
        size, offsets, sensor = np.exp(logs[:2]), float(np.exp(logs[2])), np.exp(logs[3:])
        each = size[0] * own + size[1] * proportional
        total = by_mixing(each * sensor, mixed)
        if off:
            total += offsets * moved
        total = total + total.T
        np.fill_diagonal(total, 1.0)
        had = 1.0 / total
        np.fill_diagonal(had, 0.0)  # nothing is its own transpose
        square = _without_factors(apart, whole, had) / left
        wanted = square * had
        cost = float(np.sum(np.log(total)) + np.sum(wanted)) / (n * (n - 1))
        wanted *= had
        by_offsets = np.sum(moved * wanted) / np.sum(moved * had) if off else 1.0
        wanted, had = by_mixing(wanted, mixed.T), by_mixing(had, mixed.T)
        told, expected = (
            np.array([own[:, 0] @ part @ sensor, np.sum((proportional * part) @ sensor)])
            for part in (wanted, had)
        )
        gain = 0.5 * size * (told - expected)  # of the log likelihood
        size = size * np.sqrt(told / expected)
        size = np.maximum(size, max(least, share * size.max()))
        counted = sensor * np.sum(each * had, axis=0) + PRIOR_RESIDUALS
        sensor = np.sqrt(
            (sensor**2 * np.sum(each * wanted, axis=0) + PRIOR_RESIDUALS) * sensor / counted
        )
        offsets = max(offsets * np.sqrt(by_offsets), share)
        # A common factor of c belongs to a^2 and p^2: the prior is most likely if mean 1/c is 1.
        common = float(np.mean(1.0 / sensor))
        sensor, size = sensor * common, size / common
        return np.log(np.concatenate([size, [offsets], sensor])), cost, gain

    logs = start
    if logs is None:
        first = max(0.25 * float(np.mean(apart**2)) / float(np.mean(own)), least)
        logs = np.concatenate([np.log([first, first, 1.0]), np.zeros(n)])
    for _ in range(40):  # of three steps each
        one, _, _ = stepped(logs)
        two, cost, _ = stepped(one)
        step, bend = one - logs, two - 2.0 * one + logs
        far = max(1.0, float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-300))
        jumped = logs + np.clip(2.0 * far * step + far**2 * bend, -4.0, 4.0)
        logs, reached, gain = stepped(jumped)
        change = np.abs(logs - jumped)
        if not reached <= cost:
            logs, reached, change = two, cost, np.abs(two - one)
        matters = np.abs(gain) > 0.1  # the smaller part may be negligible
        if change[:2][matters].max(initial=0.0) < 2e-3 and change[3:].max() < 0.05:
            break
    size = np.exp(logs[:2])
    variance = (size[0] + size[1] * stiffness**2 / mean) * np.exp(logs[3:])
    return variance, reached, logs


def cost_of_modes(fit: Fit) -> float:
    """Return the cost of a pair if noise is one of modes, each of unit length."""
    states, weights = fit.point.states, fit.point.weights
    pairs = ~np.eye(states.count, dtype=bool)
    length = np.log(np.sum(states.displacements**2, axis=0))
    unit = np.log(weights.of_pairs) + length[:, None] + length
    return 1.0 - float(np.mean(unit[pairs]))


def _by_offsets(forces: Array, fit: Fit, seen: SensorModel) -> Array:
    """Return (n, n) variance of forces per displacement by errors of the offsets."""
    total = np.zeros_like(forces)
    if seen.slopes is None:
        return total
    for kind, slopes in zip(OFFSETS, seen.slopes, strict=True):
        errors = np.diag(fit.covariance_of(kind))
        total += (forces**2 * errors) @ (slopes @ np.linalg.inv(seen.motion)) ** 2
    return total


def _without_factors(apart: Array, whole: Array, weight: Array) -> Array:
    """Return (n, n) squared differences of pairs that no factor of each actuator explains.

    Each is divided by 1 less its leverage: a few strong pairs determine most of a factor. The
    leverage is at most 0.9, since beyond that too little is left to determine the noise.
    """
    links = weight * whole**2
    laplacian = np.diag(links.sum(axis=1)) - links
    laplacian += np.trace(laplacian) / len(links) ** 2  # the factor of all is free
    inverse = inverse_of_positive(laplacian)
    factor = inverse @ np.sum(weight * whole * apart, axis=1)
    own = np.diag(inverse)
    leverage = np.minimum(links * (own[:, None] + own - 2.0 * inverse), 0.9)
    return np.asarray((apart - whole * (factor[:, None] - factor)) ** 2 / (1.0 - leverage))


MAX_DRAWS = 300  # of random noise
RARE_DRAW_FRACTION = 0.01  # of draws: a larger difference is not noise
UNCERTAIN_VARIANCE_FACTOR = 1.5  # margin, as the variance of the elements is uncertain


@dataclass(frozen=True, eq=False)
class MatrixNoise:
    """Noise of a stiffness."""

    variance: Array | None  # (n, n) of its elements [(N/m)^2]; None for noise of modes
    # standard deviations of log g and of the offsets [m] beyond noise
    scatter: tuple[float, float] = (0.0, 0.0)
    scores: Array | None = None  # (draws, u) of the fit that gave the noise of its elements

    def of(self, asked: Request, n: int) -> Array:
        """Return (u,) standard deviations of the unknowns that are drawn."""
        gain, offset = self.scatter
        spreads = {Kind.ALPHA: 0.0, Kind.GAIN: gain, Kind.X: offset, Kind.Y: offset}
        return np.repeat([spreads[kind] for kind in asked.kinds], n)


def noise_of(stiffness: Array, fit: Fit, places: Places, *, rough: bool = False) -> MatrixNoise:
    """Return the noise of an (n, n) K_c, of elements or modes, whichever is more likely.

    ``rough``: for a typical error, by few draws.
    """
    variance = element_variance(stiffness, fit, places)
    if variance is None:
        return MatrixNoise(None)
    n = len(variance)
    drawn = scores([fit], variance, 20 if rough else MAX_DRAWS)[0]
    by_noise = -drawn @ fit.covariance
    unit = np.random.default_rng(1).standard_normal(by_noise.shape)
    known = fit.asked.information(n)
    scatter = []
    for kinds in ((Kind.GAIN,), OFFSETS):
        which = [kind for kind in kinds if kind in fit.asked.kinds]
        if not which:
            scatter.append(0.0)
            continue
        found = sum(float(np.sum(fit.values.of(kind) ** 2)) for kind in which)
        some = np.isin(np.repeat(fit.asked.kinds, n), which)
        pulled = unit * some - (unit * some * known) @ fit.covariance
        feigned, passed = (np.sum(each[:, some] ** 2) / len(each) for each in (by_noise, pulled))
        scatter.append(float(np.sqrt(max(found - feigned, 0.0) / passed)))
    return MatrixNoise(variance, (scatter[0], scatter[1]), drawn)


def scores(fits: Sequence[Fit], variance: Array, most: int = MAX_DRAWS) -> list[Array]:
    """Return (draws, u) scores of some fits for noise whose elements have (n, n) variance.

    In single precision, as they are random; the noise is the same for all.
    """
    random, n, root = np.random.default_rng(1), len(variance), np.sqrt(variance)
    draws = [_Scores(fit) for fit in fits]
    found = [list[Array]() for _ in fits]
    for _ in range(min(most, max(50, int(1e9 / n**3)))):
        noise = root * random.standard_normal(root.shape)
        for draw, several in zip(draws, found, strict=True):
            several.append(draw.score_of(noise))
    return list(map(np.array, found))


class _Scores:
    """Scores of a fit for noise of the elements."""

    def __init__(self, fit: Fit) -> None:
        self.states, self.alpha = fit.point.states, fit.values.alpha[:, None]
        weights = fit.point.weights
        self.symmetric = bool(weights.reciprocity.any())
        if self.symmetric:
            weights = replace(weights, exact=to_single(weights.of_pairs))
        self.point = replace(in_single(fit.point), weights=weights)
        # rigid motions are judged by the forces of the modes alone
        used = self.states.forces / self.alpha
        self.used = used / np.linalg.norm(used, axis=0)
        self.readings = to_single(self.states.readings)
        self.displacements = to_single(self.states.displacements)

    def score_of(self, noise: Array) -> Array:
        """Return the (u,) score for (n, n) noise of the commanded stiffness."""
        states, pushed = self.states, self.alpha * noise
        statics = states.rigid.T @ pushed @ states.readings
        rigid = self.used @ (self.used.T @ (noise @ states.rigid_readings))
        rigid = states.displacements.T @ (self.alpha * rigid)
        work = np.zeros((0, 0))
        if self.symmetric:
            work = self.displacements.T @ (to_single(pushed) @ self.readings)
        return score(replace(self.point, left=Residuals(statics, rigid, work)))


def errors(fit: Fit, noise: MatrixNoise, by_noise: Array) -> Array:
    """Return (draws, u) errors of all unknowns by `scores` of noise and scatter of sensors."""
    n, total = len(fit.values.log_alpha), by_noise.copy()
    unit = np.random.default_rng([1, 1]).standard_normal((len(total), 3 * n))
    sensors = np.concatenate([np.zeros((len(total), n)), unit], axis=1)[:, : total.shape[1]]
    total += sensors * noise.of(fit.asked, n) * fit.asked.information(n)
    return np.asarray(-total @ fit.covariance)


def stated_errors(fit: Fit, noise: MatrixNoise) -> tuple[Array, dict[Kind, Array]]:
    """Return the (n, n) covariance of log alpha, and (n,) errors of log g and offsets [m]."""
    alpha = fit.covariance_of(Kind.ALPHA)
    if noise.variance is None:
        return alpha, errors_of_sensors(fit)
    assert noise.scores is not None
    drawn = errors(fit, noise, noise.scores)
    rms = np.split(np.sqrt(np.mean(drawn**2, axis=0)), len(fit.asked.kinds))
    of_sensors = dict(zip(fit.asked.kinds[1:], rms[1:], strict=True))
    # There may be few draws: as if the variances of `_by_size` had been observed in n draws before
    # (the mean of an inverse Wishart distribution).
    drawn = drawn[:, : len(alpha)]
    (draws, n), (held, vectors) = drawn.shape, _by_size(alpha, drawn)
    covariance = (drawn.T @ drawn + n * (vectors * held) @ vectors.T) / (draws + n)
    return covariance, of_sensors


def _by_size(stated: Array, drawn: Array) -> tuple[Array, Array]:
    """Return variances of the patterns of an (n, n) covariance, descending, and the patterns.

    The ratio to the stated variance is the mean over patterns of similar variance in the draws, in
    bands of as many patterns as there are before.
    """
    values, vectors = (each[..., ::-1] for each in np.linalg.eigh(stated))
    least = 1e-9 * values[0]  # only the variance of the scale is smaller, which is not an error
    base = np.maximum(values, least)
    along, start = np.mean((drawn @ vectors) ** 2, axis=0) / base, 0
    held = np.zeros(len(values))
    while start < len(values):
        some = slice(start, max(1, 2 * start))
        held[some] = base[some] * np.mean(along[some])
        start = some.stop
    held[values < least] = 0.0
    return held, vectors


def drawn_differences(fits: Sequence[Fit], noise: MatrixNoise) -> Array:
    """Return (draws, n) differences that noise makes between the log alpha of two fits."""
    if noise.variance is None:
        one, other = (fit.covariance_of(Kind.ALPHA) for fit in fits)
        factor = factor_of(one + other)
        unit = np.random.default_rng(1).standard_normal((MAX_DRAWS, factor.shape[1]))
        return np.asarray(unit @ factor.T)
    n = len(noise.variance)
    drawn = zip(fits, scores(fits, noise.variance), strict=True)
    one, other = (errors(fit, noise, each)[:, :n] for fit, each in drawn)
    return np.asarray(one - other)


def beyond_noise(fits: Sequence[Fit], drawn: Array, *, alike: bool, doubtful: bool) -> float:
    """Return the variance between the log alpha of two fits over that of noise, 1 at least.

    Patterns are compared relative to their errors; if fits are ``alike``, and err in many patterns,
    alpha itself as well, whichever is larger. Unless the model is doubtful, differences within the
    (draws, n) of `drawn_differences` are noise.
    """
    one, other = fits
    difference = one.values.log_alpha - other.values.log_alpha
    stated = one.covariance_of(Kind.ALPHA) + other.covariance_of(Kind.ALPHA)
    held, vectors = _by_size(stated, drawn)
    white = vectors[:, held > 0.0] / np.sqrt(held[held > 0.0])
    excess = 1.0
    for way in (white, np.eye(len(held)))[: 1 + alike]:
        seen, usual = np.sum((difference @ way) ** 2), np.sum((drawn @ way) ** 2, axis=1)
        if doubtful or seen > UNCERTAIN_VARIANCE_FACTOR * np.quantile(
            usual, 1.0 - RARE_DRAW_FRACTION
        ):
            excess = max(excess, float(seen / usual.mean()))
    return excess
