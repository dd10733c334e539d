"""Reading the numbers in a file of any format, which its first bytes determine.

Columns of a text file are separated by commas, semicolons, tabs or blanks; if one of the others
separates columns, commas are decimal ones. Comments begin with #, ; % or !. An array of an LBT
supervisor begins with its type and sizes (`float 672`), with the first index fastest.
"""

from __future__ import annotations

import importlib
import io
import math
import os
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile, located
from truenewton.files.content import Image, Table
from truenewton.files.fits import START, read_fits, refuse_doubles
from truenewton.files.opening import GZIP, MAX_UNPACKED_BYTES, open_plain, refuse_too_large
from truenewton.records.tables import LENGTHS, columns_in
from truenewton.rounding import counted

COMMENT = "#;%!"
ECSV = "# %ECSV"
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf(inity)?)", re.I)
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eEdD][-+]?\d+)?")
THOUSANDS = re.compile(r"[-+]?\d{1,3}(\.\d{3})+(,\d+)?")
TYPED = re.compile(r"(byte|u?int|u?long|u?long64|float|double)((?:\s+\d+)+)\s*(?:[;#].*)?", re.I)
UNIT_CELL = re.compile(rf"[\[(]?({LENGTHS}|-?)[\])]?", re.I)  # of a line of units below the names
LOGICAL = {"true": "1", "false": "0"}
HDF5_UNITS = ("unit", "units", "UNIT", "UNITS")  # attributes of a dataset
MAX_WORD_COLUMNS = 16  # a table with more columns is a matrix, without columns of words


class Item(NamedTuple):
    """Numbers, masked ones NaN, or texts; and the unit that their file declares, or ''."""

    values: NDArray[Any]
    unit: str = ""


@dataclass(frozen=True)
class Stored:
    """The numbers in a file.

    ``arrays`` have one dimension or more, ``columns`` are those of tables, also of texts; both by
    name, which is '' if there is none. ``header`` contains the keywords of a FITS file.
    """

    path: str
    arrays: Mapping[str, Item] = field(default_factory=dict)
    columns: Mapping[str, Item] = field(default_factory=dict)
    header: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def every(self) -> dict[str, Item]:
        """Arrays and columns."""
        return {**self.arrays, **self.columns}

    @cached_property
    def names(self) -> dict[str, tuple[str, str]]:
        """Their names, also short ones (`columns_in`)."""
        return columns_in(self.every)


def read_stored(path: str | os.PathLike[str]) -> Stored:
    """Read all numbers of a file."""
    path = os.fspath(path)
    try:
        with open_plain(path) as file:
            start = file.read(16)
        for magic, read in READERS.items():
            if start.startswith(magic):
                return read(path)
        return _as_stored(path, *table_in(text_of(path)))
    except TrueNewtonError as error:
        raise located(error, path) from None
    except Exception as error:  # libraries raise nearly anything for a damaged file
        told = " ".join(str(error).split())[:80]
        remedy = "write it again, or give FITS, .npy or text"
        raise UnreadableFile(f"cannot be read ({told})", remedy=remedy, path=path) from error


