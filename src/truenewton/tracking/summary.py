"""How alpha varies, in words for people and in figures for scripts."""

from __future__ import annotations

import datetime
import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from truenewton.calibration.summary import row
from truenewton.files.format import attributes, columns_by_name
from truenewton.records.parts import Parts, has_parts
from truenewton.records.result import Summary, summary_of
from truenewton.rounding import by_chance, counted, numbered, with_error
from truenewton.tracking.law import ACTUATORS, DAYS, Tracking, Validity, validity_of

UNITS = {"temperature": "% per K", "drift": "% per year"}
OUTLYING = {
    "temperature": "by temperature",
    "drift": "by its drift",
    "line": "its days lie on no line",
}
MOST_ROWS, FIRST_ROWS = 60, 10  # of the table of actuators; of a longer one only the first


def lines(tracking: Tracking | Parts[Tracking], accuracy: float | None) -> Iterator[str]:
    """Yield what was found, for people, and how long it holds to an accuracy."""
    t = tracking
    if has_parts(t):
        yield from _lines_of_parts(t, accuracy)
        return
    yield headline(t)
    for day in t.days:
        verdict = f"{day.verdict}: " if day.verdict else ""
        yield f"  {day.date:%Y-%m-%d %H:%M}  {_degrees(day.temperature):>10}  {verdict}{day.name}"
    for name, value in summary_rows(t):
        yield row(name, value)
    yield from _table(t)
    for remark in remarks(t):
        yield f"  {remark}"
    yield from _validity_lines(t, accuracy)


def headline(tracking: Tracking) -> str:
    """Return what was tracked, from how many days."""
    t, first, last = tracking, tracking.days[0].date, tracking.days[-1].date
    return (
        f"{t.instrument}: {len(t.days)} calibrations, {first:%Y-%m-%d} to {last:%Y-%m-%d},"
        f" alpha at {_degrees(t.temperature)} on {t.date:%Y-%m-%d}"
    )


@summary_of.register(Tracking)
def _summary(tracking: Tracking | Parts[Tracking]) -> Summary | None:
    if has_parts(tracking):
        return None
    return Summary(headline(tracking), summary_rows(tracking), remarks(tracking))


def summary_rows(tracking: Tracking) -> Iterator[tuple[str, str]]:
    """Yield name and value of what is common to the actuators."""
    t = tracking
    for family in t.families:
        unit, (low, high) = UNITS[family.effect], family.spread_interval
        mean = with_error(100 * family.mean, 100 * family.mean_error)
        within = f"95 % within {100 * low:.2g} .. {100 * high:.2g}"
        yield (f"{family.effect}, mean", f"{mean} {unit}")
        yield ("  spread of actuators", f"{100 * family.spread:.2g} {unit}, {within}")
    if t.scatter_degrees:
        own, common = (f"{100 * s:.2g} %" for s in (np.nanmedian(t.scatter), t.common_scatter))
        degrees = f"{t.scatter_degrees} degree{'s' * (t.scatter_degrees > 1)} of freedom"
        yield ("scatter of days", f"{own} of each actuator, {common} of all ({degrees})")
    if t.degrees_of_freedom:
        reduced = f"chi2/DOF = {t.chi2 / t.degrees_of_freedom:.3g}, DOF {t.degrees_of_freedom}"
        yield ("fit", f"{reduced}, probability {t.probability:.2g}")


def remarks(tracking: Tracking) -> Iterator[str]:
    """Yield who left the family, what is wrong, and what cannot be said."""
    t = tracking
    for one in t.outliers:
        yield (
            f"LEFT THE FAMILY: actuator {one.actuator}, {OUTLYING[one.effect]},"
            f" {abs(one.sigmas):.1f} sigma; {by_chance(one.probability)}"
        )
    if not t.outliers:
        yield "nobody leaves the family (false alarm on at most 1 % of mirrors)"
    if t.probability < 1e-3:
        yield (
            "WARNING: the days do not lie on lines within their errors; look at the figures,"
            " and for what else changed between them"
        )
    for limit in t.limits:
        yield f"LIMIT: {limit}"


def _table(t: Tracking) -> Iterator[str]:
    yield f"  {'actuator':<10}{'alpha':<20}{'k [%/K]':<20}drift [%/yr]"
    shown = FIRST_ROWS if t.layout.n > MOST_ROWS else t.layout.n
    columns = (t.layout.id, t.alpha, t.coefficient, t.drift, *t.errors)
    for name, a, k, d, ea, ek, ed in itertools.islice(zip(*columns, strict=True), shown):
        coefficient = with_error(100 * k, 100 * ek) if "temperature" in t.effects else "-"
        drift = with_error(100 * d / a, 100 * ed / a) if "drift" in t.effects else "-"
        yield f"  {name!s:<10}{with_error(a, ea):<20}{coefficient:<20}{drift}"
    if shown < t.layout.n:
        yield f"  and {counted(t.layout.n - shown, 'actuator')} more"


