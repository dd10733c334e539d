"""`truenewton track`: how alpha varies with temperature and time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
    from truenewton.cli.terminal import busy, print_result
    from truenewton.errors import FormatError
    from truenewton.figures.writing import write_drawn
    from truenewton.files.outputs import refuse_existing, together
    from truenewton.reading import of_several
    from truenewton.tracking.days import named
    from truenewton.tracking.figures import figures_of_segments, tracking_figures
    from truenewton.tracking.fit import track
    from truenewton.tracking.segments import track_segments
    from truenewton.tracking.validity import validity_of
    from truenewton.tracking.words import lines, segmented_lines, segmented_values, values

    if accuracy is not None and not 1e-9 <= accuracy <= 1:
        raise FormatError(f"--accuracy is {accuracy:g}", remedy="give it relative, as 0.005")
    refuse_existing(output, figures, overwrite=overwrite)
    with busy("tracking"):
        days = [named(path) for path in paths]
        if segment is None and any(of_several(day.data) for day in days):
            whole = track_segments(*days, force=force)
            found: Any = whole
            schema, draws = "track-segments", figures_of_segments(whole)
            due = {n: validity_of(law, accuracy) for n, law in whole.segments.items() if accuracy}
            told, as_values = segmented_lines(whole, due), segmented_values(whole, due)
        else:
            found = law = track(*days, force=force, segment=segment)
            schema, draws = "track", tracking_figures(law)
            validity = None if accuracy is None else validity_of(law, accuracy)
            told, as_values = lines(law, validity), values(law, validity)
    drawn: list[Path] = []
    with together():
        if output is not None:
            found.write(output, overwrite=overwrite)
        if figures is not None:
            drawn = write_drawn(draws, figures, overwrite=overwrite)
    shown = as_values if json else None
    print_result(told, output, *drawn, values=shown, schema=schema, quiet=quiet)
