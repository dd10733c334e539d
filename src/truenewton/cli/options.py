"""Options and arguments that several commands share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truenewton.mirrors.known import Mirror


JSON = typer.Option(False, "--json", help="Print figures as JSON, for scripts.")
OVERWRITE = typer.Option(False, "--overwrite", help="Replace an output that exists.")
PATHS = typer.Argument(
    ..., metavar="PATH...", help="Cycle files or their folder, a stiffness file, or a calibration."
)


def mirror_or_file(name: str) -> Mirror:
    """Return a mirror by name or TOML file, or P45's numbers on the layout of a FITS file."""
    import dataclasses
    from pathlib import Path

    from truenewton.mirrors.file import mirror_from
    from truenewton.mirrors.known import p45
    from truenewton.records.file import SUFFIXES, read_layout

    if name.endswith(SUFFIXES) and Path(name).exists():
        return dataclasses.replace(p45(), name=Path(name).name, layout=read_layout(name))
    return mirror_from(name)


def ids(text: str, option: str) -> list[int]:
    """Return the IDs of a list with commas.

    Raises
    ------
    FormatError
    """
    from truenewton.errors import FormatError

    try:
        return [int(word) for word in text.split(",")]
    except ValueError:
        raise FormatError(f"{option} is '{text}'", remedy="give IDs, as 17,18", got=text) from None