def plain(values: Any) -> NDArray[np.float64] | None:
    """Return (...,) numbers as floats, masked ones NaN; None for anything but real numbers."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    numbers = np.asarray(values)
    return numbers.astype(np.float64) if numbers.dtype.kind in "fiub" else None


def _gathered(path: str, named: Mapping[str, Any]) -> Stored:
    """Return those named values that are arrays of numbers."""
    every = {name: plain(value) for name, value in named.items()}
    return Stored(path, {k: Item(v) for k, v in every.items() if v is not None and v.ndim})


def _fits(path: str) -> Stored:
    file = read_fits(path)
    arrays: dict[str, Item] = {}
    columns: dict[str, Item] = {}
    tables = [part.columns for part in file.extensions.values() if isinstance(part, Table)]
    count = Counter(column for table in tables for column in table)
    for name, part in file.extensions.items():
        if isinstance(part, Image):
            numbers = plain(part.data)
            if numbers is not None:
                arrays[name] = Item(numbers, part.unit)
        elif isinstance(part, Table):
            for column, (values, unit) in part.columns.items():
                cells = np.asarray(values)
                held = cells if cells.dtype.kind == "U" else plain(cells)
                if held is not None:  # of one name in two tables: with that of the table
                    columns[column if count[column] == 1 else f"{name}/{column}"] = Item(held, unit)
        else:
            raise part
    return Stored(path, arrays, columns, file.header)


def _numpy(path: str) -> Stored:
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            refuse_too_large(sum(part.file_size for part in archive.infolist()), path)
    held = np.load(path, allow_pickle=False)
    return _gathered(path, {"": held} if isinstance(held, np.ndarray) else dict(held))


def _zipped(path: str) -> Stored:
    """Read .npz, or the first sheet of an Excel workbook."""
    with zipfile.ZipFile(path) as file:
        if "xl/workbook.xml" not in file.namelist():
            return _numpy(path)
    try:
        import openpyxl
    except ModuleNotFoundError:
        remedy = "pip install 'truenewton[excel]', or save it as CSV"
        raise UnreadableFile("is an Excel workbook, which needs openpyxl", remedy=remedy) from None
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    # Each row is a line, so that their numbers agree.
    rows = (["" if cell is None else " ".join(str(cell).split()) for cell in row] for row in
            book.worksheets[0].iter_rows(values_only=True))  # fmt: skip
    values, columns = table_in("\n".join("\t".join(row) for row in rows))
    return _as_stored(path, values, columns)


def _as_stored(path: str, values: NDArray[Any] | None, columns: Mapping[str, Any]) -> Stored:
    arrays = {} if values is None else {"": Item(values)}
    return Stored(path, arrays, {name: Item(column) for name, column in columns.items()})


def _hdf5(path: str) -> Stored:
    try:
        h5py: Any = importlib.import_module("h5py")
    except ModuleNotFoundError:
        raise UnreadableFile(
            "is HDF5, for which h5py is missing",
            remedy="install the extra: pip install 'truenewton[hdf5]'",
            path=path,
        ) from None
    found: dict[str, Item] = {}

    def take(name: str, held: Any) -> None:
        if isinstance(held, h5py.Dataset) and held.dtype.kind in "fiub" and held.ndim:
            refuse_too_large(held.nbytes, path, name)
            # MATLAB 7.3 stores arrays with their axes reversed.
            matlab = "MATLAB_class" in held.attrs
            values = held[()].T if matlab else held[()]
            found[name.replace("/", ".") if matlab else name] = Item(
                np.asarray(values, dtype=np.float64), _unit_of(held)
            )

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return Stored(path, found)


def _unit_of(dataset: Any) -> str:
    """Return the unit that a dataset of HDF5 declares, or ''."""
    found = [np.ravel(dataset.attrs[name])[0] for name in HDF5_UNITS if name in dataset.attrs]
    unit = found[0] if found else ""
    return unit.decode("utf-8", "backslashreplace") if isinstance(unit, bytes) else str(unit)


def _matlab(path: str) -> Stored:
    import scipy.io

    if b"MATLAB 7.3" in Path(path).read_bytes()[:128]:
        return _hdf5(path)
    refuse_too_large(sum(8 * math.prod(shape) for _, shape, _ in scipy.io.whosmat(path)), path)
    held = scipy.io.loadmat(path)
    variables = {k: v for k, v in held.items() if not k.startswith("__")}
    return _gathered(path, dict(_fields("", variables)))


def _fields(before: str, variables: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield arrays of MATLAB; those in structs have names as 'sys.ff_matrix' or 'sys(2).ff'."""
    for name, value in variables.items():
        fields = getattr(value.dtype, "names", None)
        if not fields:
            yield before + name, value
            continue
        for k, one in enumerate(value.ravel(), 1):
            of = f"{name}." if value.size == 1 else f"{name}({k})."
            yield from _fields(before + of, {each: np.asarray(one[each]) for each in fields})


def _idl(path: str) -> Stored:
    import scipy.io

    with warnings.catch_warnings(action="ignore"):
        return _gathered(path, scipy.io.readsav(path))


READERS = {
    START: _fits,
    GZIP: _fits,
    b"\x93NUMPY": _numpy,
    b"PK\x03\x04": _zipped,
    b"\x89HDF": _hdf5,
    b"MATLAB": _matlab,
    b"SR\x00": _idl,
}


TextTable = tuple[NDArray[Any] | None, dict[str, NDArray[Any]]]


class Line(NamedTuple):
    """A line of a file, and its number from 1."""

    number: int
    text: str


def text_of(path: str | os.PathLike[str]) -> str:
    """Return the text of a file."""
    with open_plain(path) as file:
        raw = file.read(MAX_UNPACKED_BYTES + 1)
        if len(raw) > MAX_UNPACKED_BYTES:
            fault = f"is longer than {MAX_UNPACKED_BYTES >> 30} GB"
            raise UnreadableFile(fault, remedy="give FITS, .npy or HDF5")
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return raw.decode("utf-16", "replace")
        if b"\0" in raw:
            remedy = "give FITS, .npy, .npz, CSV or text, HDF5, .mat or .sav"
            raise UnreadableFile("is of an unknown format", remedy=remedy)
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            return raw.decode("latin-1")


