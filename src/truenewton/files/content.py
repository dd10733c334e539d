"""The contents of a FITS file: keywords, columns and images by name, type and unit."""

from __future__ import annotations

import datetime
import math
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import astropy.units as u
import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, TrueNewtonError, naming
from truenewton.files.format import REQUIRED, STORED, Column, FileFormat, Keyword, TableFormat
from truenewton.linalg import covariance_fault
from truenewton.rounding import counted

PRIMARY = "PRIMARY"  # name of the image of a file that is but one
YEARS = range(1950, 2200)  # of dates: arithmetic with them stays far from its ends

Record = TypeVar("Record")
Extension = TypeVar("Extension", "Table", "Image")


class Table(NamedTuple):
    """A binary table as it was read."""

    rows: int
    # By upper-case name: values in native byte order, and their unit or ''.
    columns: Mapping[str, tuple[NDArray[Any], str]]


class Image(NamedTuple):
    """An image as it was read: pixels in numpy order, and BUNIT or ''."""

    data: NDArray[Any]
    unit: str


@dataclass(frozen=True, eq=False)
class FitsFile:
    """A FITS file, read and verified."""

    path: str
    sha256: str  # of its bytes
    header: Mapping[str, Any]  # the primary header
    # By upper-case EXTNAME, the image of the primary HDU as PRIMARY. An error is raised on use.
    extensions: Mapping[str, Table | Image | TrueNewtonError]

    def filled(self, kind: type[Record], values: dict[str, Any]) -> Record:
        """Return a record filled from `values`; its errors name the file."""
        with naming(self.path):
            made: Record = _filled(kind, values)
        return made

    def values(self, form: FileFormat, largest: float = math.inf) -> dict[str, Any]:
        """Return the values of a format by attribute, with a dictionary for each record inside.

        Numbers of a magnitude beyond ``largest`` are refused, so that their squares are finite.
        """
        values: dict[str, Any] = {}

        def put(attribute: Any, value: Any) -> None:
            *way, last = attribute.split(".")
            inside = values
            for name in way:
                inside = inside.setdefault(name, {})
            inside[last] = value

        for keyword in form.keywords:
            if not callable(keyword.attribute):
                put(keyword.attribute, self._bounded(self._keyword(keyword), keyword.name, largest))
        for extension in form.extensions:
            if isinstance(extension, TableFormat):
                if extension.optional and extension.name not in self.extensions:
                    continue
                for column in extension.columns:
                    if not callable(column.attribute):
                        name = f"{extension.of}.{column.attribute}".lstrip(".")
                        what = f"{column.name} of {extension.name}"
                        read = self._column(extension.name, column)
                        if column.finite and not np.isfinite(read).all():
                            self._refuse(f"{what} holds NaN or inf", "make the file again")
                        put(name, self._bounded(read, what, largest))
            elif not callable(extension.attribute):
                put(extension.attribute, self.pixels(extension.name, extension.unit))
        return values

    def _bounded(self, values: Any, what: str, largest: float) -> Any:
        """Return values as they are, unless a finite number among them is absurd."""
        if largest < math.inf and isinstance(values, float | np.ndarray):
            sizes = np.ravel(np.abs(values))
            absurd = (sizes > largest) & (sizes < math.inf)
            if absurd.any():
                bad = np.ravel(values)[absurd.argmax()]
                self._refuse(f"{what} is {bad:g}", "nothing is as large: make the file again")
        return values

    def _keyword(self, keyword: Keyword) -> Any:
        key, value, stored = keyword.name, self.header.get(keyword.name), STORED[keyword.kind]
        if value is None:
            if keyword.absent is REQUIRED:
                what = f"{keyword.comment}{f' [{keyword.unit}]' if keyword.unit else ''}"
                self._refuse(f"the primary header has no {key}", f"add it, {what} (docs/files.md)")
            return keyword.absent
        number = keyword.kind in ("float", "count")
        if type(value) not in stored.types or (number and not math.isfinite(value)):
            self._refuse(f"{key} is {value!r}", f"store {stored.words}")
        if stored.dtype is np.str_:
            return self._text(value, keyword, key)
        if keyword.kind == "count":
            return int(value)
        return float(value) if number else value

    def _column(self, table: str, column: Column) -> Any:
        """Return a column, (rows,) or (rows, width), in its unit; of texts and dates a tuple."""
        rows, columns = self._extension(table, Table)
        if column.name not in columns:
            if column.absent is REQUIRED:
                self._refuse(f"{table} has no column {column.name}", _add_it(columns))
            if column.kind == "str":
                return (column.absent,) * rows
            return None if column.absent is None else np.full(rows, column.absent)
        values, has_unit = columns[column.name]
        what, words = f"column {column.name} of {table}", STORED[column.kind].words
        if values.dtype.kind not in STORED[column.kind].kinds:
            self._refuse(f"{what} holds {values.dtype}", f"store {words}")
        stored = column.as_stored(values)
        width = self._extension(column.each, Table).rows if column.each else None
        try:
            values = values.astype(stored.dtype, copy=False)
        except UnicodeDecodeError:
            self._refuse(f"{what} holds bytes that are not ASCII", "store plain text")
        if width == 1 and values.ndim == 1:
            values = values[:, None]
        want = (rows,) if width is None else (rows, width)
        if values.shape != want:
            size = math.prod(values.shape[1:]) if rows else 0
            self._refuse(
                f"{what} has {counted(size, 'value')} a row instead of {width or 1}",
                "store one for each actuator" if width else "store one",
            )
        if stored.dtype is np.str_:
            return tuple(
                self._text(text, column, f"{column.name} in {table}") for text in np.asarray(values)
            )
        if column.unit is None:
            return values
        return _convert(values, has_unit, column.unit, what, self.path)

    def _text(self, value: str, declared: Keyword | Column, what: str) -> Any:
        """Return a text, or the date in it; blank text counts as absent."""
        text = str(value).strip()
        if declared.kind != "date":
            return text if text or declared.absent is REQUIRED else declared.absent
        try:
            date = datetime.datetime.fromisoformat(text)
        except ValueError:
            self._refuse(f"{what} is '{text}'", "write ISO 8601, as 2026-11-21T09:30:00")
        if date.year not in YEARS:
            first, last = YEARS[0], YEARS[-1]
            self._refuse(f"{what} is '{text}'", f"give the true date, of {first} to {last}")
        if date.tzinfo is None:
            return date.replace(tzinfo=datetime.UTC)
        return date.astimezone(datetime.UTC)

    def pixels(self, name: str, unit: str | None = None) -> NDArray[np.float64]:
        """Return the (rows, columns) pixels of an image in numpy order, converted to ``unit``."""
        data, has_unit = self._extension(name, Image)
        if data.dtype.kind not in "fiu":
            self._refuse(f"{name} is not numeric", "store D")
        values: NDArray[np.float64] = data.astype(np.float64, copy=False)
        return values if unit is None else _convert(values, has_unit, unit, name, self.path)

    def require_squares(self, names: tuple[str, ...], side: int, meaning: str) -> None:
        """Refuse images that are not square, with a side that has a meaning."""
        for name in names:
            shape = self.pixels(name).shape
            if shape != (side, side):
                self._refuse(f"{name} has the shape {shape}", f"it is square, of {side}: {meaning}")

    def enabled(self, alpha: NDArray[Any], remedy: str) -> NDArray[np.bool_]:
        """Return which actuators take part: those with an (n,) alpha."""
        some = np.asarray(np.isfinite(alpha))
        if not some.any():
            raise FormatError("ALPHA contains no number", remedy=remedy, path=self.path)
        return some

    def require_covariances(self, side: int, meaning: str, remedy: str) -> None:
        """Refuse COVARIANCE and SYSTEMATIC that are none, or not parts of one another."""
        self.require_squares(("COVARIANCE", "SYSTEMATIC"), side, meaning)
        whole, part = self.pixels("COVARIANCE"), self.pixels("SYSTEMATIC")
        for name, matrix, unit in (
            ("COVARIANCE", whole, None),
            ("SYSTEMATIC", part, None),
            ("COVARIANCE less SYSTEMATIC", whole - part, np.diag(whole)),
        ):
            if fault := covariance_fault(matrix, unit):
                self._refuse(f"{name} {fault}", remedy)

    def _extension(self, name: str, kind: type[Extension]) -> Extension:
        extension = self.extensions.get(name)
        if isinstance(extension, TrueNewtonError):
            raise extension
        if not isinstance(extension, kind):
            self._refuse(f"there is no {kind.__name__.lower()} {name}", _add_it(self.extensions))
        return extension

    def _refuse(self, fault: str, remedy: str) -> NoReturn:
        raise FormatError(fault, remedy=remedy, path=self.path) from None


