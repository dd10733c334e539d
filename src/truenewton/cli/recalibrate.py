"""`truenewton recalibrate`: a short run after a part was replaced."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path

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
    from truenewton.calibration.export import suffix_of
    from truenewton.calibration.verdict import usable
    from truenewton.cli.terminal import REFUSALS, about, busy, print_result, schema_of
    from truenewton.errors import FormatError
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_chosen
    from truenewton.recalibration.fit import recalibrate
    from truenewton.recalibration.summary import lines, values
    from truenewton.records.parts import apply

    auto = actuators.strip().casefold() == "auto"
    ids = [] if auto else options.ids(actuators, "--actuators")
    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    with busy("recalibrating"), about(paths, (*REFUSALS, FormatError)):
        data = read_chosen(*paths, segment=segment)
        made = recalibrate(data, known, ids, force=force)
        calibration = usable(apply(attrgetter("calibration"), made), force=force)
    told, as_values = lines(made, calibration), values(made, calibration) if json else None
    if output is not None:
        calibration.write(output, overwrite=overwrite)
    schema = schema_of("recalibrate", made)
    print_result(told, output, values=as_values, schema=schema, quiet=quiet)
