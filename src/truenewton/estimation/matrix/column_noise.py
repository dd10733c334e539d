"""What the noise of a stiffness matrix follows, chosen by what its columns leave out of balance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from truenewton.arrays import Array

MIN_LOG_LIKELIHOOD_GAIN = 3.0  # in log likelihood: what a further parameter must bring
MIN_COLUMN_DEVIATION = 1e-13  # of a typical element, its standard deviation at least


@dataclass(frozen=True)
class ColumnNoise:
    """The noise of the elements of a stiffness matrix, all independent.

    Attributes
    ----------
    variance
        Of an element, in the mean over all [(N/m)^2].
    proportional
        Share of it that goes with the square of the element; the rest is the same for all.
    freedom
        Of Student's t from sensor to sensor; infinite where all have one noise.
    """

    variance: float
    proportional: float
    freedom: float = np.inf

    def of_elements(self, k: Array) -> Array:
        """Return (n, m) variances of (n, m) elements [(N/m)^2], of a typical sensor."""
        square = k**2
        mean = float(square.mean())
        law = (1.0 - self.proportional) + (self.proportional / mean) * square
        return np.asarray(
            max(self.variance, MIN_COLUMN_DEVIATION**2 * mean) * law
            + (MIN_COLUMN_DEVIATION**2 * mean)
        )

    @property
    def lost(self) -> float:
        """Variance of a fit weighted by t in terms of what its weights alone let expect."""
        return 1.0 if np.isinf(self.freedom) else (self.freedom + 4.0) / (self.freedom + 2.0)

    def cost(self, distance: Array) -> float:
        """Return minus log likelihood of (m,) squared distances of 3-vectors, parameters paid."""
        parameters = (0.0 < self.proportional < 1.0) + np.isfinite(self.freedom)
        return MIN_LOG_LIKELIHOOD_GAIN * float(parameters) + _cost(distance, self.freedom, 3.0)

    def __str__(self) -> str:
        if self.proportional < 0.02:
            law = "equal in all elements"
        elif self.proportional > 0.98:
            law = "in proportion to each element"
        else:
            law = "partly in proportion to each element"
        return law if np.isinf(self.freedom) else f"{law}, more at some sensors"


def likeliest_noise(
    residual: Array, left: Array, laws: tuple[Array, Array]
) -> tuple[ColumnNoise, Array]:
    """Return the likeliest noise and the weight of each column.

    Of the laws 'equal', 'proportional' and 'both', with one noise for all sensors or by sensor, the
    likeliest; a further parameter counts if it raises the log likelihood by more than
    `MIN_LOG_LIKELIHOOD_GAIN`.

    Parameters
    ----------
    residual
        (m, 3) combinations of the imbalance of each column, what the fit took away put back.
    left
        (m, 3) part of each that the fit had left, descending: its degrees of freedom, as what was
        put back is said by other columns. Each counts as conditional on those before it.
    laws
        (m, 3, 3) covariance of a residual if the noise were equal in all elements, and if in
        proportion, for variance 1.
    """
    freedoms = left.sum(axis=1)

    def at(share: float) -> tuple[float, Array]:
        s = (1.0 - share) * laws[0] + share * laws[1]
        # A column with one element alone is noisy in one direction, by proportion.
        s = s + MIN_COLUMN_DEVIATION * np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        factor = np.linalg.cholesky(s)
        solved = np.linalg.solve(factor, residual[:, :, None])[:, :, 0]
        size = np.log(np.diagonal(factor, axis1=1, axis2=2))
        return float(np.sum(left * size)), np.sum(left * solved**2, axis=1)

    def normal(share: float) -> tuple[float, ColumnNoise]:
        determinant, distance = at(share)
        variance = max(float(distance.sum() / freedoms.sum()), 1e-300)
        cost = determinant + 0.5 * float(freedoms.sum() * (np.log(variance) + 1.0))
        return cost, ColumnNoise(variance, share)

    def student(share: float) -> tuple[float, ColumnNoise]:
        determinant, distance = at(share)
        value, freedom, variance = _student(distance, freedoms)
        return determinant + value + MIN_LOG_LIKELIHOOD_GAIN, ColumnNoise(variance, share, freedom)

    found = []
    for law in (normal, student):
        found += [law(0.0), law(1.0)]
        value, noise = law(_likeliest_share(law))
        found.append((value + MIN_LOG_LIKELIHOOD_GAIN, noise))
    noise = min(found, key=lambda each: each[0])[1]
    if np.isinf(noise.freedom):
        return noise, np.ones(len(residual))
    distance = at(noise.proportional)[1] / noise.variance
    return noise, (noise.freedom + freedoms) / (noise.freedom + distance)


def _likeliest_share(law: Callable[[float], tuple[float, ColumnNoise]]) -> float:
    """Return the share of proportional noise of least cost, between the ends."""
    found = scipy.optimize.minimize_scalar(
        lambda logit: law(float(scipy.special.expit(logit)))[0],
        bounds=(-7.0, 7.0),
        method="bounded",
        options={"xatol": 0.05},
    )
    return float(scipy.special.expit(found.x))


def _cost(distance: Array, freedom: float, dimensions: Array | float) -> float:
    """Return minus log likelihood of squared distances of t, but for what is the same for all."""
    if np.isinf(freedom):
        return 0.5 * float(distance.sum())
    half, gamma = 0.5 * (freedom + dimensions), scipy.special.gammaln
    size = half - 0.5 * freedom
    each = size * np.log(0.5 * freedom) - (gamma(half) - gamma(0.5 * freedom))
    return float(np.sum(each + half * np.log1p(distance / freedom)))


def _cost_by_freedom(distance: Array, freedom: float, dimensions: Array) -> tuple[float, float]:
    """Return d cost / d freedom and d cost / d log(distance) of all distances, of `_cost`."""
    half, psi = 0.5 * (freedom + dimensions), scipy.special.psi
    pulled = half * distance / (freedom + distance)
    each = 0.5 * dimensions / freedom - 0.5 * (psi(half) - psi(0.5 * freedom))
    each += 0.5 * np.log1p(distance / freedom) - pulled / freedom
    return float(each.sum()), float(pulled.sum())


def _student(distance: Array, dimensions: Array) -> tuple[float, float, float]:
    """Return minus log likelihood, freedom and variance of (m,) squared distances."""
    scale, total = max(float(np.median(distance)), 1e-300), 0.5 * float(dimensions.sum())

    def cost(x: Array) -> tuple[float, Array]:
        freedom, variance = float(np.exp(x[0])), scale * float(np.exp(x[1]))
        scaled = distance / variance
        value = total * float(np.log(variance)) + _cost(scaled, freedom, dimensions)
        by_freedom, by_distance = _cost_by_freedom(scaled, freedom, dimensions)
        return value, np.array([freedom * by_freedom, total - by_distance])

    found = scipy.optimize.minimize(
        cost,
        [np.log(8.0), -1.0],
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, np.log(200.0)), (-20.0, 20.0)],
    )
    return float(found.fun), float(np.exp(found.x[0])), scale * float(np.exp(found.x[1]))
