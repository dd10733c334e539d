"""What all results have in common: verdict, summary, figures and files.

The columns and keywords of a result are declared next to its record, in `FORMATS`. Verdict,
summary and figures are registered for its class, since they need modules that need the record.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, NamedTuple

from truenewton.errors import OutputFailed
from truenewton.files.fits import SUFFIXES, write_fits
from truenewton.files.format import FileFormat
from truenewton.files.outputs import file_beside
from truenewton.rounding import html_table, row, wrapped


class OtherFormat(NamedTuple):
    """A format that is not FITS: what writes it, and what it contains and lacks of a result."""

    write: Callable[[Any, Path], None]
    lacks: str = ""


FORMATS: dict[type, FileFormat] = {}  # of the FITS file of each class of results
OTHER_FORMATS: dict[type, dict[str, OtherFormat]] = {}  # by the end of the name


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


def format_of(kind: type, path: str | os.PathLike[str] | None) -> OtherFormat | None:
    """Return the format of a class of results that a name ends in, None for FITS or no name.

    Raises OutputFailed for another end if the class has several formats.
    """
    others = OTHER_FORMATS.get(kind, {}) if path is not None else {}
    endings = (*(SUFFIXES if kind in FORMATS else ()), *others)
    found = [end for end in endings if Path(path or "").name.lower().endswith(end)]
    if others and not found:
        fault = f"is no name for a {kind.__name__.lower()}"
        raise OutputFailed(fault, remedy=f"let it end in {', '.join(endings)}", path=path)
    return others.get(found[0]) if found else None


def write(result: Any, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a result in the format that the name ends in."""
    other = format_of(type(result), path)
    if other is None:
        write_fits(path, FORMATS[type(result)], result, overwrite=overwrite)
        return
    with file_beside(path, overwrite=overwrite) as temporary:
        other.write(result, temporary)


class Summarised:
    """A result that a notebook shows by its summary."""

    def _repr_html_(self) -> str | None:
        summary = summary_of(self)
        return html_table(*summary) if summary else None

    def summary(self) -> str:
        """Return the summary as text: values with their uncertainties, and remarks."""
        summary = summary_of(self)
        if summary is None:
            return repr(self)
        rows = (row(*cells) for cells in summary.rows)
        return "\n".join(wrapped([summary.headline, *rows, *summary.remarks]))


class Result(Summarised):
    """A result that has a file."""

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the result (docs/files.md).

        The name ends in ``.fits`` or ``.fits.gz``. A calibration can also be written as ``.ecsv``
        (table with units, and the verdict), ``.csv`` (table only) or ``.npy`` (alpha only).

        Raises
        ------
        OutputExists, OutputFailed
        """
        write(self, path, overwrite=overwrite)
