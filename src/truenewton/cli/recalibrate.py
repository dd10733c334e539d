"""`truenewton recalibrate`: a short run after a part was replaced."""

from __future__ import annotations

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
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.calibration.written import suffix_of
    from truenewton.cli.terminal import about, print_result
    from truenewton.errors import FormatError
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_one
    from truenewton.recalibration.fit import recalibrate
    from truenewton.recalibration.words import lines, values
    from truenewton.records.campaign import Campaign

    auto = actuators.strip().casefold() == "auto"
    ids = [] if auto else options.ids(actuators, "--actuators")
    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    data = read_one(*paths, segment=segment)
    if not isinstance(data, Campaign):
        raise FormatError("holds no cycles", remedy="give the run after the change", path=paths[0])
    with about(paths):
        made = recalibrate(data, known, ids, force=force)
        refuse_unusable(made.calibration, force=force)
    if output is not None:
        made.calibration.write(output, overwrite=overwrite)
    as_values = values(made) if json else None
    print_result(
        lines(made),
        output,
        values=as_values,
        schema="recalibrate",
        quiet=quiet,
    )
