"""`truenewton report`: what a campaign gave, on one page that opens without network."""

from __future__ import annotations

import shlex
from pathlib import Path

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = typer.Argument(
        ...,
        metavar="PATH...",
        help="Cycle files or their folder, a stiffness file, a calibration, or two to compare.",
    ),
    output: Path = typer.Option(..., "-o", "--output", help="Page to write (HTML)."),
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.GLASS,
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Put verdict, map, residuals and inputs on one page; or what changed between two."""
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.segmented import SegmentedCalibration
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.errors import OutputFailed
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import of_segment, read, read_calibrations
    from truenewton.records.segmented import SegmentedData
    from truenewton.report.change import Change, change
    from truenewton.report.investigate import Findings, investigate
    from truenewton.report.page.page import write_report
    from truenewton.report.verdict import headline_of

    if output.suffix.lower() not in (".html", ".htm"):
        raise OutputFailed(
            "is no name for a page", remedy="let -o end in .html (a browser prints it)", path=output
        )
    refuse_existing(output, overwrite=overwrite)
    with busy("looking into it"):
        pair = read_calibrations(*paths, segment=segment) if len(paths) == 2 else ()
        if pair:
            edges = options.edges_of(mirror, pair[0].layout)
            findings: Findings | Change | SegmentedCalibration = change(*pair)
        else:
            data = read(*paths)
            data = data if segment is None else of_segment(data, segment, paths[0])
            edges = options.edges_of(mirror, data.layout)
            if isinstance(data, SegmentedCalibration):
                findings = data
            elif isinstance(data, SegmentedData):
                seen = options.motion_of(mirror, data)
                with about(paths):
                    findings = calibrate(data, method, population=population, motion=seen)
            else:
                known = None if isinstance(data, Calibration) else options.motion_of(mirror, data)
                findings = investigate(data, method, population=population, motion=known)
    words = ["truenewton", "report", *map(str, paths), "-o", str(output)]
    words += ["--method", method] if method else []
    words += ["--population"] if population else []
    words += [] if segment is None else ["--segment", str(segment)]
    words += ["--mirror", mirror] if mirror else []
    told = shlex.join(words)
    write_report(output, findings, command=told, edges=edges, overwrite=overwrite)
    lines = list(headline_of(findings).lines())
    values = {"verdict": lines[0], "lines": lines[1:], "written": str(output)}
    print_result(lines, output, values=values if json else None, schema="report", quiet=quiet)
