"""Whether coordinates stand in the order of a stiffness matrix, and in which they would.

A free shell costs no force where it is moved rigidly: K {1, x, y} vanishes but for the gains of the
sensors, and {1, x, y}' K but for alpha. With coordinates of other actuators it is bent.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import FoundEffect
from truenewton.records.stiffness_matrix import StiffnessMatrix

# Gains or alpha that scatter by 10 % cost 0.08, neighbours exchanged on 45 actuators 0.09; random
# places 0.9, those sorted by radius 0.4.
BENT = 0.12
DISORDERED = "coordinates in another order than STIFFNESS"
SUSPECT = 0.005  # cost from which other orders are tried
BETTER = 3.0  # times less it costs in the right one
SAME_RADIUS = 1e-3  # of the largest: actuators of one ring


def order_effects(matrix: StiffnessMatrix, *, named: bool) -> Iterator[FoundEffect]:
    """Say that the coordinates are not those of the matrix's actuators.

    Parameters
    ----------
    matrix
        Measured.
    named
        Only where another order is told, which a few bad actuators cannot feign.
    """
    layout, on = matrix.layout, matrix.layout.enabled
    x, y, k = layout.x, layout.y, matrix.used_stiffness

    squares = k.T @ k, k @ k.T

    def cost(order: NDArray[np.int64]) -> float:
        return rigid_cost(squares, x[order][on], y[order][on])

    size = cost(np.arange(layout.n))
    if size < SUSPECT:
        return
    orders = ((cost(order), name) for name, order in other_orders(x, y))
    least, name = min(orders, default=(np.inf, ""))
    told = least * BETTER < size
    if told or (not named and size > BENT):
        yield FoundEffect(
            name=DISORDERED + (f": {name}" if told else ""),
            size=size,
            unit="of the force that any displacement costs, to move it rigidly",
            remedy="put the rows of ACTUATORS in the order of rows and columns of STIFFNESS",
        )


def rigid_cost(squares: tuple[Array, Array], x: Array, y: Array) -> float:
    """Return what rigid motions cost in terms of any; the less by (n, n) K'K and KK', at (n,)."""
    rigid = np.linalg.qr(np.stack([np.ones(len(x)), x, y], axis=1))[0]
    least = min(float(np.sum(rigid * (square @ rigid))) for square in squares)
    return float(np.sqrt(max(least, 0.0) / (3.0 / len(x) * np.trace(squares[0]))))


def other_orders(x: Array, y: Array) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield orders that people come to, and (n,) the coordinates that belong to each row."""
    n = len(x)
    every = np.arange(n)
    yield "reversed", every[::-1]
    for shift in range(1, n):
        rows = shift if shift <= n // 2 else shift - n
        yield f"shifted by {rows} row{'s' if abs(rows) > 1 else ''}", np.roll(every, -rows)
    for rows in range(2, n // 2 + 1):
        if n % rows == 0:
            yield f"a table of {rows} rows, transposed", every.reshape(rows, -1).T.ravel()
    radius = np.hypot(x, y)
    jumps = np.abs(np.diff(radius)) > SAME_RADIUS * radius.max(initial=0.0)
    rings = np.split(every, np.flatnonzero(jumps) + 1)
    if 1 < len(rings) < n // 2:
        yield "rings the other way round", np.concatenate([ring[::-1] for ring in rings])
        start_kept = [np.roll(ring[::-1], 1) for ring in rings]
        yield "rings the other way round, from the same start", np.concatenate(start_kept)
        yield "rings from the rim inward", np.concatenate(rings[::-1])
        for step in (-1, 1):
            turned = [np.roll(ring, step) for ring in rings]
            yield "rings that start at another actuator", np.concatenate(turned)
