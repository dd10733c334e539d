"""Two stiffness matrices of one mirror, reduced to the same actuators in the same order.

Actuators are matched by ID and position, or by position alone. An actuator that only one matrix
contains is removed from that one by condensation, K_gg - K_gb K_bb^-1 K_bg: the stiffness if it
exerts no force. Factors of rows and columns commute with that. It is right only if the missing
actuator exerted no force while the other matrix was measured. Rows that were exchanged are
recognised by their direction, which alpha does not change, and columns in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.comparison.fit import rough_factors
from truenewton.errors import CampaignMismatch
from truenewton.estimation.matrix.couplings import typical_spacing
from truenewton.estimation.matrix.misfits import condensed
from truenewton.linalg import assignment
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.arms import arms
from truenewton.statics.layout import Layout

POSITION_TOLERANCE = 0.2  # of the spacing: sensors and tables differ by less, neighbours by more
MIN_COMMON_FRACTION = 0.5  # of the actuators of each matrix
MIN_COSINE = 0.5  # of a row or column to its counterpart; noise alone gives 1/sqrt(n)
MIN_COSINE_GAIN = 0.02  # of another row over the own: neighbours resemble each other by 0.9
MAX_EXCHANGED_FRACTION = 0.1  # of the rows: beyond, all are in another order


@dataclass(frozen=True, eq=False)
class Side:
    """A stiffness matrix, measured directly or by a campaign.

    Attributes
    ----------
    matrix
        Of all actuators.
    covariance
        (n, n) of the elements of a row by the regression of a campaign, up to a factor that is
        common to both sides; otherwise 0.
    """

    matrix: StiffnessMatrix
    covariance: Array


@dataclass(frozen=True)
class Matching:
    """How actuators, rows and columns of two matrices were matched.

    Attributes
    ----------
    only_old, only_new
        IDs of actuators that the other matrix does not contain.
    exchanged_rows, exchanged_columns
        IDs of actuators whose rows (coil cables) or columns (sensor cables) of the new matrix were
        put back in order, as pairs (the row of, has become that of).
    lost_rows, lost_columns
        IDs of actuators whose row or column resembles no other; both are removed by condensation.
    """

    only_old: tuple[int, ...] = ()
    only_new: tuple[int, ...] = ()
    exchanged_rows: tuple[tuple[int, int], ...] = ()
    exchanged_columns: tuple[tuple[int, int], ...] = ()
    lost_rows: tuple[int, ...] = ()
    lost_columns: tuple[int, ...] = ()

    @property
    def rows(self) -> tuple[tuple[str, int, int], ...]:
        """Name of the attribute, actuator, and in whose place it is."""
        return tuple(
            (name, *(one if isinstance(one, tuple) else (one, one)))
            for name, ids in vars(self).items()
            for one in ids
        )

    @classmethod
    def of(cls, rows: Iterable[tuple[str, int, int]]) -> Matching:
        """Return the matching of such rows."""
        found: dict[str, list[Any]] = {each.name: [] for each in fields(cls)}
        for name, i, j in rows:
            if name in found:
                found[name].append((int(i), int(j)) if name.startswith("exchanged") else int(i))
        return cls(**{name: tuple(ids) for name, ids in found.items()})


@dataclass(frozen=True, eq=False)
class Pair:
    """Two matrices of the same n actuators in the same order.

    Attributes
    ----------
    at
        (n,) rows of the actuators in the old matrix.
    layout
        Of the n actuators, from the old matrix.
    old, new
        (n, n) [N/m].
    inflation
        (n, n) variance of an element relative to that of matrices that were not condensed.
    covariance
        (n, n) sum of both sides.
    matching
        How they were matched.
    """

    at: NDArray[np.int64]
    layout: Layout
    old: Array
    new: Array
    inflation: Array
    covariance: Array
    matching: Matching


def pair_matrices(old: Side, new: Side) -> Pair:
    """Return two matrices of one mirror for the actuators that both contain.

    Raises
    ------
    CampaignMismatch
        They have few actuators in common, or their rows or columns are in another order than the
        actuators.
    """
    of_old, of_new = _common(old.matrix, new.matrix)
    selected = _paired(old, new, of_old, of_new, condense=False)
    if len(selected.at) == old.matrix.layout.n == new.matrix.layout.n:
        return selected
    # A missing actuator exerted no force, or only its row and column were left out of the file.
    condensed_pair = _paired(old, new, of_old, of_new, condense=True)
    return min(condensed_pair, selected, key=lambda pair: rough_residual(pair.old, pair.new))


def _paired(
    old: Side,
    new: Side,
    of_old: NDArray[np.int64],
    of_new: NDArray[np.int64],
    *,
    condense: bool,
) -> Pair:
    """Return both matrices for common actuators; the others are condensed or left out."""
    take = partial(_taken, condense=condense)
    k_old, inflation_old, covariance_old = take(old.matrix.stiffness, old.covariance, of_old)
    k_new, inflation_new, covariance_new = take(new.matrix.stiffness, new.covariance, of_new)
    rows, lost_rows = _order(k_old, k_new, "rows")
    k_new = k_new[rows]
    reversed_rows = np.sign(np.einsum("ij,ij->i", k_old, k_new))  # would make columns differ
    columns, lost_columns = _order(k_old.T, (k_new * reversed_rows[:, None]).T, "columns")
    k_new, covariance_new = k_new[:, columns], covariance_new[np.ix_(columns, columns)]
    inflation = 0.5 * (inflation_old + inflation_new[np.ix_(rows, columns)])
    kept = np.flatnonzero(~(lost_rows | lost_columns))
    if len(kept) < len(of_old):
        k_old, more_old, covariance_old = take(k_old, covariance_old, kept)
        k_new, more_new, covariance_new = take(k_new, covariance_new, kept)
        inflation = inflation[np.ix_(kept, kept)] * 0.5 * (more_old + more_new)
    ids = old.matrix.layout.id[of_old]
    return Pair(
        at=of_old[kept],
        layout=old.matrix.layout.part(of_old[kept]),
        old=k_old,
        new=k_new,
        inflation=inflation,
        covariance=covariance_old + covariance_new,
        matching=Matching(
            only_old=_missing(old.matrix, of_old),
            only_new=_missing(new.matrix, of_new),
            exchanged_rows=_exchanged(ids, rows, lost_rows),
            exchanged_columns=_exchanged(ids, columns, lost_columns),
            lost_rows=tuple(ids[lost_rows].tolist()),
            lost_columns=tuple(ids[lost_columns].tolist()),
        ),
    )


def _common(old: StiffnessMatrix, new: StiffnessMatrix) -> tuple[NDArray[np.int64], ...]:
    """Return the rows of the common enabled actuators in the old and in the new matrix."""
    one, other = old.layout, new.layout
    usable = [
        m.layout.enabled & m.stiffness.any(axis=0) & m.stiffness.any(axis=1) for m in (old, new)
    ]
    distance = np.hypot(one.x[:, None] - other.x, one.y[:, None] - other.y)
    near = distance < POSITION_TOLERANCE * typical_spacing(arms(one))
    same = near & (one.id[:, None] == other.id)
    # IDs count if positions confirm most of them; otherwise the tables are numbered differently.
    if np.count_nonzero(same) < MIN_COMMON_FRACTION * min(one.n, other.n):
        same = near & (distance == distance.min(axis=1)[:, None])
    of_old, of_new = np.nonzero(same & usable[0][:, None] & usable[1])
    least = MIN_COMMON_FRACTION * max(np.count_nonzero(each) for each in usable)
    if len(of_old) < least or len(set(of_new)) < len(of_new):
        raise CampaignMismatch(
            f"the matrices of {old.instrument} and {new.instrument} have {len(of_old)} actuators in"
            f" common, of {np.count_nonzero(usable[0])} and {np.count_nonzero(usable[1])}",
            remedy="give two matrices of one mirror, with positions in the same coordinates",
        )
    return of_old, of_new


def _missing(matrix: StiffnessMatrix, common: NDArray[np.int64]) -> tuple[int, ...]:
    """Return the IDs of enabled actuators that are not common."""
    on = matrix.layout.enabled.copy()
    on[common] = False
    return tuple(matrix.layout.id[on].tolist())


def _taken(
    k: Array, covariance: Array, common: NDArray[np.int64], *, condense: bool
) -> tuple[Array, Array, Array]:
    """Return stiffness of some actuators in their order, inflation of variances, covariance."""
    at = np.ix_(common, common)
    if not condense:
        return k[at], np.ones((len(common), len(common))), covariance[at]
    good = np.zeros(len(k), dtype=np.bool_)
    good[common] = True
    core, left, right = condensed(k, good)
    order = np.argsort(np.argsort(common))
    at = np.ix_(order, order)
    inflation = np.outer((left**2).sum(axis=1), (right**2).sum(axis=0))
    return core[at], inflation[at], (right.T @ covariance @ right)[at]


def _order(old: Array, new: Array, what: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the row of the new matrix for each of the old one, and which resemble none."""
    n = len(old)
    cosine, own = _cosines(old, new), np.arange(n)
    order = assignment(-cosine)
    # A row stays unless it resembles another clearly more.
    order = np.where(cosine[own, order] > cosine[own, own] + MIN_COSINE_GAIN, order, own)
    if len(set(order)) < n:
        order = own
    moved = np.count_nonzero(order != own)
    if moved > MAX_EXCHANGED_FRACTION * n:
        raise CampaignMismatch(
            f"{moved} of {n} {what} of the new matrix do not belong to the actuators at their"
            " positions: the matrix is in another order than its actuators",
            remedy=f"put {what} and positions in the same order (docs/import.md)",
        )
    lost = cosine[own, order] < MIN_COSINE
    if lost.sum() > MAX_EXCHANGED_FRACTION * n:
        raise CampaignMismatch(
            f"{lost.sum()} of {n} {what} of the new matrix resemble none of the old one",
            remedy="give two matrices of one mirror, with rows, columns and positions in one order",
        )
    return order, np.asarray(lost)


