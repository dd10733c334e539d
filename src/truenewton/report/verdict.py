"""The verdict on what a page shows, with three numbers and advice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from truenewton.calibration.summary import MEANINGS, summary_rows
from truenewton.comparison.calibrations import Change
from truenewton.comparison.result import AnyChange, Comparison
from truenewton.comparison.summary import MEANINGS_OF_CHANGES, WEIGHTS_INDEPENDENT, figures
from truenewton.errors import Fault
from truenewton.estimation.findings.code import Level
from truenewton.estimation.findings.estimate import Scale, typical
from truenewton.estimation.findings.finding import Finding, Verdict, as_sentences, no_alpha
from truenewton.report.findings import Findings
from truenewton.rounding import counted, named, percent, significant, with_error

Reported = Findings | AnyChange
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
    if isinstance(findings, Comparison):
        return _on_comparison(findings)
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
    one, other = ({s.sha256 for s in c.sources} for c in (change.one, change.other))
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


def _on_comparison(c: Comparison) -> Headline:
    """Return the verdict on what changed between two matrices or campaigns."""
    changed, compared = int(c.changed.sum()), int(c.layout.enabled.sum())
    sentence = f"{changed or 'None'} of {counted(compared, 'actuator')} changed."
    advice = list[Fault]()
    for name, which, remedy in (
        (
            "alpha",
            c.alpha_changed,
            "check coil and magnet, and multiply the old alpha by the ratio",
        ),
        ("sensor gain", c.sensor_changed, "check the sensor; alpha remains valid"),
    ):
        if which.any():
            ids = c.layout.id[which].tolist()
            advice.append(Fault(f"{name} changed: {named('actuator', ids, 8)}", remedy))
    if c.couplings:
        sentence += f" {counted(c.couplings, 'single coupling')} changed."
    shown = _headline(c.verdict, sentence, tuple(islice(figures(c), 3)), MEANINGS_OF_CHANGES)
    return replace(shown, advice=(*advice, *shown.advice))


def _ratio(change: Change) -> tuple[str, str, str]:
    """Return name, value and note of the common ratio."""
    name = "common ratio, second to first"
    if np.isfinite(change.ratio_error):
        return (name, with_error(change.ratio, change.ratio_error),
                f"removed; {WEIGHTS_INDEPENDENT}")  # fmt: skip
    return name, f"{change.ratio:.4f}", "removed; the scale of one is a convention"
