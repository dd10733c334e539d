"""How fits of a stiffness answer to noise of its elements: what their errors are.

A fit weighs residuals of modes as if they were independent. Noise of elements is not so: where it
is in proportion to each it sits near the diagonal, and all modes share it. To first order the error
of a fit is -C s(E), with its covariance C and the score s of noise E, whatever the weights. So
noise is drawn as the elements have it, the same for all fits, and errors are counted. Where noise
is one of modes the fit's covariance is that of its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.acceptance import errors_of_sensors
from truenewton.estimation.reciprocity.information import Residuals, in_single, score, to_single
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.noise import cost_of_modes, element_variance
from truenewton.estimation.reciprocity.sensor_model import Places
from truenewton.estimation.reciprocity.unknowns import OFFSETS, Kind, Request
from truenewton.linalg import factor_of

DRAW_SEED = 1
MAX_DRAWS = 300
# Of draws: what differs by more than all but these may be no noise, and is none.
RARE_DRAW_FRACTION = 0.01
# Times beyond these, as the variance of the elements is not known for sure.
UNCERTAIN_VARIANCE_FACTOR = 1.5
SCALE_VARIANCE = 1e-9  # of the largest variance: below it only the scale is, which is no error


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of a stiffness.

    Attributes
    ----------
    variance
        (n, n) of its elements [(N/m)^2]; None where it is one of modes.
    scatter
        Standard deviations of log g and of the offsets [m], as far as noise does not feign them.
    scores
        (draws, u) of the fit that the noise is from, for noise of its elements.
    """

    variance: Array | None
    scatter: tuple[float, float] = (0.0, 0.0)
    scores: Array | None = None

    def of(self, asked: Request, n: int) -> Array:
        """Return (u,) standard deviations of the unknowns that are drawn."""
        gain, offset = self.scatter
        spreads = {Kind.ALPHA: 0.0, Kind.GAIN: gain, Kind.X: offset, Kind.Y: offset}
        return np.repeat([spreads[kind] for kind in asked.kinds], n)


def noise_of(stiffness: Array, fit: Fit, places: Places) -> Noise:
    """Return the noise of an (n, n) K_c, of elements or modes, whichever is likelier.

    How sensors scatter beyond that of elements the fit tells.
    """
    variance, cost = element_variance(stiffness, fit, places)
    if cost > cost_of_modes(fit):
        return Noise(None)
    n = len(variance)
    drawn = scores(fit, variance)
    by_noise = -drawn @ fit.covariance
    unit = np.random.default_rng(DRAW_SEED).standard_normal(by_noise.shape)
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
    return Noise(variance, (scatter[0], scatter[1]), drawn)


def scores(fit: Fit, variance: Array) -> Array:
    """Return (draws, u) scores of a fit for noise whose elements have (n, n) variance.

    In single precision: they are random.
    """
    n, point = len(variance), in_single(fit.point)
    random, states, alpha = (
        np.random.default_rng(DRAW_SEED),
        fit.point.states,
        fit.values.alpha[:, None],
    )
    symmetric = bool(point.weights.reciprocity.any())
    used = states.forces / alpha  # rigid motions are judged by the forces of the modes alone
    used = used / np.linalg.norm(used, axis=0)
    size, w = alpha * np.sqrt(variance), states.displacements
    readings, displacements = to_single(states.readings), to_single(w)
    found = []
    for _ in range(int(np.clip(1e9 / n**3, 50, MAX_DRAWS))):
        noise = size * random.standard_normal(size.shape)
        pushed = to_single(noise) @ readings
        rigid = alpha * (used @ (used.T @ ((noise @ states.rigid_readings) / alpha)))
        work = displacements.T @ pushed if symmetric else np.zeros((0, 0))
        left = Residuals(states.rigid.T @ pushed, w.T @ rigid, work)
        found.append(score(replace(point, left=left)))
    return np.array(found)


def errors(fit: Fit, noise: Noise, by_noise: Array) -> Array:
    """Return (draws, u) errors of all unknowns by the `scores` of noise and the sensors' scatter.

    Noise and sensors are the same for all fits.
    """
    n, total = len(fit.values.log_alpha), by_noise.copy()
    unit = np.random.default_rng([DRAW_SEED, 1]).standard_normal((len(total), 3 * n))
    sensors = np.concatenate([np.zeros((len(total), n)), unit], axis=1)[:, : total.shape[1]]
    total += sensors * noise.of(fit.asked, n) * fit.asked.information(n)
    return np.asarray(-total @ fit.covariance)


def stated_errors(fit: Fit, noise: Noise) -> tuple[Array, dict[Kind, Array]]:
    """Return the (n, n) covariance of log alpha, and (n,) errors of what is asked of the sensors.

    These are log g and offsets [m].
    """
    alpha = fit.covariance_of(Kind.ALPHA)
    if noise.variance is None:
        return alpha, errors_of_sensors(fit)
    assert noise.scores is not None
    drawn = errors(fit, noise, noise.scores)
    rms = np.split(np.sqrt(np.mean(drawn**2, axis=0)), len(fit.asked.kinds))
    of_sensors = dict(zip(fit.asked.kinds[1:], rms[1:], strict=True))
    return covariance_of_draws(alpha, drawn[:, : len(alpha)]), of_sensors


def covariance_of_draws(stated: Array, drawn: Array) -> Array:
    """Return the (n, n) covariance of (draws, n) errors, of which there may be few.

    As if that of `_by_size` had been seen in n draws before (the mean of an inverse Wishart
    distribution).
    """
    draws, n = drawn.shape
    held, vectors = _by_size(stated, drawn)
    return np.asarray((drawn.T @ drawn + n * (vectors * held) @ vectors.T) / (draws + n))


def _by_size(stated: Array, drawn: Array) -> tuple[Array, Array]:
    """Return variances of the patterns of an (n, n) covariance, descending, and the patterns.

    Each is as much larger or smaller than stated as those of about its size are in the draws, in
    bands of as many patterns as there are before.
    """
    values, vectors = (each[..., ::-1] for each in np.linalg.eigh(stated))
    base = np.maximum(values, SCALE_VARIANCE * values[0])
    along, start = np.mean((drawn @ vectors) ** 2, axis=0) / base, 0
    held = np.zeros(len(values))
    while start < len(values):
        some = slice(start, max(1, 2 * start))
        held[some] = base[some] * np.mean(along[some])
        start = some.stop
    held[values < SCALE_VARIANCE * values[0]] = 0.0
    return held, vectors


def drawn_differences(fits: Sequence[Fit], noise: Noise) -> Array:
    """Return (draws, n) differences that noise makes between the log alpha of two fits."""
    if noise.variance is None:
        one, other = (fit.covariance_of(Kind.ALPHA) for fit in fits)
        factor = factor_of(one + other)
        unit = np.random.default_rng(DRAW_SEED).standard_normal((MAX_DRAWS, factor.shape[1]))
        return np.asarray(unit @ factor.T)
    n = len(noise.variance)
    one, other = (errors(fit, noise, scores(fit, noise.variance))[:, :n] for fit in fits)
    return np.asarray(one - other)


def beyond_noise(fits: Sequence[Fit], drawn: Array, *, alike: bool, doubtful: bool) -> float:
    """Return the variance between the log alpha of two fits over that of noise, 1 at least.

    Of patterns in terms of their errors; of fits that are alike, which err in more than a few
    patterns, also of alpha as it is, whichever is more. Unless the model is doubtful, what noise
    may do, (draws, n) by `drawn_differences`, is noise.
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
