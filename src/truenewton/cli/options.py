"""Options and arguments that several commands share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truenewton.mirrors import Mirror

JSON = typer.Option(False, "--json", help="Print figures as JSON, for scripts.")
OVERWRITE = typer.Option(False, "--overwrite", help="Replace an output that exists.")
PATHS = typer.Argument(
    ..., metavar="PATH...", help="Cycle files or their folder, a stiffness file, or a calibration."
)


def mirror_or_file(name: str) -> Mirror:
    """Return a known mirror, or P45's numbers on the layout of a FITS file."""
    import dataclasses
    from pathlib import Path

    from truenewton.campaign_files import read_layout
    from truenewton.mirrors import KNOWN, mirror, p45

    if name.lower() in KNOWN or not Path(name).exists():
        return mirror(name)
    return dataclasses.replace(p45(), name=Path(name).name, layout=read_layout(name))
