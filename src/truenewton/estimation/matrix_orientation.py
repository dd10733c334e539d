"""Whether a stiffness matrix lies the right way round, and in the order of its positions.

Both are judged by medians over actuators: a few bad ones say nothing of the rest.
"""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.matrix_faults import NEAR, relative_couplings, typical_spacing

TURNED = 2.0  # times as much that rigid displacements cost as forces are out of balance


def rigid_cost_and_imbalance(k: Array, a: Array) -> tuple[float, float]:
    """Return what a rigid displacement costs, and how far a column is out of balance.

    K {1, x, y} vanishes but for the scatter of the sensor gains and the bias magnets, and
    {1, x, y}' K but for that of alpha, which is larger; transposed, they change places.

    Parameters
    ----------
    k, a
        (n, n) stiffness [N/m] and (3, n) arms in comparable units.

    Returns
    -------
    tuple of float
        Each in terms of the own stiffness of an actuator, the median over all.
    """
    own = np.abs(np.diag(k))
    own = np.where(own > 0.0, own, np.inf)
    rows, columns = np.linalg.norm(k @ a.T, axis=1), np.linalg.norm(a @ k, axis=0)
    return float(np.median(rows / own)), float(np.median(columns / own))


def looks_transposed(k: Array, a: Array) -> bool:
    """Tell whether an (n, n) stiffness looks transposed; (3, n) arms."""
    cost, imbalance = rigid_cost_and_imbalance(k, a)
    return cost > TURNED * imbalance


def share_by_distance(k: Array, a: Array) -> float:
    """Return which part of the couplings is what their distance lets expect, 1 for all.

    Neighbours are coupled most, and in one glass alike; positions in another order than rows and
    columns leave nothing of that. For fewer than four actuators NaN.

    Parameters
    ----------
    k, a
        (n, n) stiffness [N/m] and (3, n) arms in comparable units.
    """
    if len(k) < 4:
        return float("nan")
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2]) / typical_spacing(a)
    c = relative_couplings(0.5 * (k + k.T))
    pairs = np.triu_indices(len(k), 1)
    c, bins = c[pairs], np.minimum((8.0 * distance[pairs]).astype(int), int(16 * NEAR))
    c = np.clip(c, -1.0, 1.0)
    order = np.argsort(bins, kind="stable")
    expected = np.zeros_like(c)
    for some in np.split(order, np.flatnonzero(np.diff(bins[order])) + 1):
        expected[some] = np.median(c[some])
    whole = float(np.sum(c**2))
    return 1.0 - float(np.sum((c - expected) ** 2)) / whole if whole else float("nan")
