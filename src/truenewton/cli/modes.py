"""`truenewton modes`: stiffness modes, and how many of them a power or a force allows."""

from __future__ import annotations

import math
from pathlib import Path

import typer

from truenewton.cli import options


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="PATH...", help="Cycle files with POSITION or their folder, a stiffness file."
    ),
    calibration: Path | None = typer.Option(
        None, help="Calibration file; the data themselves are calibrated where there is none."
    ),
    seeing: float = typer.Option(0.8, help="At 500 nm [arcsec]."),
    outer_scale: float = typer.Option(40.0, help="Of the turbulence [m]; inf for Kolmogorov's."),
    diameter: float | None = typer.Option(
        None, help="Of the telescope's pupil [m]; magnified as at LBT where not given."
    ),
    radius: float | None = typer.Option(
        None, help="Of the mirror that fills it [m]; half a spacing beyond the last actuator."
    ),
    power: float = typer.Option(math.inf, help="Most that a coil may dissipate [W]."),
    total_power: float = typer.Option(math.inf, help="Most that all coils may dissipate [W]."),
    force: float = typer.Option(
        math.inf, help="Most true force: static and three sigma of turbulence [N]."
    ),
    efficiency: float = typer.Option(
        0.51, help="Commanded force per root of power [N/W^1/2]; LBT's."
    ),
    off: str = typer.Option("", help="IDs of actuators that will be off, as 17,18: they float."),
    slaved: str = typer.Option("", help="IDs not commanded: they follow with least force."),
    mirror: str | None = options.GLASS,
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Modal base to write; matrices are written beside it."
    ),
    figures: Path | None = typer.Option(None, "--figures", help="Folder for the figures."),
    segment: int | None = options.SEGMENT,
    anyway: bool = options.ANYWAY,
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Find stiffness modes, and how many can be corrected within a power or a force."""
    from truenewton.calibration.verdict import usable
    from truenewton.cli.terminal import about, busy, print_result, schema_of
    from truenewton.figures.writing import write_drawn
    from truenewton.files.outputs import atomic_outputs, refuse_existing
    from truenewton.modal.figures import modes_figures
    from truenewton.modal.file import modes_paths, write_modes
    from truenewton.modal.findings import find_modes
    from truenewton.modal.modal_base import Budget
    from truenewton.modal.summary import lines, values
    from truenewton.modal.turbulence import Atmosphere
    from truenewton.reading import read_alpha, read_data

    _refuse_name(output)
    atmosphere, limits = Atmosphere(seeing, outer_scale), Budget(power, total_power, force)
    refuse_existing(*(modes_paths(output) if output else ()), figures, overwrite=overwrite)
    data = read_data(*paths, segment=segment)
    if output is not None:
        for number in data.layout.segments:
            refuse_existing(*modes_paths(output, number), overwrite=overwrite)
    floats = options.ids(off, "--off") if off else ()
    follows = options.ids(slaved, "--slaved") if slaved else ()
    written: list[Path] = []
    with busy("finding modes"), about(paths):
        motion = options.motion_of(mirror, data)
        alpha = None
        if calibration is not None:
            alpha = read_alpha(calibration, segment=segment)
            alpha = usable(alpha, force=anyway, path=calibration)
        found = find_modes(
            data, alpha, atmosphere, diameter=diameter, radius=radius, efficiency=efficiency,
            motion=motion, off=floats, slaved=follows, force=anyway,
        )  # fmt: skip
        told, as_values = lines(found, limits), values(found, limits) if json else None
        with atomic_outputs():
            if output is not None:
                written += write_modes(found, output, limits, overwrite=overwrite)
            if figures is not None:
                drawn = modes_figures(found, limits)
                written += write_drawn(drawn, figures, overwrite=overwrite)
    nothing = () if output or figures else (None,)
    schema = schema_of("modes", found)
    print_result(told, *written, *nothing, values=as_values, schema=schema, quiet=quiet)


def _refuse_name(output: Path | None) -> None:
    from truenewton.errors import OutputFailed
    from truenewton.records.file import SUFFIXES

    if output is not None and not output.name.endswith(SUFFIXES):
        raise OutputFailed("is no name for a modal base", remedy="let -o end in .fits", path=output)
