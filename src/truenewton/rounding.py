"""Numbers as text: rounded with their errors, counted, listed, in tables."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence, Sized
from html import escape

WIDTH = 100  # of text, in columns
CELL = '<td style="text-align: left; white-space: pre-wrap; font-family: monospace">'


def with_error(value: float, error: float) -> str:
    """Return a number rounded with its error by the rule of the Particle Data Group.

    The error keeps two digits if its first three are below 355, else one; from 950 it becomes 1000
    with two. The value is rounded to the same place.
    """
    if not math.isfinite(value):
        return "unknown"
    if not (math.isfinite(error) and error > 0):
        return f"{value:.6g}"
    exponent = math.floor(math.log10(error))
    three = round(error / 10.0 ** (exponent - 2))
    if three >= 950:
        exponent, error, digits = exponent + 1, 10.0 ** (exponent + 1), 1
    else:
        digits = 1 if three < 355 else 0
    decimals = digits - exponent
    if decimals < 0:
        step = 10.0**-decimals
        return f"{round(value / step) * step:.0f} ± {round(error / step) * step:.0f}"
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def percent(ratio: float) -> str:
    """Return a ratio in per cent with two significant digits."""
    return f"{significant(100 * ratio)} %" if abs(ratio) < 0.995 else f"{100 * ratio:.0f} %"


def to_digits(value: float, error: float) -> str:
    """Return a number rounded by its error, without the error."""
    return with_error(value, error).split(" ±")[0]


def significant(value: float, digits: int = 2) -> str:
    """Return a number with some significant digits, trailing zeros kept."""
    if not math.isfinite(value):
        return "unknown"
    if value == 0.0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -3 <= decimals <= 6:
        return f"{round(value, decimals):.{max(decimals, 0)}f}"
    return f"{value:.{digits - 1}e}"


def chance_text(probability: float) -> str:
    """Return the probability that any actuator of a mirror deviates as much by chance."""
    return f"chance probability {f'{probability:.1g}' if probability > 1e-12 else 'below 1e-12'}"


def counted(count: int | Sized, noun: str, plural: str = "") -> str:
    """Return a number with a noun, as '1 row' or '2 rows'; a collection counts as its length."""
    number = len(count) if isinstance(count, Sized) else int(count)
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def listed(names: Iterable[object], most: int = 10) -> str:
    """Return the first names of a list, and how many more there are, as '1, 2 and 3 more'."""
    every = list(map(str, names)) or ["none"]
    if len(every) > most:
        every = [*every[:most], f"{len(every) - most} more"]
    *first, last = every
    return f"{', '.join(first)} and {last}" if first else last


def numbered(noun: str, numbers: Sequence[int]) -> str:
    """Return a noun with ascending numbers, runs shortened: 'segments 1 to 3, 5'."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    said = [
        part
        for run in runs
        for part in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))
    ]
    return f"{noun if len(numbers) == 1 else f'{noun}s'} {', '.join(said)}"


def named(noun: str, names: Sequence[object], most: int = 10) -> str:
    """Return a noun with names, as 'actuators 3, 5 and 8'."""
    return f"{noun if len(names) == 1 else f'{noun}s'} {listed(names, most)}"


def row(name: str, value: str, note: str = "") -> str:
    """Return a line of a summary: name, value and note in columns."""
    return f"  {name:<22}  {value:<28}  {note}".rstrip()


def table_lines(title: str, *table: Sequence[str]) -> Iterator[str]:
    """Yield a title and the rows of a table: its first column left-aligned, the others right."""
    yield title
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for first, *others in table:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  " + "  ".join([first.ljust(widths[0]), *cells]).rstrip()


def wrapped(lines: Iterable[str], width: int = WIDTH) -> Iterator[str]:
    """Yield lines of text of at most a width, continued below the last column of the first."""
    for line in lines:
        columns = [gap.end() for gap in re.finditer(r"^ *|  +", line) if gap.end() < 0.6 * width]
        indent = " " * (columns[-1] if len(columns) > 1 else columns[0] + 2)
        parts = textwrap.wrap(
            re.sub(r" (?=[%±])|(?<=±) ", "\xa0", line),
            width,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        yield from (part.replace("\xa0", " ") for part in parts or [""])


def html_table(title: str, rows: Iterable[Sequence[str]], remarks: Iterable[str] = ()) -> str:
    """Return a title, rows of cells and remarks as HTML; text from files is escaped."""
    cells = (f"<tr>{''.join(f'{CELL}{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    below = "".join(f"<div>{escape(remark)}</div>" for remark in remarks)
    return f"<div><b>{escape(title)}</b><table>{''.join(cells)}</table>{below}</div>"
