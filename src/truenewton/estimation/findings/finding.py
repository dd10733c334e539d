"""One finding about a bench, a file, an actuator or a fit; and the verdict on all findings."""

from __future__ import annotations

import json
import string
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from truenewton.errors import Fault
from truenewton.estimation.findings.catalogue import ENTRIES, Entry
from truenewton.estimation.findings.code import Code, Concern, Level
from truenewton.files.values import Values
from truenewton.rounding import counted, listed, named, percent
from truenewton.statics.layout import Layout

MAX_NAMED_ACTUATORS = 4  # that are named one by one in the place of a finding


class Words(string.Formatter):
    """Formats the values of a finding: the formats of Python, and some more.

    'percent', 'count NOUN' (1 row, 2 rows), 'names NOUN' (actuators 3, 5 and 2 more), 'list',
    'sign A/B' (A if positive, otherwise B).
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value in its format."""
        kind, _, noun = format_spec.partition(" ")
        if kind == "percent":
            return percent(value)
        if kind == "count":
            return counted(value, noun)
        if kind == "names":
            return named(noun, value)
        if kind == "list":
            return listed(value)
        if kind == "sign":
            return noun.split("/")[int(value <= 0.0)]
        return str(super().format_field(value, format_spec))


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding in data or a result (docs/effects.md, docs/verdict.md).

    A finding that only the user can decide has no probability, and is never corrected.

    Attributes
    ----------
    code
        Its kind, an entry of `catalogue.ENTRIES`.
    values
        Numbers and names that its sentence contains.
    cause
        The finding that it is about, if there is one.
    detail
        What its name leaves open: which column, which reason.
    where
        The file, actuator or load in which it is largest; '' if that has no meaning.
    actuators
        IDs of those that it is about, if it is about single ones.
    probability
        Of data like these without it.
    size, unit
        Of its largest parameter.
    corrected
        Whether its effect on the data was removed.
    graded
        Its level, if not that of the catalogue.
    remedy
        What to do about it; by default that of the catalogue.
    called
        What messages call actuators, by ID, if they have a text besides (`Layout.shown`).

    Examples
    --------
    >>> finding = calibration.findings[0]
    >>> print(finding.level, finding.code)
    usable scale-by-weights
    """

    code: Code
    values: Mapping[str, Any] = field(default_factory=dict)
    cause: Finding | None = None
    detail: str = ""
    where: str = ""
    actuators: tuple[int, ...] = ()
    probability: float = 0.0
    size: float = 0.0
    unit: str = ""
    corrected: bool = False
    graded: Level | None = None
    remedy: str = ""
    called: Mapping[int, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        if not self.remedy:
            object.__setattr__(self, "remedy", self._filled(self._entry.remedy))

    @classmethod
    def of(
        cls,
        code: Code,
        *,
        actuators: Iterable[int] = (),
        cause: Finding | None = None,
        remedy: str = "",
        **values: Any,
    ) -> Finding:
        """Return a finding with the values of its sentence, as Python's own numbers."""
        own = {name: _own(value) for name, value in values.items()}
        ids = tuple(int(i) for i in actuators)
        return cls(code=code, values=own, actuators=ids, cause=cause, remedy=remedy)

    @property
    def _entry(self) -> Entry:
        return ENTRIES[self.code]

    def _filled(self, text: str) -> str:
        actuators = [self.called.get(i, i) for i in self.actuators]
        known: dict[str, Any] = {"actuators": actuators, "detail": self.detail, **self.values}
        if self.cause is not None:
            known |= {"cause": self.cause.fault, "advice": self.cause.remedy}
        return Words().vformat(text, (), known).rstrip("; ")

    @property
    def name(self) -> str:
        """Its name, without where it is."""
        name = self._entry.name
        if not name:
            return self.fault
        if "{}" in name:
            return name.format(self.detail)
        return f"{name}: {self.detail}" if self.detail else name

    @property
    def fault(self) -> str:
        """What is wrong, a clause without a full stop."""
        if self._entry.sentence:
            return self._filled(self._entry.sentence)
        if self.code is Code.OTHER:
            return self.name
        if self.corrected:
            return f"found: {self.named}, {self._entry.cured}"
        done = ", not corrected" if self.concern is Concern.BENCH else ""
        return f"found: {self.named}{done}"

    @property
    def named(self) -> str:
        """Its name with where it is largest, and its size if that is one of readings."""
        size = ""
        measured = self.corrected and self._entry.cured == "corrected"
        if self.size and (measured or self.unit == "K"):
            per_cent = self.unit in ("", "1/h")
            value = 100 * self.size if per_cent else self.size
            unit = self.unit.replace("1", "%") or "%" if per_cent else self.unit
            size = f"{value:.2g} {unit}"
        inside = "; ".join(filter(None, (self.where, size)))
        return f"{self.name} ({inside})" if inside else self.name

    @property
    def level(self) -> Level:
        """What remains of a result with it."""
        if self.graded is not None:
            return self.graded
        if self._entry.level is None:
            return self.cause.level if self.cause is not None else Level.USABLE
        return max(self._entry.level, Level.USABLE) if self.corrected else self._entry.level

    @property
    def concern(self) -> Concern:
        """What it is about."""
        return self._entry.concern

    @property
    def ids(self) -> str:
        """The actuators as in a file."""
        return " ".join(map(str, self.actuators))

    @property
    def as_values(self) -> dict[str, Any]:
        """The finding in JSON."""
        return dict(FINDING.of(self))

    @property
    def stored(self) -> str:
        """Its values, actuators and cause as JSON, as in table WARNINGS."""
        parts = {"values": dict(self.values), "actuators": list(self.actuators)}
        if self.cause is not None:
            cause = {"code": str(self.cause.code), "remedy": self.cause.remedy}
            parts["cause"] = cause | json.loads(self.cause.stored)
        return json.dumps(parts)


