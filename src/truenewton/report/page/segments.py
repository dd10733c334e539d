"""The sections of a mirror in several segments: all in one table, then each by itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.words import as_sentences, headline, summary_rows
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.scale_budget import typical
from truenewton.report.change import Change
from truenewton.report.page.section import Section, TextTable
from truenewton.rounding import counted, percent, significant, with_error

HEAD = ("segment", "verdict", "actuators", "mean alpha", "typical error", "of it from the weights",
        "B (N)", "noise (mN)", "chi2/DOF", "rejected rows")  # fmt: skip


def segment_sections(c: SegmentedCalibration) -> Iterator[Section]:
    """Yield what is known of the segments: side by side, then one after the other."""
    rows = tuple(_row(c, number) for number in c.numbers)
    words = (
        "Each is a body of its own: it was balanced by itself, with its own weight, B and torques."
    )
    words += (
        f" With --segment {c.numbers[0]} added, the command at the end of this page makes one with"
        " its residuals and modes, where it was given the data."
    )
    table = TextTable(counted(c.numbers, "segment"), HEAD, rows)
    yield Section("segments", "Segments", (words,), tables=(table,))
    for number in c.numbers:
        key, title = f"segment-{number}", f"Segment {number}"
        if number in c.refused:
            yield Section(key, title, ("No alpha.", *map(as_sentences, c.refused[number])))
            continue
        one = c.segments[number]
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


def _row(c: SegmentedCalibration, number: int) -> tuple[str, ...]:
    own = c.layout.segment == number
    count = str(int(np.count_nonzero(c.layout.enabled[own])))
    if number in c.refused:
        return (str(number), str(Level.NONE), count, *[""] * (len(HEAD) - 3))
    one = c.segments[number]
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
