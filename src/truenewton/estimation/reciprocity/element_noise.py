"""Noise of the elements of a stiffness, from what reciprocity leaves of each pair.

Where elements were measured one by one, the noise of each is equal in all, in proportion to it, or
some of both, and more at some sensors than at others,

    V_ij = c_j (a^2 + p^2 k_ij^2)

Forces true at the magnets, K = D_alpha K_c (H D_g)^-1, differ from their transpose by noise whose
variance is linear in the V of a row, and by what errors of the sensors' offsets do to them. a^2,
p^2, c and the size of the latter are the likeliest for all pairs, as if these were independent; one
factor of each actuator, alpha times gain, is left free. Where modes were driven, or the stiffness
regressed, noise is one of modes (`binned_noise`) instead: of white noise both are likely alike, of
any other that one in whose terms it has no correlations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.sight import Places, Sight, sight
from truenewton.estimation.reciprocity.unknowns import OFFSETS

STEPS = 40
SETTLED = 2e-3  # relative change of what matters to the variance
LEAST = 1e-24  # variance in terms of the mean square of an element
ALIKE = 4.0  # residuals' worth of belief that a sensor is as noisy as the others
MOST_TAKEN = 0.9  # of a pair, by factors: beyond, too little is left to tell noise
LITTLE = 1e-4  # share of the variance that does not matter


def element_variance(stiffness: Array, fit: Fit, places: Places) -> tuple[Array, float]:
    """Return (n, n) variances of the elements of a measured stiffness [(N/m)^2], and their cost.

    Of sensors where the fit has them and of sensors at their magnets, whichever is likelier. The
    cost is twice minus the mean log likelihood of a pair, to compare with that of modes.

    Parameters
    ----------
    stiffness
        (n, n) K_c, force per reading.
    fit
        Of alpha and the sensors.
    places
        Of the actuators.
    """
    at_magnets = replace(fit.values, offset=np.zeros_like(fit.values.offset))
    found = [_likeliest(stiffness, fit, sight(places, at_magnets, slopes=False))]
    if fit.asked.offset_spread:
        found.append(_likeliest(stiffness, fit, sight(places, fit.values, slopes=True)))
    return min(found, key=lambda each: each[1])


def _likeliest(stiffness: Array, fit: Fit, seen: Sight) -> tuple[Array, float]:
    """Return variances and their cost where the sensors see so.

    Steps are those of a minorant of the likelihood, in which no variance becomes negative (Zhou et
    al., J. Comput. Graph. Stat. 28, 350, 2019).
    """
    n, alpha = len(stiffness), fit.values.alpha
    back = np.linalg.inv(seen.motion * fit.values.gain)
    true = alpha[:, None] * stiffness @ back
    apart, whole = true - true.T, 0.5 * (true + true.T)
    left = 1.0 - max(0.0, fit.parameters[2] - n) / fit.equations[2]  # by what else is fitted
    mixed, own, mean = back**2, alpha[:, None] ** 2, float(np.mean(stiffness**2))
    laws = np.stack([np.broadcast_to(own, stiffness.shape), own * stiffness**2 / mean])
    moved = _by_offsets(true @ seen.motion, fit, seen)
    size, sensor = np.full(2, 0.25 * float(np.mean(apart**2))) / np.mean(own), np.ones(n)
    offsets, size, pairs = 1.0, np.maximum(size, LEAST * mean), ~np.eye(n, dtype=bool)
    for _ in range(STEPS):
        each = np.tensordot(size, laws, 1)
        total = (each * sensor) @ mixed + offsets * moved
        total = total + total.T
        np.fill_diagonal(total, np.inf)  # nothing is its own transpose
        square = _without_factors(apart, whole, 1.0 / total) / left
        wanted, had = square / total**2, 1.0 / total
        offsets *= float(np.sqrt(np.sum(moved * wanted) / max(np.sum(moved * had), 1e-300)))
        wanted, had = wanted @ mixed.T, had @ mixed.T
        counted = sensor * np.sum(each * had, axis=0) + ALIKE
        found = np.sqrt((sensor**2 * np.sum(each * wanted, axis=0) + ALIKE) * sensor / counted)
        told, expected = (np.sum(laws * (sensor * part), axis=(1, 2)) for part in (wanted, had))
        change = np.sqrt(told / expected)
        moved_by, sensor = np.abs(np.log(found / sensor)).max(), found
        size = np.maximum(size * change, LEAST * mean)
        matters = size > LITTLE * size.max()
        if np.abs(change[matters] - 1.0).max() < SETTLED and moved_by < 0.05:
            break
    cost = float(np.mean(np.log(total[pairs]) + (square / total)[pairs]))
    return np.asarray(np.tensordot(size, laws, 1) / own * sensor), cost


def cost_of_modes(fit: Fit) -> float:
    """Return what a pair costs if noise is one of modes, each of unit length."""
    states, weights = fit.point.states, fit.point.weights
    pairs = ~np.eye(states.count, dtype=bool)
    length = np.log(np.sum(states.displacements**2, axis=0))
    unit = np.log(weights.of_pairs) + length[:, None] + length
    return 1.0 - float(np.mean(unit[pairs]))


def _by_offsets(forces: Array, fit: Fit, seen: Sight) -> Array:
    """Return (n, n) variance of forces per displacement by errors of the offsets."""
    total = np.zeros_like(forces)
    if seen.slopes is None:
        return total
    for kind, slopes in zip(OFFSETS, seen.slopes, strict=True):
        errors = np.diag(fit.covariance_of(kind))
        total += (forces**2 * errors) @ (slopes @ np.linalg.inv(seen.motion)) ** 2
    return total


def _without_factors(apart: Array, whole: Array, weight: Array) -> Array:
    """Return (n, n) squared differences of pairs without what one factor of each explains.

    Each over 1 less its leverage: a few strong pairs make most of a factor.
    """
    links = weight * whole**2
    laplacian = np.diag(links.sum(axis=1)) - links
    laplacian += np.trace(laplacian) / len(links) ** 2  # the factor of all is free
    inverse = np.linalg.inv(laplacian)
    factor = inverse @ np.sum(weight * whole * apart, axis=1)
    own = np.diag(inverse)
    leverage = np.minimum(links * (own[:, None] + own - 2.0 * inverse), MOST_TAKEN)
    return np.asarray((apart - whole * (factor[:, None] - factor)) ** 2 / (1.0 - leverage))
