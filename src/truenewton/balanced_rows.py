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
    force
        (N, n) commanded forces c [N].
    displacement
        (N, n) z [m], or None where nothing depends on it.
    coil_gradient, bias_gradient
        COILGRAD [1/m] and BIASGRAD [N/m].
    a
        (3, n) arms.
    """

    force: Array
    displacement: Array | None
    coil_gradient: float
    bias_gradient: float
    a: Array

    @classmethod
    def of(cls, cycle: Cycle, a: Array) -> BalancedRows:
        """Return the rows of a cycle."""
        coil, bias = cycle.coil_gradient or 0.0, cycle.bias_gradient or 0.0
        z = None
        if cycle.position is not None and (coil or bias):
            z = cycle.position[cycle.valid][:, cycle.layout.enabled]
            z = z - z[_paired(cycle)].mean(axis=0)
        return cls(cycle.used_force, z, coil, bias, a)

    def at(self, rows: slice | NDArray[np.int64]) -> tuple[Array, Array | None]:
        """Return c (1 + COILGRAD z), (m, n), and A (BIASGRAD z), (m, 3), of some rows."""
        force = self.force[rows]
        if self.displacement is None:
            return force, None
        z = self.displacement[rows]
        return force * (1.0 + self.coil_gradient * z), self.bias_gradient * z @ self.a.T


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


def _paired(cycle: Cycle) -> NDArray[np.bool_]:
    """Return (N,) true for valid rows whose opposite is valid too; all rows where none has one.

    Their mean is the flat mirror, whatever rows are missing.
    """
    code = cycle.sign[cycle.valid] * cycle.shape[cycle.valid]
    paired = np.isin(-code, code)
    return paired if paired.any() else np.ones_like(paired)


def distinct(group: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield sets of rows in none of which a group stands twice; mostly one set of all rows."""
    rest = np.argsort(group, kind="stable")
    while rest.size:
        first = np.concatenate([[True], np.diff(group[rest]) > 0])
        yield rest[first]
        rest = rest[~first]
