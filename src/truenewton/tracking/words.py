"""How alpha varies, in words for people and in figures for scripts."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from truenewton.rounding import by_chance, with_error

if TYPE_CHECKING:
    from truenewton.tracking.family import Family
    from truenewton.tracking.law import Tracking
    from truenewton.tracking.validity import Validity


def lines(tracking: Tracking, validity: Validity | None) -> list[str]:
    """Return what was found, for people."""
    t = tracking
    lines = [
        f"{t.instrument}: {len(t.days)} calibrations, {t.days[0].date:%Y-%m-%d} to"
        f" {t.days[-1].date:%Y-%m-%d}, alpha at {_degrees(t.temperature)} on {t.date:%Y-%m-%d}"
    ]
    lines += [
        f"  {day.date:%Y-%m-%d %H:%M}  {_degrees(day.temperature):>10}  {day.name}"
        for day in t.days
    ]
    for family in t.families:
        unit = _unit(family)
        lines += [
            f"  {family.effect + ', mean':<24}"
            f"{with_error(100 * family.mean, 100 * family.mean_error)} {unit}",
            f"  {'  spread of actuators':<24}{100 * family.spread:.2g} {unit}, 95 % within"
            f" {100 * family.spread_interval[0]:.2g} .. {100 * family.spread_interval[1]:.2g}",
        ]
    if t.degrees_of_freedom:
        lines.append(
            f"  {'fit':<24}chi2/DOF = {t.chi2 / t.degrees_of_freedom:.3g}, DOF"
            f" {t.degrees_of_freedom}, probability {t.probability:.2g}"
        )
    lines += _table(t)
    lines += [
        f"  LEFT THE FAMILY: actuator {one.actuator}, {_words(one.effect)},"
        f" {abs(one.sigmas):.1f} sigma; {by_chance(one.probability)}"
        for one in t.outliers
    ]
    if not t.outliers:
        lines.append("  nobody leaves the family (false alarm on at most 1 % of mirrors)")
    if t.probability < 1e-3:
        lines.append(
            "  WARNING: the days do not lie on lines within their errors; look at the figures,"
            " and for what else changed between them"
        )
    lines += [f"  LIMIT: {limit}" for limit in t.limits]
    return lines if validity is None else lines + _serves(validity)


def _table(t: Tracking) -> list[str]:
    errors = t.errors
    head = f"  {'actuator':<10}{'alpha':<20}{'k [%/K]':<20}drift [%/yr]"
    rows = [
        f"  {name!s:<10}{with_error(a, ea):<20}"
        + (f"{with_error(100 * k, 100 * ek):<20}" if "temperature" in t.effects else f"{'-':<20}")
        + (with_error(100 * d / a, 100 * ed / a) if "drift" in t.effects else "-")
        for name, a, k, d, ea, ek, ed in zip(
            t.layout.id.tolist(), t.alpha.tolist(), t.coefficient.tolist(), t.drift.tolist(),
            *errors.tolist(), strict=True,
        )
    ]  # fmt: skip
    shown = rows if len(rows) <= 60 else [*rows[:10], f"  and {len(rows) - 10} actuators more"]
    return [head, *shown]


def _serves(v: Validity) -> list[str]:
    """Return the answer to: when is a new calibration due."""
    wanted = f"{100 * v.accuracy:.2g} %"
    if v.now > v.accuracy:
        lines = [
            f"  the latest calibration does not reach {wanted}: readings alone leave"
            f" {100 * v.now:.2g} %"
        ]
    else:
        parts = []
        if v.temperatures is not None:
            parts.append(f"from {v.temperatures[0]:.1f} to {v.temperatures[1]:.1f} deg C")
        if v.until is not None:
            parts.append(f"until {v.until:%Y-%m-%d}")
        lines = [
            f"  the latest calibration, as it is, serves {wanted} {', and '.join(parts)}",
        ]
    parts = []
    if v.law_temperatures is not None:
        low, high = v.law_temperatures
        parts.append(f"from {low:.1f} to {high:.1f} deg C")
    if v.law_until is not None:
        parts.append(f"until {v.law_until:%Y-%m-%d}")
    if parts:
        lines.append(f"  this law serves {wanted} {', and '.join(parts)}")
    else:
        lines.append(f"  this law does not reach {wanted}")
    return [*lines, "  (errors of the weights left out: the same weights would repeat them)"]


def values(tracking: Tracking, validity: Validity | None) -> dict[str, Any]:
    """Return the same figures for a script."""
    t, errors = tracking, tracking.errors
    values: dict[str, Any] = {
        "instrument": t.instrument,
        "temperature": t.temperature,
        "date": t.date.isoformat(),
        "effects": list(t.effects),
        "families": [asdict(family) for family in t.families],
        "outliers": [asdict(one) for one in t.outliers],
        "chi2": t.chi2,
        "degrees_of_freedom": t.degrees_of_freedom,
        "probability": t.probability,
        "limits": list(t.limits),
        "days": [
            {"file": day.name, "date": day.date.isoformat(), "temperature": day.temperature}
            for day in t.days
        ],
        "actuators": {
            "id": t.layout.id, "alpha": t.alpha, "e_alpha": errors[0],
            "k": t.coefficient, "e_k": errors[1], "drift": t.drift, "e_drift": errors[2],
        },
    }  # fmt: skip
    if validity is not None:
        values["validity"] = {
            key: value.isoformat() if hasattr(value, "isoformat") else value
            for key, value in asdict(validity).items()
        }
    return values


def _words(what: str) -> str:
    return {"temperature": "by temperature", "drift": "by its drift"}.get(
        what, "its days lie on no line"
    )


def _unit(family: Family) -> str:
    return "% per K" if family.effect == "temperature" else "% per year"


def _degrees(temperature: float) -> str:
    return f"{temperature:.1f} deg C" if math.isfinite(temperature) else "unknown temp."
