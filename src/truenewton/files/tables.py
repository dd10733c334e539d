"""Tables of text: separators, lines of names, units, columns of numbers and of words.

Columns are separated by commas, semicolons, tabs or blanks; if one of the others separates columns,
commas are decimal ones. Comments begin with #, ; % or !. ECSV declares units. An array of an LBT
supervisor begins with its type and sizes (`float 672`), with the first index fastest.
"""

from __future__ import annotations

import io
import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, UnreadableFile
from truenewton.files.fits import refuse_doubles
from truenewton.files.opening import MAX_UNPACKED_BYTES, open_plain
from truenewton.rounding import counted

LENGTHS = "um|mm|cm|m|in|inch|micron|deg|rad"
UNIT = re.compile(
    rf"(.+?)[\s_]*(?:/|\bin\b)?[\s_]*[\[(]?\b((?i:{LENGTHS})|[kmun]?N|m?s|K|deg_C)[\])]?"
)
UNIT_CELL = re.compile(rf"[\[(]?({LENGTHS}|-?)[\])]?", re.I)  # of a line of units below the names
COMMENT = "#;%!"
ECSV = "# %ECSV"
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf(inity)?)", re.I)
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eEdD][-+]?\d+)?")
THOUSANDS = re.compile(r"[-+]?\d{1,3}(\.\d{3})+(,\d+)?")
TYPED = re.compile(r"(byte|u?int|u?long|u?long64|float|double)((?:\s+\d+)+)\s*(?:[;#].*)?", re.I)
LOGICAL = {"true": "1", "false": "0"}
MAX_WORD_COLUMNS = 16  # a table with more columns is a matrix, without columns of words


class Item(NamedTuple):
    """Numbers, masked ones NaN, or texts; the unit that their file declares, or ''; their lines."""

    values: NDArray[Any]
    unit: str = ""
    lines: Sequence[int] = ()  # numbers from 1, of a column of text

    def numbers(self, name: str, *, finite: bool = False) -> NDArray[np.float64]:
        """Return the (...,) numbers of a column; refuse words, and if asked what is not finite."""
        words = np.asarray(self.values).dtype.kind == "U"
        for k, cell in enumerate(np.ravel(self.values).tolist() if words or finite else ()):
            if not (NUMBER.fullmatch(cell) if words else math.isfinite(cell)):
                where = f"line {self.lines[k]}: " if self.lines else ""
                raise FormatError(f"{where}{name} is {cell!r}", remedy="give a number")
        return self.values


