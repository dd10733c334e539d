"""When to calibrate again: how far in temperature and time alpha holds to a wanted accuracy."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.tracking.days import YEAR
from truenewton.tracking.law import Tracking
from truenewton.tracking.scatter import expanded


@dataclass(frozen=True)
class Validity:
    """How long alpha holds to a wanted accuracy.

    Errors of the weights are left out: a new calibration with the same weights would repeat them.
    Nothing is promised where no day has been: temperatures end with those of the days, and times
    as long after the last day as the days lasted.

    Attributes
    ----------
    accuracy
        Wanted: standard uncertainty relative to alpha, root mean square over actuators.
    now
        What the latest calibration has.
    temperatures
        Between which the latest calibration holds as it is, on its day [deg C]; None where its
        effect is not known.
    until
        When it ceases to hold at its temperature; None where drift is not known.
    law_temperatures, law_until
        The same for `Tracking.alpha_at`, which takes temperature and time into account.
    reach, reach_until
        The temperatures of the days, and the last date that they tell of: no promise goes beyond.
        None where the effect is not known.

    Examples
    --------
    >>> validity = tn.validity_of(tn.track(calibration, warm), accuracy=0.005)
    >>> validity.until is None  # nothing tells the drift
    True
    """

    accuracy: float
    now: float
    temperatures: tuple[float, float] | None
    until: datetime.datetime | None
    law_temperatures: tuple[float, float] | None
    law_until: datetime.datetime | None
    reach: tuple[float, float] | None
    reach_until: datetime.datetime | None


def validity_of(tracking: Tracking, accuracy: float) -> Validity:
    """Return how far from its temperature and date the latest calibration holds.

    Used as it is, it is off by k (T - T_last) + d (t - t_last) beside its E_STAT, and by the
    scatter of its day and of the other; the mean over actuators of the square of all is a parabola
    in T - T_last and in t - t_last. So is that of what the law itself is uncertain by, and of the
    scatter of a day about it, in T - T0 and t - t0.

    Parameters
    ----------
    tracking
        The law.
    accuracy
        Wanted: standard uncertainty relative to alpha, root mean square over actuators.

    Examples
    --------
    >>> validity = tn.validity_of(tn.track(calibration, warm), accuracy=0.005)
    >>> "from {:.0f} to {:.0f} deg C".format(*validity.temperatures or ())
    'from 25 to 30 deg C'
    """
    t, last = tracking, tracking.days[-1]
    on, form = np.isfinite(t.alpha), _law_variance(t)
    between = 2 * _scatter_variance(t)
    now = float(np.mean((last.error[on] / last.alpha[on]) ** 2)) + between
    k = float(np.mean(t.coefficient[on] ** 2) + form[1, 1])
    d = float(np.mean((t.drift[on] / t.alpha[on]) ** 2) + form[2, 2])
    spare = max(accuracy**2 - now, 0.0)
    warm, late = "temperature" in t.effects, "drift" in t.effects
    reach = float(np.sqrt(spare / k)) if k > 0 else np.inf if spare else 0.0
    away = last.temperature - t.temperature if warm else 0.0
    years = (last.date - t.date) / YEAR if late else 0.0
    span = _roots(form, accuracy**2, 1, years) if warm else None
    end = _roots(form, accuracy**2, 2, away) if late else None
    coldest, warmest = t.span or (0.0, 0.0)
    latest = last.date + (last.date - t.days[0].date)

    def within(low: float, high: float) -> tuple[float, float] | None:
        span = max(low, coldest), min(high, warmest)
        return span if span[0] <= span[1] else None

    def by(start: datetime.datetime, away: float) -> datetime.datetime:
        return latest if away >= (latest - start) / YEAR else start + away * YEAR

    return Validity(
        accuracy=accuracy,
        now=float(np.sqrt(now)),
        temperatures=within(last.temperature - reach, last.temperature + reach) if warm else None,
        until=by(last.date, float(np.sqrt(spare / d)) if d > 0 else np.inf) if late else None,
        law_temperatures=within(t.temperature + span[0], t.temperature + span[1]) if span else None,
        law_until=by(t.date, end[1]) if end else None,
        reach=t.span,
        reach_until=latest if late else None,
    )


def _scatter_variance(tracking: Tracking) -> float:
    """Return the mean square of what a day scatters by about the law."""
    common = expanded(tracking.common_scatter, tracking.scatter_degrees)
    return float(np.nanmean(tracking.scatter**2)) + common**2


def _law_variance(tracking: Tracking) -> Array:
    """Return (3, 3) the mean relative variance of alpha_at as a form in (1, T - T0, t - t0).

    The readings' part and the scatter of days; k multiplies alpha, d does not.
    """
    on, n = np.isfinite(tracking.alpha), tracking.layout.n
    alpha = tracking.alpha[on]
    scale = np.array([1 / alpha, np.ones_like(alpha), 1 / alpha])
    blocks = (tracking.covariance - tracking.systematic_covariance).reshape(3, n, 3, n)
    own = np.einsum("aibi->abi", blocks)[:, :, on]
    form = np.asarray(np.mean(own * scale[:, None] * scale[None], axis=2))
    form[0, 0] += _scatter_variance(tracking)
    return form


def _roots(form: Array, limit: float, axis: int, other: float) -> tuple[float, float] | None:
    """Return where the form meets the limit along one axis; None where it never stays below."""
    at = np.array([1.0, 0.0, 0.0])
    at[3 - axis] = other
    a, b, c = form[axis, axis], form[axis] @ at, at @ form @ at - limit
    if a <= 0.0 or b * b - a * c < 0.0:
        return None
    root = np.sqrt(b * b - a * c)
    return float((-b - root) / a), float((-b + root) / a)
