"""What the noise of a stiffness matrix follows, chosen by what its columns leave out of balance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.special

from truenewton.arrays import Array

ALIKE = 200.0  # degrees of freedom of t from which all sensors have one noise
WORTH = 3.0  # in log likelihood: what a further parameter must bring
ROUNDING = 1e-13  # of a typical element, its standard deviation at least


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
        return np.asarray(max(self.variance, ROUNDING**2 * mean) * law + (ROUNDING**2 * mean))

    @property
    def lost(self) -> float:
        """Variance of a fit weighted by t in terms of what its weights alone let expect."""
        return 1.0 if np.isinf(self.freedom) else (self.freedom + 5.0) / (self.freedom + 3.0)

    def __str__(self) -> str:
        if self.proportional < 0.02:
            law = "equal in all elements"
        elif self.proportional > 0.98:
            law = "in proportion to each element"
        else:
            law = "partly in proportion to each element"
        return law if np.isinf(self.freedom) else f"{law}, more at some sensors"


def likeliest_noise(
    residual: Array, square: Array, laws: tuple[Array, Array]
) -> tuple[ColumnNoise, Array]:
    """Return the likeliest noise and the weight of each column.

    Of the laws 'equal', 'proportional' and 'both', with one noise for all sensors or by sensor, the
    likeliest; a further parameter counts if it raises the log likelihood by more than `WORTH`.

    Parameters
    ----------
    residual
        (m, 3) imbalance, what the fit took away put back.
    square
        (m, 3, 3) expected square of the imbalance at the true alpha: that at the fitted one, and
        the covariance of what the fit took away. A column that balances by chance is not taken for
        a good one, as it would be if its residual were merely put in terms of its leverage.
    laws
        (m, 3, 3) covariance of a residual if the noise were equal in all elements, and if in
        proportion, for variance 1.
    """
    m = len(residual)

    def at(share: float) -> tuple[float, Array]:
        s = (1.0 - share) * laws[0] + share * laws[1]
        # A column with one element alone is noisy in one direction, by proportion.
        s = s + ROUNDING * np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        solved = np.linalg.solve(s, residual[:, :, None])[:, :, 0]
        return 0.5 * float(np.linalg.slogdet(s)[1].sum()), np.einsum("mk,mk->m", residual, solved)

    def normal(share: float) -> float:
        determinant, distance = at(share)
        typical = max(float(distance.mean()) / 3.0, 1e-300)
        return determinant + 1.5 * m * (float(np.log(typical)) + 1.0)

    def student(share: float) -> tuple[float, float, float]:
        determinant, distance = at(share)
        value, freedom, variance = _student(distance)
        return determinant + value, freedom, variance

    best = (np.inf, ColumnNoise(1.0, 0.0))
    for by_sensor in (False, True):
        cost = (lambda share: student(share)[0]) if by_sensor else normal
        for share, worth in ((0.0, 0.0), (1.0, 0.0), (_likeliest_share(cost), WORTH)):
            total = cost(share) + worth + by_sensor * WORTH
            if total < best[0]:
                if by_sensor:
                    _, freedom, variance = student(share)
                else:
                    freedom, variance = np.inf, float(at(share)[1].mean() / 3.0)
                best = (total, ColumnNoise(variance, share, freedom))
    noise = best[1]
    if np.isinf(noise.freedom):
        return noise, np.ones(m)
    share = noise.proportional
    s = (1.0 - share) * laws[0] + share * laws[1]
    distance = np.einsum("mkl,mlk->m", np.linalg.inv(s), square)
    _, freedom, variance = _student(distance)
    noise = ColumnNoise(variance, share, freedom)
    return noise, (freedom + 3.0) / (freedom + distance / max(variance, 1e-300))


def _likeliest_share(cost: Callable[[float], float]) -> float:
    """Return the share of proportional noise of least cost, between the ends."""
    found = scipy.optimize.minimize_scalar(
        lambda logit: cost(float(scipy.special.expit(logit))),
        bounds=(-7.0, 7.0),
        method="bounded",
        options={"xatol": 0.05},
    )
    return float(scipy.special.expit(found.x))


def _student(distance: Array) -> tuple[float, float, float]:
    """Return minus log likelihood, freedom and variance of (m,) squared distances of 3-vectors."""
    m, scale = len(distance), max(float(np.median(distance)), 1e-300)

    def cost(x: Array) -> float:
        freedom, variance = np.exp(x[0]), scale * np.exp(x[1])
        gamma = scipy.special.gammaln
        return float(
            1.5 * m * np.log(variance * freedom / 2.0)
            - m * (gamma(0.5 * freedom + 1.5) - gamma(0.5 * freedom))
            + (0.5 * freedom + 1.5) * np.log1p(distance / (freedom * variance)).sum()
        )

    found = scipy.optimize.minimize(
        cost,
        [np.log(8.0), -1.0],
        method="L-BFGS-B",
        bounds=[(0.0, np.log(ALIKE)), (-20.0, 20.0)],
    )
    return float(found.fun), float(np.exp(found.x[0])), scale * float(np.exp(found.x[1]))
