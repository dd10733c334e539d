"""From calibrations of different days to alpha at any temperature and time."""

from __future__ import annotations

import datetime
from collections.abc import Sequence

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from truenewton.arrays import Array, spread, spread_square
from truenewton.errors import CampaignMismatch, RankDeficient
from truenewton.estimation.multiple_tests import FALSE_ALARM, chance_of_any
from truenewton.tracking.days import (
    SAME_TEMPERATURE,
    YEAR,
    Day,
    Given,
    gathered,
    groups,
    tracked_actuators,
)
from truenewton.tracking.family import Family, families, fitted_population, stranger
from truenewton.tracking.law import SAME_TIME, DayRecord, Departure, Tracking
from truenewton.tracking.lines import Lines, fitted_lines, own_scatter

ALIKE = 0.01  # of the square of one effect, below which it cannot be told from the other
OTHER_UNIT = 0.03  # typical change of alpha beyond its error; 50 K make 0.3 % between actuators
PATIENCE = 2  # looks behind an actuator that hides another
MOST = 0.25  # of the actuators that may leave the family, or there is none


def track(*given: Given) -> Tracking:
    """Find how alpha varies with temperature and time.

    Parameters
    ----------
    given
        Calibrations, campaigns, or paths to them, of two days or temperatures at least, in any
        order. Cycles of one campaign whose temperatures differ by more than 1 K are calibrated
        apart.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch
        Files that cannot be tracked, or not together.
    RankDeficient
        One calibration only, or all at one temperature on one day.
    """
    days = gathered(given)
    on = tracked_actuators(days)
    if np.count_nonzero(on) < 4:
        raise RankDeficient(
            "fewer than four actuators are enabled in every calibration",
            remedy="leave out the calibrations in which many are disabled",
        )
    _refuse_other_units(days, on)
    settings, told, limits, temperature, date = _settings(days)
    if len(groups(days)) > 1:
        limits += ("weights or their errors differ between days: each set has errors of its own",)
    if not on.all():
        limits += (f"actuators not enabled on every day are left out: {np.count_nonzero(~on)}",)
    layout = days[0].calibration.layout
    lines, departures = _off_their_lines(days, on, settings)
    departures, members = _departures(lines, told, layout.id[on], departures)
    values, whole, systematic_covariance, found = _pooled(lines, members, told)
    places = ["alpha", *told]
    wanted = [places.index(name) if name in told else -1 for name in ("temperature", "drift")]
    three = _three(values, wanted)
    chi2, degrees = lines.chi2, lines.degrees_of_freedom
    return Tracking(
        instrument=days[0].calibration.instrument,
        layout=layout,
        temperature=temperature,
        date=date,
        alpha=spread(three[0], on),
        coefficient=spread(three[1], on),
        drift=spread(three[2], on),
        covariance=_spread_three(whole, values, wanted, on),
        systematic_covariance=_spread_three(systematic_covariance, values, wanted, on),
        told=told,
        families=found,
        departures=departures,
        chi2=chi2,
        degrees_of_freedom=degrees,
        probability=float(scipy.stats.chi2.sf(chi2, degrees)) if degrees else float("nan"),
        limits=limits,
        days=tuple(
            DayRecord(day.name, day.date, c.temperature, c.alpha, c.reading_error)
            for day, c in ((day, day.calibration) for day in days)
        ),
    )


def _refuse_other_units(days: Sequence[Day], on: NDArray[np.bool_]) -> None:
    """Refuse calibrations of two mirrors that share a name: alpha tells them apart.

    Raises
    ------
    CampaignMismatch
    """
    alpha = np.array([day.calibration.alpha[on] for day in days])
    ratio = alpha / alpha[0]
    ratio /= np.median(ratio, axis=1)[:, None]  # the scale may be anybody's
    apart = np.median(np.abs(ratio - 1.0), axis=1)
    error = np.median([day.calibration.reading_error[on] for day in days] / alpha, axis=1)
    excess = apart - OTHER_UNIT - 3 * np.hypot(error, error[0])
    worst = int(np.argmax(excess))
    if excess[worst] > 0.0:
        raise CampaignMismatch(
            f"alpha of a typical actuator is {100 * apart[worst]:.2g} % off that in"
            f" {days[0].name}, which no temperature does",
            remedy="track calibrations of one unit",
            path=days[worst].name,
            got=float(apart[worst]),
        )


def _settings(
    days: Sequence[Day],
) -> tuple[Array, tuple[str, ...], tuple[str, ...], float, datetime.datetime]:
    """Return (J, q) temperature and time of the days from their middle, and which can be told."""
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
        limits += ("no day holds a temperature: the drift holds whatever temperature did",)
    elif not warm:
        limits += ("all days are at one temperature: how alpha varies with it is not told",)
    if warm and late:
        centred = time - time.mean()
        slope = (away @ centred) / (away @ away)
        if np.sum((centred - slope * away) ** 2) < ALIKE * np.sum(centred**2):
            late = False
            limits += (
                "temperature and time went together: all is put down to temperature, and drift"
                " is not told",
            )
    elif not late:
        limits += ("all is of one day: drift is not told",)
    if not (warm or late):
        raise RankDeficient(
            "all calibrations are of one day and one temperature",
            remedy="add one of another day or temperature",
            path=days[-1].name,
        )
    effects = (("temperature", away, warm), ("drift", time, late))
    told = tuple(name for name, _, is_told in effects if is_told)
    columns = [column for _, column, is_told in effects if is_told]
    return np.stack(columns, axis=1), told, limits, temperature, date


