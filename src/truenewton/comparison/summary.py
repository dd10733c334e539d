"""A comparison of two matrices as text for the terminal, and as values for scripts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from truenewton.calibration.summary import verdict_lines
from truenewton.comparison.calibrations import CHANGE, Change
from truenewton.comparison.pairing import Matching
from truenewton.comparison.result import CHANGES, AnyChange, Comparison
from truenewton.estimation.findings.code import Level
from truenewton.files.values import Columns, Values
from truenewton.records.result import Summary, summary_of
from truenewton.rounding import counted, named, percent, row, with_error

WEIGHTS_INDEPENDENT = "its error assumes two independent weighings"
MAX_ROWS = 12  # of the table of actuators; the file contains all
MAX_COUPLINGS = 5
MEANINGS_OF_CHANGES = {
    Level.SOUND: "the stated errors are valid",
    Level.USABLE: "the changes can be used within the limits below",
    Level.DOUBTFUL: "the stated changes or their errors may be wrong",
    Level.REJECTED: "do not use the changes",
}
UNDETECTABLE = (
    "a change of 0.1 % in alpha, because a patch of glass that becomes 1 % stiffer looks the same",
    "whether alpha or the sensor gains changed in the mean; only their product is measured",
)


def lines(c: AnyChange) -> Iterator[str]:
    """Yield what changed, the worst actuators, and whether the errors are valid."""
    if isinstance(c, Change):
        yield from _lines_of_calibrations(c)
        return
    yield f"{c.instrument}: {counted(int(c.layout.enabled.sum()), 'actuator')} compared"
    yield from (row(*each) for each in figures(c))
    if changed := [*changed_actuators(c)]:
        yield f"  {'actuator':<12}{'alpha, new / old':<30}sensor gain, new / old"
        yield from (f"  {name:<12}{alpha:<30}{gain}" for name, alpha, gain in changed[:MAX_ROWS])
    yield from verdict_lines(c.verdict, MEANINGS_OF_CHANGES)
    yield from (f"  undetectable here: {text}" for text in UNDETECTABLE)


def figures(c: Comparison) -> Iterator[tuple[str, str, str]]:
    """Yield name, value and note of what is common to the actuators, or is about a few."""
    yield "common factor", with_error(c.common, c.common_error), "alpha times sensor gain"
    for name, changed, scatter, errors in (
        ("alpha", c.alpha_changed, c.alpha_scatter, c.alpha_ratio_error),
        ("sensor gain", c.sensor_changed, c.sensor_scatter, c.sensor_ratio_error),
    ):
        count = counted(int(changed.sum()), "actuator") if changed.any() else "no single actuator"
        error = percent(float(np.nanmedian(errors)))
        beyond = f"{percent(scatter)} beyond noise" if scatter else "consistent with noise"
        which = "other actuators" if changed.any() else "actuators"
        note = f"scatter of the {which}: {beyond}; uncertainty of each: {error}"
        yield f"{name} changed", count, note
    for actuator, sensor, size in c.couplings[:MAX_COUPLINGS]:
        where = f"actuator {actuator}, sensor {sensor}"
        yield "coupling changed", where, f"{percent(size)} of the diagonal"
    if len(c.couplings) > MAX_COUPLINGS:
        yield "", f"and {counted(len(c.couplings) - MAX_COUPLINGS, 'coupling')} more", ""
    yield (
        "noise",
        percent(c.relative_noise),
        f"of the rms matrix element, independent between {c.noise_law}",
    )
    if np.isfinite(c.excess):
        yield "residual / repeat", f"{c.excess:.2f}", "1 if only factors changed"
    for name, ids in (
        ("only in the old matrix", c.matching.only_old),
        ("only in the new matrix", c.matching.only_new),
        ("row only in the old", c.matching.lost_rows),
        ("column only in the old", c.matching.lost_columns),
    ):
        if ids:
            yield name, named("actuator", ids, MAX_ROWS), "not compared"
    for name, pairs in (
        ("coil cables exchanged", c.matching.exchanged_rows),
        ("sensor cables exchanged", c.matching.exchanged_columns),
    ):
        if pairs:
            yield name, ", ".join(f"{i} in the place of {j}" for i, j in pairs[:MAX_ROWS]), ""


def changed_actuators(c: Comparison) -> Iterator[tuple[str, str, str]]:
    """Yield ID, alpha and sensor gain of those that changed, the largest change first."""
    changed = np.flatnonzero(c.changed)
    far = np.abs(np.log(np.abs(c.alpha_ratio))) + np.abs(np.log(np.abs(c.sensor_ratio)))
    for k in changed[np.argsort(-far[changed], kind="stable")]:
        alpha = with_error(float(c.alpha_ratio[k]), float(c.alpha_ratio_error[k]))
        gain = with_error(float(c.sensor_ratio[k]), float(c.sensor_ratio_error[k]))
        marks = [" changed" if each[k] else "" for each in (c.alpha_changed, c.sensor_changed)]
        yield str(c.layout.shown[k]), alpha + marks[0], gain + marks[1]


def _lines_of_calibrations(c: Change) -> Iterator[str]:
    """Yield what changed between two calibrations."""
    compared = int(np.isfinite(c.sigmas).sum())
    yield f"{c.one.instrument}: two calibrations, {counted(compared, 'actuator')} compared"
    error = WEIGHTS_INDEPENDENT if np.isfinite(c.ratio_error) else ""
    ratio = with_error(c.ratio, c.ratio_error) if error else f"{c.ratio:.4f}"
    yield row("common factor", ratio, error)
    changed = counted(c.changed, "actuator") if c.changed.size else "none"
    yield row("alpha changed", changed, f"by more than {c.limit:.1f} sigma (1 % false alarms)")
    for k in c.changed[:MAX_ROWS]:
        size, sigmas = 100 * c.relative[k], c.sigmas[k]
        yield f"  {c.layout.shown[k]:<12}{size:+.2f} %, {sigmas:+.1f} sigma"
    if len(c.changed) > MAX_ROWS:
        yield f"  and {len(c.changed) - MAX_ROWS} more"
    yield "  To detect smaller changes, and changes of the sensors, compare two stiffness matrices."


def _couplings(c: Comparison) -> list[dict[str, Any]]:
    return [dict(zip(("actuator", "sensor", "change"), one, strict=True)) for one in c.couplings]


VALUES = Values(
    Comparison, "instrument", "common", "common_error", "alpha_scatter", "sensor_scatter",
    "noise_law", "relative_noise", "pattern", "tails", "resemblance", "excess",
    ("actuators", Columns(CHANGES)), ("couplings", _couplings),
    *((each.name, f"matching.{each.name}") for each in fields(Matching)),
    ("undetectable", lambda _: UNDETECTABLE), "verdict",
)  # fmt: skip
CHANGE_VALUES = Values(
    Change, ("instrument", "one.instrument"), "ratio", "ratio_error", "limit",
    ("actuators", Columns(CHANGE)), ("changed", lambda c: c.layout.id[c.changed]),
)  # fmt: skip


def values(c: AnyChange) -> dict[str, Any]:
    """Return the same for a script."""
    return dict((CHANGE_VALUES if isinstance(c, Change) else VALUES).of(c))


@summary_of.register(Comparison)
def _summary(c: Comparison) -> Summary:
    first, *others = lines(c)
    return Summary(first, (), others)
