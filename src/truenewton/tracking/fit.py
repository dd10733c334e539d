"""`track`: from calibrations of several days to alpha at any temperature and time."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_square
from truenewton.chance import FALSE_ALARM, chance_of_any, f_sf
from truenewton.errors import CampaignMismatch, RankDeficient
from truenewton.rounding import counted
from truenewton.tracking.days import (
    OTHER_UNIT,
    SAME_TEMPERATURE,
    YEAR,
    DatedCalibration,
    Given,
    gather_days,
    named,
    weight_groups,
)
from truenewton.tracking.law import SAME_TIME, DayRecord, Outlier, Tracking
from truenewton.tracking.lines import (
    LinearFit,
    RelativeDays,
    Scatter,
    estimate_scatter,
    expanded,
    linear_fit,
    relative_days,
    widen_outlying_day,
)
from truenewton.tracking.population import (
    Population,
    fit_population,
    most_outlying,
    populations_from,
)

# Of the squares of one effect, independent of the other: below, the two cannot be separated.
MIN_INDEPENDENT_FRACTION = 0.01
MAX_MASKING = 2  # actuators that may mask the next outlier
MIN_SCATTER_DEGREES = 3  # degrees of freedom below which a common scatter is poorly determined
MAX_OUTLIER_FRACTION = 0.25  # of the actuators; with more there is no population


def track(*given: Given, accept_rejected: bool = False, segment: int | None = None) -> Tracking:
    """Find how alpha varies with temperature and time.

    Parameters
    ----------
    given
        Calibrations, campaigns, or paths to them, in any order, of two days or temperatures at
        least. Cycles of one campaign whose temperatures differ by more than 1 K are calibrated
        separately.
    accept_rejected
        Use calibrations with the verdict 'rejected', too.
    segment
        Of the paths the segment to read, as of `read`.

    Raises
    ------
    NotToBeUsed
        The verdict on one of them is 'rejected', and ``accept_rejected`` is not set.
    UnreadableFile, FormatError, CampaignMismatch, SeveralSegments, UnknownName
        Files that cannot be tracked, or not together.
    RankDeficient
        One calibration only, or all at one temperature on one day.

    Examples
    --------
    >>> tracking = tn.track(calibration, warm)
    >>> f"{100 * np.mean(tracking.coefficient):.2f} % per kelvin"
    '-0.10 % per kelvin'
    """
    every = [named(item, segment) for item in given]
    return _law(gather_days(every, accept_rejected=accept_rejected))


def _law(days: tuple[DatedCalibration, ...]) -> Tracking:
    """Return the law of the calibrations, which are in order of time."""
    on = np.all([day.calibration.layout.enabled for day in days], axis=0)
    if np.count_nonzero(on) < 4:
        raise RankDeficient(
            "fewer than four actuators are enabled in every calibration",
            remedy="leave out the calibrations in which many are disabled",
        )
    _refuse_other_units(days, on)
    settings, effects, limits, temperature, date = _settings(days)
    layout = days[0].calibration.layout
    ids, relative = layout.id[on], relative_days(days, on, settings)
    fit, jumped, scatter, own = _fit_lines(relative, ids)
    stay = ~np.isin(ids, [one.actuator for one in jumped])
    wider, outlying = widen_outlying_day(days, relative, stay)
    if outlying:
        fit, jumped, scatter, own = _fit_lines(relative_days(wider, on, settings), ids)
        limits += (outlying,)
    limits += tuple(_limits_of(days, on, scatter, len(effects)))
    outliers, members = _outliers(fit, effects, ids, jumped)
    values, covariance, systematic_covariance, populations = _pooled(fit, members, effects)
    law, derivatives = _law_from(values, effects)
    covariance, systematic_covariance = (
        spread_square(derivatives @ matrix @ derivatives.T, np.tile(on, 3))
        for matrix in (covariance, systematic_covariance)
    )
    return Tracking(
        instrument=days[0].calibration.instrument,
        layout=layout,
        temperature=temperature,
        date=date,
        alpha=spread(law[0], on),
        coefficient=spread(law[1], on),
        drift=spread(law[2], on),
        covariance=covariance,
        systematic_covariance=systematic_covariance,
        effects=effects,
        populations=populations,
        outliers=outliers,
        chi2=fit.chi2,
        degrees_of_freedom=len(fit.alpha) * fit.actuator_degrees,
        limits=limits,
        scatter=spread(own, on),
        common_scatter=scatter.common,
        scatter_degrees=scatter.degrees,
        days=tuple(
            DayRecord(
                day.name,
                day.date,
                c.temperature,
                c.alpha,
                c.statistical_error,
                str(c.verdict.level),
            )
            for day, c in ((day, day.calibration) for day in days)
        ),
    )


def _refuse_other_units(days: Sequence[DatedCalibration], on: NDArray[np.bool_]) -> None:
    """Raise `CampaignMismatch` if alpha shows that two mirrors share a name."""
    alpha = np.array([day.calibration.alpha[on] for day in days])
    ratio = alpha / alpha[0]
    ratio /= np.median(ratio, axis=1)[:, None]  # the scales may differ
    apart = np.median(np.abs(ratio - 1.0), axis=1)
    error = np.median([day.calibration.statistical_error[on] for day in days] / alpha, axis=1)
    excess = apart - OTHER_UNIT - 3 * np.hypot(error, error[0])
    worst = int(np.argmax(excess))
    if excess[worst] > 0.0:
        raise CampaignMismatch(
            f"alpha of a typical actuator differs by {100 * apart[worst]:.2g} % from that in"
            f" {days[0].name}, more than any temperature explains",
            remedy="track only calibrations of the same mirror",
            path=days[worst].name,
        )


def _settings(
    days: Sequence[DatedCalibration],
) -> tuple[Array, tuple[str, ...], tuple[str, ...], float, datetime.datetime]:
    """Return (J, q) temperature and time of the days, relative to their middle.

    Also the q effects that they determine, limitations, T0 and t0.
    """
    first = days[0].date
    seconds = [(day.date - first).total_seconds() for day in days]
    date = first + datetime.timedelta(seconds=round(float(np.mean(seconds))))
    time = np.array([(day.date - date) / YEAR for day in days])
    temperatures = np.array([day.calibration.temperature for day in days])
    temperature = float(temperatures.mean())
    away = temperatures - temperature
    warm, late = np.ptp(temperatures) > SAME_TEMPERATURE, days[-1].date - first > SAME_TIME
    limits: tuple[str, ...] = ()
    if not np.isfinite(temperature):
        limits += (
            "no calibration has a temperature, so the drift includes effects of temperature",
        )
    elif not warm:
        limits += (
            "all calibrations have the same temperature, so the temperature coefficient is not"
            " determined",
        )
    if warm and late:
        centred = time - time.mean()
        slope = (away @ centred) / (away @ away)
        if np.sum((centred - slope * away) ** 2) < MIN_INDEPENDENT_FRACTION * np.sum(centred**2):
            late = False
            limits += (
                "temperature and time changed together, so all changes are assigned to temperature,"
                " and the drift is not determined",
            )
    elif not late:
        limits += ("all data were taken on one day, so the drift is not determined",)
    if not (warm or late):
        raise RankDeficient(
            "all calibrations have the same date and temperature",
            remedy="add a calibration of another day or temperature",
            path=days[-1].name,
        )
    settings = {"temperature": away} if warm else {}
    settings |= {"drift": time} if late else {}
    return np.stack([*settings.values()], axis=1), tuple(settings), limits, temperature, date


def _fit_lines(
    days: RelativeDays, ids: NDArray[np.int64]
) -> tuple[LinearFit, list[Outlier], Scatter, Array]:
    """Fit the lines, and find actuators that lie on none.

    The worst is released first, its scatter then included: errors of actuators are correlated, so
    one that jumped shifts others. Common scatter is no jump; its degrees of freedom make this an F
    test. Returns the fit, the outliers, the scatter, and the (n,) scatter of each actuator.
    """
    n = len(ids)
    jumped: list[Outlier] = []
    stay, own = np.ones(n, dtype=bool), np.zeros(n)
    contrasts, covariance = days.contrasts()
    while True:
        scatter = Scatter()
        if len(contrasts):
            scatter = estimate_scatter(contrasts, covariance, np.eye(n), stay, common=True)
        own = np.where(stay, scatter.own, np.maximum(own, scatter.own))
        fit = linear_fit(days, own, expanded(scatter.common, scatter.degrees))
        if not fit.actuator_degrees or len(jumped) >= MAX_OUTLIER_FRACTION * n:
            return fit, jumped, scatter, own
        worst = int(np.where(stay, fit.actuator_chi2, 0.0).argmax())
        degrees = fit.actuator_degrees
        variance = scatter.own**2 + float(np.mean(np.einsum("paa->pa", covariance)[:, worst]))
        chance = f_sf(fit.actuator_chi2[worst] / degrees, degrees, scatter.degrees_of(variance))
        mirror = chance_of_any(float(chance), n * (1 + days.settings.shape[1]))
        if mirror >= FALSE_ALARM:
            return fit, jumped, scatter, own
        stay[worst], own[worst] = False, fit.own_scatter[worst]
        sigmas = float(np.sqrt(fit.actuator_chi2[worst]))
        jumped.append(Outlier(int(ids[worst]), "line", sigmas, mirror))


def _limits_of(
    days: Sequence[DatedCalibration], on: NDArray[np.bool_], scatter: Scatter, effects: int
) -> Iterator[str]:
    if len(weight_groups(days)) > 1:
        yield "weights or their errors differ between days, so their errors are independent"
    if not on.all():
        count = counted(int(np.count_nonzero(~on)), "actuator")
        yield f"left out, because not enabled on every day: {count}"
    if not scatter.degrees:
        yield (
            f"{counted(days, 'calibration')} determine only the {1 + effects} unknowns of each"
            " line, so the scatter between calibrations is assumed to be zero"
        )
    elif scatter.degrees < MIN_SCATTER_DEGREES:
        yield (
            f"the scatter common to all actuators has only {counted(scatter.degrees, 'degree')} of"
            " freedom, so errors are enlarged; more calibrations reduce them"
        )


def _outliers(
    fit: LinearFit, effects: tuple[str, ...], ids: NDArray[np.int64], jumped: list[Outlier]
) -> tuple[tuple[Outlier, ...], NDArray[np.bool_]]:
    """Return all outliers, and (q, n) the members of the population of each effect.

    The farthest is removed and the next examined, so that one does not mask another.
    """
    q, n = fit.effects.shape
    tests = n * (q + (fit.actuator_degrees > 0))
    members = np.tile(~np.isin(ids, [one.actuator for one in jumped]), (q, 1))
    outliers = [*jumped]
    suspects: list[tuple[int, int, Outlier]] = []
    least = (1 - MAX_OUTLIER_FRACTION) * n
    while len(suspects) < MAX_MASKING and members.sum(axis=1).min() > least:
        y, covariance, which = _effects_of(fit, members)
        population = fit_population(y, covariance, which)
        at, sigmas, chance = most_outlying(y, covariance, which, population)
        effect, actuator = (int(k[at]) for k in np.nonzero(members))
        mirror = chance_of_any(chance, tests)
        outlier = Outlier(int(ids[actuator]), effects[effect], sigmas, mirror)
        suspects.append((effect, actuator, outlier))
        members[effect, actuator] = False
        if mirror < FALSE_ALARM:
            outliers += [one for _, _, one in suspects]
            suspects.clear()
    for effect, actuator, _ in suspects:
        members[effect, actuator] = True
    return tuple(sorted(outliers, key=lambda one: one.probability)), members


def _effects_of(
    fit: LinearFit, members: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the effects of the members, their covariance, and the index of each effect."""
    root = fit.root[fit.alpha.size :][members.ravel()]
    return fit.effects[members], root @ root.T, np.nonzero(members)[0]


