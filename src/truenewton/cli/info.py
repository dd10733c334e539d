"""`truenewton info`: what a file holds, and whether it is sound."""

from __future__ import annotations

from pathlib import Path

from truenewton.cli import options


def run(
    paths: list[Path] = options.PATHS,
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.GLASS,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Say what files hold, and whether alpha can be had from them."""
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.survey import survey
    from truenewton.calibration.words import summary_lines, summary_values
    from truenewton.cli.terminal import busy, print_result
    from truenewton.reading import read

    data = read(*paths)
    if isinstance(data, Calibration):
        values = {"holds": "calibration", **summary_values(data)}
        headline = f"a calibration, method {data.method}, scale {data.scale}"
        lines = [headline, *summary_lines(data)]
    else:
        motion = options.motion_of(mirror, data)
        with busy("trying to calibrate"):
            values, lines = survey(data, method, population=population, motion=motion)
    print_result(lines, values=values if json else None, schema="info", quiet=quiet)
