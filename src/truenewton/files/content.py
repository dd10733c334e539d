"""What a FITS file held: keywords, columns and images, asked for by name, type and unit."""

from __future__ import annotations

import datetime
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import astropy.units as u
import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, TrueNewtonError
from truenewton.files.stored_rows import StoredRows

Kind = Literal["float", "int", "bool", "str"]
_KINDS: dict[str, tuple[str, Any, str]] = {
    "float": ("fiu", np.float64, "a number"),
    "int": ("iu", np.int64, "an integer"),
    "bool": ("b", np.bool_, "a logical"),
    "str": ("SU", np.str_, "text"),
}


@dataclass(frozen=True, eq=False)
class Table:
    """A binary table as it was read.

    Attributes
    ----------
    path, name
        The file and EXTNAME, for messages.
    rows
        Number of rows.
    columns
        Values in native byte order, or where they stay in the file, with their unit; by upper-case
        name.
    """

    path: str
    name: str
    rows: int
    columns: Mapping[str, tuple[NDArray[Any] | StoredRows, str | None]]

    def has(self, name: str) -> bool:
        """Tell whether there is such a column."""
        return name in self.columns

    def column(
        self, name: str, kind: Kind = "float", unit: str | None = None, width: int | None = None
    ) -> Any:
        """Return a column, (rows,) or (rows, width), converted to ``unit``.

        Raises
        ------
        FormatError
            The column is missing, of another type or width, or its unit is absent or foreign.
        """
        if name not in self.columns:
            raise FormatError(
                f"{self.name} has no column {name}", remedy="add it (docs/files.md)", path=self.path
            )
        values, has_unit = self.columns[name]
        what = f"column {name} of {self.name}"
        kinds, dtype, wanted = _KINDS[kind]
        if values.dtype.kind not in kinds:
            raise FormatError(
                f"{what} holds {values.dtype}",
                remedy=f"store {wanted}",
                path=self.path,
                got=str(values.dtype),
            )
        if not isinstance(values, StoredRows):
            try:
                values = values.astype(dtype, copy=False)
            except UnicodeDecodeError:
                raise FormatError(
                    f"{what} holds bytes that are not ASCII",
                    remedy="store plain text",
                    path=self.path,
                ) from None
            if width == 1 and values.ndim == 1:
                values = values[:, None]
        want = (self.rows,) if width is None else (self.rows, width)
        if values.shape != want:
            size = math.prod(values.shape[1:]) if self.rows else 0
            raise FormatError(
                f"{what} has {size} values a row instead of {width or 1}",
                remedy="store one for each actuator" if width else "store one",
                path=self.path,
                got=values.shape,
                want=want,
            )
        if unit is None:
            return values
        in_unit = partial(convert, has=has_unit, want=unit, what=what, path=self.path)
        if isinstance(values, StoredRows):
            in_unit(np.empty(0))  # refuses a unit before any use
            return replace(values, in_unit=in_unit)
        return in_unit(values)


@dataclass(frozen=True, eq=False)
class Image:
    """An image as it was read."""

    path: str
    name: str
    data: NDArray[Any]
    unit: str | None

    def values(self, unit: str | None = None) -> NDArray[np.float64]:
        """Return the pixels in numpy order as float64, converted to ``unit``."""
        if self.data.dtype.kind not in "fiu":
            raise FormatError(f"{self.name} is not numeric", remedy="store D", path=self.path)
        values = self.data.astype(np.float64, copy=False)
        return values if unit is None else convert(values, self.unit, unit, self.name, self.path)


@dataclass(frozen=True, eq=False)
class FitsFile:
    """A FITS file, read and verified.

    Attributes
    ----------
    path, sha256
        Where, and the digest of its bytes.
    header
        The primary header.
    tables, images
        By upper-case EXTNAME.
    unsound
        By upper-case EXTNAME, what is wrong with an extension; raised when it is asked for.
    """

    path: str
    sha256: str
    header: Mapping[str, Any]
    tables: Mapping[str, Table]
    images: Mapping[str, Image]
    unsound: Mapping[str, TrueNewtonError]

    def holds(self, name: str) -> bool:
        """Tell whether there is such an extension, sound or not."""
        return name in self.tables or name in self.images or name in self.unsound

    def table(self, name: str) -> Table:
        """Return a table, or raise FormatError."""
        self._refuse_unsound(name)
        if name not in self.tables:
            raise FormatError(
                f"there is no table {name}", remedy="add it (docs/files.md)", path=self.path
            )
        return self.tables[name]

    def image(self, name: str) -> Image:
        """Return an image, or raise FormatError."""
        self._refuse_unsound(name)
        if name not in self.images:
            raise FormatError(
                f"there is no image {name}", remedy="add it (docs/files.md)", path=self.path
            )
        return self.images[name]

    def text(self, key: str) -> str:
        """Return a keyword that holds text."""
        return str(self._keyword(key, lambda v: isinstance(v, str), "text").strip())

    def integer(self, key: str) -> int:
        """Return a keyword that holds an integer."""
        return int(self._keyword(key, lambda v: isinstance(v, int), "an integer"))

    def number(self, key: str) -> float:
        """Return a keyword that holds a finite number."""
        return float(
            self._keyword(
                key, lambda v: isinstance(v, int | float) and math.isfinite(v), "a number"
            )
        )

    def optional_number(self, key: str) -> float | None:
        """Return a keyword that holds a number, or None where it is absent."""
        return self.number(key) if self.header.get(key) is not None else None

    def optional_text(self, key: str) -> str | None:
        """Return a keyword that holds text, or None where it is absent."""
        return self.text(key) if self.header.get(key) is not None else None

    def date(self, key: str) -> datetime.datetime:
        """Return a keyword that holds an ISO 8601 date and time, UTC."""
        text = self.text(key)
        try:
            date = datetime.datetime.fromisoformat(text)
            if not 1950 <= date.year < 2200:  # arithmetic with dates stays far from its ends
                raise ValueError(text)
        except ValueError:
            raise FormatError(
                f"{key} is '{text}'",
                remedy="write ISO 8601, as 2026-11-21T09:30:00",
                path=self.path,
            ) from None
        if date.tzinfo is None:
            return date.replace(tzinfo=datetime.UTC)
        return date.astimezone(datetime.UTC)

    def _refuse_unsound(self, name: str) -> None:
        if name in self.unsound:
            raise self.unsound[name]

    def _keyword(self, key: str, sound: Callable[[Any], bool], wanted: str) -> Any:
        value = self.header.get(key)
        if value is None:
            raise FormatError(
                f"the primary header has no {key}", remedy="add it (docs/files.md)", path=self.path
            )
        # Python counts True as an integer; a logical is neither number nor text here.
        if isinstance(value, bool) or not sound(value):
            raise FormatError(
                f"{key} is {value!r}", remedy=f"store {wanted}", path=self.path, got=value
            )
        return value


def convert(
    values: NDArray[Any], has: str | None, want: str, what: str, path: str
) -> NDArray[np.float64]:
    """Convert values from the unit they declare to the one wanted; refuse what cannot be."""
    if not has or not has.strip():
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
            f"{what} is in '{has}'", remedy=f"store it in {want}", path=path, got=has, want=want
        ) from None


def _unit(text: str) -> Any:
    if "".join(text.split()).replace("_", "").lower() in ("degc", "celsius"):
        return u.deg_C
    unit = u.Unit(text)
    if not isinstance(unit, u.UnitBase):  # mag, dex and their kin are logarithms
        raise u.UnitsError(text)
    return unit
