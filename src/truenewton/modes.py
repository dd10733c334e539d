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

    The sign of a mode is free; the largest component of each is made positive.
    """
    values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    return StiffnessModes(values, vectors * np.where(largest < 0, -1.0, 1.0))
