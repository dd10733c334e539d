"""A line for each actuator through its days, and the scatter of the days about it.

With temperature T and time t relative to the middle of the days,

    alpha_i(T, t) = a_i (1 + k_i T + r_i t)

is linear in a, a k and a r. Days enter with the covariance of their readings over all actuators.
Each error of a weight is an unknown, measured as 0 +- 1, that all days with this weight share. It
multiplies the whole law, so k and r do not depend on it if all days share it.

Alpha scatters from day to day beyond the noise of the readings. On day j,

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
from truenewton.errors import FormatError, NotConverged
from truenewton.linalg import LeastSquares, factor_of, least_squares
from truenewton.rounding import percent
from truenewton.tracking.days import DatedCalibration, covariances, weight_groups


@dataclass(frozen=True, eq=False)
class RelativeDays:
    """The days relative to the mean alpha, with their errors."""

    names: NDArray[np.str_]  # (J,) of the files
    mean: Array  # (J, n) mean alpha, the same for all days
    values: Array  # (J, n) alpha over its mean
    readings: Array  # (J, n, n) covariance by the readings
    changes: Array  # (J, n, m) changes by m errors of the weights, at 1 sigma
    settings: Array  # (J, q) temperature and time

    def contrasts(self) -> tuple[Array, Array]:
        """Return (f, n) contrasts independent of any law (see above), and their covariance."""
        off = contrast_directions(self.settings)
        size = np.einsum("jaa->j", self.readings)
        return self._along(off @ np.linalg.eigh((off.T * size) @ off)[1])

    def contrast_of(self, day: int) -> tuple[Array, Array, float]:
        """Return (n,) deviations of a day from the law of the others, covariance, and its share."""
        off = contrast_directions(self.settings)
        share = float(np.linalg.norm(off[day]))
        contrasts, covariance = self._along(off @ off[day, :, None] / share)
        return contrasts[0], covariance[0], share

    def _along(self, directions: Array) -> tuple[Array, Array]:
        by_weights = np.einsum("jp,jam->pam", directions, self.changes)
        covariance = np.einsum("jp,jab->pab", directions**2, self.readings)
        return directions.T @ self.values, covariance + by_weights @ np.swapaxes(by_weights, 1, 2)


def relative_days(
    days: Sequence[DatedCalibration], on: NDArray[np.bool_], settings: Array
) -> RelativeDays:
    """Return the days relative to their mean alpha, of (n,) actuators ``on``.

    Errors of weights are a mean of the days that share them, relative to alpha, so that they do not
    contain the noise of single days. They multiply the fitted law for the same reason.
    """
    alpha = np.array([day.calibration.alpha[on] for day in days])
    mean = np.broadcast_to(alpha.mean(axis=0), alpha.shape)
    values = alpha / mean
    statistical, systematic = zip(*(covariances(day.calibration, on) for day in days), strict=True)
    readings = np.array([c / np.outer(m, m) for c, m in zip(statistical, mean, strict=True)])
    by_weights = np.array([c / np.outer(a, a) for c, a in zip(systematic, alpha, strict=True)])
    design = np.column_stack([np.ones(len(alpha)), settings])
    law = (design @ np.linalg.lstsq(design, values, rcond=None)[0])[:, :, None]
    changes = [np.zeros((*values.shape, 0))]
    for group in weight_groups(days):
        factor = factor_of(np.mean(by_weights[group], axis=0))
        changed = np.zeros((*values.shape, factor.shape[1]))
        changed[group] = law[group] * factor
        changes.append(changed)
    names = np.array([day.name for day in days])
    return RelativeDays(names, mean, values, readings, np.concatenate(changes, axis=2), settings)


def contrast_directions(settings: Array) -> Array:
    """Return (J, f) orthonormal combinations of the days that are independent of any law."""
    design = np.column_stack([np.ones(len(settings)), settings])
    return np.asarray(scipy.linalg.null_space(design.T))


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The lines of all actuators, without a population."""

    alpha: Array  # (n,) a, in the middle of the days
    effects: Array  # (q, n) k and r
    # ((1 + q) n, u) of the covariance of a and effects: readings first, then each weight error
    root: Array
    chi2: float  # of all days about their lines
    own_scatter: Array  # (n,) rms relative deviation of each actuator from its line
    actuator_chi2: Array  # (n,) of each actuator given all others
    actuator_degrees: int  # of freedom of each actuator: days less parameters


