"""What repeats of shapes boil down to where force and position both count: sums, row by row.

Rows with the same load, SHAPE and SIGN repeat each other, and what they deviate from their mean is
noise. A shape and its negative together, c and z counted from rest, are one shape: what they have
in common (the coils' and the sensors' laws, no stiffness) drops out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.moments import row_weights
from truenewton.files.stored_rows import BLOCK_BYTES, blocks
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Cycle


@dataclass(eq=False)
class Products:
    """Sums over rows of c_i^2 (n,), c z' and z z' (n, n)."""

    cc: Array
    cz: Array
    zz: Array

    def add(self, c: Array, z: Array) -> None:
        """Count (m, n) rows in."""
        self.cc += np.einsum("ri,ri->i", c, c)
        self.cz += c.T @ z
        self.zz += z.T @ z

    def unexplained(self, k: Array) -> Array:
        """Return (n,) the sum of (c - K z)^2."""
        left = self.cc - np.einsum("ij,ij->i", k, 2 * self.cz - k @ self.zz)
        return np.asarray(np.maximum(left, 0.0))


@dataclass(frozen=True, eq=False)
class ShapeProducts:
    """What the regression needs.

    Attributes
    ----------
    between, within
        Sums over distinct shapes, and over deviations of rows from their repeats.
    shapes, rows, spare
        Number of distinct shapes, of rows, and of rows beyond what repeats and cycles take.
    weight
        Sum of the weights of the rows.
    position_variance
        Of a reading in a row of weight 1, as far as shapes and their negatives tell; NaN where
        neither is there [m^2].
    """

    between: Products
    within: Products
    shapes: int
    rows: int
    spare: int
    weight: float
    position_variance: float


def shape_products(campaign: Campaign) -> ShapeProducts:
    """Walk through the rows, some shapes at a time, and sum."""
    n = int(campaign.layout.enabled.sum())
    between, within = (Products(np.zeros(n), *np.zeros((2, n, n))) for _ in range(2))
    groups, shapes = 0, 0
    uneven, weight, rows = 0.0, 0.0, 0
    for c, z, w, label in _blocks(campaign):
        # Rows stand in the order of their labels: first load and SHAPE, then SIGN.
        edge = np.flatnonzero(np.append(True, (label[1:] != label[:-1]).any(axis=1)))
        shape_edge = np.flatnonzero(
            np.append(True, (label[edge][1:, :2] != label[edge][:-1, :2]).any(axis=1))
        )
        count, heavy = np.diff(np.append(edge, len(w))), np.add.reduceat(w, edge)
        mean_c, mean_z = (np.add.reduceat(w[:, None] * v, edge) / heavy[:, None] for v in (c, z))
        root = np.sqrt(w)[:, None]
        within.add(
            root * (c - np.repeat(mean_c, count, axis=0)),
            root * (z - np.repeat(mean_z, count, axis=0)),
        )
        signed = label[edge, 2] * heavy
        total = np.add.reduceat(heavy, shape_edge)
        odd_c, odd_z = (
            np.add.reduceat(signed[:, None] * v, shape_edge) / np.sqrt(total)[:, None]
            for v in (mean_c, mean_z)
        )
        between.add(odd_c, odd_z)
        uneven += float(heavy @ np.sum(mean_z**2, axis=1) - np.sum(odd_z**2))
        groups, shapes = groups + len(edge), shapes + len(shape_edge)
        weight, rows = weight + float(w.sum()), rows + len(w)
    alike = rows - shapes
    return ShapeProducts(
        between=between,
        within=within,
        shapes=shapes,
        rows=rows,
        spare=rows - groups - (len(campaign.cycles) - len(campaign.loads)),
        weight=weight,
        position_variance=(float(np.trace(within.zz)) + uneven) / (n * alike) if alike else np.nan,
    )


def _blocks(campaign: Campaign) -> Iterator[tuple[Array, Array, Array, NDArray[np.int64]]]:
    """Yield force, position (m, n), weight (m,) and label (m, 3) of rows, all of some shapes.

    Counted from rest, and in the order of their labels: load, SHAPE, SIGN.
    """
    cycles = campaign.cycles
    labels = [
        np.column_stack([np.full(int(c.valid.sum()), place), c.shape[c.valid], c.sign[c.valid]])
        for c, place in zip(cycles, campaign.load_index, strict=True)
    ]
    rest = [rest_force(cycle) for cycle in cycles]
    weights = row_weights(campaign)
    label = np.concatenate(labels)
    order = np.lexsort(label.T[::-1])
    at = np.concatenate([np.arange(len(some)) for some in labels])[order]
    owner = np.repeat(np.arange(len(cycles)), [len(some) for some in labels])[order]
    label = label[order]
    starts = np.flatnonzero(np.append(True, (label[1:, :2] != label[:-1, :2]).any(axis=1)))
    ends = np.append(starts[1:], len(label))
    n = rest[0].size
    together = max(1, int(BLOCK_BYTES // (8 * n * (ends - starts).max())))
    for first in range(0, len(starts), together):
        some = slice(starts[first], ends[min(first + together, len(ends)) - 1])
        c, z = np.empty((2, some.stop - some.start, n))
        w = np.empty(len(c))
        for k in np.unique(owner[some]).tolist():
            own = np.flatnonzero(owner[some] == k)
            own = own[np.argsort(at[some][own])]  # in the order of the file
            c[own], z[own] = _from_rest(cycles[k], at[some][own])
            c[own] -= rest[k]
            w[own] = weights[k]
        yield c, z, w, label[some]


def _from_rest(cycle: Cycle, rows: slice | NDArray[np.int64]) -> tuple[Array, Array]:
    """Return c (1 + COILGRAD z) [N] and z [m], counted from rest, of some rows."""
    assert cycle.position is not None
    z = cycle.used(cycle.position, rows) - cycle.rest_position
    return cycle.used(cycle.force, rows) * (1.0 + (cycle.coil_gradient or 0.0) * z), z


def rest_force(cycle: Cycle) -> Array:
    """Return (n,) the mean of c (1 + COILGRAD z) over ``rest_rows``; of c without POSITION [N]."""
    counted = cycle.rest_rows
    total = np.zeros(int(cycle.layout.enabled.sum()))
    for some in blocks(len(counted), 16 * cycle.layout.n):
        known = cycle.position is not None
        force = _from_rest(cycle, some)[0] if known else cycle.used(cycle.force, some)
        total += force[counted[some]].sum(axis=0)
    return total / np.count_nonzero(counted)
