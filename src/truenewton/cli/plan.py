"""`truenewton plan`: what a campaign will give, before anyone touches glass."""

from __future__ import annotations

from pathlib import Path

import typer

from truenewton.cli import options


def run(
    path: Path | None = typer.Argument(None, metavar="FILE", help="The plan (TOML)."),
    new: bool = typer.Option(False, "--new", help="Print a commented plan to start from."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="With --new: the file to write instead."
    ),
    target: float | None = typer.Option(
        None, help="Wanted typical error of alpha, relative: 0.005 for half a per cent."
    ),
    plot: Path | None = typer.Option(
        None, "--plot", help="Draw error against cycles and added weight (PNG, PDF or SVG)."
    ),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Predict errors, time, forces and gap of a campaign, and what to change for a wanted error."""
    if new == (path is not None):
        raise typer.BadParameter("give a plan, or --new for one to start from")
    if target is not None and not 0 < target < 1:
        raise typer.BadParameter("--target is relative, such as 0.005 for 0.5 %")
    if path is None:
        if target is not None or plot or json:
            raise typer.BadParameter("--new takes none of --target, --plot, --json")
        _new(output, overwrite)
        return
    if output is not None:
        raise typer.BadParameter("-o goes with --new; --plot FILE writes the figure")
    from truenewton.cli.terminal import busy, print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.planning.plan_prediction import predict_plan, suggest_changes
    from truenewton.planning.summary import change_lines, lines, values

    refuse_existing(plot, overwrite=overwrite)
    with busy("planning"):
        outcome = predict_plan(path)
        missed = target is not None and outcome.prediction.typical > target
        changes = suggest_changes(outcome.ready, target) if target is not None and missed else ()
    if plot is not None:
        from truenewton.figures.writing import write_figure  # matplotlib takes half a second
        from truenewton.planning.figures import plot_plan

        write_figure(plot_plan(outcome, target), plot, overwrite=overwrite)
    said = (*lines(outcome), *change_lines(target, changes))
    drawn = () if plot is None else (plot,)
    as_values = values(outcome, target, changes) if json else None
    print_result(said, *drawn, values=as_values, schema="plan", quiet=quiet)


def _new(output: Path | None, overwrite: bool) -> None:
    from truenewton.acquisition.plan import template
    from truenewton.cli.terminal import say
    from truenewton.files.outputs import file_beside

    if output is None:
        say(*template().splitlines())
        return
    with file_beside(output, overwrite=overwrite) as temporary:
        temporary.write_text(template(), encoding="utf-8")
    say(f"written: {output}")
