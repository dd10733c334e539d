"""The verdict on a calibration with three numbers, and what to do about what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.calibration.summary import as_sentences
from truenewton.calibration.verdict import without_unusable
from truenewton.errors import Fault
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Scale, scale_total, typical
from truenewton.estimation.findings.finding import Finding, Verdict, no_alpha
from truenewton.records.cycle import Source
from truenewton.records.parts import Parts, has_parts
from truenewton.report.change import Change
from truenewton.report.findings import Findings
from truenewton.rounding import counted, named, percent, significant, to_digits, with_error

Reported = Findings | Change | Parts[Calibration]
MEANINGS = {
    Level.USABLE: " The stated errors hold and include what was found."
    " A better result is possible.",
    Level.DOUBTFUL: " The stated errors may not hold. Do not load it into electronics before the"
    " checks below.",
    Level.REJECTED: " Do not use it.",
}


@dataclass(frozen=True)
class Headline:
    """What a page says first: a verdict, and what to do.

    Attributes
    ----------
    level, title
        Of the verdict; the same as a title.
    sentence
        What is known.
    numbers
        Name, value and note: range of alpha, typical error, error of the common scale; none without
        alpha.
    advice
        What is wrong, each with what to do about it.
    """

    level: Level
    title: str
    sentence: str
    numbers: tuple[tuple[str, str, str], ...]
    advice: tuple[Finding | Fault, ...]

    def lines(self) -> Iterator[str]:
        """Yield the verdict as plain text."""
        yield f"{self.title}. {self.sentence}"
        for name, value, note in self.numbers:
            yield f"{name}: {value} ({note})"
        for each in self.advice:
            yield f"- {as_sentences(each)}"
        if not self.advice:
            yield "Nothing needs to be done."


def verdict(findings: Findings) -> Headline:
    """Say the verdict on what was found."""
    c = findings.calibration
    if c is None:
        sentence = f"These data of {findings.data.instrument} cannot give alpha."
        return _headline(no_alpha(findings.faults), sentence, ())
    known = "Alpha" if c.scale != Scale.MEAN_ONE else "Relative alpha"
    sentence = (
        f"{known} of {_actuators(c)} is known, typically to {percent(typical(c.error, c.alpha))}."
    )
    for note in c.verdict.notes:
        sentence += f" {as_sentences(note)}"
    return _headline(c.verdict, sentence, _numbers(c))


def headline_of(findings: Reported) -> Headline:
    """Say the verdict on whatever a page is made of."""
    if isinstance(findings, Change):
        return verdict_on_change(findings)
    if has_parts(findings):
        return verdict_on_whole(findings)
    return verdict(findings)


def verdict_on_whole(c: Parts[Calibration]) -> Headline:
    """Say the verdict on a mirror in several segments; figures are of those that can be used."""
    levels = [one.verdict.level for one in c.found.values()]
    sound = sum(level == Level.SOUND for level in levels)
    verdict, c = c.verdict, without_unusable(c)
    alpha, errors = c.column("alpha"), c.column("error")
    known = np.isfinite(alpha)
    error = typical(errors[known], alpha[known])
    part = f"{len(c.found)} of" if c.failed else "all"
    sentence = (
        f"Alpha of {part} {counted(c.numbers, 'segment')} of {c.instrument} is known"
        f" ({counted(int(known.sum()), 'actuator')}), typically to {percent(error)}."
    )
    of_each = {n: typical(one.error, one.alpha) for n, one in c.found.items()}
    worst = max(of_each, key=lambda n: of_each[n])
    largest = f"; {percent(of_each[worst])} on segment {worst}, the largest"
    differ = len({percent(each) for each in of_each.values()}) > 1
    numbers = (
        _range(c),
        ("typical error of alpha", percent(error), f"one sigma{largest if differ else ''}"),
        ("sound segments", f"{sound} of {len(c.numbers)}", "each has a section below"),
    )  # fmt: skip
    return _headline(verdict, sentence, numbers)


def _headline(
    verdict: Verdict, sentence: str, numbers: tuple[tuple[str, str, str], ...]
) -> Headline:
    sentence += MEANINGS.get(verdict.level, "")
    title = str(verdict.level).capitalize()
    return Headline(verdict.level, title, sentence, numbers, verdict.faults)


def verdict_on_change(change: Change) -> Headline:
    """Judge what changed between two calibrations."""
    ids, changed = change.one.layout.id, change.changed
    compared = int(np.isfinite(change.sigmas).sum())
    words = f"of {counted(compared, 'actuator')} changed by more than {change.limit:.1f} sigma"
    level, title, sentence = Level.SOUND, "No change", f"None {words}: the calibrations agree."
    advice: list[Fault] = []
    if changed.size:
        level, title = Level.DOUBTFUL, "Changed"
        sentence = f"{changed.size} {words}, where chance alone makes one in a hundred comparisons."
        advice.append(
            Fault(
                f"changed: {named('actuator', ids[changed].tolist(), 8)}",
                "calibrate anew before use, unless the change is known, as after a replacement",
            )
        )
    one, other = ({s.sha256 for s in sources_of(c)} for c in (change.one, change.other))
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
        _ratio(change),
    )  # fmt: skip
    return Headline(level, title, sentence, numbers, tuple(advice))


def sources_of(c: AnyCalibration) -> tuple[Source, ...]:
    """Return the files that went in; of several segments each once."""
    if not has_parts(c):
        return c.sources
    every = (source for one in c.found.values() for source in one.sources)
    return tuple({source.sha256: source for source in every}.values())


def _ratio(change: Change) -> tuple[str, str, str]:
    """Return name, value and note of the common ratio, or of those of the segments."""
    if change.segments:
        ratios = [part.ratio for part in change.segments.values()]
        return ("common ratios, second to first", f"{min(ratios):.4f} to {max(ratios):.4f}",
                "of each segment, taken out; each in the table of segments")  # fmt: skip
    name = "common ratio, second to first"
    if np.isfinite(change.ratio_error):
        return (name, with_error(change.ratio, change.ratio_error),
                "taken out; its error is that of the weights")  # fmt: skip
    return name, f"{change.ratio:.4f}", "taken out; the scale of one is a convention"


def _actuators(c: Calibration) -> str:
    on = c.layout.enabled
    if on.all():
        return f"all {counted(on.size, 'actuator')} of {c.instrument}"
    return (
        f"{on.sum()} of the {counted(on.size, 'actuator')} of {c.instrument}"
        f" ({named('actuator', c.layout.id[~on].tolist(), 8)} disabled)"
    )


def _numbers(c: Calibration) -> tuple[tuple[str, str, str], ...]:
    readings = percent(typical(c.reading_error, c.alpha))
    scale = (
        "common scale",
        "not measured",
        "mean alpha is 1; cycles under known weights would determine it",
    )
    if c.scale != Scale.MEAN_ONE:
        part = (
            scale_total(c.scale_errors) if c.scale_errors else typical(c.systematic_error, c.alpha)
        )
        scale = ("error of the common scale", percent(part), "one sigma, the same for all")
    return (
        _range(c),
        ("typical error of alpha", percent(typical(c.error, c.alpha)),
         f"one sigma; {readings} from the readings"),
        scale,
    )  # fmt: skip


def _range(c: AnyCalibration) -> tuple[str, str, str]:
    """Return name, value and note of the smallest and the largest alpha."""
    alpha, error, ids = c.column("alpha"), c.column("error"), c.layout.id
    low, high = int(np.nanargmin(alpha)), int(np.nanargmax(alpha))
    ends = " to ".join(to_digits(float(alpha[k]), float(error[k])) for k in (low, high))
    return "alpha", ends, f"actuators {ids[low]} and {ids[high]}, true N / commanded N"
