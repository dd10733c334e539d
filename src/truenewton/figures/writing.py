"""Figures written as files, PDF, PNG or SVG, complete or not there; and as part of a web page."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from truenewton.errors import OutputFailed
from truenewton.files.outputs import file_beside, folder_beside

SVG, XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
REFERENCE = re.compile(r"^(url\()?#")  # of one element of an SVG to another
NEEDLESS = re.compile(r"(?<=\.\d\d)\d+")  # decimals, of points of 1/72 inch
# Identifiers of an SVG are random without a salt of one's own.
SVG_STYLE: Any = {"svg.hashsalt": "truenewton"}
PAGE_STYLE: Any = {**SVG_STYLE, "svg.fonttype": "none", "font.sans-serif": ["DejaVu Sans"]}
SVG_DPI = 72  # an SVG measures in points
PAGE_DPI = 150  # of what is a picture within a figure of a page
CROWD = 600  # marks; beyond so many, a picture of them is shorter than a list
POINTS_A_MARK = 8  # of a line, which take as long to write as a mark
UNDATED = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def write_drawn(
    figures: Mapping[str, Callable[[], Axes]],
    folder: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Draw figures and write them, by name, as PDF and PNG into a folder; return the paths."""
    suffixes = (".pdf", ".png")
    with folder_beside(folder, suffixes, overwrite=overwrite) as temporary:
        for name, draw in figures.items():
            figure = _figure_of(draw())
            for suffix in suffixes:
                _save(figure, temporary / f"{name}{suffix}")
    return [Path(folder) / f"{name}{suffix}" for name in figures for suffix in suffixes]


def write_figure(ax: Axes, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the figure of some axes as PNG, PDF or SVG, by the ending of the name."""
    if Path(path).suffix not in (".png", ".pdf", ".svg"):
        raise OutputFailed(
            "is no name for a figure", remedy="let it end in .png, .pdf or .svg", path=path
        )
    with file_beside(path, overwrite=overwrite) as temporary:
        _save(_figure_of(ax), temporary)


def inline_svg(ax: Axes, key: str) -> str:
    """Return the figure of some axes as an SVG element for an HTML page.

    It is as wide as its place on the page, its text is text, and its identifiers begin with the
    key. The page's element ``caption-{key}`` is its label. Thousands of points become a picture
    within it.
    """
    figure = _figure_of(ax)
    drawn = [artist for ax in figure.axes for artist in (*ax.lines, *ax.collections)]
    if sum(map(_marks, drawn)) > CROWD:
        for artist in drawn:
            artist.set_rasterized(True)
    file, nothing = io.BytesIO(), dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context(PAGE_STYLE):
        FigureCanvasSVG(figure)
        if layout := figure.get_layout_engine():  # savefig would draw all once more for it
            figure.dpi = SVG_DPI
            if len(figure.axes) > 1:
                layout.execute(figure)
            figure.set_layout_engine("none")
            if len(figure.axes) == 1:
                _fill(figure, figure.axes[0])
        figure.savefig(file, format="svg", dpi=PAGE_DPI, metadata=nothing)
    root = ElementTree.fromstring(file.getvalue())
    for element in root.iter():
        element.tag = element.tag.removeprefix(SVG)
        element.attrib = {
            name.replace(XLINK, "xlink:"): NEEDLESS.sub("", REFERENCE.sub(rf"\g<0>{key}-", value))
            for name, value in element.attrib.items()
        }
        if "id" in element.attrib:
            element.set("id", f"{key}-{element.get('id')}")
        if (element.text or "").isspace():
            element.text = None
        element.tail = None
    del root.attrib["width"], root.attrib["height"]
    for definitions in root.findall("defs"):
        if definitions.find("style") is not None:  # which would apply to the whole page
            root.remove(definitions)
    root.attrib |= {"role": "img", "aria-labelledby": f"caption-{key}"}
    return ElementTree.tostring(root, encoding="unicode")


def _fill(figure: Figure, ax: Axes) -> None:
    """Let axes with their labels fill a figure; constrained layout measures them twice as often."""
    size, around = figure.bbox, ax.get_tightbbox() or figure.bbox
    left, low, right, high = ax.get_position().extents
    pad = 3.0  # points
    left += (pad - around.x0) / size.width
    low += (pad - around.y0) / size.height
    right -= (around.x1 - size.width + pad) / size.width
    high -= (around.y1 - size.height + pad) / size.height
    ax.set_position((left, low, right - left, high - low))


def _marks(artist: Artist) -> float:
    """Return the number of marks of an artist."""
    if isinstance(artist, Line2D):
        points = np.size(artist.get_xdata())
        return points if artist.get_marker() != "None" else points / POINTS_A_MARK
    return len(np.asarray(artist.get_offsets())) if isinstance(artist, Collection) else 1


def _save(figure: Figure, path: Path) -> None:
    """Save a figure without a date in it: the same data give the same bytes."""
    with mpl.rc_context(SVG_STYLE):
        figure.savefig(path, dpi=300, metadata=UNDATED.get(path.suffix, {}))


def _figure_of(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes have been taken off their figure")
    return figure
