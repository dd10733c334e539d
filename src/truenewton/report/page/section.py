"""What a section of the page is made of: words, a figure, tables."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TextTable:
    """A table of text, not shown without rows.

    Its first column is a name; long cells wrap where ``wraps``.
    """

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
    figure
        Name of the figure of `Findings.plot`; empty where nothing is drawn.
    caption
        What the figure shows, in words: its alternative for who cannot see it.
    tables
        What stands beneath.
    """

    key: str
    title: str
    words: tuple[str, ...] = ()
    figure: str = ""
    caption: str = ""
    tables: tuple[TextTable, ...] = ()
