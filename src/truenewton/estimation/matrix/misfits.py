"""Actuators and sensors of a stiffness matrix that do not fit the others.

A true stiffness is symmetric. A measured one becomes symmetric if each row is multiplied by a
factor, which pairs of neighbours give robustly. An actuator is a misfit if its scaled row has the
wrong sign or size, differs from its column, belongs to another position, or unbalances a column.
Misfits are eliminated: in states in which they exert no force, their data are not needed.

Symmetry gives the factor of a row relative to its column, but not which of the two is wrong. The
columns of the neighbours decide: they balance with the measured row, whatever its sensor gain, but
not with a row that was scaled to agree with a wrong column.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import RankDeficient
from truenewton.estimation.findings.code import LIMITS
from truenewton.estimation.matrix.couplings import (
    ELSEWHERE,
    NEAR_SPACINGS,
    displaced,
    pair_ratios,
    relative_couplings,
    typical_spacing,
)
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.estimation.matrix.order import row_order

MIN_GAIN_FACTOR = 1.1  # relative to other sensors; a smaller factor is tolerated
# |log gain| relative to the median, because every sensor off its magnet has an apparent gain.
MIN_GAIN_DEVIATION = 4.5
MAX_GAIN_REMAINDER = 0.5  # imbalance of adjacent columns, corrected relative to uncorrected
ELEMENT_TOLERANCE = 0.03  # relative; an element within it equals its transpose
MAX_SOUGHT_FACTOR = 30.0  # largest gain error in the search
MIN_IMBALANCE_RATIO = 5.0  # an unbalanced column, relative to the median
MAX_COMMON_REMAINDER = 0.05  # as MAX_GAIN_REMAINDER, if gains are found together


def wrong_gains(
    even: Array, a: Array, strong: NDArray[np.bool_], noisy: Sequence[int] = ()
) -> Array:
    """Return (n,) gains of the sensors, 1 except where one is wrong.

    If a sensor gain is g, the row that agrees with its column is g times too large. Wrong gains in
    one sector are found together if they balance all adjacent columns. Otherwise the most effective
    one is found first, each by the median over its adjacent columns. A sensor off its magnet also
    measures a slope, which looks like a gain; a wrong gain must therefore be an outlier.

    ``even`` is the (n, n) stiffness with rows scaled to agree with the columns, ``a`` (3, n) arms,
    and ``strong`` (n, n) marks coupled pairs. The columns of ``noisy`` actuators differ from their
    rows. When gains are found together, the imbalance of these columns is ignored.
    """
    together = _gains_together(even, a, noisy)
    if together is not None:
        return together
    even, n = even.copy(), len(even)
    own = _own(even)
    length, gain = np.sum(a**2, axis=0), np.ones(n)
    some = strong & (even != 0.0)
    around = some.any(axis=1)
    if not around.any():
        return gain
    for _ in range(n):
        rho = a @ even
        along = a.T @ rho
        each = np.full_like(even, np.nan)
        np.divide(-along, length[:, None] * even, out=each, where=some)
        t = np.ones(n)
        t[around] = np.clip(
            1.0 + np.nanmedian(each[around], axis=1), 1.0 / MAX_SOUGHT_FACTOR, MAX_SOUGHT_FACTOR
        )
        change = (t - 1.0)[:, None] * even
        before = np.sum(rho**2, axis=0)
        after = np.maximum(before + 2.0 * change * along + change**2 * length[:, None], 0.0)
        costs = [np.sum(np.sqrt(each) / own * some, axis=1) for each in (before, after)]
        size = np.abs(np.log(t))
        far = size > max(
            np.log(MIN_GAIN_FACTOR), MIN_GAIN_DEVIATION * float(np.median(size[around]))
        )
        effective = far & (costs[1] < MAX_GAIN_REMAINDER * costs[0])
        if not effective.any():
            break
        i = int(np.argmax(np.where(effective, costs[0] - costs[1], -np.inf)))
        even[i] *= t[i]
        even[:, i] *= t[i]
        own[i] *= t[i] ** 2
        gain[i] /= t[i]
    return gain


def _own(even: Array) -> Array:
    """Return (n,) absolute diagonal elements, with zeros replaced by the median."""
    own = np.abs(np.diag(even))
    return np.where(own > 0.0, own, np.median(own))


def _gains_together(even: Array, a: Array, noisy: Sequence[int]) -> Array | None:
    """Return (n,) gains that balance all adjacent columns; None if this requires many wrong gains.

    The row factors t minimise the absolute imbalance of a diag(t) K. A penalty on |t - 1| keeps
    most of them at 1; the others are then fitted without penalty.
    """
    columns = even / _own(even)
    before = np.linalg.norm(a @ columns, axis=0)
    out = before > MIN_IMBALANCE_RATIO * np.median(before)
    columns[:, list(noisy)], out[list(noisy)] = 0.0, False
    far = np.arange(len(even))
    # A factor of 2 must remove an imbalance of 3 % of a diagonal element; then no penalty.
    for penalty in (0.03, 1e-6):
        t = _row_factors(columns, a, far, penalty)
        far = np.flatnonzero(
            np.abs(np.log(np.maximum(t, 1.0 / MAX_SOUGHT_FACTOR))) > np.log(MIN_GAIN_FACTOR)
        )
        around = out.copy()
        around[far] = False
        if not 0 < far.size < np.count_nonzero(around):
            return None
    after = np.linalg.norm((a * t) @ columns, axis=0)
    if (t[far] < 1.0 / MAX_SOUGHT_FACTOR).any() or after[
        around
    ].sum() > MAX_COMMON_REMAINDER * before[around].sum():
        return None
    gain = np.ones(len(even))
    gain[far] = 1.0 / t[far]
    return gain


def _row_factors(columns: Array, a: Array, some: NDArray[np.int64], penalty: float) -> Array:
    """Return the (n,) row factors that balance the columns best, 1 except for the rows ``some``."""
    t, products = np.ones(len(columns)), a.T @ a
    for _ in range(25):
        size = np.linalg.norm((a * t) @ columns, axis=0)
        weight = 1.0 / np.maximum(size, max(float(np.median(size)), 1e-6))
        square = products[some] * ((columns[some] * weight) @ columns.T)
        prior = penalty / np.maximum(np.abs(t[some] - 1.0), 0.02)
        step = np.linalg.solve(square[:, some] + np.diag(prior), square.sum(axis=1))
        change, t[some] = np.abs(t[some] - 1.0 + step).max(), 1.0 - step
        if change < 1e-3:
            break
    return t


def signs(even: Array, a: Array, wrong: NDArray[np.int64], strong: NDArray[np.bool_]) -> Array:
    """Return (n,) signs of the sensors, -1 for a reversed sensor (and not a reversed coil).

    Both reverse the diagonal element, and make row and column differ in sign. If the sensor is
    reversed, adjacent columns balance with the measured row. ``wrong`` are indices of actuators of
    wrong sign; the other arguments are those of `wrong_gains`.
    """
    own = _own(even)
    rho, sign = a @ even, np.ones(len(even))
    for i in wrong.tolist():
        as_measured = rho - 2.0 * a[:, [i]] * even[i]
        size, other = (np.linalg.norm(each, axis=0) / own for each in (rho, as_measured))
        if np.sum(other[strong[i]]) < np.sum(size[strong[i]]):
            sign[i], rho = -1.0, as_measured
    return sign


def fill_by_symmetry(k: Array, a: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Return the (n, n) matrix with zero rows filled from columns and vice versa; their indices.

    An actuator whose row is not zero exerted force. One with only a column exerted force if the
    other columns balance with the row that symmetry predicts. Arms are (3, n).
    """
    has_row, has_column = k.any(axis=1), k.any(axis=0)
    rows = np.flatnonzero(has_column & ~has_row)
    columns = np.flatnonzero(has_row & ~has_column)
    if not (rows.size or columns.size):
        return k, rows, columns
    factor = np.exp(pair_ratios(k)[0])[:, None]
    even = factor * k
    even = columns_by_rows(even, a, columns)
    filled = columns_by_rows(even.T, a, rows).T
    sound = has_row & has_column
    own = np.diag(even)[sound]
    before, after = (
        np.sum(np.abs(a @ each[:, sound] / np.where(own != 0.0, own, np.inf)))
        for each in (even, filled)
    )
    if after > MAX_GAIN_REMAINDER * before:
        return even / factor, rows[:0], columns
    return filled / factor, rows, columns


