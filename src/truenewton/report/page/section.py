"""What a section of the page is made of: words, a plot, bars, tables."""

from __future__ import annotations

from dataclasses import dataclass

from truenewton.report.budget import BudgetLine
from truenewton.report.page.looks import Plot


@dataclass(frozen=True)
class TextTable:
    """A table of text; its first column is a name; long cells wrap where told."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    wraps: bool = False


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes
    ----------
    key, title
        For links; for people.
    words
        Paragraphs.
    plot
        The figure, if any.
    caption
        What the figure shows, in words: its alternative for who cannot see it.
    legend
        Colours of the figure and their names.
    bars, tables
        What stands beneath.
    """

    key: str
    title: str
    words: tuple[str, ...] = ()
    plot: Plot | None = None
    caption: str = ""
    legend: tuple[tuple[str, str], ...] = ()
    bars: tuple[BudgetLine, ...] = ()
    tables: tuple[TextTable, ...] = ()
