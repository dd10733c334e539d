"""A day that lies off the law of the others, all its actuators or their common scale.

Who lies off is told from the scatter of the other days alone: a day that is off makes a scatter of
its own, behind which it would hide, and who is farthest off on that day would be named. How it
differs from the law of the others, y ~ N(0, V) by its readings and theirs
(`RelativeDays.contrast_of`), has a mean m, and the rest about it; with s and s_c of the other days,

    m^2 / (1'V1 / n^2 + s^2 / n + s_c^2)  ~  F(1, f - 1),
    (y - c)' (V + s^2)^-1 (y - c) / (n - 1)  ~  F(n - 1, nu of s^2),

c being what is common, by that matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import FALSE_ALARM, chance_of_any, f_sf
from truenewton.rounding import percent
from truenewton.tracking.days import DatedCalibration
from truenewton.tracking.linear_fit import RelativeDays, relative_days
from truenewton.tracking.scatter import Scatter, scatter_of

OFF = (  # whether each by itself, or all in common; what to say
    (True, "each actuator in its own way: see how it was taken, or leave it out"),
    (False, "all actuators alike: check its weights, temperature and date, or leave it out"),
)


def widened(
    days: tuple[DatedCalibration, ...],
    on: NDArray[np.bool_],
    settings: Array,
    stay: NDArray[np.bool_],
) -> tuple[tuple[DatedCalibration, ...], str]:
    """Return the days, of which the one that lies off may be off by as much, and say so.

    ``stay``, (n,), are the actuators that are looked at. Days among which none lies off come back
    as they are, with ''.
    """
    found = _outlying(days, on, settings, stay)
    if found is None:
        return days, ""
    j, size, own, words = found
    c = days[j].calibration
    covariance, n = c.covariance.copy(), c.layout.n
    covariance[:n, :n] += size**2 * (np.diag(c.alpha**2) if own else np.outer(c.alpha, c.alpha))
    wider = replace(days[j], calibration=replace(c, covariance=covariance))
    said = f"{days[j].name} lies off the law of the other days by {percent(size)}, {words}"
    return (*days[:j], wider, *days[j + 1 :]), said


def _outlying(
    days: Sequence[DatedCalibration],
    on: NDArray[np.bool_],
    settings: Array,
    stay: NDArray[np.bool_],
) -> tuple[int, float, bool, str] | None:
    """Return the day that lies farthest off, by how much, whether each by itself, and words."""
    if len(days) < settings.shape[1] + 3:
        return None
    relative = relative_days(days, on, settings)
    offs = [_off(relative, stay, j) for j in range(len(days))]
    for own, words in OFF:
        sizes = np.array([np.mean((y - m) ** 2) if own else m**2 for y, _, m, _, _ in offs])
        j = int(sizes.argmax())
        y, v, m, variance, share = offs[j]
        rest = relative.without(j).contrasts()
        scatter = scatter_of(*rest, np.eye(len(stay)), stay, common=True)
        chance = (
            _chance_of_all(y, v, scatter)
            if own
            else _chance_of_common(m, variance, len(y), scatter)
        )
        if chance_of_any(chance, len(OFF) * len(days)) < FALSE_ALARM:
            return j, float(np.sqrt(sizes[j]) / share), own, words
    return None


def _off(
    relative: RelativeDays, stay: NDArray[np.bool_], day: int
) -> tuple[Array, Array, float, float, float]:
    """Return how a day is off, its covariance, the mean and its variance, the share it has."""
    contrast, covariance, share = relative.contrast_of(day)
    y, v = contrast[stay], covariance[np.ix_(stay, stay)]
    return y, v, float(y.mean()), float(v.mean()), share


def _chance_of_all(y: Array, v: Array, scatter: Scatter) -> float:
    v = v + scatter.own**2 * np.eye(len(y))
    # What is common is not asked: it may be anything.
    one = np.linalg.solve(v, np.ones(len(y)))
    chi2 = float(y @ np.linalg.solve(v, y) - (one @ y) ** 2 / one.sum())
    degrees = scatter.degrees_of(float(np.mean(np.diag(v))))
    return float(f_sf(chi2 / (len(y) - 1), len(y) - 1, degrees))


def _chance_of_common(mean: float, variance: float, actuators: int, scatter: Scatter) -> float:
    variance += scatter.common**2 + scatter.own**2 / actuators
    return float(f_sf(mean**2 / variance, 1, scatter.degrees))