def agrees(even: Array, i: int, near: NDArray[np.bool_]) -> bool:
    """Return whether most elements of column and row i agree, at (n,) neighbours ``near``."""
    far = np.abs(even[near, i] - even[i, near]) > ELEMENT_TOLERANCE * np.abs(even[i, near])
    return not far.any() or float(np.median(far)) < 0.5


def columns_by_rows(even: Array, a: Array, bad: NDArray[np.int64]) -> Array:
    """Return an (n, n) stiffness with the columns of bad sensors replaced by their rows.

    Both elements between two bad sensors are wrong. They are averaged and then corrected so that
    the column balances, neighbours most. Arms are (3, n).
    """
    out, some = even.copy(), np.ix_(bad, bad)
    out[some] = 0.5 * (even[some] + even[some].T)
    for i in bad.tolist():
        out[:, i] = column_by_row(out, a, i)
    if bad.size < 2:
        return out
    arms, spacing = a[:, bad], typical_spacing(a)
    distance = np.hypot(arms[1][:, None] - arms[1], arms[2][:, None] - arms[2])
    for i, weight in zip(bad.tolist(), (1.0 + (distance / spacing) ** 2) ** -2.0, strict=True):
        reach = (weight * arms).T
        out[bad, i] -= reach @ np.linalg.pinv(arms @ reach) @ (a @ out[:, i])
    out[some] = 0.5 * (out[some] + out[some].T)
    return out


