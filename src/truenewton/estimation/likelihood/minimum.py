"""What goes into the likelihood and what comes out, and alpha as samples of one population.

Magnets and coils scatter from one to the next, and that is a population; what rises to the rim or
from side to side is none, and stays as the data have it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from truenewton.arrays import Array
from truenewton.estimation.readings.moments import ShapeSums


@dataclass(frozen=True, eq=False)
class DataSet:
    """Shapes under L loads that share one noise.

    Attributes
    ----------
    sums
        The shapes.
    variance
        (n,) of one reading of weight 1, the diagonal of Sigma, as the balance feels it.
    load
        (L, 3) the part of k known beforehand: (W, 0, 0).
    nuisance
        (L, 3, p) derivative of k with respect to the unknowns beside alpha.
    excess
        All of the variance of a reading in terms of ``variance``: more than 1 where the mirror's
        own motion, which balances, makes part of the noise.
    disturbance
        (3, 3) covariance of what disturbs the balance of one row of weight 1 besides, as an unknown
        force at an actuator does; or 0.
    """

    sums: ShapeSums
    variance: Array
    load: Array
    nuisance: Array
    excess: float = 1.0
    disturbance: Array | float = 0.0

    def external(self, psi: Array) -> Array:
        """Return (L, 3) k of every load."""
        return np.asarray(self.load + self.nuisance @ psi)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the unknowns besides the data, all of it normal.

    Attributes
    ----------
    mean
        (u,) of all unknowns.
    information
        (k, k) on the first k of them; may be singular, and is 0 by 0 where nothing is known.
    measured
        How many of the last unknowns are errors of the weights: measured as 0 +- 1.
    held
        Whether they stay 0: under two loads B and the common scale take up whatever they are, and
        the data say nothing of them.
    """

    mean: Array
    information: Array
    measured: int = 0
    held: bool = False

    def added_to(self, matrix: Array) -> Array:
        """Add all of it to a (k, k) matrix of the first k unknowns, in place; return the matrix."""
        k, last = len(self.information), np.arange(len(self.mean) - self.measured, len(matrix))
        matrix[:k, :k] += self.information
        matrix[last, last] += 1.0
        return matrix

    def pull(self, values: Array) -> Array:
        """Return (u,) the information times how far the values are from the mean."""
        k, t, apart = len(self.information), len(self.mean) - self.measured, values - self.mean
        return np.concatenate([self.information @ apart[:k], np.zeros(t - k), apart[t:]])

    def with_more(self, information: Array) -> Prior:
        """Return the prior with (n, n) more information on alpha."""
        before = self.information if self.information.size else 0.0
        return replace(self, information=before + information)


@dataclass(frozen=True, eq=False)
class NoiseInformation:
    """D, what noise alone would feign of the information on alpha: diag(d) - R' R.

    A' S^-1 A and what S takes from V have rank 3 each, so their product by elements has 9.

    Attributes
    ----------
    diagonal, root
        (n,) d and (9, n) R, nine more rows for each further noise.
    """

    diagonal: Array
    root: Array

    def __matmul__(self, vectors: Array) -> Array:
        """Return D v of (n, m) vectors."""
        return np.asarray(self.diagonal[:, None] * vectors - self.root.T @ (self.root @ vectors))

    def taken_from(self, matrix: Array, times: float) -> Array:
        """Return what D, so many times, leaves of a (u, u) symmetric matrix, its upper triangle.

        In the order of Fortran, so in the lower triangle.
        """
        n, left = len(self.diagonal), np.array(matrix.T, order="F")
        at = np.arange(n)
        left[at, at] -= times * self.diagonal
        left[:n, :n] += times * (self.root.T @ self.root)
        return left


@dataclass(frozen=True, eq=False)
class Minimum:
    """The minimum and what it is worth; t unknowns without the errors of the weights.

    Attributes
    ----------
    values
        (u,) alpha, then the unknowns beside it.
    chi2
        Sum of r rho' S^-1 rho over the data, prior left out.
    information
        (u, u) H, that of the prior added: its upper triangle.
    noise_information, noise_share
        D, by how much M is larger; the sum of its eigenvalues in terms of H, B and the torques
        eliminated.
    reading_covariance
        (t, t) covariance from the readings (and from a population).
    changes
        (t, measured) change of the values by one standard uncertainty of each error of the weights.
    iterations
        Steps taken.
    """

    values: Array
    chi2: float
    information: Array
    noise_information: NoiseInformation
    noise_share: float
    reading_covariance: Array
    changes: Array
    iterations: int


