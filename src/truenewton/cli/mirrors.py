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
    from truenewton.mirrors.segmented import SegmentedMirror


def run(
    mirror: str = typer.Argument(
        "", help="A mirror to tell more of: its name, or a TOML file (docs/mirrors.md)."
    ),
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
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.known import KNOWN, MAX_RING_ACTUATORS, ring
    from truenewton.mirrors.segmented import SEGMENTED, SegmentedMirror

    if not mirror:
        if plot or output:
            raise typer.BadParameter("name a mirror to draw")
        every = [make() for make in KNOWN.values()]
        whole = [make() for make in SEGMENTED.values()]
        head = ("name", "actuators", "glass, mm", "thick, mm", "curvature, m", "weight, N")
        rows = [_row(one) for one in (*every, ring(MAX_RING_ACTUATORS))]
        title = "The known mirrors, and the last of the family ring4, ring5, ...:"
        rows_of_parts = [_row_of_part(one, *kind) for one in whole for kind in one.kinds]
        more = "`truenewton mirrors NAME` tells where the numbers come from."
        values = {
            "mirrors": [_numbers(one) for one in every],
            "segmented": [_numbers_of_whole(one) for one in whole],
        }
        print_result(
            [
                *table_lines(title, head, *rows),
                *table_lines("In segments, of which there are:", head, *rows_of_parts),
                more,
            ],
            values=values if json else None,
            schema="mirrors",
            quiet=quiet,
        )
        return
    known = whole_mirror_from(mirror)
    if isinstance(known, SegmentedMirror):
        numbers = _numbers_of_whole(known)
        lines = [
            f"  {known.name}: {known.layout.n} actuators",
            *(line for kind in known.kinds for line in _lines_of_part(known, *kind)),
        ]
    else:
        numbers = _numbers(known)
        lines = [f"  {line}" for line in _lines_of(known)]
    makers = KNOWN | SEGMENTED
    source = makers.get(mirror.lower(), ring if mirror.lower().startswith("ring") else None)
    if source:
        text = re.split(r"\n\w+\n---", inspect.getdoc(source) or "")[0]
        lines += ["", *(f"  {line}".rstrip() for line in text.split("\n")[2:])]
    drawn: list[Path] = []
    if plot:
        drawn.append(output or Path(f"{known.name.lower()}.png"))
        glass = known if isinstance(known, SegmentedMirror) else known.shell
        figure = plot_layout(known.layout, edges=glass.seen_edges())
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


def _row_of_part(whole: SegmentedMirror, part: Mirror, alike: list[int]) -> tuple[str, ...]:
    """Return what is said of segments that are alike, as of a mirror."""
    return (f"{whole.name}, {len(alike)} x", *_row(part)[1:])


def _lines_of_part(whole: SegmentedMirror, part: Mirror, alike: list[int]) -> list[str]:
    places = ", ".join(
        f"{k} at {round(at.x, 9):.4g}, {round(at.y, 9):.4g} m, turned {at.turned:g} deg"
        for k, at in ((k, whole.places[k - 1]) for k in alike)
    )
    return [f"  segments {places}:", *(f"    {line}" for line in _lines_of(part))]


def _lines_of(mirror: Mirror) -> list[str]:
    """Return what is known of a mirror in one piece, each with its unit."""
    from truenewton.rounding import counted

    quantities, sensor = {**mirror.shell.QUANTITIES, **mirror.QUANTITIES}, mirror.sensor
    units = {name: quantity.unit for name, quantity in quantities.items()}
    said = {"sensor": f"{sensor.inner_radius:g} to {sensor.outer_radius:g} m from its actuator"}
    if mirror.tool_radius is None:
        said["tool_radius"] = "not given"
    if mirror.shell.outline is not None:
        edge, *holes = mirror.shell.polygons()
        said["outline"] = f"{counted(edge, 'corner')}, {counted(holes, 'hole')}"
    return [
        f"{name:<22}{said.get(name, value)} {units.get(name, '') * (name not in said)}".rstrip()
        for name, value in _numbers(mirror).items()
    ]


def _numbers_of_whole(whole: SegmentedMirror) -> dict[str, object]:
    """Return what is known of a mirror in segments, in SI units and degrees."""
    segments = [
        {**dataclasses.asdict(place), **_numbers(segment)}
        for place, segment in zip(whole.places, whole.segments, strict=True)
    ]
    return {"name": whole.name, "actuators": whole.layout.n, "segments": segments}
