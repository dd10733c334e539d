"""Figures written as files: PDF, PNG or SVG, complete or not there."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from truenewton.errors import OutputFailed
from truenewton.files.outputs import file_beside, folder_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def write_drawn(
    figures: Mapping[str, Callable[[], Axes]],
    folder: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Draw figures and write them, by name, as PDF and PNG into a folder; return the paths.

    Raises
    ------
    OutputExists, OutputFailed
    """
    names = []
    with folder_beside(folder, (".pdf", ".png"), overwrite=overwrite) as temporary:
        for name, draw in figures.items():
            figure = _figure_of(draw())
            for suffix in (".pdf", ".png"):
                _save(figure, temporary / (name + suffix))
                names.append(name + suffix)
    return [Path(folder) / name for name in names]


def write_figure(ax: Axes, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the figure of some axes as PNG, PDF or SVG, whatever the name ends in.

    Raises
    ------
    OutputExists, OutputFailed
    """
    if Path(path).suffix not in (".png", ".pdf", ".svg"):
        raise OutputFailed(
            "is no name for a figure", remedy="let it end in .png, .pdf or .svg", path=path
        )
    with file_beside(path, overwrite=overwrite) as temporary:
        _save(_figure_of(ax), temporary)


def _save(figure: Figure, path: Path) -> None:
    """Save a figure without a date in it: the same data give the same bytes."""
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    figure.savefig(path, dpi=300, metadata=undated.get(path.suffix, {}))


def _figure_of(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes have been taken off their figure")
    return figure
