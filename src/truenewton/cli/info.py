"""`truenewton info`: what a file holds, and whether it is sound."""

from __future__ import annotations

from pathlib import Path

from truenewton.cli import options


def run(
    paths: list[Path] = options.PATHS,
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.GLASS,
    segment: int | None = options.SEGMENT,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Say what files hold, and whether alpha can be had from them."""
    from truenewton.calibration.survey import survey
    from truenewton.cli.terminal import busy, print_result
    from truenewton.reading import read_chosen

    data = read_chosen(*paths, segment=segment)
    motion = options.motion_of(mirror, data)
    with busy("trying to calibrate"):
        values, lines = survey(data, method, population=population, motion=motion)
    print_result(lines, values=values if json else None, schema="info", quiet=quiet)
