"""Calibrate: `info`, `calibrate`, `recalibrate` and `track`."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path

import typer

from truenewton.cli import options
from truenewton.cli.terminal import about, busy, print_result
from truenewton.errors import FormatError
from truenewton.files.outputs import refuse_existing


def run_info(
    paths: list[Path] = options.PATHS,
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.MIRROR_MODEL,
    segment: int | None = options.SEGMENT,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Print what files contain, and whether alpha can be calibrated from them."""
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.summary import detail_lines
    from truenewton.calibration.survey import survey
    from truenewton.files.fits import read_fits
    from truenewton.reading import read

    if len(paths) == 1 and paths[0].is_file():
        file = read_fits(paths[0])
        if {"TRACKING", "LAW"}.intersection(file.extensions):
            _print_law(paths[0], json=json, quiet=quiet, verbose=verbose)
            return
    with busy("reading and trying to calibrate"):
        data = read(*paths, segment=segment)
        motion = options.motion_of(mirror, data)
        values, lines = survey(data, method, population=population, motion=motion)
        details = detail_lines(data) if isinstance(data, Calibration) else ()
    print_result(
        lines, details=details, values=values, schema="info",
        json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip


def _print_law(path: Path, *, json: bool, quiet: bool, verbose: bool) -> None:
    """Print the law in a tracking file, as `track` does."""
    from truenewton.tracking.law import read_tracking
    from truenewton.tracking.summary import lines, table_of, values

    law = read_tracking(path)
    print_result(
        lines(law, None), details=table_of(law), values=values(law, None), schema="track",
        json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip


def run_calibrate(
    paths: list[Path] = options.paths("Cycle files or their folder, or a stiffness file."),
    output: Path | None = options.output(
        "File to write: .fits, the calibration; .ecsv or .csv, its table; .npy, alpha."
    ),
    method: str | None = options.METHOD,
    population: bool = options.POPULATION,
    mirror: str | None = options.MIRROR_MODEL,
    exclude: str | None = options.EXCLUDE,
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Calibrate alpha, true Newtons per commanded Newton, of every actuator."""
    from truenewton.calibration.file import lacking
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.summary import detail_lines, summary_lines, summary_values
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.files.fits import SUFFIXES
    from truenewton.reading import read_data
    from truenewton.records.result import format_of
    from truenewton.records.stiffness_matrix import StiffnessMatrix

    format_of(Calibration, output)
    out = options.ids(exclude, "--exclude")
    with busy("reading"):
        data = read_data(*paths, segment=segment)
    refuse_existing(output, overwrite=overwrite)
    with about(paths):
        with busy("calibrating", keeping=True) as waiting:
            motion = options.motion_of(mirror, data)
            work = partial(
                calibrate, data, method, population=population, motion=motion, exclude=out
            )
            found = waiting.end_of(work)
        refuse_unusable(found, accept_rejected=anyway)
    lines, then = [*summary_lines(found)], ""
    if output is not None:
        found.write(output, overwrite=overwrite)
        lines += filter(None, [lacking(found, output)])
        if output.name.lower().endswith(SUFFIXES):  # other formats have no report
            chosen = [] if segment is None else ["--segment", str(segment)]
            words = ["report", *map(str, paths), *chosen, "--calibration", str(output)]
            then = shlex.join(["truenewton", *words, "-o", "report.html"])
            if isinstance(data, StiffnessMatrix) and data.layout.has_channels:
                export = f"truenewton export FOLDER --calibration {shlex.quote(str(output))}"
                lines.append(f"  afterwards, with the supervisor's folder: {export} -o NEW-FOLDER")
    print_result(
        lines, output, details=detail_lines(found, data), values=summary_values(found),
        schema="calibrate", json=json, quiet=quiet, verbose=verbose, then=then,
    )  # fmt: skip


def run_recalibrate(
    paths: list[Path] = options.paths("Cycle files of the run after the change, or their folder."),
    known: Path = typer.Option(..., "--known", help="Earlier calibration, or a tracking file."),
    actuators: str = typer.Option(
        ...,
        "--actuators",
        help="IDs of the replaced actuators, such as 17,18; or auto, to find what changed.",
    ),
    output: Path | None = options.output("Calibration file to write."),
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Calibrate replaced actuators with a short run; all others keep their calibration."""
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.summary import detail_lines
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.reading import read
    from truenewton.recalibration.fit import recalibrate
    from truenewton.recalibration.summary import lines, values
    from truenewton.records.result import format_of

    auto = actuators.strip().casefold() == "auto"
    ids = [] if auto else options.ids(actuators, "--actuators")
    format_of(Calibration, output)
    with busy("recalibrating"), about(paths):
        data = read(*paths, segment=segment)
        refuse_existing(output, overwrite=overwrite)
        new = data.layout.ids_of(ids)
        made = recalibrate(data, known, new, accept_rejected=anyway)
        refuse_unusable(made.calibration, accept_rejected=anyway)
    if output is not None:
        made.calibration.write(output, overwrite=overwrite)
    print_result(
        lines(made), output, details=detail_lines(made.calibration), values=values(made),
        schema="recalibrate", json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip


def run_compare(
    old: Path = typer.Argument(
        ..., metavar="OLD", help="Earlier stiffness file, folder of a campaign, or calibration."
    ),
    new: Path = typer.Argument(
        ..., metavar="NEW", help="Later data of the same kind and the same mirror."
    ),
    repeat: Path | None = typer.Option(
        None,
        "--repeat",
        help="Second measurement on the day of OLD or NEW, used to estimate the errors.",
    ),
    output: Path | None = options.output(
        "File to write: .fits, the comparison; .ecsv or .csv, its table."
    ),
    figure: Path | None = typer.Option(
        None, "--figure", help="Map of the change of alpha to write (.pdf, .png, .svg)."
    ),
    segment: int | None = options.SEGMENT,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find what changed between two stiffness matrices, campaigns or calibrations of one mirror."""
    from truenewton.comparison.compare import compare
    from truenewton.comparison.result import Comparison
    from truenewton.comparison.summary import lines, values
    from truenewton.figures.writing import write_figure
    from truenewton.reading import read
    from truenewton.records.result import format_of

    format_of(Comparison, output)
    with busy("comparing"):
        one, other, *third = (read(path, segment=segment) for path in (old, new, repeat) if path)
        refuse_existing(output, figure, overwrite=overwrite)
        compared = compare(one, other, repeat=third[0] if third else None)
    if output is not None:
        compared.write(output, overwrite=overwrite)
    if figure is not None:
        write_figure(compared.plot(), figure, overwrite=overwrite)
    written = (output, figure) if figure else (output,)
    print_result(
        lines(compared), *written, values=values(compared), schema="compare",
        json=json, quiet=quiet,
    )  # fmt: skip


def run_track(
    paths: list[Path] = options.paths(
        "Calibration files, or folders of campaigns.", "CALIBRATION..."
    ),
    output: Path | None = options.output("Tracking file to write."),
    figures: Path | None = typer.Option(None, "--figures", help="Folder for the figures."),
    accuracy: float | None = typer.Option(
        None,
        help="Target relative error of alpha, such as 0.005. The output then states how long alpha"
        " meets this target.",
    ),
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Find how alpha varies with temperature and time, from calibrations of different days."""
    from truenewton.figures.writing import write_drawn
    from truenewton.tracking.figures import tracking_figures
    from truenewton.tracking.fit import track
    from truenewton.tracking.summary import lines, table_of, values

    if accuracy is not None and not 1e-9 <= accuracy <= 1:
        raise FormatError(
            f"--accuracy is {accuracy:g}", remedy="give a relative error, such as 0.005"
        )
    with busy("tracking"):
        law = track(*paths, accept_rejected=anyway, segment=segment)
        refuse_existing(output, figures, overwrite=overwrite)
        shown, numbers = lines(law, accuracy), values(law, accuracy)
    drawn: list[Path] = []
    if output is not None:
        law.write(output, overwrite=overwrite)
    if figures is not None:
        drawn = write_drawn(tracking_figures(law), figures, overwrite=overwrite)
    written = drawn if quiet or not figures else [figures]
    print_result(
        shown, output, *written, details=table_of(law), values=numbers,
        schema="track", json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip
