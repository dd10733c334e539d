"""Scatter of alpha from day to day, beyond the noise of the readings.

On day j, relative to the law of actuator i,

    alpha_i(j) = alpha_i(T_j, t_j) (1 + c_j + e_ij),    c ~ N(0, s_c^2),    e ~ N(0, s^2):

c is common to all actuators on that day, e is independent. Contrasts of the days
y_p = sum_j N_jp alpha_j, N'N = 1, that are independent of any law contain nothing else:

    y_p ~ N(0, V_p),    V_p = C_p + s^2 1 + s_c^2 11',

with C_p the covariance of the readings. Their likelihood is the restricted one (Patterson and
Thompson, Biometrika 58, 1971). N is rotated so that contrasts are uncorrelated if the covariances
of the days are proportional. If they are not, the remaining correlation is neglected, which biases
no estimate.

Actuators that changed must not increase the scatter: those far off, by a first estimate from the
median of the actuators, are left free, and the likelihood is that of the others.

A whole day may be an outlier (`widen_outlying_day`), in each actuator or in the common scale. It is
judged by the scatter of the other days alone; otherwise it would be hidden by the scatter that it
causes, and the actuator farthest off on that day would be named. Its deviation from the law of the
others, y ~ N(0, V) by the readings (`RelativeDays.contrast_of`), has a mean m and a remainder. With
s and s_c of the other days,

    m^2 / (1'V1 / n^2 + s^2 / n + s_c^2)  ~  F(1, f - 1),
    (y - c)' (V + s^2)^-1 (y - c) / (n - 1)  ~  F(n - 1, nu of s^2),

where c is the common part, weighted by that matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chance_of_any, chi2_ppf, chi2_sf, f_sf, normal_isf, t_isf
from truenewton.errors import NotConverged
from truenewton.rounding import percent
from truenewton.tracking.days import DatedCalibration
from truenewton.tracking.linear_fit import relative_days

MAX_ITERATIONS = 200
UNCONSTRAINED = 1e8  # prior variance of a free shift, in variances of a typical contrast


@dataclass(frozen=True)
class Scatter:
    """Relative scatter from day to day.

    Attributes
    ----------
    own, own_variance_error
        s, of each actuator independently; standard uncertainty of s^2.
    common, degrees
        s_c, common to all, and its degrees of freedom; 0 if it cannot be estimated.
    """

    own: float = 0.0
    own_variance_error: float = 0.0
    common: float = 0.0
    degrees: int = 0

    @property
    def common_expanded(self) -> float:
        """s_c as `expanded`."""
        return expanded(self.common, self.degrees)

    def degrees_of(self, variance: float) -> float:
        """Return the degrees of freedom of a variance that contains s^2 (Satterthwaite)."""
        error = self.own_variance_error
        return 2.0 * (variance / error) ** 2 if error else np.inf


def expanded(scatter: float, degrees: int) -> float:
    """Return a standard deviation, enlarged so that 1.96 times it covers 95 %."""
    if not degrees:
        return scatter
    return scatter * float(t_isf(0.025, degrees) / normal_isf(0.025))


def maximise_likelihood(
    likelihood: Callable[[Array], tuple[float, Array, Array]], start: Array, unit: Array
) -> tuple[Array, Array]:
    """Return the (q,) variances >= 0 that maximise a likelihood, and their (q, q) information.

    ``likelihood`` returns the logarithm, its derivatives and the information; ``unit`` are (q,)
    large variances.

    Raises
    ------
    NotConverged
    """
    variance = start
    value, score, information = likelihood(variance)
    for _ in range(MAX_ITERATIONS):
        free = (variance > 0.0) | (score > 0.0)
        step = np.zeros_like(variance)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], score[free])
        for halving in range(30):
            tried = np.maximum(variance + step * 0.5**halving, 0.0)
            new = likelihood(tried)
            if new[0] >= value - 1e-9:
                break
        moved = np.abs(tried - variance) / (variance + unit)
        variance, (value, score, information) = tried, new
        if moved.max() < 1e-8:
            return variance, information
    raise NotConverged(
        "the spread of the population did not converge", remedy="give more days or fewer effects"
    )


def estimate_scatter(
    y: Array, covariance: Array, shift: Array, stay: NDArray[np.bool_], *, common: bool
) -> Scatter:
    """Estimate the scatter from contrasts of the days.

    Parameters
    ----------
    y, covariance
        (f, m) contrasts, and the (f, m, m) covariance of the readings in each.
    shift
        (m, n) changes of a contrast by relative changes of the n actuators.
    stay
        (n,) actuators that are used; the others may have changed by any amount.
    common
        Whether to estimate a common scatter, too.
    """
    size = float(np.mean(np.einsum("pii->pi", covariance)) / np.mean(np.sum(shift**2, axis=1)))
    own, together = shift @ shift.T, np.outer(shift.sum(axis=1), shift.sum(axis=1))
    freed = covariance + UNCONSTRAINED * size * (shift[:, ~stay] @ shift[:, ~stay].T)
    with_common = freed + UNCONSTRAINED * size * together if common else freed
    suspects = _outlying_actuators(y, with_common, shift, stay)
    freed = freed + UNCONSTRAINED * size * (shift[:, suspects] @ shift[:, suspects].T)
    parts = [own, together] if common else [own]

    def likelihood(variance: Array) -> tuple[float, Array, Array]:
        return _likelihood(variance, y, freed, parts)

    unit = np.array([size, size][: len(parts)])
    variance, information = maximise_likelihood(likelihood, unit, unit)
    return Scatter(
        own=float(np.sqrt(variance[0])),
        own_variance_error=float(np.sqrt(np.linalg.inv(information)[0, 0])),
        common=float(np.sqrt(variance[1])) if common else 0.0,
        degrees=len(y),
    )


def _outlying_actuators(
    y: Array, covariance: Array, shift: Array, stay: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return (n,) actuators farther off than the scatter of the median actuator explains."""
    middle = float(chi2_ppf(0.5, len(y)))
    own = shift @ shift.T

    def shares(log_variance: float) -> Array:
        total = np.zeros(shift.shape[1])
        for values, matrix in zip(y, covariance, strict=True):
            factor = scipy.linalg.cho_factor(matrix + np.exp(log_variance) * own, lower=True)
            solved = scipy.linalg.cho_solve(factor, np.column_stack([values, shift]))
            total += (shift.T @ solved[:, 0]) ** 2 / np.sum(shift * solved[:, 1:], axis=0)
        return total

    def off(log_variance: float) -> float:
        return float(np.log(np.median(shares(log_variance)[stay]) / middle))

    size = np.mean(np.einsum("pii->pi", covariance)) / np.mean(np.sum(shift**2, axis=1))
    low, high = np.log(1e-6 * size), np.log(1e12 * size)
    if off(low) > 0.0 > off(high):
        low = scipy.optimize.brentq(off, low, high, xtol=0.02)
    chance = chi2_sf(shares(low), len(y))
    rare = np.array([chance_of_any(float(one), int(stay.sum())) for one in chance]) < FALSE_ALARM
    return np.asarray(rare & stay)


