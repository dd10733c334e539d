"""Take data: `plan`, `acquire` and `import`."""

from __future__ import annotations

import contextlib
import datetime
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from truenewton.cli import options
from truenewton.cli.terminal import Bar, busy, print_result, say
from truenewton.errors import BenchFault, OutputExists
from truenewton.files.outputs import file_beside, refuse_existing
from truenewton.rounding import listed

if TYPE_CHECKING:
    from truenewton.acquisition.taker import Progress
    from truenewton.importers.importing import Imported
    from truenewton.statics.load import Load

MAX_FILES_NAMED = 5  # in one line
MAX_SIZE_RATIO = 1.1  # of a known mirror that is suggested to the actuators of a matrix


def run_plan(
    path: Path | None = typer.Argument(None, metavar="FILE", help="The plan (TOML)."),
    new: bool = typer.Option(False, "--new", help="Print a plan with comments, as a template."),
    output: Path | None = options.output("With --new: write the plan to this file instead."),
    target: float | None = typer.Option(
        None, help="Target for the typical relative error of alpha (0.005 = 0.5 %)."
    ),
    plot: Path | None = typer.Option(
        None, "--plot", help="Draw error against cycles and added weight (PNG, PDF or SVG)."
    ),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    verbose: bool = options.VERBOSE,
    quiet: bool = options.QUIET,
) -> None:
    """Predict errors, time, forces and gap of a campaign, and how to reach a target error."""
    from truenewton.acquisition.plan import template

    if new == (path is not None):
        raise typer.BadParameter("give either a plan, or --new to print a template")
    if target is not None and not 0 < target < 1:
        raise typer.BadParameter("--target is relative, such as 0.005 for 0.5 %")
    if path is None:
        if target is not None or plot or json:
            raise typer.BadParameter("--new cannot be combined with --target, --plot or --json")
        if output is None:
            say(*template().splitlines())
            return
        with file_beside(output, overwrite=overwrite) as temporary:
            temporary.write_text(template(), encoding="utf-8")
        say(f"written: {output}")
        return
    if output is not None:
        raise typer.BadParameter("-o requires --new; for a figure, use --plot FILE")
    from truenewton.planning.plan_prediction import predict_plan, suggest_changes
    from truenewton.planning.summary import change_lines, detail_lines, lines, values

    refuse_existing(plot, overwrite=overwrite)
    with busy("planning"):
        outcome = predict_plan(path)
        missed = target is not None and outcome.prediction.typical > target
        changes = suggest_changes(outcome.ready, target) if target is not None and missed else ()
    if plot is not None:
        from truenewton.figures.writing import write_figure  # matplotlib takes half a second
        from truenewton.planning.figures import plot_plan

        write_figure(plot_plan(outcome, target), plot, overwrite=overwrite)
    shown = (*lines(outcome), *change_lines(target, changes))
    drawn = () if plot is None else (plot,)
    print_result(
        shown, *drawn, details=detail_lines(outcome), values=values(outcome, target, changes),
        schema="plan", json=json, quiet=quiet, verbose=verbose,
    )  # fmt: skip