def table_in(text: str) -> TextTable:
    """Return a text as an array (rows, columns), and its named columns of numbers or texts.

    A type line determines the shape of the array. It is None if a column contains words.
    """
    # A tab may begin an empty cell in the corner, unless every line begins with one.
    whole = text.splitlines()
    if whole and whole[0].startswith(ECSV):  # units in its comments would be lost
        remedy = "give CSV, with units in the names of its columns, as 'x [mm]'"
        raise UnreadableFile("is ECSV", remedy=remedy)
    every = [Line(number, text.strip(" ")) for number, text in enumerate(whole, 1) if text.strip()]
    if all(line.text.startswith("\t") for line in every):
        every = [Line(line.number, line.text.strip()) for line in every]
    data = [line for line in every if line.text[0] not in COMMENT]
    if not data:
        raise FormatError("contains no numbers", remedy="give a file with numbers")
    typed = TYPED.fullmatch(data[0].text)
    if typed:
        return _typed(typed[2], [line.text for line in data[1:]]), {}
    between = _separators(data[-1].text)
    if between.delimiter == ";":  # then it begins no comment
        data = [line for line in every if line.text[0] not in COMMENT.replace(";", "")]
    above: list[str] = []
    while len(data) > 1 and not any(map(NUMBER.fullmatch, _cells(data[1].text, between))):
        # a header of several lines
        above, data = _cells(data[0].text, between), data[1:]
    names = _cells(data[0].text, between)
    if len(above) == len(names) and all(UNIT_CELL.fullmatch(name) for name in names):
        names = [f"{name} {unit}".strip(" -") for name, unit in zip(above, names, strict=True)]
    if _is_named_row(names, data[1:], between):
        names = []
    elif all(NUMBER.fullmatch(name) for name in (names if names[-1] else names[:-1] or names)):
        comments = [line.text for line in every if line.text[0] in COMMENT]
        names = _cells(comments[-1].lstrip(COMMENT), between) if comments else []
    else:
        data = data[1:]
    if not data:
        raise FormatError("contains a header and no numbers", remedy="give its rows")
    _refuse_thousands(data, between)
    if len(_cells(data[0].text, between)) <= MAX_WORD_COLUMNS:
        return _narrow(data, between, names)
    columns = _wide(data, between, names)
    numbers = [column for column in columns if column.dtype.kind == "f"]
    if not numbers:
        raise FormatError("contains no numbers", remedy="give a file with numbers")
    values = _unlabelled(np.array(numbers).T, bool(names))
    return values, _by_name(names, columns, data[0], between)


def _by_name(
    names: list[str], columns: list[NDArray[Any]], first: Line, between: Between
) -> dict[str, NDArray[Any]]:
    """Return the columns by name, if each has one; a last column may be empty, and have one too."""
    n = len(columns)
    if len(names) != len(_cells(first.text, between)) and (len(names) < n or any(names[n:])):
        return {}
    refuse_doubles(names[:n], "columns")
    return {name: column for name, column in zip(names, columns, strict=False) if name}


class Between(NamedTuple):
    """The separator of columns, None for blanks; whether commas are decimal."""

    delimiter: str | None
    comma: bool


def _separators(line: str) -> Between:
    for delimiter in (";", "\t"):
        if delimiter in line:
            cells = map(str.strip, line.split(delimiter))
            return Between(delimiter, any(map(DECIMAL_COMMA.fullmatch, cells)))
    if "," in line:
        words = line.split()
        if len(words) > 1 and all(DECIMAL_COMMA.fullmatch(w) or NUMBER.fullmatch(w) for w in words):
            return Between(None, True)
        return Between(",", False)
    return Between(None, False)


def _refuse_thousands(lines: list[Line], between: Between) -> None:
    """Refuse a point between thousands where commas are decimal: 1.234 would be 1234 or 1,234."""
    for line in lines if between.comma else ():
        for cell in line.text.split(between.delimiter) if "." in line.text else ():
            if THOUSANDS.fullmatch(cell.strip()):
                raise FormatError(
                    f"line {line.number} has '{cell.strip()}', and commas are decimal",
                    remedy="write numbers without points between thousands",
                )


def _cells(line: str, between: Between) -> list[str]:
    line = line.replace(",", ".") if between.comma else line
    cells = [cell.strip().strip("'\"").strip() for cell in line.split(between.delimiter)]
    return [LOGICAL.get(cell.lower(), cell) for cell in cells]