def _pooled(
    fit: LinearFit, members: NDArray[np.bool_], effects: tuple[str, ...]
) -> tuple[Array, Array, Array, tuple[Population, ...]]:
    """Predict the effects of the members from their population.

    Returns (1 + q, n) alpha and effects, their covariance, its part from the weights, the
    populations.
    """
    q, n = fit.effects.shape
    y, covariance, which = _effects_of(fit, members)
    population = fit_population(y, covariance, which)
    inside = n + np.flatnonzero(members.ravel())
    values = np.concatenate([fit.alpha, fit.effects.ravel()])
    covariance = fit.root @ fit.root.T
    gain = covariance[:, inside] @ population.projection
    values = (values - gain @ y).reshape(1 + q, n)
    of_weights = fit.root[:, (1 + q) * n :]
    of_weights = of_weights - gain @ of_weights[inside]
    covariance = covariance - gain @ covariance[inside]
    populations = populations_from(effects, population, members.sum(axis=1))
    return values, covariance, of_weights @ of_weights.T, populations


def _law_from(values: Array, effects: tuple[str, ...]) -> tuple[Array, Array]:
    """Return (3, n) alpha, k and d = alpha r, and their (3 n, (1 + q) n) derivatives by ``values``.

    An effect that the days do not determine is 0.
    """
    n = values.shape[1]
    at = np.arange(n)
    law, derivatives = np.zeros((3, n)), np.zeros((3, n, *values.shape))
    law[0], derivatives[0, at, 0, at] = values[0], 1.0
    for row, effect in enumerate(effects, start=1):
        if effect == "temperature":
            law[1], derivatives[1, at, row, at] = values[row], 1.0
        else:
            law[2] = values[0] * values[row]
            derivatives[2, at, 0, at], derivatives[2, at, row, at] = values[row], values[0]
    return law, derivatives.reshape(3 * n, -1)
