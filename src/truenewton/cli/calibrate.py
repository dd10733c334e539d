"""`truenewton calibrate`: from cycle files or a stiffness file to alpha."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="PATH...", help="Cycle files or their folder, or a stiffness file."
    ),
    output: Path | None = typer.Option(
        None,
        "-o",
        "--output",
        help="File to write: .fits, the calibration; .ecsv or .csv, its table; .npy, alpha.",
    ),
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.GLASS,
    cluster: str | None = options.CLUSTER,
    force: bool = options.FORCE,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find true Newtons per commanded Newton of every actuator."""
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.calibration.words import (
        imbalance_lines,
        rejected_lines,
        summary_lines,
        summary_values,
    )
    from truenewton.calibration.written import lacking, suffix_of
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.cluster import connected
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_data
    from truenewton.records.campaign import Campaign

    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    with connected(cluster) as client:
        data = read_data(*paths, client=client)
        motion = options.motion_of(mirror, data)
        with busy("calibrating"), about(paths):
            calibration = calibrate(
                data, method, population=population, motion=motion, client=client
            )
            refuse_unusable(calibration, force=force)
    if output is not None:
        calibration.write(output, overwrite=overwrite)
    lines = [*summary_lines(calibration), *imbalance_lines(calibration.imbalances)]
    if isinstance(data, Campaign):
        lines += rejected_lines(data, calibration.rejected_rows)
    if output is not None and (lacks := lacking(calibration, output)):
        lines.append(lacks)
    values = summary_values(calibration) if json else None
    print_result(
        lines,
        output,
        values=values,
        schema="calibrate",
        quiet=quiet,
    )
