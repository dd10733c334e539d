"""`truenewton report`: what a campaign gave, on one page that opens without network."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.report.verdict import Reported


def run(
    paths: list[Path] = typer.Argument(
        ...,
        metavar="PATH...",
        help="Cycle files or their folder, a stiffness file, a calibration, or two to compare.",
    ),
    output: Path = typer.Option(..., "-o", "--output", help="Page to write (HTML)."),
    method: str | None = options.METHOD,
    calibration: Path | None = typer.Option(
        None, help="Calibration of these data, which are then not fitted again."
    ),
    population: bool = options.POPULATION,
    mirror: str | None = options.GLASS,
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Put verdict, map, residuals and inputs on one page; or what changed between two."""
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.errors import OutputFailed
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_alpha, read_calibrations, read_chosen
    from truenewton.report.change import change
    from truenewton.report.findings import investigate
    from truenewton.report.page.page import write_report
    from truenewton.report.verdict import headline_of

    if output.suffix.lower() not in (".html", ".htm"):
        raise OutputFailed(
            "is no name for a page", remedy="let -o end in .html (a browser prints it)", path=output
        )
    refuse_existing(output, overwrite=overwrite)
    findings: Reported
    with busy("looking into it"), about(paths):
        pair = read_calibrations(*paths, segment=segment) if len(paths) == 2 else ()
        if pair:
            edges = options.edges_of(mirror, pair[0].layout)
            findings = change(*pair)
        else:
            data = read_chosen(*paths, segment=segment)
            edges = options.edges_of(mirror, data.layout)
            motion = options.motion_of(mirror, data)
            made = None if calibration is None else read_alpha(calibration, segment=segment)
            findings = investigate(
                data, method, calibration=made, population=population, motion=motion
            )
    words = ["truenewton", "report", *map(str, paths), "-o", str(output)]
    words += ["--method", method] if method else []
    words += ["--calibration", str(calibration)] if calibration else []
    words += ["--population"] if population else []
    words += [] if segment is None else ["--segment", str(segment)]
    words += ["--mirror", mirror] if mirror else []
    told = shlex.join(words)
    write_report(output, findings, command=told, edges=edges, overwrite=overwrite)
    lines = list(headline_of(findings).lines())
    values = {"verdict": lines[0], "lines": lines[1:], "written": str(output)}
    print_result(lines, output, values=values if json else None, schema="report", quiet=quiet)
