"""The page in sections: what each shows, and the same in words for who cannot see it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.summary import (
    as_sentences,
    error_budget,
    headline,
    rejected_values,
    summary_rows,
)
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import typical
from truenewton.modal.figures import chosen_modes
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.modal.summary import (
    comparison_text,
    cost_rows,
    fitting_error_text,
    measured_text,
    rigid_text,
    sensor_gains_text,
    static_force_text,
    stiffness_text,
    turbulence_text,
)
from truenewton.records.campaign import Campaign
from truenewton.records.parts import Parts
from truenewton.report.change import Change
from truenewton.report.evidence import Evidence, ModeResiduals, RowResiduals
from truenewton.report.figures import columns_of_shapes
from truenewton.report.findings import Findings
from truenewton.rounding import counted, percent, significant, with_error


@dataclass(frozen=True)
class TextTable:
    """A table of text, not shown without rows.

    Its first column is a name; long cells wrap where ``wraps``.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    wraps: bool = False


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes
    ----------
    key, title
        For links; for people.
    words
        Paragraphs.
    figure
        Name of the figure of `Findings.plot`; empty where nothing is drawn.
    caption
        What the figure shows, in words: its alternative for who cannot see it.
    tables
        What stands beneath.
    """

    key: str
    title: str
    words: tuple[str, ...] = ()
    figure: str = ""
    caption: str = ""
    tables: tuple[TextTable, ...] = ()


NO_DATA = "This page was made from a calibration file, which does not hold them: give the cycles."
MOST_REJECTED = 50  # rows listed
SEGMENT_HEAD = ("segment", "verdict", "actuators", "mean alpha", "typical error",
                "of it from the weights", "B (N)", "noise (mN)", "chi2/DOF",
                "rejected rows")  # fmt: skip


def evidence_sections(findings: Findings) -> Iterator[Section]:
    """Yield what supports or explains alpha, in the order of the page."""
    c, evidence = findings.calibration, findings.evidence
    if c is None:
        return
    yield _budget(c)
    if evidence is None:
        yield Section("residuals", "Residuals, singular values and balance", (NO_DATA,))
        return
    if isinstance(evidence.residuals, ModeResiduals):
        yield _modes(evidence.residuals)
    elif isinstance(findings.data, Campaign):
        yield _rows(findings.data, c, evidence.residuals)
    yield _singular_values(evidence)
    yield _balance(evidence)


def _budget(c: Calibration) -> Section:
    """Return the error budget: of the common scale, source by source, and of an actuator."""
    title, budget = "Error budget", error_budget(c)
    if not budget:
        words = "The common scale is a convention (mean alpha 1), so all the error is the readings'"
        words += f": {percent(typical(c.error, c.alpha))}, typically."
        return Section("budget", title, (words,))
    parts = "; ".join(f"{name}: {percent(size)}" for name, size in budget.items())
    caption = (
        f"Relative standard uncertainties of alpha. {parts[:1].upper()}{parts[1:]}. The readings'"
        " part shrinks with more cycles, the weights' part with better weights."
    )
    unseen = "; ".join(f"{percent(error.relative)} if {error.name}" for error in c.unseen)
    if unseen:
        caption += f" What such data cannot show is in none of them: {unseen}."
    return Section("budget", title, (), "budget", caption)


def _rows(campaign: Campaign, c: Calibration, residuals: RowResiduals) -> Section:
    after, rejected = residuals.after[residuals.kept], int(np.count_nonzero(~residuals.kept))
    farthest = int(np.argmax(after))
    shape = columns_of_shapes(residuals)[0][residuals.kept][farthest]
    caption = (
        f"Imbalance of {counted(after, 'row')} of {counted(campaign.cycles, 'cycle')} in terms of"
        f" its noise, by signed shape and cycle: {_rms(after):.2f} rms, where noise alone gives 1,"
        f" and {after[farthest]:.1f} at most, at shape {shape} of cycle"
        f" {residuals.cycle[residuals.kept][farthest] + 1}."
        f" {counted(rejected, 'row') if rejected else 'No rows'} rejected"
        + (", marked by crosses." if rejected else ".")
    )
    listed = rejected_values(campaign, c.rejected_rows)
    rows = tuple(
        (Path(str(row["file"])).name, str(row["row"]), f"{row['sigmas']:.1f}",
         str(row["against"]), str(row["actuator"]))
        for row in listed[:MOST_REJECTED]
    )  # fmt: skip
    more = f"; the farthest {MOST_REJECTED}" if len(listed) > MOST_REJECTED else ""
    head = ("file", "row", "sigma", "against", "actuator that stands out")
    table = TextTable(f"Rejected rows: {len(listed)}{more}", head, rows)
    title = "Residuals by shape and cycle"
    return Section("residuals", title, (), "residuals", caption, (table,))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _modes(residuals: ModeResiduals) -> Section:
    before, after = percent(_rms(residuals.before)), percent(_rms(residuals.after))
    caption = (
        f"Imbalance of {residuals.after.size} elastic modes per unit of force against their"
        f" stiffness: {before} rms with alpha = 1, {after} calibrated."
    )
    return Section("residuals", "Residuals by mode", (), "residuals", caption)


def _singular_values(evidence: Evidence) -> Section:
    values = evidence.singular_values
    ratio = float(values[1] / max(values[0], 1e-16 * values[-1]))
    caption = (
        f"Singular values of the balance, ascending. The first, in the diamond, belongs to alpha"
        f" itself; the second is {significant(ratio)} times larger. Patterns that come near the"
        " first are hardly known; were it no larger, noise would choose between them."
    )
    return Section("singular-values", "Singular values", (), "singular-values", caption)


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
    used = evidence.residuals.kept
    before, after = (
        significant(_rms(values[used]))
        for values in (evidence.residuals.before, evidence.residuals.after)
    )
    caption = (
        "Imbalance of every shape, with its sign, in terms of its noise:"
        f" {before} rms with alpha = 1, {after} calibrated."
    )
    return Section("balance", title, (), "balance", caption, (table,))


def times(findings: Findings) -> Section:
    """Return when the data were taken, and how warm it was."""
    title, c, data = "Temperatures and times", findings.calibration, findings.data
    if not isinstance(data, Campaign):
        words = f"Measured on {data.date:%Y-%m-%d %H:%M} UTC"
        if c is not None and c.date_end != c.date:
            words += f" to {c.date_end:%Y-%m-%d %H:%M} UTC"
        if c is not None and np.isfinite(c.temperature):
            words += f", at {c.temperature:.1f} °C on the average"
        return Section("times", title, (f"{words}.",))
    rejected = Counter(row.cycle for row in c.rejected_rows) if c is not None else Counter()
    rows, warm = [], []
    for k, cycle in enumerate(data.cycles):
        time = cycle.time[cycle.valid]
        span = "unknown"
        if cycle.temperature is not None:
            some = cycle.temperature[cycle.valid]
            warm += [some.min(), some.max()]
            span = f"{some.min():.2f} to {some.max():.2f}"
        rows.append(
            (str(k + 1), cycle.load.name, str(cycle.number), Path(cycle.name).name,
             f"{cycle.date:%Y-%m-%d %H:%M:%S}", f"{np.ptp(time) / 60:.1f}", str(time.size),
             str(rejected[k]), span)
        )  # fmt: skip
    head = ("cycle", "load", "its number", "file", "start (UTC)", "minutes", "rows", "rejected",
            "temperature (°C)")  # fmt: skip
    starts = [cycle.date for cycle in data.cycles]
    caption = f"{counted(rows, 'cycle')}, started between {min(starts):%Y-%m-%d %H:%M} and"
    caption += f" {max(starts):%Y-%m-%d %H:%M} UTC"
    caption += f", at {min(warm):.2f} to {max(warm):.2f} °C." if warm else "."
    tables = (TextTable("Cycles", head, tuple(rows)),)
    return Section("times", title, (), "temperatures", caption, tables)


def segment_sections(c: Parts[Calibration]) -> Iterator[Section]:
    """Yield what is known of the segments: side by side, then one after the other."""
    rows = tuple(_segment_row(c, number) for number in c.numbers)
    words = (
        "Each is a body of its own: it was balanced by itself, with its own weight, B and torques."
    )
    words += (
        f" With --segment {c.numbers[0]} added, the command at the end of this page makes one with"
        " its residuals and modes, where it was given the data."
    )
    table = TextTable(counted(c.numbers, "segment"), SEGMENT_HEAD, rows)
    yield Section("segments", "Segments", (words,), tables=(table,))
    for number in c.numbers:
        key, title = f"segment-{number}", f"Segment {number}"
        if number in c.failed:
            yield Section(key, title, ("No alpha.", *map(as_sentences, c.failed[number])))
            continue
        one = c.found[number]
        faults = map(as_sentences, one.verdict.faults)
        numbers = TextTable(
            "All figures", ("figure", "value", "note"), tuple(summary_rows(one)), wraps=True
        )
        said = f"{headline(one)}. The verdict: {one.verdict.level}."
        yield Section(key, title, (said, *faults), tables=(numbers,))


def changed_segments(change: Change) -> TextTable:
    """Return the table of what changed, segment by segment."""
    rows = []
    for number in change.one.layout.segments:
        part = change.segments.get(number)
        if part is None:
            rows.append((str(number), "no alpha in one of them", "", ""))
            continue
        farthest = int(np.nanargmax(np.abs(part.sigmas)))
        known = np.isfinite(part.ratio_error)
        ratio = with_error(part.ratio, part.ratio_error) if known else f"{part.ratio:.4f}"
        largest = f"{part.sigmas[farthest]:+.1f} sigma, actuator {part.one.layout.id[farthest]}"
        rows.append((str(number), ratio, str(part.changed.size), largest))
    head = ("segment", "common ratio, second to first", "changed actuators", "largest change")
    return TextTable(counted(rows, "segment"), head, tuple(rows))


def _segment_row(c: Parts[Calibration], number: int) -> tuple[str, ...]:
    own = c.layout.segment == number
    count = str(int(np.count_nonzero(c.layout.enabled[own])))
    if number in c.failed:
        return (str(number), str(Level.NONE), count, *[""] * (len(SEGMENT_HEAD) - 3))
    one = c.found[number]
    weighed = np.isfinite(one.bias_force)
    return (
        str(number),
        str(one.verdict.level),
        count,
        f"{np.nanmean(one.alpha):.4f}",
        percent(typical(one.error, one.alpha)),
        percent(typical(one.systematic_error, one.alpha)) if weighed else "",
        with_error(one.bias_force, one.bias_force_error) if weighed else "",
        significant(1e3 * one.noise, 3) if np.isfinite(one.noise) else "",
        significant(one.goodness.reduced, 3) if one.goodness else "",
        str(one.rejected),
    )


def modal_sections(findings: Findings) -> Iterator[Section]:
    """Yield the modal base, or why there is none; nothing of a calibration file."""
    modes = findings.modes
    if modes is not None:
        yield _stiffness_modes(modes)
        yield _turbulence(modes.after)
        yield _dissipation(modes.after)
    elif findings.no_modes:
        yield Section("modes", "Stiffness modes", (findings.no_modes,))


def _stiffness_modes(modes: ModalFindings) -> Section:
    values = modes.after.modes.stiffness
    elastic = values[3:]
    negative = elastic[elastic < 0.0]
    softest, stiffest = elastic[elastic > 0.0].min(initial=np.inf), elastic.max()
    rigid = ", ".join(stiffness_text(value) for value in values[:3])
    words = [
        f"Of {counted(values, 'mode')} the softest elastic one has {stiffness_text(softest)}, the"
        f" stiffest {stiffness_text(stiffest)}. Piston and tilts bend nothing; bias magnets and"
        f" errors leave them {rigid}.",
    ]
    if negative.size:
        words.append(
            f"{counted(negative, 'elastic mode')} with negative stiffness, down to"
            f" {stiffness_text(float(negative.min()))}: no elastic body has any."
        )
    if compared := comparison_text(modes):
        words.append(f"Modes found with alpha = 1 lie {compared}.")
    if modes.measured is not None:
        texts = filter(None, (measured_text(modes.measured), rigid_text(modes.measured)))
        words.append(f"Measured stiffness: {'; '.join(texts)}.")
    if gains := sensor_gains_text(modes.after):
        words.append(f"Gains of the sensors: {gains}.")
    words += [f"Warning: {as_sentences(each)}" for each in modes.warnings]
    rows = (
        ("asymmetry", *map(percent, modes.asymmetry)),
        ("out of balance", *map(percent, modes.imbalance)),
    )
    drawn = [f"{k + 1}: {stiffness_text(values[k])}" for k in chosen_modes(values.size)]
    caption = (
        "Maps of modes, seen along -z, softest first: each actuator's displacement in terms of the"
        " mode's largest, one way purple, the other orange. Modes and their stiffness:"
        f" {'; '.join(drawn)}."
    )
    table = TextTable("Faults of the stiffness", ("of", "alpha = 1", "calibrated"), rows)
    return Section("modes", "Stiffness modes", tuple(words), "modes", caption, (table,))


def _turbulence(base: ModalBase) -> Section:
    count = base.modes.stiffness.size
    half = count // 2
    left = ", ".join(f"{1e9 * cost.residual[half - 1]:.3g} nm {cost.base}" for cost in base.costs)
    caption = (
        "Rms wavefront that the first N modes of three bases leave on the actuators. After"
        f" {half} of {count}: {left}."
    )
    words = (f"For {turbulence_text(base)}.", f"Between actuators: {fitting_error_text(base)}.")
    return Section("turbulence", "Turbulence", words, "modes-residual", caption)


def _dissipation(base: ModalBase) -> Section:
    cost = base.costs[0]
    caption = (
        "Mean power of the worst coil (full) and of all coils (dotted), static force included,"
        " against the number of modes. With all"
        f" {cost.residual.size}: {cost.power[:, -1].max():.2g} W and"
        f" {cost.power[:, -1].mean():.2g} W."
    )
    words = (
        f"Static force of the actuators: {static_force_text(cost)}.",
        "truenewton modes --power W --force N tells how many modes a limit allows.",
    )
    head = ("N", *(f"{each.base} (nm)" for each in base.costs), "force rms (mN)",
            "worst (mN)", "power mean (W)", "worst (W)", "total (W)")  # fmt: skip
    table = TextTable(
        "Rms wavefront that N modes of each base leave; force and power of N stiffness modes",
        head, tuple(cost_rows(base)),
    )  # fmt: skip
    return Section("dissipation", "Dissipation", words, "modes-power", caption, (table,))
