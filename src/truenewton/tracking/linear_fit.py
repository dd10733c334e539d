"""A line for each actuator through its days, and how well the days agree with it.

With temperature T and time t relative to the middle of the days,

    alpha_i(T, t) = a_i (1 + k_i T + r_i t)

is linear in a, a k and a r. Days enter with the covariance of their readings over all actuators.
Each error of a weight is an unknown, measured as 0 +- 1, that all days with this weight share. It
multiplies the whole law, so k and r do not depend on it if all days share it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.linalg import LeastSquares, least_squares
from truenewton.tracking.days import (
    DatedCalibration,
    covariances,
    weight_error_factor,
    weight_groups,
)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The lines of all actuators, without a population.

    Attributes
    ----------
    alpha, effects
        (n,) a in the middle of the days, and (q, n) k and r.
    root
        ((1 + q) n, u) root of the covariance of a and effects: first (1 + q) n columns from the
        readings, then one for each error of the weights.
    chi2
        Of all days about their lines.
    own_scatter
        (n,) rms relative deviation of each actuator from its line.
    actuator_chi2, actuator_degrees
        (n,) chi2 of each actuator given all others; its degrees of freedom, days less parameters.
    """

    alpha: Array
    effects: Array
    root: Array
    chi2: float
    own_scatter: Array
    actuator_chi2: Array
    actuator_degrees: int


def linear_fit(
    days: Sequence[DatedCalibration],
    on: NDArray[np.bool_],
    settings: Array,
    scatter: Array,
    common: float = 0.0,
) -> LinearFit:
    """Fit the lines of all actuators at once.

    ``on`` are the n enabled actuators, ``settings`` (J, q) temperature and time of the days
    relative to their middle, ``scatter`` the (n,) relative standard deviation of each actuator
    about its line beyond the readings, ``common`` that of all together.

    Raises
    ------
    RankDeficient
        The settings do not separate the effects.
    """
    alpha = np.array([day.calibration.alpha[on] for day in days])
    count, n = alpha.shape
    design = np.column_stack([np.ones(count), settings])
    q = settings.shape[1]
    # Relative to the mean, all actuators weigh alike in one matrix.
    mean = alpha.mean(axis=0)
    y = alpha / mean
    of_days = np.diag(scatter**2) + common**2
    readings = (covariance + of_days for covariance in _relative(days, on, mean))
    roots = np.array([*map(_inverse_root, days, readings)])
    whitened = np.einsum("jab,jk->jakb", roots, design).reshape(count * n, (1 + q) * n)
    change = _changes_by_weights(days, on, design, y)
    errors = change.shape[2]
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
    off = contrast_directions(settings)
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


def contrast_directions(settings: Array) -> Array:
    """Return (J, f) orthonormal combinations of the days that are independent of any law."""
    design = np.column_stack([np.ones(len(settings)), settings])
    return np.asarray(scipy.linalg.null_space(design.T))


@dataclass(frozen=True, eq=False)
class RelativeDays:
    """The days relative to the mean alpha, with their errors.

    Attributes
    ----------
    values
        (J, n) alpha over its mean.
    readings
        (J, n, n) covariance by the readings.
    changes
        (J, n, m) changes by m errors of the weights, at 1 sigma.
    settings
        (J, q) temperature and time.
    """

    values: Array
    readings: Array
    changes: Array
    settings: Array

    def without(self, day: int) -> RelativeDays:
        """Return all but one of the days."""
        others = np.arange(len(self.values)) != day
        return RelativeDays(*(each[others] for each in vars(self).values()))

    def contrasts(self) -> tuple[Array, Array]:
        """Return (f, n) contrasts independent of any law (see `scatter`), and their covariance."""
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
    """Return the days relative to their mean alpha, of the actuators ``on``."""
    alpha = np.array([day.calibration.alpha[on] for day in days])
    mean = alpha.mean(axis=0)
    design = np.column_stack([np.ones(len(alpha)), settings])
    readings = np.array([*_relative(days, on, mean)])
    changes = _changes_by_weights(days, on, design, alpha / mean)
    return RelativeDays(alpha / mean, readings, changes, settings)


def _relative(
    days: Sequence[DatedCalibration], on: NDArray[np.bool_], alpha: Array
) -> Iterator[Array]:
    """Yield the (n, n) statistical covariance of each day, relative to (n,) alpha."""
    return (covariances(day.calibration, on)[0] / np.outer(alpha, alpha) for day in days)


def _changes_by_weights(
    days: Sequence[DatedCalibration], on: NDArray[np.bool_], design: Array, y: Array
) -> Array:
    """Return (J, n, m) changes of the (J, n) days by m errors of the weights, at 1 sigma.

    They multiply the fitted law, not the readings, which would add noise.
    """
    law = (design @ np.linalg.lstsq(design, y, rcond=None)[0])[:, :, None]
    changes = [np.zeros((*y.shape, 0))]
    for group in weight_groups(days):
        factor = weight_error_factor([days[k] for k in group], on)
        changed = np.zeros((*y.shape, factor.shape[1]))
        changed[group] = law[group] * factor
        changes.append(changed)
    return np.concatenate(changes, axis=2)


def _inverse_root(day: DatedCalibration, covariance: Array) -> Array:
    """Return W with W' W the inverse of a covariance."""
    try:
        lower = scipy.linalg.cholesky(covariance, lower=True)
    except np.linalg.LinAlgError:
        fault = "COVARIANCE less SYSTEMATIC is no covariance"
        raise FormatError(fault, remedy="calibrate again", path=day.name) from None
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