def _likelihood(
    variance: Array, y: Array, covariance: Array, parts: Sequence[Array]
) -> tuple[float, Array, Array]:
    """Return the log-likelihood, the score and the expected information."""
    value, score = 0.0, np.zeros(len(parts))
    information = np.zeros((len(parts), len(parts)))
    for values, matrix in zip(y, covariance, strict=True):
        whole = matrix + sum(s * part for s, part in zip(variance, parts, strict=True))
        factor = scipy.linalg.cho_factor(whole, lower=True)
        weighed = scipy.linalg.cho_solve(factor, values)
        inverse = scipy.linalg.cho_solve(factor, np.eye(len(values)))
        by_part = [inverse @ part for part in parts]
        value -= float(np.log(np.diag(factor[0])).sum() + 0.5 * values @ weighed)
        for k, one in enumerate(by_part):
            score[k] += 0.5 * float(weighed @ parts[k] @ weighed - np.trace(one))
            for m, other in enumerate(by_part):
                information[k, m] += 0.5 * float(np.sum(one * other.T))
    return value, score, information


OFF = (  # whether actuators differ; the sentence
    (True, "each actuator differently: check how it was measured, or leave it out"),
    (False, "all actuators alike: check its weights, temperature and date, or leave it out"),
)


def widen_outlying_day(
    days: tuple[DatedCalibration, ...],
    on: NDArray[np.bool_],
    settings: Array,
    stay: NDArray[np.bool_],
) -> tuple[tuple[DatedCalibration, ...], str]:
    """Return the days, with larger errors of one that is an outlier, and a sentence about it.

    ``stay``: (n,) actuators that are used. If no day is an outlier, the sentence is ''.
    """
    if len(days) < settings.shape[1] + 3:
        return days, ""
    relative = relative_days(days, on, settings)
    contrasts = [
        (y[stay], v[np.ix_(stay, stay)], share)
        for y, v, share in map(relative.contrast_of, range(len(days)))
    ]
    for own, words in OFF:
        sizes = [float(np.var(y) if own else y.mean() ** 2) for y, _, _ in contrasts]
        j = int(np.argmax(sizes))
        y, v, share = contrasts[j]
        rest = relative.without(j).contrasts()
        scatter = estimate_scatter(*rest, np.eye(len(stay)), stay, common=True)
        chance = (_chance_of_own if own else _chance_of_common)(y, v, scatter)
        if chance_of_any(chance, len(OFF) * len(days)) < FALSE_ALARM:
            size, c = np.sqrt(sizes[j]) / share, days[j].calibration
            covariance, n = c.covariance.copy(), c.layout.n
            shape = np.diag(c.alpha**2) if own else np.outer(c.alpha, c.alpha)
            covariance[:n, :n] += size**2 * shape
            wider = days[j]._replace(calibration=replace(c, covariance=covariance))
            said = (
                f"{wider.name} differs from the law of the other days by {percent(size)}, {words}"
            )
            return (*days[:j], wider, *days[j + 1 :]), said
    return days, ""


def _chance_of_own(y: Array, v: Array, scatter: Scatter) -> float:
    v = v + scatter.own**2 * np.eye(len(y))
    one = np.linalg.solve(v, np.ones(len(y)))  # the common part is free
    chi2 = float(y @ np.linalg.solve(v, y) - (one @ y) ** 2 / one.sum())
    degrees = scatter.degrees_of(float(np.mean(np.diag(v))))
    return float(f_sf(chi2 / (len(y) - 1), len(y) - 1, degrees))


def _chance_of_common(y: Array, v: Array, scatter: Scatter) -> float:
    variance = float(v.mean()) + scatter.common**2 + scatter.own**2 / len(y)
    return float(f_sf(float(y.mean()) ** 2 / variance, 1, scatter.degrees))
