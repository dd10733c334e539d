"""`truenewton recalibrate`: a short run after a part was replaced."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="PATH...", help="Cycle files of the run after the change, or their folder."
    ),
    known: Path = typer.Option(..., "--known", help="Calibration from before, or a tracking file."),
    actuators: str = typer.Option(
        ..., "--actuators", help="IDs that were replaced, as 17,18; or auto: find who changed."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Calibration file to write."),
    segment: int | None = options.SEGMENT,
    force: bool = options.FORCE,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Calibrate replaced actuators by a short run; all others keep their calibration."""
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.calibration.written import suffix_of
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.errors import FormatError
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import of_segment, read
    from truenewton.recalibration.fit import recalibrate
    from truenewton.recalibration.segments import recalibrate_segments
    from truenewton.recalibration.words import lines, segmented_lines, segmented_values, values
    from truenewton.records.campaign import Campaign
    from truenewton.records.segmented import SegmentedData

    auto = actuators.strip().casefold() == "auto"
    ids = [] if auto else options.ids(actuators, "--actuators")
    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    with busy("recalibrating"), about(paths):
        data = read(*paths)
        if isinstance(data, SegmentedData) and segment is None:
            several = recalibrate_segments(data, known, ids, force=force)
            refuse_unusable(several.calibration, force=force)
            whole = several.calibration
            several = replace(several, calibration=whole if force else whole.without_unusable())
            found: Any = several.calibration
            told, schema = segmented_lines(several), "recalibrate-segments"
            as_values = segmented_values(several) if json else None
        else:
            body = of_segment(data, segment, paths[0])
            if not isinstance(body, Campaign):
                remedy = "give the run after the change"
                raise FormatError("holds no cycles", remedy=remedy, path=paths[0])
            made = recalibrate(body, known, ids, force=force)
            refuse_unusable(made.calibration, force=force)
            found, told, schema = made.calibration, lines(made), "recalibrate"
            as_values = values(made) if json else None
    if output is not None:
        found.write(output, overwrite=overwrite)
    print_result(told, output, values=as_values, schema=schema, quiet=quiet)
