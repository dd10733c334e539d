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
    from truenewton.cli.terminal import print_result
    from truenewton.errors import FormatError
    from truenewton.figures.writing import write_drawn
    from truenewton.files.outputs import refuse_existing, together
    from truenewton.tracking.figures import tracking_figures
    from truenewton.tracking.fit import track
    from truenewton.tracking.validity import validity_of
    from truenewton.tracking.words import lines, values

    if accuracy is not None and not 1e-9 <= accuracy <= 1:
        raise FormatError(f"--accuracy is {accuracy:g}", remedy="give it relative, as 0.005")
    refuse_existing(output, figures, overwrite=overwrite)
    tracking = track(*paths, force=force, segment=segment)
    validity = None if accuracy is None else validity_of(tracking, accuracy)
    drawn: list[Path] = []
    with together():
        if output is not None:
            tracking.write(output, overwrite=overwrite)
        if figures is not None:
            drawn = write_drawn(tracking_figures(tracking), figures, overwrite=overwrite)
    as_values = values(tracking, validity) if json else None
    print_result(
        lines(tracking, validity), output, *drawn, values=as_values, schema="track", quiet=quiet
    )
