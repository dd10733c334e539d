"""`truenewton mirrors`: the known mirrors and their sources."""

from __future__ import annotations

import dataclasses
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.mirrors.known import Mirror


def run(
    mirror: str = typer.Argument("", help="A mirror to tell more of: its name, or a TOML file."),
    plot: bool = typer.Option(
        False, "--plot", help="Draw its actuators and glass (figure 2) as PNG."
    ),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Name of the drawing; MIRROR.png unless told."
    ),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """List the known mirrors with the sources of their numbers, or draw one."""
    from truenewton.cli.terminal import print_result, table_lines
    from truenewton.figures.maps import plot_layout
    from truenewton.figures.writing import write_figure
    from truenewton.mirrors.file import mirror_from
    from truenewton.mirrors.known import KNOWN, MOST_ACTUATORS, ring

    if not mirror:
        if plot or output:
            raise typer.BadParameter("name a mirror to draw")
        every = [make() for make in KNOWN.values()]
        head = ("name", "actuators", "glass, mm", "thick, mm", "curvature, m", "weight, N")
        rows = [_row(one) for one in (*every, ring(MOST_ACTUATORS))]
        title = "The known mirrors, and the last of the family ring4, ring5, ...:"
        more = "`truenewton mirrors NAME` tells where the numbers come from."
        values = {"mirrors": [_numbers(one) for one in every]}
        print_result(
            [*table_lines(title, head, *rows), more],
            values=values if json else None,
            schema="mirrors",
            quiet=quiet,
        )
        return
    known = mirror_from(mirror)
    numbers = _numbers(known)
    lines = [f"  {name:<22}{value}" for name, value in numbers.items()]
    source = KNOWN.get(mirror.lower(), ring if mirror.lower().startswith("ring") else None)
    if source:
        text = re.split(r"\n\w+\n---", inspect.getdoc(source) or "")[0]
        lines += ["", *(f"  {line}".rstrip() for line in text.split("\n")[2:])]
    drawn: list[Path] = []
    if plot:
        drawn.append(output or Path(f"{known.name.lower()}.png"))
        figure = plot_layout(known.layout, edges=known.shell.seen_edges())
        write_figure(figure, drawn[0], overwrite=overwrite)
    print_result(lines, *drawn, values=numbers if json else None, schema="mirror", quiet=quiet)


def _row(mirror: Mirror) -> tuple[str, ...]:
    shell = mirror.shell
    return (
        mirror.name,
        str(mirror.layout.n),
        f"{1e3 * shell.inner_radius:.4g} .. {1e3 * shell.outer_radius:.6g}",
        f"{1e3 * shell.thickness:.2g}",
        f"{shell.radius_of_curvature:.4g}",
        f"{mirror.weight:.4g}",
    )


def _numbers(mirror: Mirror) -> dict[str, object]:
    """Return all that is known of a mirror but its layout, in SI units."""
    numbers = dataclasses.asdict(mirror)
    shell = numbers.pop("shell")
    if shell["outline"] is None:
        del shell["outline"]
    del numbers["layout"]
    return {"name": numbers.pop("name"), "actuators": mirror.layout.n, **shell, **numbers}
