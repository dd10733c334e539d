"""`truenewton modes`: stiffness modes, and how many of them a power or a force allows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.segmented import SegmentedCalibration
    from truenewton.modal.modal_base import Budget


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
    from truenewton.cli.terminal import about, busy, print_result
    from truenewton.files.outputs import refuse_existing
    from truenewton.modal.file import modes_paths, numbered
    from truenewton.modal.findings import find_modes
    from truenewton.modal.modal_base import Budget
    from truenewton.modal.segments import modes_of_segments
    from truenewton.modal.summary import lines, segment_lines, segment_values, values
    from truenewton.modal.turbulence import Atmosphere
    from truenewton.reading import of_segment, read_data
    from truenewton.records.segmented import SegmentedData

    _refuse_name(output)
    atmosphere, limits = Atmosphere(seeing, outer_scale), Budget(power, total_power, force)
    refuse_existing(*(modes_paths(output) if output else ()), figures, overwrite=overwrite)
    data = read_data(*paths)
    several = data.numbers if isinstance(data, SegmentedData) and segment is None else ()
    for path in (numbered(output, number) for number in several if output):
        refuse_existing(*modes_paths(path), overwrite=overwrite)
    asked: dict[str, Any] = {
        "diameter": diameter, "radius": radius, "efficiency": efficiency, "force": anyway,
        "off": options.ids(off, "--off") if off else (),
        "slaved": options.ids(slaved, "--slaved") if slaved else (),
    }  # fmt: skip
    with busy("finding modes"), about(paths):
        body = data if several else of_segment(data, segment, paths[0])
        asked["motion"] = options.motion_of(mirror, body)
        if isinstance(body, SegmentedData):
            alphas = _usable_segments(calibration, anyway)
            found: Mapping[int, Any] = modes_of_segments(body, alphas, atmosphere, **asked)
            told, schema = [*segment_lines(found, limits)], "modes-segments"
            as_values = segment_values(found, limits) if json else None
        else:
            one = find_modes(body, _usable(calibration, segment, anyway), atmosphere, **asked)
            found, told, schema = {0: one}, lines(one, limits), "modes"
            as_values = values(one, limits) if json else None
        written = _written(found, output, figures, limits, overwrite=overwrite)
    nothing = () if output or figures else (None,)
    print_result(told, *written, *nothing, values=as_values, schema=schema, quiet=quiet)


def _refuse_name(output: Path | None) -> None:
    from truenewton.errors import OutputFailed
    from truenewton.records.file import SUFFIXES

    if output is not None and not output.name.endswith(SUFFIXES):
        raise OutputFailed("is no name for a modal base", remedy="let -o end in .fits", path=output)


def _usable(path: Path | None, segment: int | None, force: bool) -> Calibration | None:
    """Return the calibration of a file, None without; by its name refused where it is unusable."""
    from truenewton.calibration.verdict import refuse_unusable
    from truenewton.reading import read_calibration

    if path is None:
        return None
    alpha = read_calibration(path, segment=segment)
    refuse_unusable(alpha, force=force, path=path)
    return alpha


def _usable_segments(path: Path | None, force: bool) -> SegmentedCalibration | None:
    """Return the same of all segments; each without alpha to be used says of which file."""
    from truenewton.calibration.verdict import REGARDLESS, refuse_unusable
    from truenewton.errors import Fault
    from truenewton.reading import read_segmented

    if path is None:
        return None
    given = read_segmented(path)
    refuse_unusable(given, force=force, path=path)
    usable = given if force else given.without_unusable()
    lacking = {}
    for number, ((fault, remedy), *_) in usable.refused.items():
        anyway = f"; {REGARDLESS}" if number in given.segments else ""
        lacking[number] = (Fault(f"{path} gives no alpha: {fault}", remedy + anyway),)
    return replace(usable, refused=lacking)


def _written(
    found: Mapping[int, Any],
    output: Path | None,
    figures: Path | None,
    limits: Budget,
    *,
    overwrite: bool,
) -> list[Path]:
    """Write modes by their segment, 0 of a mirror in one piece, and figures; return the paths."""
    from truenewton.figures.writing import write_drawn
    from truenewton.files.outputs import together
    from truenewton.modal.figures import modes_figures
    from truenewton.modal.file import numbered, write_modes
    from truenewton.modal.findings import ModalFindings

    drawn: dict[str, Any] = {}
    written: list[Path] = []
    with together():
        for number, each in found.items():
            if not isinstance(each, ModalFindings):
                continue
            if output is not None:
                target = numbered(output, number) if number else output
                written += write_modes(each, target, limits, overwrite=overwrite)
            of_it = f"segment-{number}-" if number else ""
            drawn |= {f"{of_it}{name}": draw for name, draw in modes_figures(each, limits).items()}
        if figures is not None:
            written += write_drawn(drawn, figures, overwrite=overwrite)
    return written
