"""`truenewton track`: how alpha varies with temperature and time."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="CALIBRATION...", help="Calibration files, or folders of campaigns."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Tracking file to write."),
    figures: Path | None = typer.Option(None, "--figures", help="Folder for the figures."),
    accuracy: float | None = typer.Option(
        None, help="Wanted, relative to alpha (0.005): says when to calibrate again."
    ),
    segment: int | None = options.SEGMENT,
    force: bool = options.FORCE,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find how alpha varies with temperature and time, from calibrations of different days."""
    from truenewton.cli.terminal import busy, print_result, schema_of
    from truenewton.errors import FormatError
    from truenewton.figures.writing import write_drawn
    from truenewton.files.outputs import atomic_outputs, refuse_existing
    from truenewton.tracking.figures import tracking_figures
    from truenewton.tracking.fit import track
    from truenewton.tracking.summary import lines, values

    if accuracy is not None and not 1e-9 <= accuracy <= 1:
        raise FormatError(f"--accuracy is {accuracy:g}", remedy="give it relative, as 0.005")
    refuse_existing(output, figures, overwrite=overwrite)
    with busy("tracking"):
        law = track(*paths, force=force, segment=segment)
        told, as_values = lines(law, accuracy), values(law, accuracy) if json else None
    drawn: list[Path] = []
    with atomic_outputs():
        if output is not None:
            law.write(output, overwrite=overwrite)
        if figures is not None:
            drawn = write_drawn(tracking_figures(law), figures, overwrite=overwrite)
    schema = schema_of("track", law)
    print_result(told, output, *drawn, values=as_values, schema=schema, quiet=quiet)