def column_by_row(even: Array, a: Array, i: int) -> Array:
    """Return the (n,) column of a bad sensor: the row of its actuator.

    The diagonal element is kept if it balances the column, and otherwise replaced by one that does.
    """
    column = even[i].copy()
    column[i] = 0.0
    balanced = -float(a[:, i] @ (a @ column)) / float(a[:, i] @ a[:, i])
    agree = abs(balanced - even[i, i]) < ELEMENT_TOLERANCE * abs(balanced)
    column[i] = even[i, i] if agree else balanced
    return np.asarray(column)


MAX_ALPHA_RATIO = 3.0  # of alpha relative to the median
ASYMMETRY_RATIO = 8.0  # asymmetry of an actuator relative to the median
COLUMN_IMBALANCE_RATIO = 12.0  # imbalance of a column relative to the median
# Smallest asymmetry (relative to the couplings) or imbalance (to the diagonal) of a misfit.
MIN_MISFIT = 0.05
ELEMENT_RATIO = 30.0  # asymmetry, relative to elements of similar size and of the two actuators
NORMAL_TAIL = 3.8  # 99 % quantile of the absolute values of normal noise, relative to their median
MIN_ELEMENT_DIFFERENCE = 0.01  # from the transpose, relative to the diagonal
MIN_EXCHANGE_GAIN = 1.2  # misfit relative to that after an exchange; sound neighbours reach 0.6

OTHER_ORDER, OTHER_SIGN = "its row or column exchanged with another", "wrong sign"
SENSOR_SIGN = "its sensor has the other sign"
SENSOR_GAIN, SENSOR = "its sensor gain is an outlier", "its sensor reads something else"
ROW_UNLIKE_COLUMN = "its row unlike its column"
ELEMENT_WRONG = "an element of its row is wrong"
NO_SENSOR, NO_FORCE = "its sensor reads nothing", "its row is empty or a copy, though it pushed"
# Force at zero command after correction, relative to the couplings, if the row is unknown.
UNKNOWN_FORCE = 0.3
REMAINING_FORCES = {
    SENSOR: 0.1,
    NO_SENSOR: UNKNOWN_FORCE,
    NO_FORCE: UNKNOWN_FORCE,
    ROW_UNLIKE_COLUMN: UNKNOWN_FORCE,
    ELEMENT_WRONG: 0.03,
}


@dataclass(frozen=True)
class BadActuator:
    """A misfit: the index of the actuator, the reason, and the size as a ratio."""

    index: int
    reason: str
    size: float

    @property
    def doubt(self) -> float:
        """Possible force at zero command after correction, relative to the couplings."""
        return REMAINING_FORCES.get(self.reason, 0.0)


class FitsNoSymmetry(Exception):
    """Too many actuators, by their indices, do not fit; ``certain`` if by their order or sign."""

    def __init__(self, indices: Sequence[int], *, certain: bool) -> None:
        self.indices, self.certain = indices, certain
        super().__init__(f"{len(indices)} misfits")


