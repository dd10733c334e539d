"""`truenewton import`: a stiffness file or a campaign from files of other software."""

from __future__ import annotations

import contextlib
import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.calibration.result import Calibration
    from truenewton.importers.importing import Imported

MAX_SIZE_RATIO = 1.1  # of a known mirror that is suggested to the actuators of a matrix


def run(
    matrix: Path | None = typer.Argument(
        None,
        metavar="MATRIX",
        help="FITS, .npy, CSV or text, Excel, HDF5, .mat, .sav; a folder; or the description of a"
        " campaign (TOML).",
    ),
    coordinates: Path | None = typer.Argument(
        None, metavar="POSITIONS", help="Likewise; or a folder of a supervisor's configuration."
    ),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Stiffness file (FITS), or folder of a campaign, to write."
    ),
    example: bool = typer.Option(
        False, "--example", help="Print the description of a campaign, with comments."
    ),
    unit: str | None = typer.Option(None, help="Of the matrix, as N/um; 'unknown' for steps."),
    lengths: str | None = typer.Option(None, help="Unit of positions, as mm."),
    curvature: float | None = typer.Option(
        None, help="Radius of curvature [m]: actuators push along the normals."
    ),
    arc: bool = typer.Option(False, "--arc", help="Radii are measured along the surface."),
    mirror: str | None = typer.Option(
        None, help="Where its actuators stand: a known mirror or a TOML file."
    ),
    ids: str | None = typer.Option(None, help="Names of the rows, as 17,18,... or a file of them."),
    exclude: str | None = options.EXCLUDE,
    dataset: str | None = typer.Option(None, help="Name of the matrix in a file of several."),
    shell: int | None = typer.Option(None, help="Which of several shells, from 1."),
    transpose: bool = typer.Option(False, "--transpose", help="The matrix is stored transposed."),
    date: datetime.datetime | None = typer.Option(None, help="When it was measured (UTC)."),
    instrument: str | None = typer.Option(None, help="Name of the mirror."),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Make a stiffness file, or the cycle files of a campaign, from files of other software."""
    from truenewton.cli.terminal import say

    if example:
        from truenewton.importers.campaign import example as description

        say(*description().splitlines())
        return
    if matrix is None:
        raise typer.BadParameter("give a matrix, the description of a campaign, or --example")
    if matrix.suffix.lower() == ".toml":
        _campaign(matrix, output, overwrite=overwrite, json=json, quiet=quiet)
        return
    from truenewton.cli.terminal import busy
    from truenewton.files.outputs import refuse_existing
    from truenewton.importers.importing import stiffness_from
    from truenewton.mirrors.file import mirror_from
    from truenewton.records.file import SUFFIXES, write_stiffness

    if output is not None and not output.name.endswith(SUFFIXES):
        raise typer.BadParameter("let -o end in .fits")
    refuse_existing(output, overwrite=overwrite)
    by_file = ids is not None and Path(ids).is_file()
    with busy("importing"), _suggesting_mirror():
        made = stiffness_from(
            matrix,
            coordinates,
            unit=unit,
            lengths=lengths,
            curvature=curvature,
            arc=arc,
            mirror=None if mirror is None else mirror_from(mirror),
            ids=ids if ids is None or by_file else options.ids(ids, "--ids"),
            exclude=options.ids(exclude, "--exclude") if exclude else (),
            dataset=dataset,
            shell=shell,
            transpose=transpose,
            date=date,
            instrument=instrument,
        )
        if output is not None:
            write_stiffness(made.matrix, output, overwrite=overwrite)
    _print_matrix(made, output, transpose=transpose, json=json, quiet=quiet)


@contextlib.contextmanager
def _suggesting_mirror() -> Iterator[None]:
    """Add the known mirror that has about as many actuators to the error of missing positions."""
    from truenewton.importers.inputs import NoPositions
    from truenewton.mirrors.known import KNOWN

    try:
        yield
    except NoPositions as error:
        sizes = {make().layout.n: name for name, make in KNOWN.items()}
        n = min((n for n in sizes if error.got <= n <= MAX_SIZE_RATIO * error.got), default=0)
        if not n:
            raise
        remedy = f"{error.remedy}; --mirror {sizes[n]} has {n} actuators"
        raise error.changed(remedy=remedy) from None


def _print_matrix(
    made: Imported, output: Path | None, *, transpose: bool, json: bool, quiet: bool
) -> None:
    """Print what was found of a matrix, a first answer unless quiet, and the next command."""
    from truenewton.calibration.summary import summary_values
    from truenewton.cli.terminal import print_result
    from truenewton.estimation.findings.code import Level

    if quiet and not json:
        print_result((), output, quiet=True)
        return
    said, calibration = _first_answer(made)
    lines = [*made.lines, *(f"  {what:<13}{how}" for what, how in said)]
    if made.transposed:
        how = "without" if transpose else "with"
        lines.append(f"  next         the same command {how} --transpose")
    elif not made.balanced and (calibration is None or calibration.verdict.level <= Level.REJECTED):
        lines.append("  next         mend what is said, then import again")
    elif not made.balanced and output is not None:
        lines.append(f"  next         truenewton calibrate {output} -o alpha.fits")
    values = {"instrument": made.matrix.instrument, "actuators": made.matrix.layout.n}
    found = {line[:15].strip(): line[15:] for line in made.lines[1:]}
    first = None if calibration is None else summary_values(calibration)
    as_values = {**values, "found": found, "calibration": first} if json else None
    print_result(lines, output, values=as_values, schema="import", quiet=quiet)


def _campaign(path: Path, output: Path | None, *, overwrite: bool, json: bool, quiet: bool) -> None:
    """Write the cycle files of the campaign that a TOML file describes."""
    from truenewton.cli.terminal import busy, print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.importers.campaign import campaign_from
    from truenewton.records.file import write_campaign

    refuse_existing(output, overwrite=overwrite)
    with busy("importing"):
        campaign, lines = campaign_from(path)
        if output is not None:
            write_campaign(campaign, output, overwrite=overwrite)
    next_line = () if output is None else (f"  next: truenewton calibrate {output} -o alpha.fits",)
    values = {"instrument": campaign.instrument, "actuators": campaign.layout.n}
    values |= {"found": {"cycles": lines[1:]}, "calibration": None}
    as_values = values if json else None
    print_result((*lines, *next_line), output, values=as_values, schema="import", quiet=quiet)


def _first_answer(made: Imported) -> tuple[list[tuple[str, str]], Calibration | None]:
    """Return in words what `ml` makes of the matrix, or why nothing; and what it made.

    Reciprocity, which `calibrate` tries too, takes several times as long.
    """
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.summary import summary_rows, warning_lines
    from truenewton.cli.terminal import busy
    from truenewton.errors import TrueNewtonError

    if made.transposed:
        return [("alpha", "none of a matrix that looks transposed")], None
    if made.balanced:
        return [("alpha", "none of a matrix that is balanced as commanded")], None
    try:
        with busy("calibrating"):
            found = calibrate(made.matrix, "ml")
    except TrueNewtonError as error:
        return [("alpha", f"none: {error.fault}; {error.remedy}".rstrip("; "))], None
    rows = summary_rows(found)
    lines = [
        (what, f"{value}, {note}")
        for what, (_, value, note) in zip(("alpha", "error", "scale"), rows, strict=False)
    ]
    lines.append(("method", "ml; calibrate tries reciprocity too, which takes longer"))
    lines.append(("verdict", str(found.verdict.level)))
    return [*lines, *(("", line.strip()) for line in warning_lines(found.verdict.faults))], found
