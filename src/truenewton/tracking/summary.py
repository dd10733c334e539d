"""The law in text for the terminal, and in values for JSON."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from truenewton.errors import Fault
from truenewton.estimation.findings.finding import as_sentences
from truenewton.files.values import Columns, Values
from truenewton.records.result import Summary, summary_of
from truenewton.rounding import chance_text, row, table_lines, with_error
from truenewton.tracking.law import ACTUATORS, DAYS, Tracking, Validity, validity_of

NAMES = {"temperature": "coefficient k", "drift": "drift"}
UNITS = {"temperature": "% per K", "drift": "% per year"}
OUTLYING = {
    "temperature": "temperature coefficient {} sigma from the population",
    "drift": "drift {} sigma from the population",
    "line": "its calibrations are {} sigma from a line",
}


def lines(tracking: Tracking, accuracy: float | None) -> Iterator[str]:
    """Yield the lines of the terminal; with an accuracy also how long the law is valid."""
    t = tracking
    yield headline(t)
    for day in t.days:
        verdict = f"{day.verdict}: " if day.verdict else ""
        yield f"  {day.date:%Y-%m-%d %H:%M}  {_degrees(day.temperature):>10}  {verdict}{day.name}"
    for name, value in summary_rows(t):
        yield row(name, value)
    for remark in remarks(t):
        yield f"  {remark}"
    yield from _validity_lines(t, accuracy)


def headline(tracking: Tracking) -> str:
    """Return the mirror, the number of calibrations and their dates."""
    t, first, last = tracking, tracking.days[0].date, tracking.days[-1].date
    return (
        f"{t.instrument}: {len(t.days)} calibrations, {first:%Y-%m-%d} to {last:%Y-%m-%d},"
        f" alpha at {_degrees(t.temperature)} on {t.date:%Y-%m-%d}"
    )


@summary_of.register(Tracking)
def _summary(tracking: Tracking) -> Summary:
    return Summary(headline(tracking), summary_rows(tracking), remarks(tracking))


def summary_rows(tracking: Tracking) -> Iterator[tuple[str, str]]:
    """Yield name and value of what is common to the actuators."""
    t = tracking
    for population in t.populations:
        unit, (low, high) = UNITS[population.effect], population.spread_interval
        mean = with_error(100 * population.mean, 100 * population.mean_error)
        within = f"95 % interval {100 * low:.2g} to {100 * high:.2g} {unit}"
        yield (f"{NAMES[population.effect]}, mean", f"{mean} {unit}")
        yield ("  spread of actuators", f"{100 * population.spread:.2g} {unit}, {within}")
    if t.scatter_degrees:
        own, common = (f"{100 * s:.2g} %" for s in (np.nanmedian(t.scatter), t.common_scatter))
        degrees = f"{t.scatter_degrees} degree{'s' * (t.scatter_degrees > 1)} of freedom"
        yield ("scatter of days", f"{own} of one actuator, {common} common to all ({degrees})")
    if t.degrees_of_freedom:
        reduced = f"chi2/DOF = {t.chi2 / t.degrees_of_freedom:.3g}, DOF {t.degrees_of_freedom}"
        yield ("fit", f"{reduced}, probability {t.probability:.2g}")


def remarks(tracking: Tracking) -> Iterator[str]:
    """Yield outliers, warnings and limitations."""
    t = tracking
    for one in t.outliers:
        deviation = OUTLYING[one.effect].format(f"{abs(one.sigmas):.1f}")
        chance = chance_text(one.probability)
        name = t.layout.shown[t.layout.id == one.actuator][0]
        yield f"OUTLIER: actuator {name}, {deviation} ({chance})"
    if not t.outliers:
        yield "no outliers (false alarms on at most 1 % of mirrors)"
    if t.probability < 1e-3:
        yield (
            "warning: The calibrations do not lie on lines within their errors. Look at the"
            " figures, and look for other changes between the days."
        )
    for limit in t.limits:
        yield f"limit: {as_sentences(Fault(limit, ''))}"


def table_of(tracking: Tracking) -> Iterator[str]:
    """Yield the table of the actuators."""
    t, rows = tracking, [("actuator", "alpha", "k [%/K]", "drift [%/yr]")]
    columns = (t.layout.shown, t.alpha, t.coefficient, t.drift, *t.errors)
    for name, a, k, d, ea, ek, ed in zip(*columns, strict=True):
        coefficient = with_error(100 * k, 100 * ek) if "temperature" in t.effects else "-"
        drift = with_error(100 * d / a, 100 * ed / a) if "drift" in t.effects else "-"
        rows.append((str(name), with_error(a, ea), coefficient, drift))
    yield from table_lines("actuators:", *rows)


def _validity_lines(tracking: Tracking, accuracy: float | None) -> Iterator[str]:
    if accuracy is None:
        return
    v = validity_of(tracking, accuracy)
    wanted = f"{100 * v.accuracy:.2g} %"
    latest = _span(v, v.temperatures, v.until)
    if v.now > v.accuracy:
        latest = f"never: its statistical error is {100 * v.now:.2g} %"
    law = _span(v, v.law_temperatures, v.law_until)
    yield f"  alpha of the latest calibration is valid to {wanted} {latest}"
    yield f"  alpha corrected for temperature and time is valid to {wanted} {law or 'never'}"
    yield "  These limits do not include the errors of the weights, which the same weights repeat."


def _span(
    v: Validity, temperatures: tuple[float, float] | None, until: datetime.datetime | None
) -> str:
    parts = []
    if temperatures is not None:
        ends = " (range of the data)" if set(temperatures) & set(v.reach or ()) else ""
        parts.append(f"from {temperatures[0]:.1f} to {temperatures[1]:.1f} deg C{ends}")
    if until is not None:
        ends = " (limit of extrapolation)" if until == v.reach_until else ""
        parts.append(f"until {until:%Y-%m-%d}{ends}")
    return ", and ".join(parts)


def _days(t: Tracking) -> list[dict[str, Any]]:
    columns = Columns(DAYS, "file", "date", "temperature", "verdict").of(t)
    return [dict(zip(columns, day, strict=True)) for day in zip(*columns.values(), strict=True)]


SCATTER = Values(
    Tracking,
    ("own", "scatter"), ("common", "common_scatter"), ("degrees_of_freedom", "scatter_degrees"),
)  # fmt: skip
VALUES = Values(
    Tracking, "instrument", "temperature", "date", "effects", ("families", "populations"),
    ("scatter", SCATTER), "outliers", "chi2", "degrees_of_freedom", "probability", "limits",
    ("days", _days),
    ("actuators", Columns(ACTUATORS, "id", "alpha", "e_alpha", "k", "e_k", "drift", "e_drift")),
)  # fmt: skip


def values(tracking: Tracking, accuracy: float | None) -> dict[str, Any]:
    """Return the same values for a script."""
    t = tracking
    validity = {} if accuracy is None else {"validity": validity_of(t, accuracy)}
    return {**VALUES.of(t), **validity}


def _degrees(temperature: float) -> str:
    return f"{temperature:.1f} deg C" if math.isfinite(temperature) else "unknown temp."