def about_actuators(
    layout: Layout, code: Code, which: Any, where: str = "{}", *, many: str = "", **values: Any
) -> Finding:
    """Return a finding about some actuators, whose names replace '{}' in ``where``.

    ``which`` are indices among the enabled ones, or a mask of these; ``many`` is the noun for too
    many to be named, such as 'columns'.
    """
    enabled = layout.id[layout.enabled]
    ids = enabled[which].tolist()
    shown = layout.shown[layout.enabled][which].tolist()
    names = named("actuator", shown, MAX_NAMED_ACTUATORS) if ids else ""
    if many and len(ids) > MAX_NAMED_ACTUATORS:
        names = f"{len(ids)} of {len(enabled)} {many}"
    where = where.replace("{}", names)
    return Finding(code=code, where=where, actuators=tuple(ids), **values)


def from_stored(code: str, remedy: str, parts: Mapping[str, Any]) -> Finding:
    """Return a finding from its code, remedy and `Finding.stored`.

    Raises KeyError, ValueError, TypeError or AttributeError if it is of another version, or
    damaged.
    """
    cause = parts.get("cause")
    finding = Finding(
        code=Code(code),
        values=dict(parts["values"]),
        actuators=tuple(int(i) for i in parts["actuators"]),
        cause=None if cause is None else from_stored(cause["code"], cause["remedy"], cause),
        remedy=remedy,
    )
    _ = finding.fault  # KeyError if its sentence contains a value that the file does not
    return finding


def as_sentences(said: Finding | Fault) -> str:
    """Return a fault and its remedy as sentences."""
    both = filter(None, (said.fault, said.remedy))
    return " ".join(f"{each[0].upper()}{each[1:].rstrip('.')}." for each in both)


def distinct(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return each finding once, in their order, with the level of the first."""
    kept: list[Finding] = []
    for each in findings:
        if not any(replace(each, graded=one.graded) == one for one in kept):
            kept.append(each)
    return tuple(kept)


def _own(value: Any) -> Any:
    """Return a value of numpy as one of Python."""
    if isinstance(value, (list, tuple)):
        return [_own(each) for each in value]
    return value.item() if hasattr(value, "item") else value


@dataclass(frozen=True)
class Verdict:
    """Whether the stated errors of a result are valid.

    Attributes
    ----------
    level
        'sound', 'usable', 'doubtful', 'rejected'; 'no alpha' of data that give none.
    findings
        All findings, the worst first; those of level 'sound' are notes.

    Examples
    --------
    >>> print(calibration.verdict.level, len(calibration.verdict.findings))
    usable 1
    """

    level: Level
    findings: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        if not self.faults:
            return str(self.level)
        more = f" (and {len(self.faults) - 1} more)" if len(self.faults) > 1 else ""
        return f"{self.level}: {as_sentences(self.faults[0])}{more}"

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that limit the result."""
        return tuple(each for each in self.findings if each.level < Level.SOUND)

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes that limit nothing, such as why another method was not used."""
        return tuple(each for each in self.findings if each.level is Level.SOUND)

    @property
    def as_values(self) -> dict[str, Any]:
        """The verdict in JSON."""
        return dict(VERDICT.of(self))


def _level(said: Finding | Verdict) -> str:
    return str(said.level)


FINDING = Values(
    Finding, ("code", lambda finding: str(finding.code), Code), ("level", _level, Level), "fault",
    "remedy", "actuators", ("values", lambda finding: dict(finding.values), dict), "name", "detail",
    "where", "probability", "size", "unit", "corrected",
)  # fmt: skip
VERDICT = Values(Verdict, ("level", _level, Level), "findings")


def judged(findings: Collection[Finding]) -> Verdict:
    """Return the verdict on findings: its level is that of the worst, which is first."""
    ordered = sorted(distinct(findings), key=lambda each: each.level)
    return Verdict(min((each.level for each in ordered), default=Level.SOUND), tuple(ordered))


def no_alpha(faults: Collection[Fault]) -> Verdict:
    """Return the verdict on data that give no alpha."""
    return judged(
        [Finding.of(Code.NO_ALPHA, fault=each.fault, remedy=each.remedy) for each in faults]
    )
