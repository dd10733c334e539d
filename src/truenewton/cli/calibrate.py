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
        None, "-o", "--output", help="Calibration file to write (FITS)."
    ),
    method: str = options.METHOD,
    population: bool = options.POPULATION,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
) -> None:
    """Find true Newtons per commanded Newton of every actuator."""
    from truenewton.calibration.methods import calibrate, held_out
    from truenewton.calibration.words import (
        imbalance_lines,
        rejected_lines,
        summary_lines,
        summary_values,
    )
    from truenewton.cli.terminal import print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_data
    from truenewton.records.stiffness_matrix import StiffnessMatrix

    refuse_existing(output, overwrite=overwrite)
    data = read_data(*paths)
    calibration = calibrate(data, method, population=population)
    if output is not None:
        calibration.write(output, overwrite=overwrite)
    if isinstance(data, StiffnessMatrix):
        judged = held_out(data, method, population=population)
        values, more = summary_values(calibration, judged), imbalance_lines(judged)
    else:
        values, more = summary_values(calibration), rejected_lines(data, calibration.rejected_rows)
    lines = [*summary_lines(calibration), *more]
    print_result(lines, output, values=values if json else None)
