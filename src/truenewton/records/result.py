"""What all results have in common: verdict, summary, figures, and files of one or several segments.

The columns and keywords of a result are declared next to its record, as a `ResultKind`. Verdict,
summary and figures are registered for its class, since they need modules that need the record.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, singledispatch
from operator import methodcaller
from typing import Any, Generic, NamedTuple, TypeVar

from truenewton.files.content import FitsFile
from truenewton.files.fits import write_fits
from truenewton.files.format import (
    Attribute,
    Column,
    FileFormat,
    Keyword,
    TableFormat,
    iso,
    value_of,
)
from truenewton.records.file import ENABLED, ID, NUMBER, NZ, X, Y
from truenewton.rounding import html_table, row, wrapped

Part = TypeVar("Part")


class Summary(NamedTuple):
    """The summary of a result: a headline, rows of cells, and remarks below them."""

    headline: str
    rows: Iterable[Sequence[str]]
    remarks: Iterable[str] = ()


@singledispatch
def summary_of(result: Any) -> Summary | None:
    """Return the summary of a result; None if none is registered for its class."""
    del result
    return None


@singledispatch
def verdict_of(result: Any) -> Any:
    """Return the verdict on a result."""
    raise TypeError(f"there is no verdict on {result!r}")


@singledispatch
def figures_of(result: Any) -> dict[str, Callable[..., Any]]:
    """Return the function that draws each figure of a result, by name."""
    raise TypeError(f"there are no figures of {result!r}")


@singledispatch
def write(result: Any, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a result as FITS; the extensions of a segment have EXTVER = its number."""
    kind, several = result._kind, result._one is not result
    form, of_version = (kind.whole, kind.form) if several else (kind.form, None)
    versions = result.found if several else None
    write_fits(path, form, result, versions=versions, of_version=of_version, overwrite=overwrite)


class Summarised:
    """A result that a notebook shows by its summary."""

    @property
    def _one(self) -> Any:
        """The result, of several segments the first: its class selects what is registered."""
        return self

    def _repr_html_(self) -> str | None:
        summary = summary_of.dispatch(type(self._one))(self)
        return html_table(*summary) if summary else None

    def summary(self) -> str:
        """Return the summary as text: values with their uncertainties, and remarks."""
        summary = summary_of.dispatch(type(self._one))(self)
        if summary is None:
            return repr(self)
        rows = (row(*cells) for cells in summary.rows)
        return "\n".join(wrapped([summary.headline, *rows, *summary.remarks]))


class Result(Summarised):
    """A result that has a file, of one body or of several segments."""

    @property
    def _kind(self) -> ResultKind[Any]:
        """The columns, keywords and file."""
        return KINDS[type(self._one)]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the result (docs/files.md), of all segments into one file.

        The name ends in ``.fits`` or ``.fits.gz``. A calibration can also be written as ``.ecsv``
        (table with units, and the verdict), ``.csv`` (table only) or ``.npy`` (alpha only).

        Raises
        ------
        OutputExists, OutputFailed
        """
        write.dispatch(type(self._one))(self, path, overwrite=overwrite)


# -- the file of all segments ---------------------------------------------------------------------

FAILED = TableFormat(
    "REFUSED",
    (
        Column("SEGMENT", "0", kind="int"),
        Column("FAULT", "1", kind="str"),
        Column("REMEDY", "2", kind="str"),
    ),
    of="failures",
    optional=True,
)
SEGMENT = Column("SEGMENT", "layout.segment", kind="int")
SHARED = ("INSTRUME", "DATE-OBS", "DATE-END", "VERDICT")  # keywords of one body, and of all


@dataclass(frozen=True, eq=False)
class ResultKind(Generic[Part]):
    """The columns, keywords and files of the results of one class.

    Attributes
    ----------
    form, read
        The file of one body; its first extension has a row for each actuator.
    name
        Of the table of the actuators of all segments.
    summary
        Keywords of one body that become columns of SEGMENTS, with the value for a segment that
        failed.
    counts
        Further columns of SEGMENTS: integers of a part by name.
    """

    form: FileFormat
    read: Callable[[FitsFile], Part]
    name: str
    summary: Mapping[str, Any]
    counts: Mapping[str, Callable[[Part], int]] = field(default_factory=dict)

    @cached_property
    def actuators(self) -> TableFormat:
        """The table of all actuators, without columns that a part may lack."""
        places = (ID, X, Y, NZ, NUMBER)
        own = [
            Column(column.name, methodcaller("column", column.attribute), column.unit)
            for column in self.form.extensions[0].columns  # type: ignore[union-attr]
            if column not in places and column.absent is not None
        ]
        return TableFormat(self.name, (ID, X, Y, SEGMENT, *own, NUMBER, NZ, ENABLED))

    @cached_property
    def whole(self) -> FileFormat:
        """The file of all parts, without the extensions of each."""
        keywords = {keyword.name: keyword for keyword in self.form.keywords}
        segments = [Column("SEGMENT", lambda parts: parts.numbers, kind="int")]
        segments += [_summary(keywords[name], none) for name, none in self.summary.items()]
        segments += [
            Column(name, partial(_of_segments, count, 0), kind="int")
            for name, count in self.counts.items()
        ]
        return FileFormat(
            tuple(_shared(keyword) for name, keyword in keywords.items() if name in SHARED),
            (self.actuators, TableFormat("SEGMENTS", tuple(segments)), FAILED),
        )


KINDS: dict[type, ResultKind[Any]] = {}


def _of_found(attribute: Attribute, parts: Any) -> dict[int, Any]:
    """Return an attribute of each part by its number."""
    return {number: value_of(one, attribute) for number, one in parts.found.items()}


def _of_segments(attribute: Attribute, none: Any, parts: Any) -> list[Any]:
    """Return an attribute of each part, or ``none`` if there is no part or no value."""
    values = _of_found(attribute, parts)
    return [none if values.get(k) is None else values[k] for k in parts.numbers]


def _summary(keyword: Keyword, none: Any) -> Column:
    """Return a keyword of one body as a column of SEGMENTS."""
    values = partial(_of_segments, keyword.attribute, none)
    if keyword.kind == "date":
        return Column(keyword.name, lambda parts: [d and iso(d) for d in values(parts)], kind="str")
    kind = "int" if keyword.kind == "count" else keyword.kind
    return Column(keyword.name, values, keyword.unit or None, kind)


def _shared(keyword: Keyword) -> Keyword:
    """Return a keyword of one body as the file of all parts has it."""
    if keyword.name in ("DATE-OBS", "DATE-END"):
        choose = min if keyword.name == "DATE-OBS" else max
        dates = partial(_of_found, keyword.attribute)
        return replace(keyword, attribute=lambda parts: choose(dates(parts).values()))
    of_all = keyword.name == "VERDICT"
    return replace(keyword, comment="of all segments") if of_all else keyword
