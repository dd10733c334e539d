"""The summary of a modal basis: text for the terminal and the page, values for scripts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from truenewton.calibration.summary import warning_lines
from truenewton.estimation.findings.estimate import Scale
from truenewton.files.values import Values
from truenewton.modal.findings import ModalFindings, ModesComparison
from truenewton.modal.measured_stiffness import MeasuredStiffness
from truenewton.modal.modal_base import SUMMARIES, Budget, Dissipation, ModalBase
from truenewton.records.result import Summary, summary_of
from truenewton.rounding import counted, percent, row, significant, table_lines

NUMBERS = 8  # of modes, in the table
DETAILS = "measured stiffness", "piston and tilts", "static forces", "fitting error"


def stiffness_text(value: float) -> str:
    """Return a stiffness [N/m] with two digits: '-22 N/m', '4.6 kN/m', '9.0 MN/m'."""
    for size, unit in ((1e6, "MN/m"), (1e3, "kN/m")):
        if abs(value) >= 0.995 * size:
            return f"{significant(value / size)} {unit}"
    return f"{significant(value)} N/m"


def cost_rows(base: ModalBase) -> list[tuple[str, ...]]:
    """Return residual and cost of some numbers of modes, a row for each.

    Columns: number of modes; rms residual wavefront of each of the three bases [nm]; for stiffness
    modes the force, rms and of the worst actuator [mN], and the power, mean, worst and total [W],
    if the efficiency is known.
    """
    cost, count = base.costs[0], base.modes.stiffness.size
    rows = []
    for number in np.unique(np.linspace(0, count, NUMBERS + 1).round().astype(int))[1:].tolist():
        k = number - 1
        left = (_plain(1e9 * each.residual[k], 4) for each in base.costs)
        power: tuple[str, ...] = ()
        if math.isfinite(cost.efficiency):
            power = (f"{cost.power_mean[k]:.2g}", f"{cost.power_worst[k]:.2g}",
                     f"{cost.power_total[k]:.3g}")  # fmt: skip
        force = (_plain(1e3 * each[k], 3) for each in (cost.force_rms, cost.force_worst))
        rows.append((str(number), *left, *force, *power))
    return rows


def measured_text(measured: MeasuredStiffness) -> str:
    """Return the number of shapes and rows of a stiffness, and its error."""
    m = measured
    return (
        f"{counted(m.shapes, 'shape')} (counted for each load), {counted(m.rows, 'row')}"
        + (f"; uncertainty {percent(m.relative_error)}" if math.isfinite(m.relative_error) else "")
        + (f", chi2/DOF {m.misfit:.3g}" if math.isfinite(m.misfit) else "")
        + (f"; {counted(m.rejected, 'row')} left out" if m.rejected else "")
    )


def rigid_text(measured: MeasuredStiffness) -> str:
    """Return the number of rigid motions that no shape contains; empty if there are none."""
    if not measured.rigid_assumed:
        return ""
    return f"{measured.rigid_assumed} of 3 rigid motions, in no shape: assumed to need no force"


def sensor_gains_text(base: ModalBase) -> str:
    """Return the range of gains and offsets of the sensors; empty if not known."""
    gain, offset = base.stiffness.enabled_gain, base.stiffness.enabled_offset
    if (gain == 1.0).all() and not offset.any():
        return ""
    far = f", at most {1e3 * np.hypot(*offset).max():.2g} mm from their magnets"
    used = "; modes are in true displacement"
    return f"{gain.min():.4g} .. {gain.max():.4g}{far if offset.any() else ''}{used}"


def comparison_text(findings: ModalFindings) -> str:
    """Return the difference of the modes with alpha = 1; empty for large mirrors."""
    if not findings.compares:
        return ""
    c = findings.comparison
    if not c.orders.size:
        return "the same subspace: all have nearly the same stiffness"
    worst = int(c.largest_angle.argmax())
    order = int(c.orders[worst])
    where = "mode 1" if order == 1 else f"between the subspaces of the first {order} modes"
    return (
        f"rotated by {math.degrees(c.distance):.2g} deg rms; worst:"
        f" {math.degrees(c.largest_angle[worst]):.2g} deg, {where}"
    )


def turbulence_text(base: ModalBase) -> str:
    """Return the turbulence and the size of the mirror; why there is none without a pupil."""
    if base.seen is None:
        return "not computed: give --diameter, the diameter of the telescope's pupil in metres"
    a, pupil = base.seen.atmosphere, base.seen.pupil
    return (
        f"seeing {a.seeing:g} arcsec, r0 {100 * a.fried_parameter:.3g} cm, L0"
        f" {a.outer_scale:g} m; pupil {pupil.diameter:.3g} m on a mirror of"
        f" {2e3 * pupil.radius:.0f} mm"
    )


def fitting_error_text(base: ModalBase) -> str:
    """Return the wavefront that no modes correct; empty without turbulence."""
    if base.seen is None:
        return ""
    rms = f"{1e9 * base.seen.fitting_error:.3g} nm rms"
    return f"{rms} of wavefront, which no mode corrects; residuals exclude it"


def static_force_text(base: ModalBase) -> str:
    """Return the range of the static forces."""
    force = 1e3 * base.static
    if not force.any():
        return "assumed 0 (a stiffness file contains no weight)"
    return f"{force.min():.3g} .. {force.max():.3g} mN"


def headline(findings: ModalFindings) -> str:
    """Return mirror, number of modes, and the method and scale of alpha."""
    base, c = findings.after, findings.calibration
    count = base.modes.stiffness.size
    return (
        f"{base.matrix.instrument}: {count} stiffness modes (alpha: method {c.method}, common"
        f" scale {Scale(c.scale).origin})"
    )


@summary_of.register(ModalFindings)
def _summary(findings: ModalFindings) -> Summary:
    rows = [row for row in summary_rows(findings) if row[1]]
    rows.append(("verdict on alpha", str(findings.calibration.verdict)))
    return Summary(headline(findings), rows, warning_lines(findings.warnings))


def summary_rows(findings: ModalFindings) -> list[tuple[str, str]]:
    """Return names and texts of the results; some texts are empty."""
    base, measured = findings.after, findings.measured
    asymmetry, imbalance = (
        "".join(f"{percent(fault):<12}" for fault in faults)
        for faults in (findings.asymmetry, findings.imbalance)
    )
    elastic = base.modes.stiffness[3:]
    rigid = ", ".join(f"{value:.3g}" for value in base.modes.stiffness[:3])
    negative = int(np.count_nonzero(elastic < 0))
    return [
        ("measured stiffness", measured_text(measured) if measured else ""),
        ("", rigid_text(measured) if measured else ""),
        ("", f"{'alpha = 1':<12}calibrated"),
        ("  asymmetry", f"{asymmetry}K - K' relative to K"),
        ("  imbalance", f"{imbalance}of the columns of K, relative to their forces"),
        ("piston and tilts", f"{rigid} N/m (expected without bias magnets: 0)"),
        ("elastic modes", f"{elastic.min():.3g} .. {elastic.max():.3g} N/m"
         + (f"; {negative} negative (bias magnets or measurement errors)" if negative else "")),
        ("sensor gains", sensor_gains_text(base)),
        ("modes with alpha = 1", comparison_text(findings)),
        ("turbulence", turbulence_text(base)),
        ("fitting error", fitting_error_text(base)),
        ("static forces", static_force_text(base)),
    ]  # fmt: skip


def lines(findings: ModalFindings, limits: Budget) -> list[str]:
    """Return the lines of the summary."""
    return [
        headline(findings),
        *(row(name, text) for name, text in summary_rows(findings) if text and name not in DETAILS),
        *(_within(findings, limits) if findings.after.costs else ()),
        row("verdict on alpha", str(findings.calibration.verdict)),
        *warning_lines(findings.warnings),
    ]


def detail_lines(findings: ModalFindings) -> Iterator[str]:
    """Yield the other rows, and the table of the number of modes."""
    rows = summary_rows(findings)
    yield from (row(name, text) for name, text in rows if text and name in DETAILS)
    yield from _table(findings.after) if findings.after.costs else ()


def _table(base: ModalBase) -> Iterator[str]:
    """Yield the table of residual, force and power against the number of modes."""
    rows = cost_rows(base)
    power = ", power [W]" if math.isfinite(base.costs[0].efficiency) else ""
    title = f"  rms wavefront [nm] left by N modes; force [mN]{power} of N stiffness modes:"
    cost = "rms force", "worst", "mean power", "worst", "total"
    head = ("N", *(each.base for each in base.costs), *cost)[: len(rows[0])]
    return table_lines(title, head, *rows)


def _plain(value: float, digits: int) -> str:
    """Return a number with some digits, thousands and millions without an exponent."""
    return f"{value:.{digits}g}" if abs(value) < 1.0 else f"{float(f'{value:.{digits}g}'):.9g}"


def _within(findings: ModalFindings, limits: Budget) -> list[str]:
    """Return the number of modes within the limits, with and without alpha."""
    asked = (
        (limits.power, "W in the worst coil"),
        (limits.total, "W in all"),
        (limits.force, "N on any actuator"),
    )
    words = " and ".join(f"{limit:g} {what}" for limit, what in asked if math.isfinite(limit))
    if not words:
        return ["  to find how many modes a limit allows, add --power, --total-power or --force"]
    lines = [f"  modes within {words}, piston and tilts included:"]
    for cost, uncalibrated in _costs(findings):
        number = cost.modes_within(limits)
        fewest, most = findings.modes_between(cost, limits)
        words = "none" if number == 0 else f"{number} of {cost.residual.size}"
        if number:
            words += f", residual {1e9 * cost.residual[number - 1]:.3g} nm"
        if fewest != most:
            words += f"; within the error of alpha: {fewest} to {most}"
        if uncalibrated is not None:
            words += f"; with alpha = 1: {uncalibrated.modes_within(limits)}"
        lines.append(f"    {cost.base:<22}{words}")
    return lines


def _costs(findings: ModalFindings) -> Iterator[tuple[Dissipation, Dissipation | None]]:
    """Yield the costs of each basis with alpha, and with alpha = 1 (None for large mirrors)."""
    after = findings.after.costs
    before = findings.before.costs if findings.compares else (None,) * len(after)
    yield from zip(after, before, strict=True)


def _comparison(findings: ModalFindings) -> ModesComparison | None:
    return findings.comparison if findings.compares else None


VALUES = Values(
    ModalFindings, ("instrument", "after.matrix.instrument"), ("date", "after.matrix.date"),
    ("method", "calibration.method"), ("scale", "calibration.scale"),
    ("verdict", "calibration.verdict"),
    ("seeing", "after.seen.atmosphere.seeing"),
    ("fried_parameter", "after.seen.atmosphere.fried_parameter"),
    ("outer_scale", "after.seen.atmosphere.outer_scale"),
    ("diameter", "after.seen.pupil.diameter"), ("radius", "after.seen.pupil.radius"),
    ("efficiency", lambda f: f.after.costs[0].efficiency if f.after.costs else None, float),
    ("fitting_error", "after.seen.fitting_error"), ("static_force", "after.static"),
    ("stiffness", "after.modes.stiffness"), "asymmetry", "imbalance",
    ("rigid_stiffness", lambda f: f.after.modes.stiffness[:3]),
    ("sensor_gain", "after.stiffness.enabled_gain"),
    ("sensor_offset", "after.stiffness.enabled_offset"),
    ("uncalibrated_modes", Values(
        ModesComparison, "distance", "overlap", "orders", "largest_angle",
        path=_comparison,
    )),
    ("warnings", lambda f: [[each.fault, each.remedy] for each in f.warnings]),
)  # fmt: skip
MEASURED = Values(
    MeasuredStiffness, "shapes", "rows", "residual", "misfit", "relative_error", "rigid_assumed",
    ("rejected", lambda measured: len(measured.rejected), int),
)  # fmt: skip


def values(findings: ModalFindings, limits: Budget) -> dict[str, Any]:
    """Return the values for a script."""
    bases = [
        {
            "base": cost.base,
            **{name: summary(cost) for name, _, summary in SUMMARIES},
            "modes_within": cost.modes_within(limits),
            "modes_between": findings.modes_between(cost, limits),
            "modes_within_uncalibrated": uncalibrated and uncalibrated.modes_within(limits),
        }
        for cost, uncalibrated in _costs(findings)
    ]
    measured = {} if findings.measured is None else {"measured": MEASURED.of(findings.measured)}
    return {**VALUES.of(findings), "limits": limits, "bases": bases, **measured}