def _is_named_row(cells: list[str], others: list[Line], between: Between) -> bool:
    """Return whether the first line is a name and numbers, as the others, instead of a header."""
    if len(cells) < 3 or not all(map(NUMBER.fullmatch, cells[1:])) or not others:
        return False
    columns = np.diff([_float(cell) for cell in cells[1:]])  # 1 of a header that counts columns
    begins = (_cells(line.text, between)[0] for line in others)
    words = not any(NUMBER.fullmatch(cell) for cell in (cells[0], *begins))
    return words and not (columns == 1.0).all()


def _typed(sizes: str, lines: list[str]) -> NDArray[Any]:
    shape = tuple(map(int, sizes.split()))[::-1]
    words = " ".join(lines).split()
    wrong = [word for word in words if not NUMBER.fullmatch(word)]
    if wrong or len(words) != np.prod(shape):
        fault = f"contains '{wrong[0]}'" if wrong else f"contains {len(words)} numbers"
        remedy = f"give {' x '.join(map(str, shape))} numbers, as its first line says"
        raise FormatError(fault, remedy=remedy)
    return np.array([_float(word) for word in words]).reshape(shape)


def _narrow(lines: list[Line], between: Between, names: list[str]) -> TextTable:
    rows = _alike(lines, between)
    words = list(zip(*rows, strict=True))
    columns: list[NDArray[Any]] = []
    for cells in words:
        sound = all(not cell or NUMBER.fullmatch(cell) for cell in cells)
        columns.append(np.array([_float(cell) for cell in cells] if sound else cells))
    numbers = [column for column in columns if column.dtype.kind == "f"]
    if not numbers:
        raise FormatError("contains no numbers", remedy="give a file with numbers")
    named = _by_name(names, columns, lines[0], between)
    labelled = columns[0].dtype.kind == "U" and len(numbers) == len(columns) - 1 == len(rows) > 2
    if len(numbers) < len(columns) and not labelled:
        return None, named
    return _unlabelled(np.array(numbers).T, bool(names)), named


def _alike(lines: list[Line], between: Between) -> list[list[str]]:
    """Return the cells of lines, without an empty last column, if all have the same number."""
    rows = [_cells(line.text, between) for line in lines]
    if len(rows[0]) > 1 and not any(row[-1] for row in rows):
        rows = [row[:-1] for row in rows]
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(rows[0]):
            raise FormatError(
                f"line {line.number} has {counted(row, 'cell')}, line {lines[0].number} has"
                f" {len(rows[0])}: '{line.text[:40]}'",
                remedy="give every line as many; begin lines of words with #",
            )
    return rows


def _wide(lines: list[Line], between: Between, names: list[str]) -> list[NDArray[Any]]:
    """Return columns of numbers, and of texts if they have names or are the first."""
    text = "\n".join(line.text for line in lines).replace('"', "")
    try:
        values = np.loadtxt(
            io.StringIO(text.replace(",", ".") if between.comma else text),
            delimiter=between.delimiter, ndmin=2, comments=None,
        )  # fmt: skip
        return list(values.T)
    except ValueError:
        rows = _alike(lines, between)
    columns: list[NDArray[Any]] = []
    for number, cells in enumerate(zip(*rows, strict=True), 1):
        wrong = [k for k, cell in enumerate(cells) if not NUMBER.fullmatch(cell)]
        texts = len(wrong) == len(cells) and (number == 1 or len(names) >= len(rows[0]))
        if wrong and not texts:
            raise FormatError(
                f"line {lines[wrong[0]].number}, column {number} is '{cells[wrong[0]][:40]}'",
                remedy="give a number there; begin lines of words with #",
            )
        columns.append(np.array(cells if texts else [_float(cell) for cell in cells]))
    return columns


def _float(cell: str) -> float:
    """Return a number, which may have a Fortran exponent; NaN for an empty cell."""
    return float(cell.lower().replace("d", "e") or "nan")


def _unlabelled(values: NDArray[Any], header: bool) -> NDArray[Any]:
    """Return a matrix without the numbers of its rows and columns."""

    def counts(numbers: NDArray[Any]) -> bool:
        return bool(numbers.size and numbers[0] in (0, 1) and (np.diff(numbers) == 1).all())

    rows, columns = values.shape
    if header and columns == rows + 1 and counts(values[:, 0]):
        return values[:, 1:]
    if rows == columns + 1 and counts(values[0]):
        return values[1:]
    if rows == columns and rows > 2 and counts(values[0, 1:]) and counts(values[1:, 0]):
        return values[1:, 1:]
    return values
