"""What the data can and cannot fix, judged against noise; and what to do about it.

Noise fills null spaces, so the rank of E says nothing. Instead, with equal noise s in all readings
and the arms made orthonormal (U = (A A')^-1/2 A), alpha is the pattern v for which the centred
forces are in balance:

    v' G v / v' D v = least,    G = sum over shapes (c - c_mean)(c - c_mean)' o (U' U),
                                D = number of shapes * diag(U' U)        (o: elementwise)

The eigenvalues of G in terms of D are squared noise in every pattern that the data leave free, and
stand above it in every pattern that they hold. The least belongs to alpha itself; every further one
that does not stand apart from it is a direction that only noise decides (docs/method.md).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from truenewton.actuators import Array
from truenewton.balance import enabled_arms
from truenewton.campaign import Campaign
from truenewton.diagnosis import Diagnosis
from truenewton.errors import RankDeficient
from truenewton.repeats import RowGroups, row_groups


def balance_spectrum(force: Array, a: Array) -> Array:
    """Return (n,) ascending eigenvalues of G in terms of D.

    Parameters
    ----------
    force
        (shapes, n) commanded forces, centred on their load's mean, times the root of their number.
    a
        (3, n) arms.
    """
    gram = a.T @ np.linalg.solve(a @ a.T, a)  # U' U
    root = np.sqrt(len(force) * np.diag(gram))
    scaled = (force.T @ force) * gram / np.outer(root, root)
    return np.asarray(np.maximum(scipy.linalg.eigvalsh(scaled), 0.0))


def free_patterns(eigenvalues: Array, shapes: int) -> int:
    """Count the patterns beside alpha that cannot be told from noise.

    Pure noise in 3 N equations spreads the eigenvalues over (1 +- root(n / 3 N))^2 (Marchenko and
    Pastur); what lies within that spread above the least one is noise.
    """
    spread = np.sqrt(min(len(eigenvalues) / (3 * max(shapes, 1)), 0.49))
    factor = max(2.0, ((1 + spread) / (1 - spread)) ** 2)
    # Rounding: G squares the forces, so nothing below 1e-13 of its largest eigenvalue is real.
    noise = max(eigenvalues[0], 1e-13 * eigenvalues[-1])
    return int(np.count_nonzero(eigenvalues[1:] <= factor * noise))


def diagnose(campaign: Campaign) -> Diagnosis:
    """Judge whether a campaign fixes alpha, B and the torques, and name what is missing."""
    a = enabled_arms(campaign.layout)
    faults = geometry_faults(a) + _load_faults(campaign)
    if geometry_faults(a):
        return Diagnosis((), 0, faults)
    groups = row_groups(campaign)
    centred = _centred(groups)
    n = a.shape[1]
    # Both signs of a shape, and all its loads, are one elastic pattern: three equations.
    distinct = len(np.unique(groups.labels[:, 1]))
    if 3 * distinct < n - 1:
        return Diagnosis((), n - 1 - 3 * distinct, (*faults, _too_few(distinct, n)))
    eigenvalues = balance_spectrum(centred, a)
    free = free_patterns(eigenvalues, len(centred) - len(campaign.loads))
    if free:
        noise = float(np.sqrt(eigenvalues[: free + 1].mean()))
        span = min(_span(centred, noise), n - 3)
        faults += (_drowned(span, free, n),)
    return Diagnosis(tuple(eigenvalues.tolist()), free, faults)


def _centred(groups: RowGroups) -> Array:
    """Return the means of repeats, centred for each load and weighted by the root of their number.

    What is common to a load (weight, bias, torques) drops out, as do its unknown B, M_y and M_x.
    """
    centred = np.empty_like(groups.mean)
    for load in np.unique(groups.labels[:, 0]):
        at = groups.labels[:, 0] == load
        weight = groups.count[at]
        mean = weight @ groups.mean[at] / weight.sum()
        centred[at] = (groups.mean[at] - mean) * np.sqrt(weight)[:, None]
    return centred


def _span(centred: Array, noise: float) -> int:
    """Return how many directions of force stand above what noise alone would reach.

    The largest singular value of N rows of n noisy readings is s (root N + root n).
    """
    values = np.linalg.svd(centred, compute_uv=False)
    edge = noise * np.sum(np.sqrt(centred.shape))
    return int(np.count_nonzero(values > max(1.1 * edge, 1e-12 * values[0])))


def geometry_faults(a: Array) -> tuple[tuple[str, str], ...]:
    """Name what no shape could make good: too few actuators, or all on one line or conic."""
    n = a.shape[1]
    if n < 4:
        return ((f"only {n} actuators take part", "three hold the mirror; enable four at least"),)
    x, y = a[1], a[2]
    values = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()]), compute_uv=False)
    if values[1] <= 1e-6 * values[0]:
        return (
            (
                "the actuators are collinear",
                "a mirror on one line has no torque about it; check X and Y",
            ),
        )
    # {v : v A in the span of A}, larger than the constants on certain conics (docs/method.md).
    orthonormal = np.linalg.qr(a.T)[0]
    outside = np.eye(n) - orthonormal @ orthonormal.T
    stacked = np.vstack([outside * row for row in orthonormal.T])
    if np.linalg.svd(stacked, compute_uv=False)[-2] <= 1e-9:
        return (
            (
                "the actuators stand on a conic on which balance leaves alpha free",
                "add an actuator off it",
            ),
        )
    return ()


def _load_faults(campaign: Campaign) -> tuple[tuple[str, str], ...]:
    """Judge the weights themselves: with noise, equal weights leave no trace in the rank."""
    weights = campaign.effective_weights
    if len(weights) == 1:
        return (
            (
                f"there is only one load, '{campaign.loads[0].name}', so the common scale is free",
                "add cycles under a load of another known weight",
            ),
        )
    if np.ptp(weights) <= 1e-6 * np.abs(weights).max():
        return (
            (
                f"the {len(weights)} loads have the same weight, so the common scale is free",
                "add a load that differs",
            ),
        )
    return ()


def _too_few(distinct: int, n: int) -> tuple[str, str]:
    return (
        f"there are too few shapes: {distinct} for {n} actuators",
        f"apply {n} independent shapes, both signs",
    )


def _drowned(span: int, free: int, n: int) -> tuple[str, str]:
    return (
        f"the shapes stand above the noise in {span} of the {n - 3} elastic directions, too few"
        f" or dependent: {free} pattern{'s' if free > 1 else ''} of alpha left to noise",
        f"apply {n} independent shapes, larger or more often",
    )


def refuse(diagnosis: Diagnosis) -> None:
    """Raise RankDeficient with the first fault, where there is one."""
    if diagnosis.faults:
        fault, remedy = diagnosis.faults[0]
        raise RankDeficient(fault, remedy=remedy, got=diagnosis.undetermined, want=0)
