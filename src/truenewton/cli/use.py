"""Show and use a calibration: `report`, `figures`, `modes` and `export`."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options
from truenewton.cli.terminal import about, busy, print_result
from truenewton.files.outputs import refuse_existing
from truenewton.rounding import row

if TYPE_CHECKING:
    from truenewton.modal.modal_base import Budget
    from truenewton.modal.turbulence import Atmosphere
    from truenewton.report.verdict import Reported


DIAMETER = typer.Option(
    None,
    help="Diameter of the telescope pupil, or of the part that the segment fills [m]; without it,"
    " no turbulence is modelled.",
)
RADIUS = typer.Option(
    None,
    help="Radius of the mirror area that fills the pupil [m]; by default half an actuator"
    " spacing beyond the last actuator.",
)
EFFICIENCY = typer.Option(
    None, help="Commanded force per root of power [N/W^1/2]; without it, no power is printed."
)
ALSO_WRITTEN = (
    "  also written, next to the modal basis: stiffness (true, commanded); for electronics, per"
    " sensor reading, in sign, unit and order of an imported file: modes (ff_v_matrix),"
    " feed-forward (ff_matrix, ff_matrix_true)"
)


def run_report(
    paths: list[Path] = options.paths(
        "Cycle files or their folder, a stiffness file, a calibration, or two to compare."
    ),
    output: Path = options.output("Page to write (HTML).", ...),
    method: str | None = options.METHOD,
    calibration: Path | None = typer.Option(
        None, help="Calibration of these data. If you give it, they are not fitted again."
    ),
    population: bool = options.POPULATION,
    mirror: str | None = options.MIRROR_MODEL,
    diameter: float | None = DIAMETER,
    efficiency: float | None = EFFICIENCY,
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Write one page: verdict, map, residuals and inputs, or the comparison of two states."""
    from truenewton.comparison.compare import compare
    from truenewton.reading import read, read_calibration, read_compared
    from truenewton.report.findings import investigate
    from truenewton.report.page.page import write_report
    from truenewton.report.verdict import headline_of

    options.require_suffix(output, (".html", ".htm"), "page")
    findings: Reported
    with busy("investigating"), about(paths):
        pair = read_compared(*paths, segment=segment)
        data = None if pair else read(*paths, segment=segment)
        refuse_existing(output, overwrite=overwrite)
        if data is None:
            edges = options.edges_of(mirror, pair[0].layout)
            findings = compare(*pair)
        else:
            edges = options.edges_of(mirror, data.layout)
            motion = options.motion_of(mirror, data)
            made = None if calibration is None else read_calibration(calibration)
            findings = investigate(
                data, method, calibration=made, population=population, motion=motion,
                diameter=diameter, efficiency=efficiency,
            )  # fmt: skip
    command = shlex.join(["truenewton", *sys.argv[1:]])
    with busy("writing the report"):
        write_report(output, findings, command=command, edges=edges, overwrite=overwrite)
    lines = list(headline_of(findings).lines())
    values = {"verdict": lines[0], "lines": lines[1:], "written": str(output)}
    print_result(lines, output, values=values, schema="report", json=json, quiet=quiet)


