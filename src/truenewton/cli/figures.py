"""`truenewton figures`: the paper's figures 2, 5 and 6, and their kin."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = options.PATHS,
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the figures."),
    numbers: bool = typer.Option(False, "--numbers", help="Write alpha into the map of fig. 6."),
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Draw the paper's figures and those of the report that stand still, as PDF and PNG."""
    from truenewton.calibration.figures import write_figures
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.reading import read_chosen
    from truenewton.report.figures import still_figures
    from truenewton.report.findings import investigate, require_calibration

    refuse_existing(output, overwrite=overwrite)
    with busy("drawing"), about(paths):
        data = read_chosen(*paths, segment=segment)
        findings = investigate(data)
        made, more = require_calibration(findings), still_figures(findings)
        written = write_figures(made, output, more=more, numbers=numbers, overwrite=overwrite)
    verdict = str(made.verdict)
    values = {"verdict": verdict, "written": [str(path) for path in written]}
    print_result(
        [f"verdict: {verdict}"],
        *written,
        values=values if json else None,
        schema="figures",
        quiet=quiet,
    )
