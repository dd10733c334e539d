"""How alpha scatters from day to day, beyond what the readings explain.

On day j, relative to the law of actuator i,

    alpha_i(j) = alpha_i(T_j, t_j) (1 + c_j + e_ij),    c ~ N(0, s_c^2),    e ~ N(0, s^2):

a scatter c of the day, common to all, and one of each actuator by itself. Contrasts of the days
that no law touches, y_p = sum_j N_jp alpha_j with N'N = 1, hold nothing else:

    y_p ~ N(0, V_p),    V_p = C_p + s^2 1 + s_c^2 11',

C_p being the covariance of their readings. The likelihood of such contrasts is the restricted one
(Patterson and Thompson, Biometrika 58, 1971). N is turned so that contrasts are uncorrelated where
the covariances of the days are in proportion; where they are not, what correlation is left is
neglected, which biases no estimate.

Actuators that changed must not pass for scatter: by a first estimate, from the median of the
actuators, those far off are set free, and the likelihood is that of the others.

A day may lie off the law of the others (`widened`), all its actuators or their common scale. This
is judged from the scatter of the other days alone: a day that is off makes a scatter of its own,
behind which it would hide, and the actuator farthest off on that day would be named. How it differs
from the law of the others, y ~ N(0, V) by its readings and theirs (`RelativeDays.contrast_of`), has
a mean m, and the rest about it; with s and s_c of the other days,

    m^2 / (1'V1 / n^2 + s^2 / n + s_c^2)  ~  F(1, f - 1),
    (y - c)' (V + s^2)^-1 (y - c) / (n - 1)  ~  F(n - 1, nu of s^2),

c being what is common, by that matrix.
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
from truenewton.tracking.linear_fit import RelativeDays, relative_days

STEPS = 200
FREE = 1e8  # of the variance of a typical contrast: of a shift that may be anything


@dataclass(frozen=True)
class Scatter:
    """Relative scatter from day to day.

    Attributes
    ----------
    own
        s, of each actuator by itself.
    own_variance_error
        Standard uncertainty of s^2.
    common
        s_c, of all together.
    degrees
        Of freedom of s_c: contrasts of the days; 0 where there are none, and nothing is known.
    """

    own: float = 0.0
    own_variance_error: float = 0.0
    common: float = 0.0
    degrees: int = 0

    @property
    def expanded_common(self) -> float:
        """s_c as `expanded`."""
        return expanded(self.common, self.degrees)

    def degrees_of(self, variance: float) -> float:
        """Degrees of freedom of a variance that s^2 is part of (Satterthwaite)."""
        error = self.own_variance_error
        return 2.0 * (variance / error) ** 2 if error else np.inf


def expanded(scatter: float, degrees: int) -> float:
    """Return a standard deviation of few degrees of freedom, so that 1.96 times it holds 95 %."""
    if not degrees:
        return scatter
    return scatter * float(t_isf(0.025, degrees) / normal_isf(0.025))


def largest_likelihood(
    likelihood: Callable[[Array], tuple[float, Array, Array]], start: Array, unit: Array
) -> tuple[Array, Array]:
    """Return the (q,) variances of the largest likelihood, none below 0, and their information.

    Parameters
    ----------
    likelihood
        From (q,) variances to the logarithm, its (q,) derivatives, and the (q, q) information.
    start, unit
        (q,) to begin with, and what counts as large.

    Raises
    ------
    NotConverged
    """
    variance = start
    value, score, information = likelihood(variance)
    for _ in range(STEPS):
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
        "the spread of the family does not settle", remedy="give more days or fewer effects"
    )


def scatter_of(
    y: Array, covariance: Array, shift: Array, stay: NDArray[np.bool_], *, common: bool
) -> Scatter:
    """Estimate the scatter from contrasts of the days.

    Parameters
    ----------
    y, covariance
        (f, m) contrasts, and the (f, m, m) covariance of the readings in each.
    shift
        (m, n) what relative changes of the n actuators add to a contrast.
    stay
        (n,) who is looked at; the others may have changed by anything.
    common
        Whether there is a scatter common to all, too.
    """
    size = float(np.mean(np.einsum("pii->pi", covariance)) / np.mean(np.sum(shift**2, axis=1)))
    own, together = shift @ shift.T, np.outer(shift.sum(axis=1), shift.sum(axis=1))
    freed = covariance + FREE * size * (shift[:, ~stay] @ shift[:, ~stay].T)
    suspects = _standing_out(y, freed + FREE * size * together if common else freed, shift, stay)
    freed = freed + FREE * size * (shift[:, suspects] @ shift[:, suspects].T)
    parts = [own, together] if common else [own]

    def likelihood(variance: Array) -> tuple[float, Array, Array]:
        return _likelihood(variance, y, freed, parts)

    unit = np.array([size, size][: len(parts)])
    variance, information = largest_likelihood(likelihood, unit, unit)
    return Scatter(
        own=float(np.sqrt(variance[0])),
        own_variance_error=float(np.sqrt(np.linalg.inv(information)[0, 0])),
        common=float(np.sqrt(variance[1])) if common else 0.0,
        degrees=len(y),
    )


def _standing_out(
    y: Array, covariance: Array, shift: Array, stay: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return (n,) who is farther off than a scatter that holds for the median lets expect."""
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


