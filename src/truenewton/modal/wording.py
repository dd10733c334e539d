"""What was found of the modes, in words for people and in figures for scripts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from truenewton.modal.dissipation import Limits
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.shown import (
    apart,
    between_actuators,
    cost_rows,
    measured_text,
    negative_text,
    rigid_text,
    static_force,
    turbulence,
)
from truenewton.rounding import percent

WIDTHS = (8, 15, 15, 15, 8, 8, 9, 9, 0)  # of the table's columns


def lines(found: ModalFindings, limits: Limits) -> list[str]:
    """Return what was found, for people."""
    before, after = found.before.stiffness, found.after.stiffness
    base, c = found.after, found.calibration
    count = base.modes.stiffness.size
    told = [
        f"{base.instrument}: {count} stiffness modes; alpha by {c.method}, scale {c.scale}",
    ]
    if (m := found.measured) is not None:
        told.append(f"  {'measured stiffness':<24}{measured_text(m)}")
        if m.rigid_assumed:
            told.append(f"  {'':<24}{rigid_text(m)}")
    rigid = ", ".join(f"{value:.3g}" for value in after.rigid_stiffness)
    elastic = base.modes.stiffness[3:]
    told += [
        f"  {'':<24}{'alpha = 1':<12}calibrated",
        f"  {'asymmetry of it':<24}{percent(before.asymmetry):<12}{percent(after.asymmetry)}",
        f"  {'imbalance of it':<24}{percent(before.imbalance):<12}{percent(after.imbalance)}",
        f"  {'rigid motions':<24}{'':<12}{rigid} N/m",
        f"  {'elastic modes':<24}{'':<12}{elastic.min():.3g} .. {elastic.max():.3g} N/m"
        + (f"; {negative}" if (negative := negative_text(base)) else ""),
        f"  {'modes by alpha = 1':<24}{apart(found.comparison)}",
        f"  {'turbulence':<24}{turbulence(base)}",
        f"  {'between actuators':<24}{between_actuators(base)}",
        f"  {'static force':<24}{static_force(base.costs[0])}",
    ]
    told += _table(base) + _within(found, limits)
    warnings = c.diagnosis.warnings if c.diagnosis else ()
    return told + [
        f"  WARNING: {fault}; {remedy}" for fault, remedy in (*warnings, *found.warnings)
    ]


def _table(base: ModalBase) -> list[str]:
    """Return residual, force and power against the number of modes."""
    names = "".join(f"{cost.base:<15}" for cost in base.costs)
    lines = [
        f"  {'':<8}{'residual wavefront at actuators [nm]':<45}"
        "stiffness modes: force [mN], power [W]",
        f"  {'modes':<8}{names}rms     worst   mean     worst    total",
    ]
    for row in cost_rows(base):
        cells = (f"{cell:<{width}}" for cell, width in zip(row, WIDTHS, strict=True))
        lines.append(f"  {''.join(cells)}")
    return lines


def _within(found: ModalFindings, limits: Limits) -> list[str]:
    """Return how many modes the limits allow, and what alpha has to do with it."""
    if not limits.any:
        return ["  --power, --total-power or --force asks how many modes they allow"]
    asked = [f"{limits.power:g} W in the worst coil"] if math.isfinite(limits.power) else []
    asked += [f"{limits.total:g} W in all"] if math.isfinite(limits.total) else []
    asked += [f"{limits.force:g} N on any actuator"] if math.isfinite(limits.force) else []
    lines = [f"  within {' and '.join(asked)}, piston and tilts counted:"]
    for cost, uncalibrated in zip(found.after.costs, found.before.costs, strict=True):
        number = cost.modes_within(limits)
        fewest, most = found.modes_between(cost, limits)
        words = "none" if number == 0 else f"{number} of {cost.residual.size}"
        if number:
            words += f", {1e9 * cost.residual[number - 1]:.3g} nm left"
        if fewest != most:
            words += f"; {fewest} to {most} by the error of alpha"
        words += f"; with alpha = 1 it would seem {uncalibrated.modes_within(limits)}"
        lines.append(f"    {cost.base:<22}{words}")
    return lines


def values(found: ModalFindings, limits: Limits) -> dict[str, Any]:
    """Return the same figures for a script."""
    base, m, c = found.after, found.measured, found.comparison
    told: dict[str, Any] = {
        "instrument": base.instrument,
        "date": base.date.isoformat(),
        "method": found.calibration.method,
        "scale": found.calibration.scale,
        "seeing": base.seen.atmosphere.seeing,
        "fried_parameter": base.seen.atmosphere.fried_parameter,
        "outer_scale": base.seen.atmosphere.outer_scale,
        "diameter": base.seen.pupil.diameter,
        "radius": base.seen.pupil.radius,
        "efficiency": base.costs[0].efficiency,
        "fitting_error": base.seen.fitting_error,
        "static_force": base.costs[0].static,
        "stiffness": base.modes.stiffness,
        "asymmetry": [x.stiffness.asymmetry for x in (found.before, base)],
        "imbalance": [x.stiffness.imbalance for x in (found.before, base)],
        "rigid_stiffness": base.stiffness.rigid_stiffness,
        "uncalibrated_modes": {
            "distance": c.distance,
            "overlap": c.overlap,
            "orders": c.orders,
            "largest_angle": c.largest_angle,
        },
        "limits": {"power": limits.power, "total": limits.total, "force": limits.force},
        "warnings": [list(warning) for warning in found.warnings],
        "bases": [
            {
                "base": cost.base,
                "residual": cost.residual,
                "force_rms": np.sqrt(np.mean(cost.force**2, axis=0)),
                "force_worst": cost.force.max(axis=0),
                "reach": cost.reach.max(axis=0),
                "power_mean": cost.power.mean(axis=0),
                "power_worst": cost.power.max(axis=0),
                "modes_within": cost.modes_within(limits),
                "modes_between": found.modes_between(cost, limits),
                "modes_within_uncalibrated": uncalibrated.modes_within(limits),
            }
            for cost, uncalibrated in zip(base.costs, found.before.costs, strict=True)
        ],
    }
    if m is not None:
        told["measured"] = {
            "shapes": m.shapes, "rows": m.rows, "residual": m.residual, "misfit": m.misfit,
            "relative_error": m.relative_error, "rigid_assumed": m.rigid_assumed,
            "rejected": len(m.rejected),
        }  # fmt: skip
    return told