def _add_it(others: Collection[str]) -> str:
    """Return the remedy for a missing name; ``others`` are those that exist."""
    named = f", or name it so: there is {', '.join(others)}" if others else ""
    return f"add it{named} (docs/files.md)"


def _filled(kind: Any, value: Any) -> Any:
    """Fill a record, a tuple of records or a plain tuple, as the types of the fields declare."""
    if not isinstance(value, dict):
        return value
    if get_origin(kind) is not tuple:
        hints = get_type_hints(kind)
        return kind(**{name: _filled(hints[name], part) for name, part in value.items()})
    inner = get_args(kind)
    if inner[-1] is not ...:
        return tuple(value.values())
    return tuple(_filled(inner[0], row) for row in _rows(value))


def _rows(columns: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of columns, in Python's own numbers."""
    cells = [
        _rows(part) if isinstance(part, dict)
        else part.tolist() if isinstance(part, np.ndarray) and part.ndim == 1
        else part
        for part in columns.values()
    ]  # fmt: skip
    return [dict(zip(columns, row, strict=True)) for row in zip(*cells, strict=True)]


def _convert(
    values: NDArray[Any], has: str, want: str, what: str, path: str
) -> NDArray[np.float64]:
    """Convert values from their declared unit to the one wanted."""
    if not has.strip():
        raise FormatError(f"{what} declares no unit", remedy=f"declare {want}", path=path)
    try:
        # An odd spelling of a unit is no concern of the user's; what overflows is refused as inf.
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            old, new = _unit(has), _unit(want)
            if old == new:
                return values
            return np.asarray(old.to(new, values, equivalencies=u.temperature()), dtype=np.float64)
    except Exception:  # the text may be anything
        raise FormatError(
            f"{what} is in '{has}'", remedy=f"store it in {want}", path=path
        ) from None


def _unit(text: str) -> Any:
    if "".join(text.split()).replace("_", "").lower() in ("degc", "celsius"):
        return u.deg_C
    unit = u.Unit(text)
    if not isinstance(unit, u.UnitBase):  # mag, dex and their kin are logarithms
        raise u.UnitsError(text)
    return unit