OFF = (  # whether each by itself, or all in common; what to say
    (True, "each actuator in its own way: see how it was taken, or leave it out"),
    (False, "all actuators alike: check its weights, temperature and date, or leave it out"),
)


def widened(
    days: tuple[DatedCalibration, ...],
    on: NDArray[np.bool_],
    settings: Array,
    stay: NDArray[np.bool_],
) -> tuple[tuple[DatedCalibration, ...], str]:
    """Return the days, of which the one that lies off may be off by as much, and say so.

    ``stay``, (n,), are the actuators that are looked at. Days among which none lies off come back
    as they are, with ''.
    """
    found = _outlying(days, on, settings, stay)
    if found is None:
        return days, ""
    j, size, own, words = found
    c = days[j].calibration
    covariance, n = c.covariance.copy(), c.layout.n
    covariance[:n, :n] += size**2 * (np.diag(c.alpha**2) if own else np.outer(c.alpha, c.alpha))
    wider = replace(days[j], calibration=replace(c, covariance=covariance))
    said = f"{days[j].name} lies off the law of the other days by {percent(size)}, {words}"
    return (*days[:j], wider, *days[j + 1 :]), said


def _outlying(
    days: Sequence[DatedCalibration],
    on: NDArray[np.bool_],
    settings: Array,
    stay: NDArray[np.bool_],
) -> tuple[int, float, bool, str] | None:
    """Return the day that lies farthest off, by how much, whether each by itself, and words."""
    if len(days) < settings.shape[1] + 3:
        return None
    relative = relative_days(days, on, settings)
    offs = [_off(relative, stay, j) for j in range(len(days))]
    for own, words in OFF:
        sizes = np.array([np.mean((y - m) ** 2) if own else m**2 for y, _, m, _, _ in offs])
        j = int(sizes.argmax())
        y, v, m, variance, share = offs[j]
        rest = relative.without(j).contrasts()
        scatter = scatter_of(*rest, np.eye(len(stay)), stay, common=True)
        chance = (
            _chance_of_all(y, v, scatter)
            if own
            else _chance_of_common(m, variance, len(y), scatter)
        )
        if chance_of_any(chance, len(OFF) * len(days)) < FALSE_ALARM:
            return j, float(np.sqrt(sizes[j]) / share), own, words
    return None


def _off(
    relative: RelativeDays, stay: NDArray[np.bool_], day: int
) -> tuple[Array, Array, float, float, float]:
    """Return how a day is off, its covariance, the mean and its variance, the share it has."""
    contrast, covariance, share = relative.contrast_of(day)
    y, v = contrast[stay], covariance[np.ix_(stay, stay)]
    return y, v, float(y.mean()), float(v.mean()), share


def _chance_of_all(y: Array, v: Array, scatter: Scatter) -> float:
    v = v + scatter.own**2 * np.eye(len(y))
    # What is common is not asked: it may be anything.
    one = np.linalg.solve(v, np.ones(len(y)))
    chi2 = float(y @ np.linalg.solve(v, y) - (one @ y) ** 2 / one.sum())
    degrees = scatter.degrees_of(float(np.mean(np.diag(v))))
    return float(f_sf(chi2 / (len(y) - 1), len(y) - 1, degrees))


def _chance_of_common(mean: float, variance: float, actuators: int, scatter: Scatter) -> float:
    variance += scatter.common**2 + scatter.own**2 / actuators
    return float(f_sf(mean**2 / variance, 1, scatter.degrees))