def bad_actuators(
    facts: MatrixFacts, gaps: Array, filled: Sequence[int] = ()
) -> tuple[tuple[BadActuator, ...], Array]:
    """Return the misfits, and the (n, n) stiffness corrected where possible.

    ``facts`` are those of a stiffness without empty rows or columns. ``gaps`` are (3, m) arms of
    actuators that are not in the matrix, so that adjacent columns may be unbalanced. ``filled`` are
    indices of rows or columns that were filled by symmetry.

    Raises
    ------
    RankDeficient
        Most rows have the wrong order.
    FitsNoSymmetry
        There are too many misfits.
    """
    found: dict[int, BadActuator] = {}
    k, a, n = facts.stiffness, facts.arms, len(facts.stiffness)

    def add(reason: str, sizes: Iterable[tuple[Any, float]]) -> None:
        for index, size in sizes:
            found.setdefault(int(index), BadActuator(int(index), reason, float(size)))
        if len(found) > max(2, LIMITS.misfit_fraction * n):
            raise FitsNoSymmetry(sorted(found), certain=reason in (OTHER_ORDER, OTHER_SIGN))

    order = row_order(k)
    moved = np.flatnonzero(order != np.arange(n))
    if 2 * len(moved) > n:
        raise RankDeficient(
            f"{len(moved)} of {n} rows of STIFFNESS are not in the order of its columns",
            remedy="put the rows of STIFFNESS in the order of its columns, that of ACTUATORS",
        )
    add(OTHER_ORDER, ((i, 1.0) for i in moved))
    own = np.diag(k[order])
    sign = 1.0 if np.count_nonzero(own > 0.0) >= np.count_nonzero(own < 0.0) else -1.0
    wrong = np.flatnonzero(sign * own < 0.0)
    add(OTHER_SIGN, zip(wrong, own[wrong] / np.median(own), strict=True))
    factor = np.where(own < 0.0, -1.0, 1.0)
    as_measured = (factor > 0.0).all() and not moved.size
    ratios = facts.pair_ratios if as_measured else pair_ratios(factor[:, None] * k[order])
    log_alpha, misfit = ratios[0], ratios[1].copy()
    linked = ~np.isnan(misfit)
    even = (factor * np.exp(log_alpha))[:, None] * k[order]
    off = displaced(even, a)
    moved = np.flatnonzero(off.any(axis=0))
    add(ELSEWHERE, zip(moved, np.hypot(*off[1:, moved]), strict=True))
    a = a + off
    turned = signs(even, a, wrong, linked)
    found |= {i: replace(found[i], reason=SENSOR_SIGN) for i in np.flatnonzero(turned < 0).tolist()}
    factor, k, even = factor * turned, k * turned, even * np.outer(turned, turned)
    gain = wrong_gains(even, a, linked, [i for i, _ in _unlike_their_columns(misfit)])
    bad_gain = np.flatnonzero(gain != 1.0)
    misfit[bad_gain], misfit[:, bad_gain] = np.nan, np.nan
    log_alpha = log_alpha - np.log(gain)
    far = np.flatnonzero(np.abs(log_alpha) > np.log(MAX_ALPHA_RATIO))
    for i, ratio in zip(far, np.exp(-log_alpha[far]), strict=True):
        add(f"its row {ratio:.2g} times as large as those of others", [(i, ratio)])
    factor = factor * np.exp(log_alpha)
    even = factor[:, None] * k[order] / gain
    only_gain = np.array([agrees(even, i, linked[i]) for i in bad_gain.tolist()], bool)
    for some, reason in ((bad_gain[only_gain], SENSOR_GAIN), (bad_gain[~only_gain], SENSOR)):
        add(reason, zip(some, gain[some], strict=True))
    even = columns_by_rows(even, a, bad_gain[~only_gain])
    unlike = _unlike_their_columns(misfit)
    add(ROW_UNLIKE_COLUMN, unlike)
    _make_alike(even, a, [i for i, _ in unlike], linked)
    place = exchanged_places(even, a)
    moved = np.flatnonzero(place != np.arange(n))
    add("exchanged with a neighbour", ((i, 1.0) for i in moved))
    mended = [*filled, *bad_gain[~only_gain].tolist(), *(i for i, _ in unlike)]
    holes = np.concatenate([gaps, a[:, [i for i, _ in unlike]]], axis=1)
    add(ELEMENT_WRONG, _mend_elements(even, a[:, place], holes, mended))
    return tuple(found[i] for i in sorted(found)), even / factor[:, None]