def run_acquire(
    plan: Path = typer.Argument(..., metavar="PLAN", help="The plan of the campaign (TOML)."),
    output: Path = options.output("Folder for the cycle files.", ...),
    segment: int | None = options.ONE_SEGMENT,
    yes: bool = typer.Option(
        False,
        "--yes",
        help="Do not prompt: assume that each load is in place (forces are still checked).",
    ),
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Run a plan on a bench and write OUTPUT; the same command takes missing cycles."""
    from truenewton.acquisition.acquire import acquire, chosen_bench
    from truenewton.acquisition.folder import invalid_rows, is_complete, refuse_other_plan
    from truenewton.acquisition.plan import read_plan
    from truenewton.bench.protocol import Operator, faults_of
    from truenewton.bench.simulated.bench import SimulatedBench
    from truenewton.bench.simulated.truth import truth_path
    from truenewton.rounding import counted

    wanted, beside = read_plan(plan), plan.parent
    wanted = wanted if segment is None else replace(wanted, segment=segment)
    simulated, complete = wanted.bench.kind == "simulated", is_complete(output, wanted)
    if simulated and not output.exists() and truth_path(output).exists():
        raise OutputExists(
            "exists already, without its campaign",
            remedy="remove it, or choose another name",
            path=truth_path(output),
        )
    if complete:
        refuse_other_plan(output, wanted, beside)
    with busy("connecting"):
        bench = chosen_bench(wanted, beside) if simulated or not complete else None
    if bench is not None and not complete:
        terminal = Terminal(yes, apart=json or quiet)
        try:
            operator = None if isinstance(bench, Operator) else terminal
            acquire(bench, wanted, output, beside=beside, operator=operator, onlooker=terminal)
        finally:
            terminal.bar.stop()
            if hasattr(bench, "close"):
                with faults_of(f"{type(bench).__name__}.close"):
                    bench.close()
    if simulated and isinstance(bench, SimulatedBench):
        bench.write_truth(output, overwrite=True)
    with busy("checking the files"):
        rows = invalid_rows(output, wanted)
    invalid = {name: number for name, (number, _) in rows.items() if number}
    not_valid = ""
    if invalid:
        files = listed([f"{name} {number}" for name, number in invalid.items()], MAX_FILES_NAMED)
        not_valid = (
            f", but {sum(invalid.values())} of {sum(every for _, every in rows.values())} rows are"
            f" not valid ({files}); to repeat a cycle, remove its file and run the same command"
        )
        if quiet:
            say(f"{output}: complete{not_valid}", stream=sys.stderr)
    values = {
        "folder": str(output),
        "before": complete,
        "loads": [load.name for load in wanted.loads],
        "cycles": wanted.cycles,
        "invalid": invalid,
    }
    loads, cycles = counted(wanted.loads, "load"), counted(wanted.cycles, "cycle")
    line = f"{output}: complete{' already' if complete else ''}, {loads} x {cycles}{not_valid}"
    written = (output,) if quiet else ()
    then = shlex.join(["truenewton", "calibrate", str(output), "-o", "alpha.fits"])
    print_result(
        [line], *written, values=values, schema="acquire", json=json, quiet=quiet, then=then
    )


class Terminal:
    """Shows the progress of a campaign, and asks the operator for each load.

    With ``yes`` it assumes that each load is in place. With ``apart``, lines go to standard error,
    because standard output is for a script.
    """

    def __init__(self, yes: bool, *, apart: bool = False) -> None:
        self._yes = yes
        self._stream = sys.stderr if apart else sys.stdout
        self.bar = Bar()

    def put_on(self, load: Load) -> None:
        """Ask for a load, and wait for Enter; BenchFault if standard input is no terminal."""
        self.bar.stop()
        if load.added:
            what = f"put '{load.name}' on the mirror ({-load.added:g} N)"
        else:
            what = f"take every weight off the mirror ('{load.name}')"
        if load.tilt:
            what += f", tilted by {load.tilt:g} deg"
        if self._yes:
            self.say(f"{what}: assumed to be done (--yes)")
        elif sys.stdin is None or not sys.stdin.isatty():
            raise BenchFault(
                f"an operator must {what}",
                remedy="run this command in a terminal, or add --yes if this was done",
            )
        else:
            question = f"{what[0].upper()}{what[1:]}, then press Enter: "
            say(question, stream=self._stream, end="")
            input()

    def progress(self, now: Progress) -> None:
        """Draw the bar: which shape was taken, and the extremes so far."""
        shape, sign = now.shape, "+" if now.shape.sign > 0 else "-"
        invalid = f", {now.invalid} not valid" if now.invalid else ""
        self.bar.show(
            f"{shape.load.name} cycle {shape.cycle}/{now.cycles}"
            f" shape {shape.number}/{now.shapes} {sign}, largest force {now.largest_force:.3f} N,"
            f" smallest gap {1e6 * now.smallest_gap:.1f} um{invalid}",
            now.done / now.total,
        )

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        self.bar.say(line, self._stream)


def run_import(
    matrix: Path | None = typer.Argument(
        None,
        metavar="MATRIX",
        help="FITS, .npy, CSV or text, Excel, HDF5, .mat, .sav; a folder; or the description of a"
        " campaign (TOML).",
    ),
    coordinates: Path | None = typer.Argument(
        None,
        metavar="POSITIONS",
        help="File of positions (same formats), or folder of a supervisor's configuration.",
    ),
    output: Path | None = options.output("Stiffness file (FITS), or folder of a campaign."),
    example: bool = typer.Option(
        False, "--example", help="Print the description of a campaign, with comments."
    ),
    unit: str | None = typer.Option(
        None, help="Unit of the matrix, such as N/um; 'unknown' for counts of the electronics."
    ),
    lengths: str | None = typer.Option(None, help="Unit of the positions, such as mm."),
    curvature: float | None = typer.Option(
        None,
        help="Radius of curvature [m], negative if convex: forces are normal to the surface.",
    ),
    arc: bool = typer.Option(False, "--arc", help="Radii are measured along the surface."),
    mirror: str | None = typer.Option(
        None, help="Use the positions of this mirror (name or TOML file)."
    ),
    ids: str | None = typer.Option(None, help="IDs of the rows: 17,18 or 0-56, or a file of IDs."),
    dataset: str | None = typer.Option(None, help="Name of the matrix, if there are several."),
    shell: int | None = typer.Option(None, help="Number of the shell (from 1), if several."),
    transpose: bool = typer.Option(False, "--transpose", help="The matrix is stored transposed."),
    date: datetime.datetime | None = typer.Option(None, help="Date of the measurement (UTC)."),
    instrument: str | None = typer.Option(None, help="Name of the mirror."),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Convert files of other software to a stiffness file, or to the cycle files of a campaign."""
    if example:
        from truenewton.importers.campaign import example as description

        say(*description().splitlines())
        return
    if matrix is None:
        raise typer.BadParameter("give a matrix, the description of a campaign, or --example")
    of_matrix: dict[str, Any] = {
        "unit": unit, "lengths": lengths, "curvature": curvature, "arc": arc, "mirror": mirror,
        "ids": ids, "dataset": dataset, "shell": shell, "transpose": transpose,
        "date": date, "instrument": instrument,
    }  # fmt: skip
    if matrix.suffix.lower() == ".toml":
        names = ["POSITIONS"] if coordinates else []
        if names := names + [f"--{name}" for name, value in of_matrix.items() if value]:
            fault = f"only a matrix is imported with {listed(names, 9)}"
            raise typer.BadParameter(f"{fault}; give {matrix} alone: it describes the campaign")
        _import_campaign(matrix, output, overwrite=overwrite, json=json, quiet=quiet)
        return
    from truenewton.files.fits import SUFFIXES
    from truenewton.importers.importing import stiffness_from
    from truenewton.mirrors.file import mirror_from
    from truenewton.records.file import write_stiffness

    options.require_suffix(
        output, SUFFIXES, "stiffness file", "; a campaign is described by `import --example`"
    )
    refuse_existing(output, overwrite=overwrite)
    by_file = ids is not None and Path(ids).is_file()
    with busy("importing"), _suggesting_mirror():
        of_matrix |= {
            "mirror": None if mirror is None else mirror_from(mirror),
            "ids": ids if ids is None or by_file else _row_ids(ids),
        }
        made = stiffness_from(matrix, coordinates, **of_matrix)
        if output is not None:
            write_stiffness(made.matrix, output, overwrite=overwrite)
    _print_matrix(made, output, transpose=transpose, json=json, quiet=quiet)


def _row_ids(text: str) -> list[int | str]:
    """Return the IDs of a list, in which 0-56 stands for integers if numbers ascend."""
    words = options.ids(text, "--ids")
    ranges = [re.fullmatch(r"(\d+)(?:-(\d+))?", str(word)) for word in words]
    ends = [int(end) for each in ranges if each for end in each.groups() if end]
    if not all(ranges) or any(one >= other for one, other in pairwise(ends)):
        return words  # texts, such as 3-1
    return [i for each in ranges if each for i in range(int(each[1]), int(each[2] or each[1]) + 1)]


@contextlib.contextmanager
def _suggesting_mirror() -> Iterator[None]:
    """Add the known mirror that has about as many actuators to the error of missing positions."""
    from truenewton.importers.inputs import NoPositions
    from truenewton.mirrors.known import KNOWN

    try:
        yield
    except NoPositions as error:
        sizes = {make().layout.n: name for name, make in KNOWN.items()}
        need = error.actuators
        n = min((n for n in sizes if need <= n <= MAX_SIZE_RATIO * need), default=0)
        if not n:
            raise
        remedy = f"{error.remedy}; --mirror {sizes[n]} has {n} actuators"
        raise error.changed(remedy=remedy) from None


def _print_matrix(
    made: Imported, output: Path | None, *, transpose: bool, json: bool, quiet: bool
) -> None:
    """Print what was found of a matrix, and the next command: `calibrate` judges it."""
    lines, then = list(made.lines), ""
    if made.transposed:
        then = f"the same command {'without' if transpose else 'with'} --transpose"
    elif not made.balanced and output is not None:
        then = _calibrating(output)
        lines.append(f"  {'alpha':<13}not estimated: use `truenewton calibrate`")
        new = "NEW-FOLDER" if made.folder else "NEW.fits"
        alpha = shlex.join([str(_alpha_of(output)), "-o", new])
        source = shlex.quote(made.folder or str(output))
        lines.append(f"  {'afterwards':<13}truenewton export {source} --calibration {alpha}")
    values = {
        "instrument": made.matrix.instrument,
        "actuators": made.matrix.layout.n,
        "found": {line[:15].strip(): line[15:] for line in made.lines[1:]},
    }
    print_result(lines, output, values=values, schema="import", json=json, quiet=quiet, then=then)


def _import_campaign(
    path: Path, output: Path | None, *, overwrite: bool, json: bool, quiet: bool
) -> None:
    """Write the cycle files of the campaign that a TOML file describes."""
    from truenewton.files.fits import SUFFIXES
    from truenewton.importers.campaign import campaign_from
    from truenewton.records.file import write_campaign

    if output is not None and output.name.endswith(SUFFIXES):
        raise typer.BadParameter("-o must be a folder: a campaign has a file for each cycle")
    refuse_existing(output, overwrite=overwrite)
    with busy("importing"):
        campaign, lines = campaign_from(path)
        if output is not None:
            write_campaign(campaign, output, overwrite=overwrite)
    values = {"instrument": campaign.instrument, "actuators": campaign.layout.n}
    values |= {"found": {"cycles": lines[1:]}}
    then = "" if output is None else _calibrating(output)
    print_result(lines, output, values=values, schema="import", json=json, quiet=quiet, then=then)


def _calibrating(output: Path) -> str:
    """Return the command that calibrates an output, into a file of another name beside it."""
    return shlex.join(["truenewton", "calibrate", str(output), "-o", str(_alpha_of(output))])


def _alpha_of(output: Path) -> Path:
    """Return the name of the calibration of an output."""
    return output.with_name(f"{output.name.partition('.')[0]}-alpha.fits")
