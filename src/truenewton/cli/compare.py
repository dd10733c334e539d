"""`truenewton compare`: what changed between two stiffness matrices of one mirror."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    old: Path = typer.Argument(..., metavar="OLD", help="Stiffness file of before."),
    new: Path = typer.Argument(..., metavar="NEW", help="Stiffness file of after."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Table of all changes to write (.csv, .ecsv)."
    ),
    figure: Path | None = typer.Option(
        None, "--figure", help="Map of the change of alpha to write (.pdf, .png, .svg)."
    ),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find which actuators and sensors changed between two matrices of one mirror."""
    from truenewton.cli.terminal import busy, print_result
    from truenewton.comparison.compare import compare, table_suffix
    from truenewton.comparison.summary import lines, values
    from truenewton.figures.writing import write_figure
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_stiffness

    if output is not None:
        table_suffix(output)
    refuse_existing(output, figure, overwrite=overwrite)
    with busy("comparing"):
        compared = compare(read_stiffness(old), read_stiffness(new))
    if output is not None:
        compared.write(output, overwrite=overwrite)
    if figure is not None:
        write_figure(compared.plot(), figure, overwrite=overwrite)
    as_values = values(compared) if json else None
    written = (output, figure) if figure else (output,)
    print_result(lines(compared), *written, values=as_values, schema="compare", quiet=quiet)
