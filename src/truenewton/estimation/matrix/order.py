"""Whether an array is a stiffness matrix, its orientation, and the order of its coordinates.

A rigid-body motion of a free shell requires no force (`facts`). If coordinates are assigned to the
wrong actuators, the computed motion bends the shell. The orientation is judged by medians over
actuators, which a few bad actuators do not change.

Commanded forces that balance to the rounding of the file were not measured. Either rigid-body
motions were projected out, which mixes the alpha of each column into all rows, or alpha was 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.couplings import (
    MIN_JUDGED_ACTUATORS,
    NEAR_SPACINGS,
    relative_couplings,
    typical_spacing,
)
from truenewton.estimation.matrix.facts import (
    MAX_SENSOR_COST,
    MIN_MEASURED_DEVIATION,
    MatrixFacts,
)
from truenewton.linalg import assignment
from truenewton.statics.layout import Layout

# Rigid-body residuals: 0.08 if gains or alpha scatter by 10 %, 0.09 if two neighbours of 45
# actuators are exchanged, 0.4 if positions are sorted by radius, 0.9 if they are random.
MAX_RIGID_COST = 0.12
MIN_COST_RATIO = 3.0  # rigid-body residual in this order relative to the right one
MIN_EXPLAINED_COUPLING = 0.65  # fraction of the squared couplings that distance explains
# Column imbalance relative to the diagonal. Measured matrices have more, as alpha differs from 1.
MIN_MEASURED_IMBALANCE = 0.02
MAX_SAME = 1e-6  # relative difference of equal numbers, in single precision
# Rigid-body residual with and without the same force in all columns. It is 1.1 if there is none,
# and 1.4 if the sensor in the centre is wrong.
MIN_REST_COST_RATIO = 2.0
MAX_SOFTEST_COST = 1.5  # rigid-body residual relative to an arbitrary motion; small for a stiffness


def refuse_no_stiffness(k: Array) -> None:
    """Raise RankDeficient for an (n, n) array that is not a measured stiffness."""
    own = np.diag(k)
    below, above = np.tril(k, -1).any(), np.triu(k, 1).any()
    if len(k) > 1 and k.any() and not (below and above):
        fault = "diagonal: no actuator feels another"
        if below or above:
            fault = f"zero {'above' if below else 'below'} its diagonal: half of it is not there"
        raise RankDeficient(
            f"STIFFNESS is {fault}",
            remedy="store the forces of all actuators for a displacement of each",
        )
    if len(k) < MIN_JUDGED_ACTUATORS and np.median(own):
        return
    for name, sizes in (
        ("own elements", own),
        ("norms of the rows", np.linalg.norm(k, axis=1)),
        ("absolute sums of the rows", np.abs(k).sum(axis=1)),
    ):
        typical = float(np.median(sizes))
        same = np.count_nonzero(np.abs(sizes - typical) <= MAX_SAME * abs(typical))
        if 2 * same > len(k):
            raise RankDeficient(
                f"{same} of {len(k)} {name} of STIFFNESS are the same number, {typical:.3g}: rows"
                " were divided by them, or cut off at a limit",
                remedy="give the matrix as it was measured",
            )


def refuse_compliance(facts: MatrixFacts, layout: Layout) -> None:
    """Raise RankDeficient for a matrix that is dominated by rigid-body motions."""
    on = layout.enabled
    cost = rigid_cost(facts.squares, layout.x[on], layout.y[on])
    if cost > MAX_SOFTEST_COST:
        raise RankDeficient(
            "STIFFNESS looks like a compliance, displacement per force: rigid motions are its"
            " largest part",
            remedy="give force per displacement, its inverse but for rigid motions",
        )


def row_order(k: Array) -> NDArray[np.int64]:
    """Return the row that belongs to each column of an (n, n) stiffness.

    In a positive definite matrix |k_ij|^2 < k_ii k_jj. The right order of rows therefore has the
    largest product of diagonal elements, whatever the gains. Wrong elements may exceed the bound: a
    row is moved only if it resembles the column at its new position more than its present column.
    """
    size = np.abs(k)
    least = 1e-12 * float(size.max())
    # The present order is favoured, so that rounding alone does not change it.
    cost = -np.log(np.maximum(size, least)) - 1e-6 * np.eye(len(k))
    order = assignment(cost.T)
    left = {int(i) for i in np.flatnonzero(order != np.arange(len(k)))}
    while left:
        cycle = [left.pop()]
        while (after := int(order[cycle[-1]])) != cycle[0]:
            left.remove(after)
            cycle.append(after)
        at, before = np.array(cycle), order.copy()
        before[at] = at
        if _likeness(k, before, at) >= _likeness(k, order, at):
            order = before
    return order


def _likeness(k: Array, order: NDArray[np.int64], at: NDArray[np.int64]) -> float:
    """Return the similarity of rows in an order to the columns ``at``.

    It is that of the elements of all others, as one wrong element may be why rows are exchanged;
    unless these are fewer.
    """
    every = np.arange(len(k))
    others = np.delete(every, at) if 2 * len(at) < len(k) else every
    r, c = k[np.ix_(order[at], others)], k[np.ix_(order[others], at)].T
    sizes = np.linalg.norm(r, axis=1) * np.linalg.norm(c, axis=1)
    return float(np.sum(np.abs(np.sum(r * c, axis=1)) / np.maximum(sizes, 1e-300)))


def order_effects(facts: MatrixFacts, layout: Layout) -> Iterator[Finding]:
    """Yield a finding if the order of coordinates and matrix differs, or if forces are missing.

    If the true order is identified, the finding names it. A few bad actuators cannot imitate this.
    """
    x, y, on = layout.x, layout.y, layout.enabled

    def cost(order: NDArray[np.int64]) -> float:
        return rigid_cost(facts.squares, x[order][on], y[order][on])

    size = cost(np.arange(layout.n))
    if size < 0.005:  # as small as in the right order
        return
    orders = ((cost(order), name) for name, order in other_orders(x, y))
    least, name = min(orders, default=(np.inf, ""))
    identified = least * MIN_COST_RATIO < size
    unit = "of the force that any displacement costs, to move it rigidly"
    if identified or size > MAX_RIGID_COST:
        explained = share_by_distance(facts.stiffness, facts.arms)
        if identified or not explained > MIN_EXPLAINED_COUPLING:
            yield Finding(
                code=Code.DISORDERED_STIFFNESS,
                detail=name if identified else "",
                size=size,
                unit=unit,
                remedy="put the rows of ACTUATORS in the order of rows and columns of STIFFNESS",
            )
        else:
            yield Finding(
                code=Code.INCOMPLETE_STIFFNESS,
                size=size,
                unit=unit,
                remedy="look for elements that are zero, cut off at a limit or in another unit, and"
                " check X and Y",
            )


def rest_effects(facts: MatrixFacts) -> Iterator[Finding]:
    """Yield a finding if all columns contain the same forces."""
    if len(facts.stiffness) < MIN_JUDGED_ACTUATORS:
        return
    if facts.rigid_cost > MIN_REST_COST_RATIO * facts.without_forces_at_rest.rigid_cost:
        yield Finding(
            code=Code.FORCES_AT_REST,
            size=facts.rigid_cost,
            unit="of the own stiffness, to move it rigidly",
            remedy="subtract the forces at rest from each column of STIFFNESS before it is divided"
            " by the displacement",
        )


def balance_effects(facts: MatrixFacts) -> Iterator[Finding]:
    """Yield a finding if commanded forces balance, so that alpha cannot be estimated."""
    symmetric = facts.asymmetry < MIN_MEASURED_DEVIATION
    true = symmetric and facts.imbalance < MIN_MEASURED_IMBALANCE
    if true or facts.balances_by_rounding:
        yield Finding(
            code=Code.TRUE_STIFFNESS if true else Code.CLEANED_STIFFNESS,
            size=facts.imbalance,
            unit="of the own stiffness, columns out of balance",
            remedy="give the matrix as it was measured",
        )


def orientation_effects(facts: MatrixFacts) -> Iterator[Finding]:
    """Yield a finding if the matrix is transposed or was symmetrised."""
    if (
        len(facts.stiffness) >= MIN_JUDGED_ACTUATORS
        and facts.asymmetry < MIN_MEASURED_DEVIATION
        and facts.imbalance > MIN_MEASURED_IMBALANCE
    ):
        yield Finding(
            code=Code.SYMMETRISED_STIFFNESS,
            size=facts.imbalance,
            unit="of the own stiffness, columns out of balance",
            remedy="use the matrix as it was measured: averaged, it does not separate alpha from"
            " sensor gains",
        )
    elif facts.looks_transposed and facts.rigid_cost > MAX_SENSOR_COST:
        yield Finding(
            code=Code.TRANSPOSED_STIFFNESS,
            size=facts.rigid_cost,
            unit="of the own stiffness, to move it rigidly",
            remedy="store [i, j], the force of actuator i per displacement of sensor j",
        )


def rigid_cost(squares: tuple[Array, Array], x: Array, y: Array) -> float:
    """Return the rms force of rigid-body motions, relative to arbitrary motions.

    ``squares`` are the (n, n) K'K and KK'; the smaller result is returned. Positions are (n,) x, y.
    """
    rigid = np.linalg.qr(np.stack([np.ones(len(x)), x, y], axis=1))[0]
    least = min(float(np.sum(rigid * (square @ rigid))) for square in squares)
    return float(np.sqrt(max(least, 0.0) / (3.0 / len(x) * np.trace(squares[0]))))


def other_orders(x: Array, y: Array) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield name and (n,) row indices of the coordinates, for each common wrong order."""
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
    jumps = np.abs(np.diff(radius)) > 1e-3 * radius.max(initial=0.0)
    rings = np.split(every, np.flatnonzero(jumps) + 1)
    if 1 < len(rings) < n // 2:
        yield "rings the other way round", np.concatenate([ring[::-1] for ring in rings])
        start_kept = [np.roll(ring[::-1], 1) for ring in rings]
        yield "rings the other way round, from the same start", np.concatenate(start_kept)
        yield "rings from the rim inward", np.concatenate(rings[::-1])
        for step in (-1, 1):
            turned = [np.roll(ring, step) for ring in rings]
            yield "rings that start at another actuator", np.concatenate(turned)


def share_by_distance(k: Array, a: Array) -> float:
    """Return the fraction of the squared couplings that distance explains, at most 1.

    ``k`` is an (n, n) stiffness and ``a`` (3, n) arms. If positions are in the wrong order, the
    fraction is about zero. It is NaN for fewer than four actuators.
    """
    if len(k) < 4:
        return float("nan")
    distance = np.hypot(a[1][:, None] - a[1], a[2][:, None] - a[2]) / typical_spacing(a)
    c = relative_couplings(0.5 * (k + k.T))
    pairs = np.triu_indices(len(k), 1)
    c, bins = c[pairs], np.minimum((8.0 * distance[pairs]).astype(int), int(16 * NEAR_SPACINGS))
    c = np.clip(c, -1.0, 1.0)
    order = np.argsort(bins, kind="stable")
    expected = np.zeros_like(c)
    for some in np.split(order, np.flatnonzero(np.diff(bins[order])) + 1):
        expected[some] = np.median(c[some])
    whole = float(np.sum(c**2))
    return 1.0 - float(np.sum((c - expected) ** 2)) / whole if whole else float("nan")
