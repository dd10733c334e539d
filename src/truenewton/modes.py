"""Stiffness modes: the eigenmodes of a stiffness matrix, softest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.actuators import Array


@dataclass(frozen=True, eq=False)
class StiffnessModes:
    """Eigenmodes of a symmetric stiffness.

    Attributes
    ----------
    stiffness
        (n,) eigenvalues, ascending [N/m].
    modes
        (n, n), one mode a column, of unit length.
    """

    stiffness: Array
    modes: Array


def stiffness_modes(stiffness: Array) -> StiffnessModes:
    """Return the eigenmodes of a symmetric (n, n) stiffness, rigid motions first.

    A symmetric mirror has pairs of equal stiffness, in which rounding would choose the modes. So
    each set of equals gets the basis nearest to fixed random vectors: the same on every machine,
    to rounding. That settles the signs as well.
    """
    values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    n = len(values)
    reference = np.random.default_rng(0).standard_normal((n, n))
    apart = np.diff(values) > 1e-11 * values[-1] + 1e-6 * np.abs(values[1:])
    modes = np.empty_like(vectors)
    for equal in np.split(np.arange(n), np.flatnonzero(apart) + 1):
        # Polar decomposition of the projected references: no pivots, so no ties.
        left, _, right = np.linalg.svd(vectors[:, equal].T @ reference[:, equal])
        modes[:, equal] = vectors[:, equal] @ (left @ right)
    return StiffnessModes(values, modes)
