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
from truenewton.linalg import inverse_of_positive

STEPS = 40  # of three each
SETTLED, SETTLED_SENSOR = 2e-3, 0.05  # relative change of what matters to the variance; of c
LEAST = 1e-24  # variance in terms of the mean square of an element
ALIKE = 4.0  # residuals' worth of belief that a sensor is as noisy as the others
MOST_TAKEN = 0.9  # of a pair, by factors: beyond, too little is left to tell noise
LITTLE = 1e-4  # share of the variance that does not matter
LEAST_SHARE = 1e-6  # below which no part of the variance falls, so that logarithms stay bounded
LONGEST = 4.0  # step of a logarithm


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
    ways = [sight(places, at_magnets, slopes=False)]
    if fit.asked.offset_spread:
        ways.append(sight(places, fit.values, slopes=True))
    found, start = list[tuple[Array, float]](), None
    for seen in ways:
        variance, cost, start = _likeliest(stiffness, fit, seen, start)
        found.append((variance, cost))
    return min(found, key=lambda each: each[1])


def _likeliest(
    stiffness: Array, fit: Fit, seen: Sight, start: Array | None
) -> tuple[Array, float, Array]:
    """Return variances where the sensors see so, their cost, and the logarithms behind them.

    With those of another way to ``start`` from, fewer steps are needed. Steps are those of a
    minorant of the likelihood, in which no variance becomes negative (Zhou et al., J. Comput.
    Graph. Stat. 28, 350, 2019). Two of them say how far a third may go (SQUAREM: Varadhan and
    Roland, Scand. J. Stat. 35, 335, 2008).
    """
    n, alpha = len(stiffness), fit.values.alpha
    back = np.linalg.inv(seen.motion * fit.values.gain)
    true = alpha[:, None] * stiffness @ back
    apart, whole = true - true.T, 0.5 * (true + true.T)
    left = 1.0 - max(0.0, fit.parameters[2] - n) / fit.equations[2]  # by what else is fitted
    mixed = np.asarray(back**2)
    own, mean = alpha[:, None] ** 2, float(np.mean(stiffness**2))
    alone = np.count_nonzero(mixed) == n  # each sensor sees its own magnet alone
    laws = np.stack([np.broadcast_to(own, stiffness.shape), own * stiffness**2 / mean])
    moved, pairs = _by_offsets(true @ seen.motion, fit, seen), ~np.eye(n, dtype=bool)

    def by_mixing(each: Array, mixed: Array) -> Array:
        return np.asarray(each * np.diag(mixed) if alone else each @ mixed)

    def stepped(logs: Array) -> tuple[Array, float]:
        """Return the logarithms of a^2, p^2, the offsets' part and c after a step; their cost."""
        size, offsets, sensor = np.exp(logs[:2]), float(np.exp(logs[2])), np.exp(logs[3:])
        each = np.tensordot(size, laws, 1)
        total = by_mixing(each * sensor, mixed) + offsets * moved
        total = total + total.T
        np.fill_diagonal(total, np.inf)  # nothing is its own transpose
        had = 1.0 / total
        square = _without_factors(apart, whole, had) / left
        cost = float(np.mean(np.log(total[pairs]) + (square * had)[pairs]))
        wanted = square * had**2
        by_offsets = np.sum(moved * wanted) / np.sum(moved * had) if moved.any() else 1.0
        wanted, had = by_mixing(wanted, mixed.T), by_mixing(had, mixed.T)
        told, expected = (np.sum(laws * (sensor * part), axis=(1, 2)) for part in (wanted, had))
        size = size * np.sqrt(told / expected)
        size = np.maximum(size, max(LEAST * mean, LEAST_SHARE * size.max()))
        counted = sensor * np.sum(each * had, axis=0) + ALIKE
        sensor = np.sqrt((sensor**2 * np.sum(each * wanted, axis=0) + ALIKE) * sensor / counted)
        offsets = max(offsets * np.sqrt(by_offsets), LEAST_SHARE)
        return np.log(np.concatenate([size, [offsets], sensor])), cost

    logs = start
    if logs is None:
        first = max(0.25 * float(np.mean(apart**2)) / float(np.mean(own)), LEAST * mean)
        logs = np.concatenate([np.log([first, first, 1.0]), np.zeros(n)])
    for _ in range(STEPS):
        one, _ = stepped(logs)
        two, cost = stepped(one)
        step, bend = one - logs, two - 2.0 * one + logs
        far = max(1.0, float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-300))
        jumped = logs + np.clip(2.0 * far * step + far**2 * bend, -LONGEST, LONGEST)
        logs, reached = stepped(jumped)
        change = np.abs(logs - jumped)
        if not reached <= cost:
            logs, reached, change = two, cost, np.abs(two - one)
        matters = logs[:2] > np.log(LITTLE) + logs[:2].max()
        if change[:2][matters].max() < SETTLED and change[3:].max() < SETTLED_SENSOR:
            break
    size = np.exp(logs[:2])
    variance = (size[0] + size[1] * stiffness**2 / mean) * np.exp(logs[3:])
    return variance, reached, logs


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
    inverse = inverse_of_positive(laplacian)
    factor = inverse @ np.sum(weight * whole * apart, axis=1)
    own = np.diag(inverse)
    leverage = np.minimum(links * (own[:, None] + own - 2.0 * inverse), MOST_TAKEN)
    return np.asarray((apart - whole * (factor[:, None] - factor)) ** 2 / (1.0 - leverage))
