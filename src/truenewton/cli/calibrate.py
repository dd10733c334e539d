"""`truenewton calibrate`: from cycle files or a stiffness file to alpha."""

from __future__ import annotations

from functools import partial
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
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.segment_words import segmented_lines, segmented_values
    from truenewton.calibration.segmented import SegmentedCalibration
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
    from truenewton.reading import of_segment, read_data
    from truenewton.records.campaign import Campaign

    if output is not None:
        suffix_of(output)
    refuse_existing(output, overwrite=overwrite)
    schema, values = "calibrate", None
    out = options.ids(exclude, "--exclude") if exclude else ()
    with connected(cluster) as client:
        data = read_data(*paths, client=client)
        data = data if segment is None else of_segment(data, segment, paths[0])
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
                found: Calibration | SegmentedCalibration = waiting.end_of(work)
            refuse_unusable(found, force=force)
            if isinstance(found, SegmentedCalibration):
                found = found if force else found.without_unusable()
                lines, schema = [*segmented_lines(found)], "calibrate-segments"
                values = segmented_values(found) if json else None
            else:
                lines = [*summary_lines(found), *imbalance_lines(found.imbalances)]
                if isinstance(data, Campaign):
                    lines += rejected_lines(data, found.rejected_rows)
                values = summary_values(found) if json else None
    if output is not None:
        found.write(output, overwrite=overwrite)
        lines += filter(None, [lacking(found, output)])
    print_result(lines, output, values=values, schema=schema, quiet=quiet)