def linear_fit(days: RelativeDays, scatter: Array, common: float = 0.0) -> LinearFit:
    """Fit the lines of all actuators at once.

    ``scatter`` is the (n,) relative standard deviation of each actuator about its line beyond the
    readings, ``common`` that of all together. Raises `RankDeficient` if the settings do not
    separate the effects.
    """
    y, change, mean = days.values, days.changes, days.mean[0]
    (count, n), q, errors = y.shape, days.settings.shape[1], change.shape[2]
    design = np.column_stack([np.ones(count), days.settings])
    readings = days.readings + np.diag(scatter**2) + common**2
    roots = np.array([*map(_inverse_root, days.names, readings)])
    whitened = np.einsum("jab,jk->jakb", roots, design).reshape(count * n, (1 + q) * n)
    nothing = np.zeros((errors, (1 + q) * n))
    whitened_change = (roots @ change).reshape(count * n, errors)
    matrix = np.block([[whitened, whitened_change], [nothing, np.eye(errors)]])
    right = np.concatenate([np.einsum("jab,jb->ja", roots, y).ravel(), np.zeros(errors)])
    solution = least_squares(matrix, right)
    values = solution.values[: (1 + q) * n].reshape(1 + q, n)
    a, effects = values[0], values[1:] / values[0]
    root = solution.root[: (1 + q) * n].reshape(1 + q, n, -1).copy()
    root[1:] = (root[1:] - effects[:, :, None] * root[0]) / a[:, None]
    root[0] *= mean[:, None]
    off = contrast_directions(days.settings)
    degrees = off.shape[1]
    return LinearFit(
        alpha=a * mean,
        effects=effects,
        root=root.reshape((1 + q) * n, -1),
        chi2=solution.chi2,
        own_scatter=np.sqrt(np.sum((off.T @ y) ** 2, axis=0) / max(degrees, 1)),
        actuator_chi2=_share(solution, roots, off) if degrees else np.zeros(n),
        actuator_degrees=degrees,
    )


def _inverse_root(name: str, covariance: Array) -> Array:
    """Return W with W' W the inverse of a covariance."""
    try:
        lower = scipy.linalg.cholesky(covariance, lower=True)
    except np.linalg.LinAlgError:
        fault = "COVARIANCE less SYSTEMATIC is no covariance"
        raise FormatError(fault, remedy="calibrate again", path=str(name)) from None
    return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True))


def _share(solution: LeastSquares, roots: Array, off: Array) -> Array:
    """Return (n,) chi2 of the days of each actuator given all others.

    Columns Z that shift each day of the actuator freely would lower chi2 by s' (Z' M Z)^+ s, with
    s = Z' residual and M the projection off the columns of the fit. ``off`` restricts the shifts to
    those that the law of the actuator does not explain.
    """
    count, n = roots.shape[:2]
    residual = solution.residual[: count * n].reshape(count, n)
    basis = solution.orthogonal[: count * n].reshape(count, n, -1)
    s = np.einsum("jab,ja->bj", roots, residual)
    shared = np.swapaxes(basis, 1, 2) @ roots
    m = -np.einsum("jpb,kpb->bjk", shared, shared)
    day = np.arange(count)
    m[:, day, day] += np.einsum("jab,jab->bj", roots, roots)
    inner = np.einsum("jp,bjk,kq->bpq", off, m, off)
    reduced = s @ off
    solved = np.linalg.solve(inner, reduced[..., None])[..., 0]
    return np.asarray(np.sum(reduced * solved, axis=1))


MAX_ITERATIONS = 200
UNCONSTRAINED = 1e8  # prior variance of a free shift, in variances of a typical contrast


@dataclass(frozen=True)
class Scatter:
    """Relative scatter from day to day."""

    own: float = 0.0  # s, of each actuator independently
    own_variance_error: float = 0.0  # standard uncertainty of s^2
    common: float = 0.0  # s_c, common to all
    degrees: int = 0  # of freedom of s_c; 0 if scatter cannot be estimated

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
    large variances. Raises `NotConverged`.
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
    """Estimate the scatter from (f, m) contrasts of the days and their (f, m, m) covariance.

    ``shift`` are the (m, n) changes of a contrast by relative changes of the n actuators. Of these
    the (n,) ``stay`` are used; the others may have changed by any amount.
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
        share = float(np.median(shares(log_variance)[stay]))
        return float(np.log(max(share / middle, 1e-300)))  # 0 if the days are equal

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
    days: tuple[DatedCalibration, ...], relative: RelativeDays, stay: NDArray[np.bool_]
) -> tuple[tuple[DatedCalibration, ...], str]:
    """Return the days, with larger errors of one that is an outlier, and a sentence about it.

    ``stay``: (n,) actuators that are used. If no day is an outlier, the sentence is ''.
    """
    if len(days) < relative.settings.shape[1] + 3:
        return days, ""
    contrasts = [
        (y[stay], v[np.ix_(stay, stay)], share)
        for y, v, share in map(relative.contrast_of, range(len(days)))
    ]
    for own, words in OFF:
        sizes = [float(np.var(y) if own else y.mean() ** 2) for y, _, _ in contrasts]
        j = int(np.argmax(sizes))
        y, v, share = contrasts[j]
        others = RelativeDays(*(np.delete(each, j, axis=0) for each in vars(relative).values()))
        scatter = estimate_scatter(*others.contrasts(), np.eye(len(stay)), stay, common=True)
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
