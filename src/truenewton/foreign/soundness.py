"""Sign, orientation and order of a matrix, and what of it was off: judged, and said."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.estimation.findings.code import Code
from truenewton.estimation.matrix.order import (
    MIN_EXPLAINED_COUPLING,
    balance_effects,
    looks_transposed,
    refuse_compliance,
    rigid_cost_and_imbalance,
    share_by_distance,
)
from truenewton.estimation.matrix.screen import released, screen_matrix
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named
from truenewton.statics.arms import comparable_arms
from truenewton.statics.layout import Layout

OTHER_ORDER = 0.2  # of the couplings, explained by distance
MOST_NAMES = 12


class OtherOrder(FormatError):
    """Positions are in another order than rows and columns."""


class Judged(NamedTuple):
    """What was found: lines of what, and how it is; which actuators are off; is it turned.

    Balanced are forces as commanded, so that nothing tells alpha.
    """

    lines: tuple[tuple[str, str], ...]
    off: NDArray[np.bool_]
    transposed: bool
    balanced: bool


def silent_actuators(k: Array) -> NDArray[np.bool_]:
    """Return (n,) whether row and column of an (n, n) matrix hold nothing: zeros, or NaN."""
    empty = ~(np.isfinite(k) & (k != 0.0))
    return np.asarray(empty.all(axis=0) & empty.all(axis=1))


def turned_sign(k: Array) -> tuple[Array, str]:
    """Return an (n, n) stiffness whose actuators resist their displacement, and what was done."""
    own = np.diag(k)
    against = np.count_nonzero(own < 0.0)
    if against <= np.count_nonzero(own > 0.0):
        return k, "positive, as it should be"
    return -k, "negative: turned (forces on the mirror, positive upward, hold a displacement)"


def judge(matrix: StiffnessMatrix) -> Judged:
    """Judge orientation, order and single actuators of a matrix.

    Raises
    ------
    OtherOrder, RankDeficient
        Its positions are in another order, or rows in another than columns.
    """
    refuse_compliance(matrix)
    matrix = released(matrix)
    measured = matrix.used_stiffness.any(axis=0) | matrix.used_stiffness.any(axis=1)
    k = matrix.used_stiffness[np.ix_(measured, measured)]
    a = comparable_arms(matrix.layout)[:, measured]
    balanced = tuple(balance_effects(matrix))
    lines = [("orientation", _orientation(k, a))]
    lines += [("balance", f"{each.name}; {each.remedy}") for each in balanced]
    share = share_by_distance(k, a)
    if share < OTHER_ORDER and len(k) >= 20:
        raise OtherOrder(
            f"positions are in another order than rows and columns: {100 * max(share, 0.0):.0f} %"
            " of the couplings follow the distance, where a mirror's do to 80 %",
            remedy="put them in the order of the matrix, or match them by ID (--ids)",
            got=share,
        )
    if np.isfinite(share):
        doubt = "" if share > MIN_EXPLAINED_COUPLING else ": LOW, check numbering and places"
        lines.append(("order", f"{100 * share:.0f} % of the couplings follow the distance{doubt}"))
    screened = screen_matrix(matrix)
    gone = np.zeros(matrix.layout.n, dtype=np.bool_)
    gone[matrix.layout.enabled] = ~measured
    off = gone if not screened.pushing else np.zeros_like(gone)
    if gone.any():
        what = "disabled" if not screened.pushing else "left enabled: around them columns do not"
        what += " balance, as if they had pushed" if screened.pushing else ""
        zero = "rows and columns of zeros"
        lines.append(
            ("off", f"{np.count_nonzero(gone)} with {zero}, {what}: {names(matrix.layout, gone)}")
        )
    lines += [("do not fit", each.fault) for each in screened.unsure]
    left_out = [each for each in screened.effects if each.code == Code.ACTUATOR_MISFIT]
    for reason in dict.fromkeys(each.detail for each in left_out):
        ids = [i for each in left_out if each.detail == reason for i in each.actuators]
        which = named("actuator", ids, MOST_NAMES)
        lines.append(("do not fit", f"{which}: {reason} (calibrate leaves them out)"))
    return Judged(tuple(lines), off, looks_transposed(k, a), bool(balanced))


def names(layout: Layout, some: NDArray[np.bool_]) -> str:
    """Return the names of some actuators, (n,) true, as many as can be read."""
    ids = layout.id[some].tolist()
    more = f" and {len(ids) - MOST_NAMES} more" if len(ids) > MOST_NAMES else ""
    return ", ".join(map(str, ids[:MOST_NAMES])) + more


def _orientation(k: Array, a: Array) -> str:
    cost, imbalance = rigid_cost_and_imbalance(k, a)
    figures = f"a rigid motion costs {cost:.2g} of the own stiffness, columns miss balance by"
    figures += f" {imbalance:.2g}"
    if looks_transposed(k, a):
        return (
            f"LOOKS TRANSPOSED: {figures}; [i, j] is the force of actuator i per displacement of"
            " sensor j, else it lies the other way round (--transpose)"
        )
    return f"as it should be: {figures}"
