"""`truenewton figures`: the paper's figures 2, 5 and 6."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options

NAME = "figures"


def run(
    paths: list[Path] = options.PATHS,
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the figures."),
    overwrite: bool = options.OVERWRITE,
) -> None:
    """Draw the actuators, alpha per actuator and alpha on the map, as PDF and PNG."""
    from truenewton.calibration import Calibration
    from truenewton.estimators import calibrate
    from truenewton.figures import write_figures
    from truenewton.outputs import refuse_existing
    from truenewton.reading import read

    refuse_existing(output, overwrite=overwrite)
    data = read(*paths)
    calibration = data if isinstance(data, Calibration) else calibrate(data)
    for path in write_figures(calibration, output, overwrite=overwrite):
        print(path)