def _make_alike(even: Array, a: Array, some: Sequence[int], linked: NDArray[np.bool_]) -> None:
    """Replace the row by the column of some actuators, or vice versa, whichever balances better."""
    for i in some:
        rho = a @ even
        by_column = rho + a[:, [i]] * (even[:, i] - even[i])
        out = [np.linalg.norm(each, axis=0) / _own(even) for each in (rho, by_column)]
        if np.sum(out[0][linked[i]]) <= np.sum(out[1][linked[i]]):
            even[:, i] = column_by_row(even, a, i)
        else:
            even[i] = even[:, i]


def _unlike_their_columns(misfit: Array) -> list[tuple[int, float]]:
    """Return actuators whose median asymmetry of couplings is an outlier, the worst first."""
    misfit = np.minimum(misfit, 10.0)
    out: list[tuple[int, float]] = []
    while True:
        linked = np.isfinite(misfit).sum(axis=1)
        typical = np.zeros(len(misfit))
        typical[linked > 0] = np.nanmedian(misfit[linked > 0], axis=1)
        worst, usual = int(np.argmax(typical)), float(np.median(typical))
        if typical[worst] <= max(ASYMMETRY_RATIO * usual, MIN_MISFIT):
            return out
        out.append((worst, float(typical[worst])))
        misfit[worst], misfit[:, worst] = np.nan, np.nan


