"""The verdict on a calibration in words and three numbers, and what to do about what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truenewton.calibration.result import Calibration
from truenewton.calibration.words import rejected_sentence, rejected_values, scale_limit
from truenewton.estimation.estimate import Scale
from truenewton.estimation.weights import scale_total, typical
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.report.change import Change
from truenewton.report.evidence import ModeResiduals
from truenewton.report.investigate import Findings
from truenewton.rounding import percent, significant, to_digits, with_error

FAR = 5.0  # robust standard deviations, for an actuator off the others
IMPROBABLE = 1e-3  # of a fit; as weights are warned of
MANY = 0.02  # of the rows left out
# Level and title.
SOUND, LIMITED = ("sound", "Sound"), ("limited", "Sound, within a limit")
CARE, NONE = ("care", "To be used with care"), ("none", "No alpha")


@dataclass(frozen=True)
class Verdict:
    """What to think of a calibration, and what to do.

    Attributes
    ----------
    level, title
        'sound', 'limited', 'care' or 'none'; the same in words.
    sentence
        The verdict.
    numbers
        Name, value and note: range of alpha, typical error, error of the common scale; none without
        alpha.
    advice
        What is wrong, each with what to do about it.
    """

    level: str
    title: str
    sentence: str
    numbers: tuple[tuple[str, str, str], ...]
    advice: tuple[Fault, ...]

    def lines(self) -> Iterator[str]:
        """Yield the verdict as plain text."""
        yield f"{self.title}. {self.sentence}"
        for name, value, note in self.numbers:
            yield f"{name}: {value} ({note})"
        for fault, remedy in self.advice:
            yield f"- {_sentence(fault)} {_sentence(remedy)}"
        if not self.advice:
            yield "Nothing needs to be done."


def verdict(findings: Findings) -> Verdict:
    """Judge what was found."""
    c = findings.calibration
    if c is None:
        sentence = f"These data of {findings.data.instrument} cannot give alpha."
        return Verdict(*NONE, sentence, (), findings.faults)
    limits, cares = list(_limits(findings, c)), list(_cares(c))
    level = CARE if cares else LIMITED if limits else SOUND
    known = "Alpha" if c.scale != Scale.MEAN_ONE else "Relative alpha"
    sentence = (
        f"{known} of {_actuators(c)} is known, typically to {percent(typical(c.error, c.alpha))}."
    )
    return Verdict(*level, sentence, _numbers(c), tuple(cares + limits))


def verdict_on_change(change: Change) -> Verdict:
    """Judge what changed between two calibrations."""
    ids, changed = change.one.layout.id, change.changed
    compared = int(np.isfinite(change.sigmas).sum())
    words = f"of {compared} actuators changed by more than {change.limit:.1f} sigma"
    level, title, sentence = "sound", "No change", f"None {words}: the calibrations agree."
    advice: list[Fault] = []
    if changed.size:
        level, title = "limited", "Changed"
        sentence = f"{changed.size} {words}, where chance alone makes one in a hundred comparisons."
        advice.append(
            Fault(
                f"changed: {_names(ids[changed])}",
                "calibrate anew before use, unless the change is known, as after a replacement",
            )
        )
    one, other = ({s.sha256 for s in c.sources} for c in (change.one, change.other))
    if one == other:  # a recalibration has files of its own beside those it inherits
        advice.append(
            Fault(
                "both calibrations rest on the same files, so most of their errors is common",
                "read the changes as those of the method; they scatter by less than a sigma",
            )
        )
    farthest = int(np.nanargmax(np.abs(change.sigmas)))
    numbers = (
        ("changed actuators", f"{changed.size} of {compared}", f"beyond {change.limit:.1f} sigma"),
        ("largest change", f"{change.sigmas[farthest]:+.1f} sigma",
         f"actuator {ids[farthest]}, {significant(100 * change.relative[farthest])} %"),
        ("common ratio, second to first", with_error(change.ratio, change.ratio_error)
         if np.isfinite(change.ratio_error) else f"{change.ratio:.4f}",
         "taken out; its error is that of the weights" if np.isfinite(change.ratio_error)
         else "taken out; the scale of one is a convention"),
    )  # fmt: skip
    return Verdict(level, title, sentence, numbers, tuple(advice))


def _actuators(c: Calibration) -> str:
    on = c.layout.enabled
    if on.all():
        return f"all {on.size} actuators of {c.instrument}"
    return (
        f"{on.sum()} of the {on.size} actuators of {c.instrument}"
        f" ({_names(c.layout.id[~on])} disabled)"
    )


def _names(ids: NDArray[np.int64]) -> str:
    shown = ", ".join(map(str, ids[:8]))
    more = f" and {ids.size - 8} more" if ids.size > 8 else ""
    return f"actuator{'s' if ids.size > 1 else ''} {shown}{more}"


def _numbers(c: Calibration) -> tuple[tuple[str, str, str], ...]:
    low, high = int(np.nanargmin(c.alpha)), int(np.nanargmax(c.alpha))
    ends = [to_digits(float(c.alpha[k]), float(c.error[k])) for k in (low, high)]
    readings = percent(typical(c.reading_error, c.alpha))
    scale = ("common scale", "free", "the mean of alpha is set to 1; weights would fix it")
    if c.scale != Scale.MEAN_ONE:
        part = (
            scale_total(c.scale_errors) if c.scale_errors else typical(c.systematic_error, c.alpha)
        )
        scale = ("error of the common scale", percent(part), "one sigma, the same for all")
    return (
        ("alpha", f"{ends[0]} to {ends[1]}", f"actuators {c.layout.id[low]} and"
         f" {c.layout.id[high]}, true N / commanded N"),
        ("typical error of alpha", percent(typical(c.error, c.alpha)),
         f"one sigma; {readings} from the readings"),
        scale,
    )  # fmt: skip


def _limits(findings: Findings, c: Calibration) -> Iterator[Fault]:
    """Yield what limits a calibration that is sound otherwise."""
    weights, readings = typical(c.systematic_error, c.alpha), typical(c.reading_error, c.alpha)
    if c.scale != Scale.MEAN_ONE and weights > 2.0 * readings:
        fault, remedy = scale_limit(c) or (f"the common scale is known to {percent(weights)}", "")
        yield Fault(fault, remedy or "better known weights would help, more cycles would not")
    if c.rejected_rows and isinstance(findings.data, Campaign):
        rows = rejected_values(findings.data, c.rejected_rows)
        farthest = rejected_sentence({**rows[0], "file": Path(str(rows[0]["file"])).name})
        several = len(rows) > 1
        yield Fault(
            f"{len(rows)} {'rows do' if several else 'row does'} not fit and"
            f" {'were' if several else 'was'} left out; the farthest: {farthest}",
            "look at the residuals; an actuator that stands out again and again is worth a look",
        )
    elif c.rejected:
        yield Fault(
            f"{c.rejected} rows do not fit and were left out", "see the report of the cycle files"
        )
    yield from _unseen(findings)
    for k in _off_family(c):
        alpha = with_error(float(c.alpha[k]), float(c.reading_error[k]))
        yield Fault(
            f"actuator {c.layout.id[k]} stands off the others: alpha is {alpha}",
            "look at its coil, magnet and wiring",
        )


def _unseen(findings: Findings) -> Iterator[Fault]:
    """Yield that modes which the fit has not seen balance much worse, where they do."""
    evidence = findings.evidence
    if evidence is None or not isinstance(evidence.residuals, ModeResiduals):
        return
    fitted, *unseen = (line.after for line in evidence.balance)
    worst = max(unseen)
    if worst > 2.0 * fitted:
        yield Fault(
            f"modes that the fit has not seen are out of balance by up to {percent(worst)} of their"
            f" force, fitted ones by {percent(fitted)}",
            "trust smooth patterns of alpha the least; cycles under known weights would hold them",
        )


def _cares(c: Calibration) -> Iterator[Fault]:
    """Yield what makes a calibration one to be used with care."""
    if c.diagnosis is not None:
        yield from c.diagnosis.warnings
    fit = c.goodness
    if fit is not None and fit.probability < IMPROBABLE:
        yield Fault(
            f"the shapes are out of balance by {np.sqrt(fit.reduced):.2g} times what their noise"
            " explains",
            "take E_STAT for as much too small; look for a drift, and give POSITION with COILGRAD"
            " and BIASGRAD",
        )
    if c.rejected > MANY * (c.rejected + c.shapes_used):
        part = percent(c.rejected / (c.rejected + c.shapes_used))
        yield Fault(f"{part} of the rows do not fit", "find out what happened during the run")


def _off_family(c: Calibration) -> NDArray[np.int64]:
    """Return the indices of actuators far from the others, in terms of their spread and error."""
    middle = np.nanmedian(c.alpha)
    spread = 1.4826 * np.nanmedian(np.abs(c.alpha - middle))
    far = np.abs(c.alpha - middle) > FAR * np.hypot(spread, c.reading_error)
    return np.flatnonzero(far)


def _sentence(text: str) -> str:
    """Return a fault or remedy as a sentence of its own."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith(".") else f"{text}."