def _off_their_lines(
    days: Sequence[Day], on: NDArray[np.bool_], settings: Array
) -> tuple[Lines, tuple[Departure, ...]]:
    """Fit the lines, and find who lies on none: the worst first, its scatter then allowed for.

    Readings of all actuators hang together, so one that jumped drags others off their lines.
    """
    n = int(on.sum())
    ids = days[0].calibration.layout.id[on]
    own, scatter = own_scatter(days, on, settings), np.zeros(n)
    found: list[Departure] = []
    while True:
        lines = fitted_lines(days, on, settings, scatter)
        if not lines.each_degrees or len(found) >= MOST * n:
            return lines, tuple(found)
        worst = int(lines.each.argmax())
        chance = float(scipy.stats.chi2.sf(lines.each[worst], lines.each_degrees))
        mirror = chance_of_any(chance, n * (1 + settings.shape[1]))
        if mirror >= FALSE_ALARM or scatter[worst]:
            return lines, tuple(found)
        scatter[worst] = own[worst]
        sigmas = float(np.sqrt(lines.each[worst]))
        found.append(Departure(int(ids[worst]), "line", sigmas, mirror))


def _departures(
    lines: Lines,
    told: tuple[str, ...],
    ids: NDArray[np.int64],
    known: tuple[Departure, ...],
) -> tuple[tuple[Departure, ...], NDArray[np.bool_]]:
    """Find who leaves the family; return all departures and (q, n) who is a member by each effect.

    The farthest is taken out and the next looked at, so that none hides behind another.
    """
    q, n = lines.effects.shape
    tests = n * (q + (lines.each_degrees > 0))
    members = np.tile(~np.isin(ids, [one.actuator for one in known]), (q, 1))
    looked: list[tuple[int, int, Departure]] = []
    sure = 0
    while len(looked) - sure < PATIENCE and members.sum(axis=1).min() > (1 - MOST) * n:
        y, covariance, which = _effects_of(lines, members)
        population = fitted_population(y, covariance, which)
        at, sigmas, chance = stranger(y, covariance, which, population)
        effect, place = (int(k[at]) for k in np.nonzero(members))
        mirror = chance_of_any(chance, tests)
        departure = Departure(int(ids[place]), told[effect], sigmas, mirror)
        looked.append((effect, place, departure))
        members[effect, place] = False
        if mirror < FALSE_ALARM:
            sure = len(looked)
    for effect, place, _ in looked[sure:]:
        members[effect, place] = True
    found = [*known, *(departure for _, _, departure in looked[:sure])]
    return tuple(sorted(found, key=lambda one: one.probability)), members


def _effects_of(lines: Lines, members: NDArray[np.bool_]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the effects of the members, their covariance, and which effect each is."""
    n = lines.alpha.size
    root = lines.root[n:][members.ravel()]
    return lines.effects[members], root @ root.T, np.nonzero(members)[0]


def _pooled(
    lines: Lines, members: NDArray[np.bool_], told: tuple[str, ...]
) -> tuple[Array, Array, Array, tuple[Family, ...]]:
    """Pull the members to their family: values, covariance, part from the weights, families."""
    q, n = lines.effects.shape
    y, covariance, which = _effects_of(lines, members)
    population = fitted_population(y, covariance, which)
    inside = n + np.flatnonzero(members.ravel())
    values = np.concatenate([lines.alpha, lines.effects.ravel()])
    whole = lines.root @ lines.root.T
    gain = whole[:, inside] @ population.projection
    values = (values - gain @ y).reshape(1 + q, n)
    of_weights = lines.root[:, (1 + q) * n :]
    of_weights = of_weights - gain @ of_weights[inside]
    whole = whole - gain @ whole[inside]
    found = families(told, population, members.sum(axis=1))
    return values, whole, of_weights @ of_weights.T, found


def _three(values: Array, wanted: list[int]) -> Array:
    """Return (3, n) alpha, k and d = alpha r; 0 where an effect is not told."""
    alpha = values[0]
    k, r = (values[place] if place > 0 else np.zeros_like(alpha) for place in wanted)
    return np.stack([alpha, k, alpha * r])


def _spread_three(matrix: Array, values: Array, wanted: list[int], on: NDArray[np.bool_]) -> Array:
    """Turn a covariance of alpha and the effects told into one of alpha, k and d of all."""
    n = values.shape[1]
    j = np.zeros((3 * n, matrix.shape[0]))
    at = np.arange(n)
    j[at, at] = 1.0
    if wanted[0] > 0:
        j[n + at, wanted[0] * n + at] = 1.0
    if wanted[1] > 0:
        j[2 * n + at, at] = values[wanted[1]]
        j[2 * n + at, wanted[1] * n + at] = values[0]
    return spread_square(j @ matrix @ j.T, np.tile(on, 3))
