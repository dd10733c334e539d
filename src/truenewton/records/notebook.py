"""Results as a notebook shows them: the words of a terminal in a small table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

CELL = '<td style="text-align: left; white-space: pre-wrap; font-family: monospace">'


def html_table(title: str, rows: Iterable[Sequence[str]], remarks: Iterable[str] = ()) -> str:
    """Return a title, rows of cells and remarks below them as HTML, everything escaped.

    Names and warnings come from files: whatever stands in them is text.
    """
    cells = (f"<tr>{''.join(f'{CELL}{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    below = "".join(f"<div>{escape(remark)}</div>" for remark in remarks)
    return f"<div><b>{escape(title)}</b><table>{''.join(cells)}</table>{below}</div>"