def run_figures(
    paths: list[Path] = options.PATHS,
    output: Path = options.output("Folder for the figures.", ...),
    numbers: bool = typer.Option(False, "--numbers", help="Write alpha into the map of fig. 6."),
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Draw the figures of the paper and of the report, as PDF and PNG."""
    from truenewton.calibration.figures import write_figures
    from truenewton.reading import read
    from truenewton.report.figures import still_figures
    from truenewton.report.findings import investigate, require_calibration

    with busy("drawing"), about(paths):
        data = read(*paths, segment=segment)
        refuse_existing(output, overwrite=overwrite)
        findings = investigate(data)
        made, more = require_calibration(findings), still_figures(findings)
        written = write_figures(made, output, more=more, numbers=numbers, overwrite=overwrite)
    values = {"verdict": str(made.verdict), "written": [str(path) for path in written]}
    lines = [row("verdict", str(made.verdict))]
    shown = written if quiet else (output,)
    print_result(lines, *shown, values=values, schema="figures", json=json, quiet=quiet)


def run_modes(
    paths: list[Path] = options.paths(
        "Cycle files with POSITION or their folder, or a stiffness file."
    ),
    calibration: Path | None = typer.Option(
        None, help="Calibration file; by default the data themselves are calibrated."
    ),
    seeing: float | None = typer.Option(None, help="Seeing at 500 nm [arcsec]; by default 0.8."),
    outer_scale: float | None = typer.Option(
        None, help="Outer scale [m]; by default 40. inf: Kolmogorov."
    ),
    diameter: float | None = DIAMETER,
    radius: float | None = RADIUS,
    power: float = typer.Option(math.inf, help="Largest power dissipated by one coil [W]."),
    total_power: float = typer.Option(math.inf, help="Largest power dissipated by all coils [W]."),
    force: float = typer.Option(
        math.inf, help="Largest true force [N]: static force plus three sigma of turbulence."
    ),
    efficiency: float | None = EFFICIENCY,
    off: str = typer.Option("", help="IDs of actuators that are switched off, such as 17,18."),
    slaved: str = typer.Option("", help="IDs of slaved actuators, which follow the others."),
    mirror: str | None = options.MIRROR_MODEL,
    output: Path | None = options.output("Modal basis to write. Matrices are written next to it."),
    figures: Path | None = typer.Option(None, "--figures", help="Folder for the figures."),
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Find stiffness modes, and how many can be corrected within limits of power or force."""
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.figures.writing import write_drawn
    from truenewton.files.fits import SUFFIXES
    from truenewton.modal.figures import modes_figures
    from truenewton.modal.file import modes_paths, write_modes
    from truenewton.modal.findings import find_modes
    from truenewton.modal.modal_base import Budget
    from truenewton.modal.summary import detail_lines, lines, values
    from truenewton.reading import read_calibration, read_data

    options.require_suffix(output, SUFFIXES, "modal basis")
    limits = Budget(power, total_power, force)
    atmosphere = _atmosphere(seeing, outer_scale, diameter, efficiency, limits)
    with busy("reading"):
        data = read_data(*paths, segment=segment)
    refuse_existing(*(modes_paths(output) if output else ()), figures, overwrite=overwrite)
    floating = data.layout.ids_of(options.ids(off, "--off"))
    follows = data.layout.ids_of(options.ids(slaved, "--slaved"))
    written: list[Path] = []
    with busy("finding modes"), about(paths):
        motion, alpha = options.motion_of(mirror, data), None
        if calibration is not None:
            alpha = read_calibration(calibration)
            refuse_unusable(alpha, accept_rejected=anyway, path=calibration)
        found = find_modes(
            data, alpha, atmosphere, diameter=diameter, radius=radius, accept_rejected=anyway,
            efficiency=efficiency, motion=motion, model=options.model_of(mirror, data),
            off=floating, slaved=follows,
        )  # fmt: skip
        if output is not None:
            within = limits if diameter else None
            written += write_modes(found, output, within, overwrite=overwrite)
        if figures is not None:
            written += write_drawn(modes_figures(found, limits), figures, overwrite=overwrite)
    shown = list(lines(found, limits))
    if output is not None and not quiet:
        shown.append(ALSO_WRITTEN)
    files: Iterable[Path | None] = written or (None,)
    if written and not quiet:
        files = filter(None, (output, figures))
    print_result(
        shown, *files, details=detail_lines(found), values=values(found, limits),
        schema="modes", json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip


def _atmosphere(
    seeing: float | None,
    outer_scale: float | None,
    diameter: float | None,
    efficiency: float | None,
    limits: Budget,
) -> Atmosphere | None:
    """Return the turbulence, None without a pupil; refuse limits that nothing was given for."""
    from truenewton.modal.modal_base import Budget
    from truenewton.modal.turbulence import Atmosphere

    if efficiency is None and min(limits.power, limits.total) < math.inf:
        raise typer.BadParameter("--power and --total-power need --efficiency (of the coils)")
    given = {"seeing": seeing, "outer_scale": outer_scale}
    known = {name: value for name, value in given.items() if value is not None}
    if diameter is None and (known or limits != Budget()):
        raise typer.BadParameter("turbulence and limits need --diameter (of the pupil)")
    return Atmosphere(**known) if diameter is not None else None


def run_export(
    source: Path = typer.Argument(
        ...,
        metavar="SOURCE",
        help="Stiffness file that `import` wrote, or the folder of a supervisor or of opticalib.",
    ),
    calibration: Path = typer.Option(..., help="Calibration file of the same actuators."),
    output: Path = options.output(
        "Matrix to write (.npy, .fits, .csv, .mat); of a folder also a folder.", ...
    ),
    anyway: bool = typer.Option(
        False, "--anyway", help="Continue even if the verdict is 'doubtful' or 'rejected'."
    ),
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Convert an imported matrix to true Newtons, as its file stored it."""
    from truenewton.importers.export import export_matrix
    from truenewton.reading import read_calibration

    refuse_existing(output, overwrite=overwrite)
    with busy("exporting"):
        one = read_calibration(calibration)
        lines = export_matrix(source, one, output, overwrite=overwrite, accept_rejected=anyway)
    print_result(lines, output, quiet=quiet)
