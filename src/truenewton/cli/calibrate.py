"""`truenewton calibrate`: from cycle files or a stiffness file to alpha."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.calibration.result import AnyCalibration


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
    exclude: str | None = options.EXCLUDE,
    cluster: str | None = options.CLUSTER,
    segment: int | None = options.SEGMENT,
    processes: int | None = typer.Option(
        None, min=1, help="Segments calibrated at once; as many as processors unless given."
    ),
    force: bool = options.FORCE,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find true Newtons per commanded Newton of every actuator."""
    from truenewton.calibration.export import lacking, suffix_of
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.summary import all_lines, summary_values
    from truenewton.calibration.verdict import usable
    from truenewton.cli.terminal import about, busy, print_result, schema_of
    from truenewton.cluster import connected
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_data

    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    out = options.ids(exclude, "--exclude") if exclude else ()
    with connected(cluster) as client:
        data = read_data(*paths, segment=segment, client=client)
        with about(paths):
            motion = options.motion_of(mirror, data)
            with busy("calibrating", keeping=True) as waiting:
                work = partial(
                    calibrate,
                    data,
                    method,
                    population=population,
                    motion=motion,
                    exclude=out,
                    client=client,
                    processes=processes,
                )
                found: AnyCalibration = waiting.end_of(work)
            found = usable(found, force=force)
    lines, values = [*all_lines(found, data)], summary_values(found) if json else None
    if output is not None:
        found.write(output, overwrite=overwrite)
        lines += filter(None, [lacking(found, output)])
    schema = schema_of("calibrate", found)
    print_result(lines, output, values=values, schema=schema, quiet=quiet)