def _validity_lines(tracking: Tracking, accuracy: float | None) -> Iterator[str]:
    """Yield the answer to: when is a new calibration due."""
    if accuracy is None:
        return
    v = validity_of(tracking, accuracy)
    wanted = f"{100 * v.accuracy:.2g} %"
    if v.now > v.accuracy:
        yield (
            f"  the latest calibration does not reach {wanted}: readings alone leave"
            f" {100 * v.now:.2g} %"
        )
    else:
        span = _span(v, v.temperatures, v.until)
        yield f"  the latest calibration, as it is, serves {wanted} {span}"
    law = _span(v, v.law_temperatures, v.law_until)
    yield f"  this law serves {wanted} {law}" if law else f"  this law does not reach {wanted}"
    yield "  (errors of the weights left out: the same weights would repeat them)"


def _span(
    v: Validity, temperatures: tuple[float, float] | None, until: datetime.datetime | None
) -> str:
    parts = []
    if temperatures is not None:
        ends = " (the days saw no other)" if set(temperatures) & set(v.reach or ()) else ""
        parts.append(f"from {temperatures[0]:.1f} to {temperatures[1]:.1f} deg C{ends}")
    if until is not None:
        ends = " (as long again as the days lasted)" if until == v.reach_until else ""
        parts.append(f"until {until:%Y-%m-%d}{ends}")
    return ", and ".join(parts)


def _lines_of_parts(t: Parts[Tracking], accuracy: float | None) -> Iterator[str]:
    """Yield what was found of all segments; what is the same of several once."""
    days = next(iter(t.found.values())).days
    first, last = days[0].date, days[-1].date
    yield (
        f"{t.instrument}: {len(days)} calibrations, {first:%Y-%m-%d} to {last:%Y-%m-%d}, of"
        f" {counted(t.numbers, 'segment')}"
        + (f", {len(t.failed)} without a law" if t.failed else "")
    )
    for day in days:
        yield f"  {day.date:%Y-%m-%d %H:%M}  {_degrees(day.temperature):>10}  {day.name}"
    for number in t.numbers:
        if number in t.failed:
            yield row(f"segment {number}", "no law")
            continue
        law = t.found[number]
        yield f"  segment {number}, alpha at {_degrees(law.temperature)} on {law.date:%Y-%m-%d}"
        for name, value in summary_rows(law):
            yield f"  {row(name, value)}"
    said: dict[str, set[int]] = {}
    for number, fault, remedy in t.failures:
        said.setdefault(f"{fault}; {remedy}", set()).add(number)
    for number, law in t.found.items():
        for line in (*remarks(law), *_validity_lines(law, accuracy)):
            said.setdefault(line.strip(), set()).add(number)
    for line, numbers in said.items():
        yield f"  {numbered('segment', sorted(numbers))}: {line}"


def values(tracking: Tracking | Parts[Tracking], accuracy: float | None) -> dict[str, Any]:
    """Return the same figures for a script."""
    t = tracking
    if has_parts(t):
        return {
            "instrument": t.instrument,
            "segments": [
                {"segment": number, **values(t.found[number], accuracy)}
                if number in t.found
                else {"segment": number, "faults": [f._asdict() for f in t.failed[number]]}
                for number in t.numbers
            ],
        }
    names = "file", "date", "temperature", "verdict"
    days = zip(*columns_by_name(t, DAYS, *names).values(), strict=True)
    figures = {
        **attributes(t, "instrument", "temperature", "date", "effects", "families"),
        "scatter": {
            **attributes(t, own="scatter", common="common_scatter"),
            "degrees_of_freedom": t.scatter_degrees,
        },
        **attributes(t, "outliers", "chi2", "degrees_of_freedom", "probability", "limits"),
        "days": [dict(zip(names, day, strict=True)) for day in days],
        "actuators": columns_by_name(
            t, ACTUATORS, "id", "alpha", "e_alpha", "k", "e_k", "drift", "e_drift"
        ),
    }
    if accuracy is not None:
        figures["validity"] = validity_of(t, accuracy)
    return figures


def _degrees(temperature: float) -> str:
    return f"{temperature:.1f} deg C" if math.isfinite(temperature) else "unknown temp."