def _cosines(old: Array, new: Array) -> Array:
    """Return (n, n) absolute cosines of rows i and j without their elements i and j.

    These are the largest, and they move if the columns i and j were exchanged instead.
    """
    own_old, own_new = np.diag(old)[:, None], np.diag(new)
    products = old @ new.T - own_old * new.T - old * own_new
    squares = (
        (old**2).sum(axis=1)[:, None] - own_old**2 - old**2,
        (new**2).sum(axis=1) - own_new**2 - new.T**2,
    )
    rest = np.arange(len(old))
    products[rest, rest] += own_old[:, 0] * own_new  # subtracted twice
    squares[0][rest, rest] += own_old[:, 0] ** 2
    squares[1][rest, rest] += own_new**2
    scale = np.sqrt(np.maximum(squares[0], 0.0) * np.maximum(squares[1], 0.0))
    return np.asarray(np.abs(products) / np.maximum(scale, np.finfo(float).tiny))


def rough_residual(one: Array, other: Array) -> float:
    """Return the residual of factors between (n, n) matrices, relative to the fit."""
    logs, signs = rough_factors(one, other)
    fitted = one * np.exp(logs[0][:, None] + logs[1]) * signs[0][:, None] * signs[1]
    return float(np.linalg.norm(other - fitted) / np.linalg.norm(fitted))


def _exchanged(
    ids: NDArray[np.int64], order: NDArray[np.int64], lost: NDArray[np.bool_]
) -> tuple[tuple[int, int], ...]:
    """Return pairs of IDs: an actuator, and in whose place of the new matrix it is."""
    moved = np.flatnonzero((order != np.arange(len(order))) & ~lost)
    return tuple((int(ids[i]), int(ids[order[i]])) for i in moved)
