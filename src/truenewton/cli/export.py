"""`truenewton export`: a supervisor's files with alpha in."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    folder: Path = typer.Argument(
        ..., metavar="FOLDER", help="A supervisor's: ff_matrix.fits, ff_list.fits."
    ),
    calibration: Path = typer.Option(..., help="Calibration file, its IDs the channels."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder to write the five files to."),
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Write a supervisor's feed-forward files anew, forces in true Newtons."""
    from truenewton.cli.terminal import busy, print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.importers.supervisor import export_supervisor
    from truenewton.reading import read_calibration

    refuse_existing(output, overwrite=overwrite)
    with busy("exporting"):
        one = read_calibration(calibration, segment=segment)
        lines = export_supervisor(folder, one, output, overwrite=overwrite, force=anyway)
    print_result(lines, output, quiet=quiet)
