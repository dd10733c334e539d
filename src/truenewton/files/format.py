"""File formats: each is declared once, for writing a record to a file and for reading it.

An attribute is a path from the record, as ``load.name`` or ``interval.0``; a tuple of records on
the path contains the rows of a table. The values of a function of the record are written only.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from astropy.table import QTable

Attribute = str | Callable[[Any], Any]
Kind = Literal["float", "int", "count", "bool", "str", "date", "label"]
REQUIRED: Any = ...  # instead of a value for something absent


class Stored(NamedTuple):
    """How a kind of value is stored: format and dtypes of a column, types of a keyword, words."""

    form: str
    kinds: str
    dtype: Any
    types: tuple[type, ...]
    words: str


STORED: dict[Kind, Stored] = {
    "float": Stored("D", "fiu", np.float64, (int, float), "a number"),
    "int": Stored("J", "iu", np.int64, (int,), "an integer"),
    "count": Stored("J", "iu", np.int64, (int, float), "a number"),  # as a float too
    "bool": Stored("L", "b", np.bool_, (bool,), "a logical"),
    "str": Stored("A", "SU", np.str_, (str,), "text"),
    "date": Stored("A", "SU", np.str_, (str,), "text"),
    "label": Stored("J", "iuSU", None, (int, str), "an integer or text"),
}


@dataclass(frozen=True)
class Keyword:
    """A keyword of the primary header; not written if None, NaN, or infinite and that is absent."""

    name: str
    attribute: Attribute
    comment: str
    unit: str = ""  # written in brackets before the comment
    kind: Kind = "float"
    absent: Any = REQUIRED  # the value if a file has no such keyword


@dataclass(frozen=True)
class Column:
    """A column of a table; not written if its values are None."""

    name: str
    attribute: Attribute
    unit: str | None = None  # in which it is written, and to which others are converted
    kind: Kind = "float"
    absent: Any = REQUIRED  # the value if a file has no such column; None for no values at all
    each: str = ""  # for vectors: the table for each row of which they have a value
    width: int = 0  # of text; 0 for that of the longest
    finite: bool = False  # refuse NaN and inf on reading

    def as_stored(self, values: Any) -> Stored:
        """Return how the values are stored; labels are integers or texts."""
        if self.kind != "label":
            return STORED[self.kind]
        return STORED["str" if np.asarray(values).dtype.kind in "SU" else "int"]


@dataclass(frozen=True)
class TableFormat:
    """A binary table; an ``optional`` one is written only if it has rows, and may be missing."""

    name: str
    columns: tuple[Column, ...]
    of: str = ""  # attribute of the record to which those of the columns belong
    optional: bool = False


@dataclass(frozen=True)
class ImageFormat:
    """An image, and the unit of its pixels."""

    name: str
    attribute: Attribute
    unit: str | None = None


@dataclass(frozen=True)
class FileFormat:
    """A kind of file: keywords, tables and images in order."""

    keywords: tuple[Keyword, ...] = ()
    extensions: tuple[TableFormat | ImageFormat, ...] = ()
    # Pixels of the primary HDU, where other programs look for a single matrix.
    matrix: Attribute | None = None


def header_of(record: Any, form: FileFormat) -> Iterator[tuple[str, Any, str]]:
    """Yield name, value and comment of each keyword that there is."""
    for keyword in form.keywords:
        value = value_of(record, keyword.attribute)
        if value is None or value != value or value == np.inf == keyword.absent:
            continue
        unit = f"[{keyword.unit}] " if keyword.unit else ""
        yield keyword.name, iso(value) if keyword.kind == "date" else value, unit + keyword.comment


def columns_of(record: Any, table: TableFormat) -> Iterator[tuple[str, str, str | None, Any]]:
    """Yield name, FITS format, unit and values of each column that there is."""
    rows = value_of(record, table.of)
    for column in table.columns:
        values = value_of(rows, column.attribute)
        if values is None:
            continue
        form, _, dtype, _, _ = column.as_stored(values)
        if dtype is np.str_:
            dates = column.kind == "date"
            values = [iso(one) if dates else _ascii(one or "") for one in values]
            width = str(column.width or max([1, *map(len, values)]))
        else:
            values = np.asarray(values, dtype=dtype)
            width = str(values.shape[1]) if column.each else ""
            if form == "J" and np.abs(values).max(initial=0) > 2**31 - 1:
                form = "K"  # 64 bit
        yield column.name, width + form, column.unit, values


def quantities(record: Any, table: TableFormat, *, without: tuple[str, ...] = ()) -> QTable:
    """Return the columns of a table, all but some, with units as astropy keeps them."""
    import astropy.units as u
    from astropy.table import QTable

    made = QTable()
    for name, _, unit, values in columns_of(record, table):
        if name not in without:
            plain = isinstance(values, list) or values.dtype.kind == "i"
            made[name] = values if plain else u.Quantity(values, unit or "")
            if not plain:
                made[name].info.format = ".5g"
    return made


def value_of(record: Any, attribute: Attribute) -> Any:
    """Return an attribute of a record, or a tuple of those of a tuple of records."""
    parts = [attribute] if callable(attribute) else attribute.split(".") if attribute else []
    for part in parts:
        several = isinstance(record, tuple)
        record = tuple(_part(one, part) for one in record) if several else _part(record, part)
    return record


def attributes(record: Any, *names: str, **others: Attribute) -> dict[str, Any]:
    """Return attributes of a record by their names, then others by the names given to them."""
    return {name: value_of(record, name) for name in names} | {
        name: value_of(record, attribute) for name, attribute in others.items()
    }


def _part(record: Any, part: Attribute) -> Any:
    if callable(part):
        return part(record)
    if record is None:
        return None
    return record[int(part)] if part.isdigit() else getattr(record, part)


def iso(date: datetime.datetime) -> str:
    """Return a date as FITS writes it: ISO 8601, UTC, no zone, to the microsecond if need be."""
    digits = "microseconds" if date.microsecond % 1000 else "milliseconds"
    if date.tzinfo is not None:
        date = date.astimezone(datetime.UTC).replace(tzinfo=None)
    return date.isoformat(timespec=digits)


def _ascii(text: str) -> str:
    """FITS holds ASCII only; a file name may hold anything."""
    return text.encode("ascii", "backslashreplace").decode()