def plain(values: Any) -> NDArray[np.float64] | None:
    """Return (...,) numbers as floats, masked ones NaN; None for anything but real numbers."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    numbers = np.asarray(values)
    return numbers.astype(np.float64) if numbers.dtype.kind in "fiub" else None


class TextTable(NamedTuple):
    """A table of text: an array (rows, columns), None if a column has words; its named columns."""

    values: NDArray[Any] | None
    columns: dict[str, Item]


class Line(NamedTuple):
    """A line of a file, and its number from 1."""

    number: int
    text: str


class Between(NamedTuple):
    """The separator of columns, None for blanks; whether commas are decimal."""

    delimiter: str | None
    comma: bool


def columns_in(table: Any) -> dict[str, tuple[str, str]]:
    """Return the columns of a table or dictionary by name; also in lower case, without the unit.

    Each is the name in the table, and the unit in it or ''. There are none in other data. A name of
    HDF5 or MATLAB is found without its group or struct, too. A short name that two columns have
    finds none.
    """
    every = getattr(table, "columns", table if isinstance(table, Mapping) else ())
    names = [name for name in every if isinstance(name, str)]
    pandas = hasattr(table, "iloc")  # its read_csv calls the second of two columns F1 'F1.1'
    refuse_doubles([name.removesuffix(".1") if pandas else name for name in names], "columns")
    known, found = {name: name_and_unit(name) for name in names}, dict[str, set[str]]()
    for name, (plain, _) in known.items():
        for short in (name, plain, without_group(name)):
            found.setdefault(short.casefold(), set()).add(name)
    alone = {short: name for short, (name, *others) in found.items() if not others}
    every_name = alone | {name: name for name in names}
    return {short: (name, known[name][1]) for short, name in every_name.items()}


def without_group(name: str) -> str:
    """Return the name of an array without its group in HDF5 or struct in MATLAB."""
    return re.split(r"[/.]", name)[-1]


def name_and_unit(name: str) -> tuple[str, str]:
    """Return name and unit of a column, from names as 'force [mN]', 'x / mm', 'x (mm)', 'x mm'."""
    match = UNIT.fullmatch(name.strip())
    if not match:
        return name.strip(), ""
    lower = match[2].lower()
    return match[1], lower if lower in LENGTHS.split("|") else match[2]


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
    """Return the array and the named columns of a text.

    A type line determines the shape of the array.
    """
    if text.startswith(ECSV):
        return _ecsv(text)
    lines = _lines(text)
    data = [line for line in lines if line.text[0] not in COMMENT]
    if not data:
        raise FormatError("contains no numbers", remedy="give a file with numbers")
    if typed := TYPED.fullmatch(data[0].text):
        return TextTable(_typed(typed[2], [line.text for line in data[1:]]), {})
    between = _separators(data[-1].text)
    if between.delimiter == ";":  # then it begins no comment
        data = [line for line in lines if line.text[0] not in COMMENT.replace(";", "")]
    comments = [line.text for line in lines if line.text[0] in COMMENT]
    names, rows = _names_and_rows(data, comments, between)
    if not rows:
        raise FormatError("contains a header and no numbers", remedy="give its rows")
    _refuse_thousands(rows, between)
    columns = _columns(rows, names, between)
    numbers = [column for column in columns if column.dtype.kind == "f"]
    if not numbers:
        raise FormatError("contains no numbers", remedy="give a file with numbers")
    words = len(columns) - len(numbers)
    labelled = columns[0].dtype.kind == "U" and words == 1 and len(numbers) == len(rows) > 2
    matrix = not words or labelled or len(columns) > MAX_WORD_COLUMNS
    values = _unlabelled(np.array(numbers).T, bool(names)) if matrix else None
    return TextTable(values, _by_name(names, columns, rows, between))


def _ecsv(text: str) -> TextTable:
    from astropy.table import Table

    try:
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):  # of overflows
            table = Table.read(text.splitlines(), format="ascii.ecsv")
    except Exception as error:  # astropy raises nearly anything for a damaged file
        told = " ".join(str(error).split())[:80]
        raise FormatError(f"is not ECSV ({told})", remedy="write it again, or give CSV") from error
    held = {c.name: np.asarray(c) if c.dtype.kind == "U" else plain(c) for c in table.itercols()}
    units = {c.name: str(c.unit or "") for c in table.itercols()}
    return TextTable(None, {k: Item(v, units[k]) for k, v in held.items() if v is not None})


def _lines(text: str) -> list[Line]:
    """Return the lines that are not empty.

    A tab may begin an empty cell in the corner, unless every line begins with one.
    """
    whole = enumerate(text.splitlines(), 1)
    lines = [Line(number, line.strip(" ")) for number, line in whole if line.strip()]
    if all(line.text.startswith("\t") for line in lines):
        lines = [Line(line.number, line.text.strip()) for line in lines]
    return lines


def _typed(sizes: str, lines: list[str]) -> NDArray[Any]:
    shape = tuple(map(int, sizes.split()))[::-1]
    words = " ".join(lines).split()
    wrong = [word for word in words if not NUMBER.fullmatch(word)]
    if wrong or len(words) != np.prod(shape):
        fault = f"contains '{wrong[0]}'" if wrong else f"contains {len(words)} numbers"
        remedy = f"give {' x '.join(map(str, shape))} numbers, as its first line says"
        raise FormatError(fault, remedy=remedy)
    return np.array([_float(word) for word in words]).reshape(shape)


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


def _cells(line: str, between: Between) -> list[str]:
    line = line.replace(",", ".") if between.comma else line
    cells = [cell.strip().strip("'\"").strip() for cell in line.split(between.delimiter)]
    return [LOGICAL.get(cell.lower(), cell) for cell in cells]


def _names_and_rows(
    data: list[Line], comments: list[str], between: Between
) -> tuple[list[str], list[Line]]:
    """Return the names of the columns, those of the last comment if no line has them; the rows."""
    above: list[str] = []
    while len(data) > 1 and not any(map(NUMBER.fullmatch, _cells(data[1].text, between))):
        # a header of several lines
        above, data = _cells(data[0].text, between), data[1:]
    names = _cells(data[0].text, between)
    if len(above) == len(names) and all(UNIT_CELL.fullmatch(name) for name in names):
        names = [f"{name} {unit}".strip(" -") for name, unit in zip(above, names, strict=True)]
    if _is_named_row(names, data[1:], between):
        return [], data
    if all(NUMBER.fullmatch(name) for name in (names if names[-1] else names[:-1] or names)):
        return _cells(comments[-1].lstrip(COMMENT), between) if comments else [], data
    return names, data[1:]


def _is_named_row(cells: list[str], others: list[Line], between: Between) -> bool:
    """Return whether the first line is a name and numbers, as the others, instead of a header."""
    if len(cells) < 3 or not all(map(NUMBER.fullmatch, cells[1:])) or not others:
        return False
    columns = np.diff([_float(cell) for cell in cells[1:]])  # 1 of a header that counts columns
    begins = (_cells(line.text, between)[0] for line in others)
    words = not any(NUMBER.fullmatch(cell) for cell in (cells[0], *begins))
    return words and not (columns == 1.0).all()


def _refuse_thousands(lines: list[Line], between: Between) -> None:
    """Refuse a point between thousands where commas are decimal: 1.234 would be 1234 or 1,234."""
    for line in lines if between.comma else ():
        for cell in line.text.split(between.delimiter) if "." in line.text else ():
            if THOUSANDS.fullmatch(cell.strip()):
                raise FormatError(
                    f"line {line.number} has '{cell.strip()}', and commas are decimal",
                    remedy="write numbers without points between thousands",
                )


def _columns(lines: list[Line], names: list[str], between: Between) -> list[NDArray[Any]]:
    """Return columns of numbers, and of texts if the table is narrow or the column has no number.

    Of a wide table, the latter also needs a name, unless it is the first.
    """
    text = "\n".join(line.text for line in lines).replace('"', "")
    try:
        values = np.loadtxt(
            io.StringIO(text.replace(",", ".") if between.comma else text),
            delimiter=between.delimiter, ndmin=2, comments=None,
        )  # fmt: skip
        return list(values.T)
    except ValueError:
        rows = _alike(lines, between)
    columns, wide = list[NDArray[Any]](), len(rows[0]) > MAX_WORD_COLUMNS
    for number, cells in enumerate(zip(*rows, strict=True), 1):
        wrong = [k for k, cell in enumerate(cells) if (cell or wide) and not NUMBER.fullmatch(cell)]
        texts = len(wrong) == len(cells) and (number == 1 or len(names) >= len(rows[0]))
        if wide and wrong and not texts:
            raise FormatError(
                f"line {lines[wrong[0]].number}, column {number} is '{cells[wrong[0]][:40]}'",
                remedy="give a number there; begin lines of words with #",
            )
        columns.append(np.array(cells if wrong else [_float(cell) for cell in cells]))
    return columns


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


def _float(cell: str) -> float:
    """Return a number, which may have a Fortran exponent; NaN for an empty cell."""
    return float(cell.lower().replace("d", "e") or "nan")


def _by_name(
    names: list[str], columns: list[NDArray[Any]], rows: list[Line], between: Between
) -> dict[str, Item]:
    """Return the columns by name, if each has one; a last column may be empty, and have one too."""
    n = len(columns)
    if len(names) != len(_cells(rows[0].text, between)) and (len(names) < n or any(names[n:])):
        return {}
    refuse_doubles(names[:n], "columns")
    lines = [line.number for line in rows]
    named = zip(names, columns, strict=False)
    return {name: Item(column, "", lines) for name, column in named if name}


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
