"""The page in sections: what each shows, and the same in words for who cannot see it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from truenewton.calibration.result import Calibration
from truenewton.calibration.words import cycle_name, rejected_values
from truenewton.estimation.estimate import Scale
from truenewton.figures.style import CURVES
from truenewton.records.campaign import Campaign
from truenewton.report.budget import budget_bars, typical_error
from truenewton.report.evidence import Evidence, ModeResiduals, RowResiduals
from truenewton.report.investigate import Findings
from truenewton.report.page import evidence_plots
from truenewton.report.page.section import Section, TextTable
from truenewton.report.series import columns_of_shapes
from truenewton.rounding import percent, significant, to_digits
from truenewton.statics.layout import ring_of

BEFORE_AND_AFTER = ((CURVES[1], "alpha = 1, open circles"), (CURVES[0], "calibrated, squares"))
NO_DATA = "This page was made from a calibration file, which does not hold them: give the cycles."
MOST_REJECTED = 50  # rows listed


def evidence_sections(findings: Findings) -> Iterator[Section]:
    """Yield what supports or explains alpha, in the order of the page."""
    c, evidence = findings.calibration, findings.evidence
    if c is not None:
        yield budget(c)
    if evidence is None and c is not None:
        yield Section("residuals", "Residuals, singular values and balance", (NO_DATA,))
    elif evidence is not None:
        if isinstance(evidence.residuals, RowResiduals):
            yield _rows(findings, evidence.residuals)
        else:
            yield _modes(evidence.residuals)
        yield _singular_values(evidence)
        yield _balance(evidence)


def map_caption(c: Calibration) -> str:
    """Say in words what the map of alpha shows."""
    low, high = int(np.nanargmin(c.alpha)), int(np.nanargmax(c.alpha))
    ring = ring_of(c.layout) + 1
    lowest, highest = (
        f"actuator {c.layout.id[k]} on ring {ring[k]}"
        f" ({to_digits(float(c.alpha[k]), float(c.reading_error[k]))})"
        for k in (low, high)
    )
    return (
        f"Map of the {c.layout.n} actuators, seen along -z, each dot coloured by the layer chosen"
        f" above. Alpha is lowest at {lowest} and highest at {highest}. The table of actuators"
        " holds every value."
    )


def ring_caption(c: Calibration) -> str:
    """Say in words what alpha by ring shows."""
    ring = ring_of(c.layout)
    means = [float(np.nanmean(c.alpha[ring == k])) if np.isfinite(c.alpha[ring == k]).any()
             else float("nan") for k in range(ring.max() + 1)]  # fmt: skip
    words = "Alpha of each actuator, ring by ring from the centre. Bars: three standard"
    words += " uncertainties from the readings (3 E_STAT); the error of the common scale moves all"
    words += " points together. "
    if len(means) == 1:
        return words + f"The mean is {means[0]:.3g}."
    return words + "Means of the rings: " + ", ".join(f"{mean:.3f}" for mean in means) + "."


def budget(c: Calibration) -> Section:
    """Return the error budget: of the common scale, source by source, and of an actuator."""
    if c.scale == Scale.MEAN_ONE:
        words = "The common scale is a convention (mean alpha 1), so all the error is the readings'"
        return Section(
            "budget", "Error budget", (f"{words}: {percent(typical_error(c))}, typically.",)
        )
    words = "Relative standard uncertainties of alpha. The readings' part shrinks with more cycles,"
    return Section(
        "budget",
        "Error budget",
        (words + " the weights' part with better weights.",),
        bars=budget_bars(c),
    )


def _rows(findings: Findings, residuals: RowResiduals) -> Section:
    campaign, c = findings.data, findings.calibration
    if not isinstance(campaign, Campaign) or c is None:
        raise ValueError("residuals of rows belong to a campaign")
    names = [_file(campaign, k) for k in range(len(campaign.cycles))]
    kept = residuals.after[residuals.kept]
    rms, place = float(np.sqrt(np.mean(kept**2))), int(np.argmax(kept))
    shape = columns_of_shapes(residuals)[0][residuals.kept][place]
    lost = int(np.count_nonzero(~residuals.kept))
    caption = (
        f"Imbalance of {kept.size} rows of {len(names)} cycles in terms of its noise, by signed"
        f" shape and cycle: {rms:.2f} rms, where noise alone gives 1, and {kept.max():.1f} at most,"
        f" at shape {shape} of cycle {residuals.cycle[residuals.kept][place] + 1}."
        f" {lost or 'No'} row{'' if lost == 1 else 's'} rejected"
        + (", marked by crosses in circles." if lost else ".")
    )
    listed = rejected_values(campaign, c.rejected_rows)
    tables: tuple[TextTable, ...] = ()
    if listed:
        rows = tuple(
            (Path(str(row["file"])).name, str(row["row"]), f"{row['sigmas']:.1f}",
             str(row["against"]), str(row["actuator"]))
            for row in listed[:MOST_REJECTED]
        )  # fmt: skip
        more = f"; the farthest {MOST_REJECTED}" if len(listed) > MOST_REJECTED else ""
        head = ("file", "row", "sigma", "against", "actuator that stands out")
        tables = (TextTable(f"Rejected rows: {len(listed)}{more}", head, rows),)
    plot = evidence_plots.row_residuals(residuals, c.rejected_rows, names)
    return Section("residuals", "Residuals by shape and cycle", (), plot, caption, tables=tables)


def _file(campaign: Campaign, place: int) -> str:
    return Path(cycle_name(campaign, place)).name


def _modes(residuals: ModeResiduals) -> Section:
    before, after = (
        float(np.sqrt(np.mean(values**2))) for values in (residuals.before, residuals.after)
    )
    caption = (
        f"Imbalance of {residuals.after.size} elastic modes per unit of force against their"
        f" stiffness: {percent(before)} rms with alpha = 1, {percent(after)} calibrated."
    )
    plot = evidence_plots.mode_residuals(residuals)
    return Section("residuals", "Residuals by mode", (), plot, caption, BEFORE_AND_AFTER)


def _singular_values(evidence: Evidence) -> Section:
    values = evidence.singular_values
    ratio = float(values[1] / max(values[0], 1e-16 * values[-1]))
    caption = (
        f"Singular values of the balance, ascending. The first, in the diamond, belongs to alpha"
        f" itself; the second is {significant(ratio)} times larger. Patterns that come near the"
        " first are hardly known; were it no larger, noise would choose between them."
    )
    plot = evidence_plots.singular_values(evidence)
    return Section("singular-values", "Singular values", (), plot, caption)


def _balance(evidence: Evidence) -> Section:
    noise = any(np.isfinite(line.noise) for line in evidence.balance)
    head = ("of", "alpha = 1", "calibrated", "noise alone")[: 4 if noise else 3]
    rows = tuple(
        (line.what, *(f"{significant(value)} {line.unit}".rstrip() for value in
                      (line.before, line.after, line.noise)[: len(head) - 1]))
        for line in evidence.balance
    )  # fmt: skip
    caption = "Rms imbalance" if noise else "Rms imbalance per unit of force"
    table = TextTable(caption, head, rows)
    title = "The balance before and after"
    if isinstance(evidence.residuals, ModeResiduals):
        words = "Modes that the fit has not seen tell what alpha is worth on other forces."
        return Section("balance", title, (words,), tables=(table,))
    kept = evidence.residuals.kept
    before, after = (
        float(np.sqrt(np.mean(values[kept] ** 2)))
        for values in (evidence.residuals.before, evidence.residuals.after)
    )
    caption = (
        "Imbalance of every shape, with its sign, in terms of its noise:"
        f" {significant(before)} rms with alpha = 1, {significant(after)} calibrated."
    )
    plot = evidence_plots.balance(evidence.residuals)
    return Section("balance", title, (), plot, caption, BEFORE_AND_AFTER, tables=(table,))


def times(findings: Findings) -> Section:
    """Return when the data were taken, and how warm it was."""
    title, c, data = "Temperatures and times", findings.calibration, findings.data
    if not isinstance(data, Campaign):
        date = c.date if c is not None else data.date if data is not None else None
        words = f"Measured on {date:%Y-%m-%d %H:%M} UTC" if date else "Unknown"
        if c is not None and c.date_end != c.date:
            words += f" to {c.date_end:%Y-%m-%d %H:%M} UTC"
        if c is not None and np.isfinite(c.temperature):
            words += f", at {c.temperature:.1f} °C on the average"
        return Section("times", title, (f"{words}.",))
    lost = [0] * len(data.cycles)
    for gone in c.rejected_rows if c is not None else ():
        lost[gone.cycle] += 1
    rows, warm = [], []
    for k, cycle in enumerate(data.cycles):
        time = cycle.time[cycle.valid]
        span = "unknown"
        if cycle.temperature is not None:
            some = cycle.temperature[cycle.valid]
            warm += [some.min(), some.max()]
            span = f"{some.min():.2f} to {some.max():.2f}"
        rows.append(
            (str(k + 1), cycle.load.name, str(cycle.number), _file(data, k),
             f"{cycle.date:%Y-%m-%d %H:%M:%S}", f"{np.ptp(time) / 60:.1f}", str(time.size),
             str(lost[k]), span)
        )  # fmt: skip
    head = ("cycle", "load", "its number", "file", "start (UTC)", "minutes", "rows", "rejected",
            "temperature (°C)")  # fmt: skip
    starts = [cycle.date for cycle in data.cycles]
    caption = f"{len(rows)} cycles, started between {min(starts):%Y-%m-%d %H:%M} and"
    caption += f" {max(starts):%Y-%m-%d %H:%M} UTC"
    caption += f", at {min(warm):.2f} to {max(warm):.2f} °C." if warm else "."
    legend = tuple(
        (CURVES[k % len(CURVES)], f"load {load.name}") for k, load in enumerate(data.loads)
    )
    plot, table = evidence_plots.temperatures(data), TextTable("Cycles", head, tuple(rows))
    return Section("times", title, (), plot, caption, legend, tables=(table,))
