"""Sensors of a stiffness matrix that read something else, told from actuators that push otherwise.

Symmetry gives the factor of a row over that of its column, and says not which of them is off. The
columns of the neighbours do: they balance with the row of the actuator as it is, whatever the gain
of its sensor, but not with a row that was made to agree with its column.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.matrix.couplings import pair_ratios, typical_spacing

MIN_GAIN_FACTOR = 1.1  # from that of other sensors, from which one is wrong, and
# Times what is typical of log t: sensors off their magnets feign gains, all of them.
MIN_GAIN_DEVIATION = 4.5
MAX_GAIN_REMAINDER = 0.5  # of what the columns around are out of balance by, at most
SAME_ELEMENT_TOLERANCE = 0.03  # of an own element
TRANSPOSE_TOLERANCE = 0.03  # of an element, that it may differ from its transpose
MAX_SOUGHT_FACTOR = 30.0  # factor that is looked for
FACTOR_PENALTY = 0.03  # imbalance, in terms of an own element, that pays for one factor of 2
MIN_IMBALANCE_RATIO = 5.0  # times what is typical: columns out of balance
# Of what those columns are out of balance by, if many gains are wrong at once.
MAX_COMMON_REMAINDER = 0.05
MIN_LOG_FACTOR = 0.02  # factor that is taken for none, in reweighting


def wrong_gains(
    even: Array, a: Array, strong: NDArray[np.bool_], noisy: Sequence[int] = ()
) -> Array:
    """Return (n,) gains of the sensors, 1 but where one is wrong.

    A gain g makes a row that agrees with its column g times too large. Many in one sector are found
    together if that cures all columns around; else one by one, each the median over the columns
    around it, the one that cures most first. A sensor off its magnet reads a slope besides, which
    looks like a gain; so one is wrong only if it stands out from what the others seem to have.

    Parameters
    ----------
    even
        (n, n) stiffness, rows scaled to agree with the columns.
    a
        (3, n) arms in comparable units.
    strong
        (n, n) which pairs are coupled, the diagonal not.
    noisy
        Whose columns are unlike their rows: where many are found together, what noise leaves of
        these out of balance is no matter of rows.
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
        cures = far & (costs[1] < MAX_GAIN_REMAINDER * costs[0])
        if not cures.any():
            break
        i = int(np.argmax(np.where(cures, costs[0] - costs[1], -np.inf)))
        even[i] *= t[i]
        even[:, i] *= t[i]
        own[i] *= t[i] ** 2
        gain[i] /= t[i]
    return gain


def _own(even: Array) -> Array:
    """Return (n,) sizes of the own elements; the median where one is 0."""
    own = np.abs(np.diag(even))
    return np.where(own > 0.0, own, np.median(own))


def _gains_together(even: Array, a: Array, noisy: Sequence[int]) -> Array | None:
    """Return (n,) gains that cure the columns about them all; None where no few do.

    Rows t with a diag(t) K = 0 by least absolute imbalance of columns, |t - 1| of each row
    penalized, so that few differ from 1; then these alone, without penalty.
    """
    columns = even / _own(even)
    before = np.linalg.norm(a @ columns, axis=0)
    out = before > MIN_IMBALANCE_RATIO * np.median(before)
    columns[:, list(noisy)], out[list(noisy)] = 0.0, False
    far = np.arange(len(even))
    for penalty in (FACTOR_PENALTY, 1e-6):  # the second as good as none
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
    """Return (n,) factors of rows, some of them not 1, by which (n, n) columns balance best."""
    t, products = np.ones(len(columns)), a.T @ a
    for _ in range(25):
        size = np.linalg.norm((a * t) @ columns, axis=0)
        weight = 1.0 / np.maximum(size, max(float(np.median(size)), 1e-6))
        square = products[some] * ((columns[some] * weight) @ columns.T)
        held = penalty / np.maximum(np.abs(t[some] - 1.0), MIN_LOG_FACTOR)
        step = np.linalg.solve(square[:, some] + np.diag(held), square.sum(axis=1))
        change, t[some] = np.abs(t[some] - 1.0 + step).max(), 1.0 - step
        if change < 1e-3:
            break
    return t


