"""Rows of a cycle as they balance, in layers in which no shape stands twice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.actuators import Array
from truenewton.measurements import Cycle


@dataclass(frozen=True, eq=False)
class BalancedRows:
    """The valid rows of a cycle, what POSITION says of them taken into account.

    Attributes
    ----------
    cycle
        The cycle.
    a
        (3, n) arms of its enabled actuators.
    """

    cycle: Cycle
    a: Array

    def at(self, rows: slice | NDArray[np.int64]) -> tuple[Array, Array | None]:
        """Return c (1 + COILGRAD z), (m, n), and A (BIASGRAD z), (m, 3), of some rows."""
        cycle = self.cycle
        force = cycle.used(cycle.force, rows)
        coil, bias = cycle.coil_gradient or 0.0, cycle.bias_gradient or 0.0
        if cycle.position is None or not (coil or bias):
            return force, None
        z = cycle.used(cycle.position, rows) - cycle.rest_position
        return force * (1.0 + coil * z), bias * z @ self.a.T


@dataclass(frozen=True, eq=False)
class Layer:
    """Rows of a cycle in none of which a group stands twice, in the order of their groups."""

    rows: BalancedRows
    some: NDArray[np.int64]
    group: NDArray[np.int64]
    weight: float

    def within(
        self, block: slice
    ) -> tuple[slice | NDArray[np.int64], Array, Array | None, float] | None:
        """Return where in a block of groups rows stand, and the rows; None where none does."""
        first, end = np.searchsorted(self.group, [block.start, block.stop]).tolist()
        if first == end:
            return None
        whole = end - first == block.stop - block.start
        at = slice(None) if whole else self.group[first:end] - block.start
        some = self.some[first:end]
        inorder = (np.diff(some) == 1).all()
        force, balance = self.rows.at(slice(some[0], some[-1] + 1) if inorder else some)
        return at, force, balance, self.weight


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of rows in none of which a group stands twice; mostly one set of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
