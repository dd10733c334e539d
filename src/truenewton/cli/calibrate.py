"""`truenewton calibrate`: from cycle files or a stiffness file to alpha."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options

NAME = "calibrate"


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="PATH...", help="Cycle files or their folder, or a stiffness file."
    ),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Calibration file to write (FITS)."
    ),
    method: str = typer.Option("svd", help="Estimator: svd, the paper's."),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
) -> None:
    """Find true Newtons per commanded Newton of every actuator."""
    from truenewton.cli.printing import print_json
    from truenewton.cli.summary import imbalance_lines, print_summary, summary_values
    from truenewton.estimators import calibrate
    from truenewton.estimators.elastic import imbalances
    from truenewton.measurements import StiffnessMatrix
    from truenewton.outputs import refuse_existing
    from truenewton.reading import read_data

    if output is not None:
        refuse_existing(output, overwrite=overwrite)
    data = read_data(*paths)
    calibration = calibrate(data, method)
    judged = imbalances(data) if isinstance(data, StiffnessMatrix) else ()
    if output is not None:
        calibration.write(output, overwrite=overwrite)
    if json:
        print_json(summary_values(calibration, judged))
        return
    print_summary(calibration)
    for line in imbalance_lines(judged):
        print(line)
    print(f"written: {output}" if output is not None else "not written; -o FILE keeps it")