def signs(even: Array, a: Array, wrong: NDArray[np.int64], strong: NDArray[np.bool_]) -> Array:
    """Return (n,) signs of the sensors, -1 where the sensor is turned and not the coil.

    Either turns the own element and makes row and column differ in sign; but if it is the sensor,
    the columns around balance with the row as it was measured.

    Parameters
    ----------
    even
        (n, n) stiffness, rows scaled and turned to agree with the columns.
    a
        (3, n) arms in comparable units.
    wrong
        Actuators of wrong sign.
    strong
        (n, n) which pairs are coupled, the diagonal not.
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
    """Return the matrix with rows that are zero by their columns and the reverse, and which.

    An actuator of which a row is there pushed, whatever its sensor reads; one of which the column
    is there pushed if the other columns balance with the row that symmetry lets expect.

    Parameters
    ----------
    k, a
        (n, n) stiffness [N/m] and (3, n) arms in comparable units.

    Returns
    -------
    Array
        (n, n), own elements as they balance.
    rows, columns
        Indices of those that were zero.
    """
    there, read = k.any(axis=1), k.any(axis=0)
    rows, columns = np.flatnonzero(read & ~there), np.flatnonzero(there & ~read)
    if not (rows.size or columns.size):
        return k, rows, columns
    factor = np.exp(pair_ratios(k)[0])[:, None]
    even = factor * k
    even = columns_by_rows(even, a, columns)
    filled = columns_by_rows(even.T, a, rows).T
    sound = there & read
    own = np.diag(even)[sound]
    before, after = (
        np.sum(np.abs(a @ each[:, sound] / np.where(own != 0.0, own, np.inf)))
        for each in (even, filled)
    )
    if after > MAX_GAIN_REMAINDER * before:
        return even / factor, rows[:0], columns
    return filled / factor, rows, columns


def better_by_row(even: Array, a: Array, i: int, near: NDArray[np.bool_]) -> bool:
    """Tell whether columns near an actuator balance better with its row than with its column.

    Parameters
    ----------
    even
        (n, n) stiffness, rows scaled to agree with the columns.
    a
        (3, n) arms in comparable units.
    i
        The actuator.
    near
        (n,) the columns to judge by.
    """
    rho = a @ even
    by_column = rho + a[:, [i]] * (even[:, i] - even[i])
    own = _own(even)
    sizes = [np.sum((np.linalg.norm(each, axis=0) / own)[near]) for each in (rho, by_column)]
    return bool(sizes[0] <= sizes[1])


def agrees(even: Array, i: int, near: NDArray[np.bool_]) -> bool:
    """Tell whether a column of an (n, n) stiffness is its row, at the (n,) others near it."""
    far = np.abs(even[near, i] - even[i, near]) > TRANSPOSE_TOLERANCE * np.abs(even[i, near])
    return not far.any() or float(np.median(far)) < 0.5


def columns_by_rows(even: Array, a: Array, bad: NDArray[np.int64]) -> Array:
    """Return an (n, n) stiffness with the columns of bad sensors by the rows of their actuators.

    Between two of them neither element is right: both count half, and take what the column is then
    out of balance by, those of neighbours most.
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

    Its own element is as read if the column balances so, else what balances it.

    Parameters
    ----------
    even, a, i
        As in `better_by_row`.
    """
    column = even[i].copy()
    column[i] = 0.0
    balanced = -float(a[:, i] @ (a @ column)) / float(a[:, i] @ a[:, i])
    alike = abs(balanced - even[i, i]) < SAME_ELEMENT_TOLERANCE * abs(balanced)
    column[i] = even[i, i] if alike else balanced
    return np.asarray(column)
