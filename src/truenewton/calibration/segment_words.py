"""The calibration of a mirror in several segments in words and numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from truenewton.calibration.segmented import SegmentedCalibration
from truenewton.calibration.verdict import no_alpha
from truenewton.calibration.words import row, summary_values, verdict_lines
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.scale_budget import typical
from truenewton.rounding import counted, percent, to_digits, with_error


def segmented_headline(c: SegmentedCalibration) -> str:
    """Return what was calibrated."""
    disabled = int(np.count_nonzero(~c.layout.enabled))
    return (
        f"{c.instrument}, {c.date:%Y-%m-%d}: {counted(c.layout.n - disabled, 'actuator')}"
        + (f" ({disabled} disabled)" if disabled else "")
        + f" of {counted(c.numbers, 'segment')}"
        + (f", {len(c.refused)} without alpha" if c.refused else "")
    )


def segment_rows(c: SegmentedCalibration) -> Iterator[tuple[str, str, str]]:
    """Yield name, range of alpha and what is known of each segment."""
    for number in c.numbers:
        if number in c.refused:
            yield f"segment {number}", str(Level.NONE), c.refused[number][0].fault
            continue
        one = c.segments[number]
        low, high = int(np.nanargmin(one.alpha)), int(np.nanargmax(one.alpha))
        ends = " .. ".join(to_digits(float(one.alpha[k]), float(one.error[k])) for k in (low, high))
        error = percent(typical(one.error, one.alpha))
        bias = ""
        if one.loads:
            bias = f", B = {with_error(one.bias_force, one.bias_force_error)} N"
        yield f"segment {number}", f"alpha {ends}", f"{one.verdict.level}; error {error}{bias}"


def segmented_lines(c: SegmentedCalibration) -> Iterator[str]:
    """Yield what was found, segment by segment, and what limits it."""
    yield segmented_headline(c)
    for name, value, note in segment_rows(c):
        yield row(name, value, note)
    yield from verdict_lines(c.verdict)


def segmented_values(c: SegmentedCalibration) -> dict[str, Any]:
    """Return the same figures for a script."""
    return {
        "instrument": c.instrument,
        "date": c.date.isoformat(),
        "verdict": c.verdict.values,
        "actuators": {
            "id": c.layout.id,
            "segment": c.layout.segment,
            "alpha": c.alpha,
            "e_alpha": c.error,
            "e_stat": c.reading_error,
            "e_syst": c.systematic_error,
            "e_cycle": c.cycle_error,
        },
        "segments": [
            {"segment": number, **summary_values(c.segments[number])}
            if number in c.segments
            else {
                "segment": number,
                "verdict": no_alpha(c.refused[number]).values,
            }
            for number in c.numbers
        ],
    }
