"""Actuators as samples of one population: what is not smooth over the mirror, shrunk to it.

Magnets and coils scatter from one to the next, and that is a population; what rises to the rim or
from side to side is none, and stays as the data have it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from truenewton.arrays import Array
from truenewton.estimation.minimum import Prior

MANY = 100  # actuators, which are enough to leave smooth patterns of the fourth degree free
NARROW = 1e-3  # no coils and magnets are more alike


def smooth_patterns(a: Array) -> Array:
    """Return (n, p) orthonormal polynomials of the places in (3, n) arms.

    Quadratic; of the fourth degree on mirrors of `MANY` actuators.
    """
    degree = 4 if a.shape[1] >= MANY else 2
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

    found = scipy.optimize.minimize_scalar(cost, bounds=(np.log(NARROW), 0.0), method="bounded")
    return float(np.exp(found.x))
