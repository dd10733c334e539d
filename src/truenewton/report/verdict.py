"""The verdict on what a page shows, with three numbers and advice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.calibration.summary import MEANINGS, summary_rows
from truenewton.calibration.verdict import without_unusable
from truenewton.comparison.calibrations import Change
from truenewton.comparison.result import AnyChange, Comparison
from truenewton.comparison.summary import MEANINGS_OF_CHANGES, WEIGHTS_INDEPENDENT, figures
from truenewton.errors import Fault
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.estimation.findings.finding import Finding, Verdict, as_sentences, no_alpha
from truenewton.records.cycle import Source
from truenewton.records.parts import Parts, by_number, has_parts
from truenewton.report.findings import Findings
from truenewton.rounding import counted, named, percent, significant, with_error

if TYPE_CHECKING:
    from typing_extensions import TypeIs

Reported = Findings | AnyChange | Parts[Calibration]
Numbers = tuple[tuple[str, str, str], ...]  # name, value and note


@dataclass(frozen=True)
class Headline:
    """The first section of a page: verdict, sentence, numbers, and findings with advice."""

    level: Level
    title: str
    sentence: str
    numbers: Numbers
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


def headline_of(findings: Reported) -> Headline:
    """Return the verdict on what a page shows."""
    if isinstance(findings, Change):
        return _on_change(findings)
    if of_comparison(findings):
        return _on_comparison(findings)
    if of_segments(findings):
        return _on_parts(findings)
    c = findings.calibration
    if c is None:
        sentence = f"These data of {findings.data.instrument} cannot give alpha."
        return _headline(no_alpha(findings.faults), sentence, ())
    on, known = c.layout.enabled, "Relative alpha" if c.scale == Scale.MEAN_ONE else "Alpha"
    which = f"all {counted(on.size, 'actuator')} of {c.instrument}"
    if not on.all():
        disabled = named("actuator", c.layout.shown[~on].tolist(), 8)
        which = f"{on.sum()} of the {which.removeprefix('all ')} ({disabled} disabled)"
    sentence = f"{known} of {which} has a typical error of {percent(typical(c.error, c.alpha))}."
    remedies = dict.fromkeys(note.remedy for note in c.verdict.notes)
    for words in (*(note.fault for note in c.verdict.notes), *filter(None, remedies)):
        sentence += f" {as_sentences(Fault(words, ''))}"
    numbers = tuple((name.strip(), *rest) for name, *rest in islice(summary_rows(c), 3))
    return _headline(c.verdict, sentence, numbers)  # type: ignore[arg-type]


def _on_parts(c: Parts[Calibration]) -> Headline:
    """Return the verdict on all segments; the numbers are of those that can be used."""
    sound = sum(one.verdict.level == Level.SOUND for one in c.found.values())
    verdict, c = c.verdict, without_unusable(c)
    alpha, errors = c.column("alpha"), c.column("error")
    known = np.isfinite(alpha)
    error = typical(errors[known], alpha[known])
    part = f"{len(c.found)} of" if c.failed else "all"
    sentence = (
        f"Alpha of {part} {counted(c.numbers, 'segment')} of {c.instrument}"
        f" ({counted(int(known.sum()), 'actuator')}) has a typical error of {percent(error)}."
    )
    of_each = {n: typical(one.error, one.alpha) for n, one in c.found.items()}
    worst = max(of_each, key=lambda n: of_each[n])
    numbers = (
        ("alpha", f"{np.nanmin(alpha):.3f} .. {np.nanmax(alpha):.3f}", "true N / commanded N"),
        ("typical error of alpha", percent(error),
         f"E_ALPHA, one sigma; the largest on segment {worst}: {percent(of_each[worst])}"),
        ("sound segments", f"{sound} of {len(c.numbers)}", "each has a section below"),
    )  # fmt: skip
    return _headline(verdict, sentence, numbers)


def _headline(
    verdict: Verdict,
    sentence: str,
    numbers: Numbers,
    meanings: Mapping[Level, str] = MEANINGS,
) -> Headline:
    if meaning := meanings.get(verdict.level):
        sentence += f" {as_sentences(Fault(meaning, ''))}"
    title = str(verdict.level).capitalize()
    return Headline(verdict.level, title, sentence, numbers, verdict.faults)


def _on_change(change: Change) -> Headline:
    """Return the verdict on what changed between two calibrations."""
    ids, changed = change.one.layout.id, change.changed
    compared = int(np.isfinite(change.sigmas).sum())
    words = f"of {counted(compared, 'actuator')} changed by more than {change.limit:.1f} sigma"
    level, title, sentence = Level.SOUND, "No change", f"None {words}: the calibrations agree."
    advice: list[Fault] = []
    if changed.size:
        level, title = Level.DOUBTFUL, "Changed"
        sentence = f"{changed.size} {words} (by chance in 1 % of comparisons)."
        advice.append(
            Fault(
                f"changed: {named('actuator', ids[changed].tolist(), 8)}",
                "calibrate again before use, unless the cause is clear, such as a replacement",
            )
        )
    one, other = ({s.sha256 for s in sources_of(c)} for c in (change.one, change.other))
    if one == other:  # a recalibration has files of its own beside those it inherits
        advice.append(
            Fault(
                "both calibrations use the same files, so most of their errors are common",
                "the changes are those of the method, and they scatter by less than a sigma",
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


def of_comparison(c: object) -> TypeIs[Comparison | Parts[Comparison]]:
    """Return whether something is what changed between matrices or campaigns."""
    return all(isinstance(each, Comparison) for each in by_number(c).values())


def of_segments(c: object) -> TypeIs[Parts[Calibration]]:
    """Return whether something is the calibrations of several segments."""
    return has_parts(c) and not of_comparison(c)


def _on_comparison(c: Comparison | Parts[Comparison]) -> Headline:
    """Return the verdict on what changed between two matrices or campaigns."""
    found = by_number(c).values()
    changed = sum(int(one.changed.sum()) for one in found)
    compared = sum(int(one.layout.enabled.sum()) for one in found)
    couplings = sum(len(one.couplings) for one in found)
    sentence = f"{changed or 'None'} of {counted(compared, 'actuator')} changed."
    advice = list[Fault]()
    for what, remedy in (
        ("alpha", "check coil and magnet, and multiply the old alpha by the ratio"),
        ("sensor", "check the sensor; alpha remains valid"),
    ):
        ids = [one.layout.id[getattr(one, f"{what}_changed")] for one in found]
        if some := np.concatenate(ids).tolist():
            name = "alpha" if what == "alpha" else "sensor gain"
            advice.append(Fault(f"{name} changed: {named('actuator', some, 8)}", remedy))
    if couplings:
        sentence += f" {counted(couplings, 'single coupling')} changed."
    numbers = tuple(islice(figures(c), 3)) if isinstance(c, Comparison) else ()
    shown = _headline(c.verdict, sentence, numbers, MEANINGS_OF_CHANGES)
    return replace(shown, advice=(*advice, *shown.advice))


def sources_of(c: AnyCalibration) -> tuple[Source, ...]:
    """Return the files of a calibration; of several segments each once."""
    if not has_parts(c):
        return c.sources
    every = (source for one in c.found.values() for source in one.sources)
    return tuple({source.sha256: source for source in every}.values())


def _ratio(change: Change) -> tuple[str, str, str]:
    """Return name, value and note of the common ratio, or of those of the segments."""
    if change.segments:
        ratios = [part.ratio for part in change.segments.values()]
        return ("common ratios, second to first", f"{min(ratios):.4f} to {max(ratios):.4f}",
                "of each segment, removed; each in the table of segments")  # fmt: skip
    name = "common ratio, second to first"
    if np.isfinite(change.ratio_error):
        return (name, with_error(change.ratio, change.ratio_error),
                f"removed; {WEIGHTS_INDEPENDENT}")  # fmt: skip
    return name, f"{change.ratio:.4f}", "removed; the scale of one is a convention"