# Actuators, which are enough to leave smooth patterns of the fourth degree free.
MIN_SMOOTH_ACTUATORS = 100
MIN_POPULATION_SPREAD = 1e-3  # no coils and magnets are more alike


def smooth_patterns(a: Array) -> Array:
    """Return (n, p) orthonormal polynomials of the places in (3, n) arms.

    Quadratic; of the fourth degree on mirrors of `MIN_SMOOTH_ACTUATORS` actuators.
    """
    degree = 4 if a.shape[1] >= MIN_SMOOTH_ACTUATORS else 2
    x, y = a[1:] / np.sqrt(np.mean(a[1:] ** 2, axis=1, keepdims=True))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.asarray(np.linalg.qr(np.stack([x**i * y**j for i, j in powers], 1))[0])


def on_logarithms(smooth: Array, spread: float) -> Array:
    """Return the (n, n) information on log alpha: (n, p) smooth patterns are free of it."""
    return np.asarray((np.eye(len(smooth)) - smooth @ smooth.T) / spread**2)


def pull(information: Array, alpha: Array) -> tuple[Array, Array]:
    """Return gradient, (n,), and (n, n) information on alpha of one on its logarithm."""
    per = 1.0 / positive(alpha)
    return -per * (information @ np.log(per)), information * np.outer(per, per)


def positive(alpha: Array) -> Array:
    """Return (n,) alpha of which a logarithm can be had: of an actuator without force as well."""
    return np.asarray(np.maximum(alpha, 0.1 * np.median(alpha)))


def with_population(prior: Prior, smooth: Array, alpha: Array, spread: float) -> Prior:
    """Return the prior with what a population says of log alpha, to first order at (n,) alpha.

    Of the logarithm, as balance holds what neighbours are in terms of each other far better than
    what a region is: were the deviations themselves pulled to 0, every region would be pulled with
    them, the common scale too.
    """
    n, at = len(alpha), positive(alpha)
    information = pull(on_logarithms(smooth, spread), alpha)[1]
    # The gradient is that of a normal prior about alpha (1 - log alpha), any multiple of alpha
    # added: so that the mean is that of before.
    about, mean = -at * np.log(at), prior.mean.copy()
    mean[:n] = about + at * ((mean[:n].mean() - about.mean()) / at.mean())
    return replace(prior, mean=mean).with_more(information)


def likeliest_spread(
    smooth: Array, alpha: Array, covariance: Array, spread: float = np.inf
) -> float:
    """Return the likeliest spread of log alpha about what is smooth.

    What data alone say of a pattern that is not smooth, all else eliminated, is y with variance v;
    minus twice the log of its marginal likelihood is log (spread^2 + v) + y^2 / (spread^2 + v)
    (restricted maximum likelihood; Patterson and Thompson, Biometrika 58, 1971).

    Parameters
    ----------
    smooth, alpha, covariance
        (n, p); (n,) and its (n, n) covariance.
    spread
        Of the population with which they were found; infinite for none.
    """
    now = spread**-2
    basis = np.linalg.qr(smooth, mode="complete")[0][:, smooth.shape[1] :]
    alpha = positive(alpha)
    relative = covariance / np.outer(alpha, alpha)
    values, vectors = np.linalg.eigh(basis.T @ relative @ basis)
    alone = np.maximum(1.0 - values * now, 1e-9)  # 0 where the data hold nothing
    y, variance = vectors.T @ (basis.T @ np.log(alpha)) / alone, np.maximum(values, 0.0) / alone

    def cost(log_spread: float) -> float:
        total = np.exp(2.0 * log_spread) + variance
        return float(np.sum(np.log(total) + y**2 / total))

    found = scipy.optimize.minimize_scalar(
        cost, bounds=(np.log(MIN_POPULATION_SPREAD), 0.0), method="bounded"
    )
    return float(np.exp(found.x))