def exchanged_places(k: Array, a: Array) -> NDArray[np.int64]:
    """Return, for each actuator of an (n, n) stiffness, the index of its position in (3, n) arms.

    The expected coupling is the median of all pairs at the same distance. Two neighbours are
    exchanged, the best pair first, as long as their couplings then fit better.
    """
    x, y = a[1], a[2]
    distance = np.hypot(x[:, None] - x, y[:, None] - y)
    spacing = typical_spacing(a)
    c = relative_couplings(0.5 * (k + k.T))
    bins = np.minimum((distance / spacing * 8.0).astype(int), int(8.0 * NEAR_SPACINGS) + 1)
    profile = np.array([np.median(c[bins == b]) if (bins == b).any() else 0.0
                        for b in range(bins.max() + 1)])  # fmt: skip
    expected, near = profile[bins], distance < NEAR_SPACINGS * spacing
    pairs = list(zip(*np.nonzero(np.triu(distance < 1.8 * spacing, 1)), strict=True))
    place = np.arange(len(k))
    for _ in range(len(k) // 4):
        here = c[np.ix_(actuator_at := np.argsort(place), actuator_at)]
        best = (0.0, 0, 0)
        for i, j in pairs:
            some = near[i] | near[j]
            some[[i, j]] = False
            (ci, cj), (ei, ej) = here[[i, j]][:, some], expected[[i, j]][:, some]
            exchanged = float(np.sum((cj - ei) ** 2) + np.sum((ci - ej) ** 2))
            now = float(np.sum((ci - ei) ** 2) + np.sum((cj - ej) ** 2))
            if now > MIN_EXCHANGE_GAIN * exchanged and now - exchanged > best[0]:
                best = (now - exchanged, int(i), int(j))
        if best[1] == best[2]:
            break
        first, second = actuator_at[[best[1], best[2]]]
        place[[first, second]] = place[[second, first]]
    return place


def _mend_elements(
    k: Array, a: Array, holes: Array, mended: Sequence[int]
) -> list[tuple[int, float]]:
    """Correct single wrong elements in place; return their rows and sizes.

    The unbalanced moments of a column, divided by its unbalanced force, give the row of the error.
    If an element differs from its transpose, the one in the less balanced column is corrected.
    Columns near (3, h) ``holes`` and of ``mended`` actuators may be unbalanced.
    """
    out: list[tuple[int, float]] = []
    own = _own(k)
    rho = (a @ k) / own
    size, spacing = np.linalg.norm(rho, axis=0), typical_spacing(a)
    explained = np.zeros(len(k), dtype=bool)
    for hole in holes.T:
        explained |= np.hypot(a[1] - hole[1], a[2] - hole[2]) < 0.5 * NEAR_SPACINGS * spacing
    c = relative_couplings(k)
    difference, size_of_both = np.abs(c - c.T), np.abs(c) + np.abs(c.T)
    # Two small elements of opposite sign are no smaller for having a small sum.
    level = np.maximum(np.abs(c + c.T), np.minimum(size_of_both, 2.0 * MIN_ELEMENT_DIFFERENCE))
    upper = np.triu_indices(len(k), 1)
    times, usual = np.zeros_like(c), np.zeros(len(upper[0]))
    order = np.argsort(level[upper], kind="stable")
    for some in np.array_split(order, max(1, min(60, len(order) // 200))):  # of similar size
        usual[some] = np.median(difference[upper][some])
    times[upper] = difference[upper] / np.maximum(usual, 1e-300)
    times += times.T
    usual = np.maximum(np.median(times, axis=1), 1.0)
    far = times / np.maximum(usual[:, None], usual)
    wrong = (far > ELEMENT_RATIO) & (difference > MIN_ELEMENT_DIFFERENCE)
    # Sensors off their magnets make a tail longer than that of noise: there, the balance decides.
    certain = ELEMENT_RATIO * max(1.0, float(np.quantile(far[upper], 0.99)) / NORMAL_TAIL)
    pairs, middle = np.argwhere(np.triu(wrong, 1)), float(np.median(size))
    for i, j in pairs[np.argsort(-times[tuple(pairs.T)], kind="stable")]:
        if explained[i] and explained[j]:
            continue
        excess = k[i, j] - k[j, i]
        in_j, in_i = rho[:, j] - excess / own[j] * a[:, i], rho[:, i] + excess / own[i] * a[:, j]
        better_j = np.linalg.norm(in_j) * size[i] < np.linalg.norm(in_i) * size[j]
        row, column = (i, j) if better_j else (j, i)
        balance = in_j if better_j else in_i
        seen = max(MIN_IMBALANCE_RATIO * middle, np.linalg.norm(balance) / MAX_GAIN_REMAINDER)
        if far[i, j] < certain and size[column] < seen:
            continue
        rho[:, column], size[column] = balance, np.linalg.norm(balance)
        k[row, column] = k[column, row]
        out.append((int(row), float(times[i, j])))
    limit = np.maximum(COLUMN_IMBALANCE_RATIO * np.median(size) * usual, MIN_MISFIT)
    size[list(mended)] = 0.0
    for j in np.flatnonzero((size > limit) & ~explained):
        force = rho[:, j] @ a / np.sum(a**2, axis=0)
        remainder = np.linalg.norm(rho[:, [j]] - force * a, axis=0)
        row = int(np.argmin(remainder))
        if explained[row]:
            continue
        k[row, j] -= force[row] * own[j]
        out.append((row, float(size[j])))
    return out


def condensed(k: Array, good: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Return the (g, g) stiffness condensed to good actuators, (g, n) L and (n, g) P.

    The other actuators exert no force: K_gg - K_gb K_bb^-1 K_bg = L K P. To first order, an error E
    of K becomes L E P. ``good`` marks the (n,) actuators that are kept. Actuators with an empty row
    or column of the (n, n) ``k`` are omitted.
    """
    left, right = np.eye(len(k))[good], np.eye(len(k))[:, good]
    free = np.asarray(~good & k.any(axis=1) & k.any(axis=0), dtype=np.bool_)
    if free.any():
        inverse = np.linalg.pinv(k[np.ix_(free, free)], rcond=1e-6)
        left[:, free] = -k[np.ix_(good, free)] @ inverse
        right[free] = -inverse @ k[np.ix_(free, good)]
    # L K suffices instead of L K P: the rows of K P of the free actuators are zero.
    core = k[np.ix_(good, good)] + left[:, free] @ k[np.ix_(free, good)]
    return np.asarray(core), left, right


def residual_force(
    k: Array, a: Array, good: NDArray[np.bool_], doubt: NDArray[np.float64]
) -> Array:
    """Return (n_good, 3, 3) covariances of forces that omitted actuators may still exert.

    ``k`` is (n, n) [N/m], ``a`` (3, n) arms. ``good`` marks the (n,) actuators that are kept.
    ``doubt`` is the (n,) force relative to the couplings, or to the diagonal for empty rows.
    """
    c = np.abs(relative_couplings(k))
    c = np.maximum(c, c.T)
    c[~c.any(axis=1)] = 1.0
    some, own = np.flatnonzero(doubt > 0.0), np.abs(np.diag(k)[good])
    force = (doubt[:, None] * c)[np.ix_(some, np.flatnonzero(good))] * np.sqrt(own * np.median(own))
    return np.asarray(np.einsum("kb,lb,bm->mkl", a[:, some], a[:, some], force**2))
