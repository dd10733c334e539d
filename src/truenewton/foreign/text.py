"""Numbers in text files, as people and programs write them.

Columns stand between commas, semicolons, tabs or blanks; where one of the others does, a comma is
a decimal one. What begins with #, ; % or ! is a comment. An LBT supervisor's array begins with its
type and sizes (`float 672`), the first index fastest.
"""

from __future__ import annotations

import io
import os
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, UnreadableFile
from truenewton.files.opening import MOST_UNPACKED, open_plain

COMMENT = "#;%!"
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf(inity)?)", re.I)
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eEdD][-+]?\d+)?")
TYPED = re.compile(r"(byte|u?int|u?long|u?long64|float|double)((?:\s+\d+)+)\s*(?:[;#].*)?", re.I)
NARROW = 16  # columns, of which some may be words


class TextTable(NamedTuple):
    """A text file of numbers.

    Attributes
    ----------
    values
        (rows, columns), or as its type line says; None where a column holds words.
    columns
        Those that hold numbers, by the names of a header.
    """

    values: NDArray[Any] | None
    columns: dict[str, NDArray[Any]]


def text_of(path: str | os.PathLike[str]) -> str:
    """Return the text of a file.

    Raises
    ------
    UnreadableFile
    """
    with open_plain(path) as file:
        raw = file.read(MOST_UNPACKED + 1)
    if len(raw) > MOST_UNPACKED:
        fault = f"is longer than {MOST_UNPACKED >> 30} GB"
        raise UnreadableFile(fault, remedy="give FITS, .npy or HDF5", path=path)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace")
    if b"\0" in raw:
        remedy = "give FITS, .npy, .npz, CSV or text, ECSV, HDF5, YAML, .mat or .sav"
        raise UnreadableFile("is of no kind that is read here", remedy=remedy, path=path)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def read_text(path: str | os.PathLike[str]) -> TextTable:
    """Read a text file of numbers.

    Raises
    ------
    UnreadableFile, FormatError
    """
    # A tab may stand for an empty cell in the corner, unless every line begins with one.
    lines = [line.strip(" ") for line in text_of(path).splitlines()]
    if all(line.startswith("\t") for line in lines if line):
        lines = [line.strip() for line in lines]
    data = [line for line in lines if line and line[0] not in COMMENT]
    if not data:
        raise FormatError("holds no numbers", remedy="give a file with numbers", path=path)
    typed = TYPED.fullmatch(data[0])
    if typed:
        return TextTable(_typed(typed[2], data[1:], path), {})
    delimiter, comma = _separators(data[-1])
    if delimiter == ";":  # then it begins no comment
        data = [line for line in lines if line and line[0] not in COMMENT.replace(";", "")]
    if comma:
        data = [line.replace(",", ".") for line in data]
    while len(data) > 1 and not _has_number(data[1], delimiter):  # a header of several lines
        data = data[1:]
    names = _words(data[0], delimiter)
    if all(NUMBER.fullmatch(name) for name in names):
        comments = [line for line in lines if line and line[0] in COMMENT]
        names = _words(comments[-1].lstrip(COMMENT), delimiter) if comments else []
    else:
        data = data[1:]
    if not data:
        raise FormatError("holds a header and no numbers", remedy="give its rows", path=path)
    if len(_words(data[-1], delimiter)) <= NARROW:
        return _narrow(data, delimiter, names, path)
    return TextTable(_unlabelled(_wide(data, delimiter, path), bool(names)), {})


def _separators(line: str) -> tuple[str | None, bool]:
    """Return what stands between columns, None for blanks, and whether commas are decimal."""
    for delimiter in (";", "\t"):
        if delimiter in line:
            return delimiter, "," in line
    if "," in line:
        words = line.split()
        if len(words) > 1 and all(DECIMAL_COMMA.fullmatch(w) or NUMBER.fullmatch(w) for w in words):
            return None, True
        return ",", False
    return None, False


def _words(line: str, delimiter: str | None) -> list[str]:
    words = [word.strip().strip("'\"").strip() for word in line.split(delimiter)]
    return words[:-1] if delimiter and len(words) > 1 and not words[-1] else words


def _has_number(line: str, delimiter: str | None) -> bool:
    return any(NUMBER.fullmatch(word) for word in _words(line, delimiter))


def _typed(sizes: str, lines: list[str], path: Any) -> NDArray[Any]:
    shape = tuple(map(int, sizes.split()))[::-1]
    words = " ".join(lines).split()
    wrong = [word for word in words if not NUMBER.fullmatch(word)]
    if wrong or len(words) != np.prod(shape):
        fault = f"holds '{wrong[0]}'" if wrong else f"holds {len(words)} numbers"
        remedy = f"give {' x '.join(map(str, shape))} numbers, as its first line says"
        raise FormatError(fault, remedy=remedy, path=path)
    return np.array([word.lower().replace("d", "e") for word in words], dtype=float).reshape(shape)


def _narrow(lines: list[str], delimiter: str | None, names: list[str], path: Any) -> TextTable:
    rows = _alike(lines, delimiter, path)
    columns: list[NDArray[Any] | None] = []
    for cells in zip(*rows, strict=True):
        sound = all(not cell or NUMBER.fullmatch(cell) for cell in cells)
        numbers = [cell.lower().replace("d", "e") or "nan" for cell in cells]
        columns.append(np.array(numbers, dtype=float) if sound else None)
    if not any(column is not None for column in columns):
        raise FormatError("holds no numbers", remedy="give a file with numbers", path=path)
    named = {}
    if len(names) == len(columns):
        named = {n: c for n, c in zip(names, columns, strict=True) if n and c is not None}
    if any(column is None for column in columns):
        return TextTable(None, named)
    return TextTable(_unlabelled(np.array(columns).T, bool(names)), named)


def _alike(lines: list[str], delimiter: str | None, path: Any) -> list[list[str]]:
    """Return the words of lines, as many in each."""
    rows = [_words(line, delimiter) for line in lines]
    for number, (row, line) in enumerate(zip(rows, lines, strict=True), 1):
        if len(row) != len(rows[0]):
            raise FormatError(
                f"row {number} has {len(row)} columns and the first {len(rows[0])}: '{line[:40]}'",
                remedy="give all rows alike; begin lines of words with #",
                path=path,
            )
    return rows


def _wide(lines: list[str], delimiter: str | None, path: Any) -> NDArray[Any]:
    try:
        return np.loadtxt(
            io.StringIO("\n".join(line.replace('"', "") for line in lines)),
            delimiter=delimiter, ndmin=2, comments=None,
        )  # fmt: skip
    except ValueError as error:
        for number, row in enumerate(_alike(lines, delimiter, path), 1):
            for column, word in enumerate(row, 1):
                if not NUMBER.fullmatch(word):
                    raise FormatError(
                        f"row {number}, column {column} is '{word[:40]}'",
                        remedy="give a number there; begin lines of words with #",
                        path=path,
                    ) from None
        raise FormatError(f"{error}", remedy="give rows of numbers", path=path) from None


def _unlabelled(values: NDArray[Any], header: bool) -> NDArray[Any]:
    """Return a square matrix without the numbers of its rows and columns, if it has such."""

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
