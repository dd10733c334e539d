"""Options that several commands share, and what they mean."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from truenewton.errors import FormatError, GeometryError, OutputFailed

if TYPE_CHECKING:
    from truenewton.arrays import Array
    from truenewton.reading import Read
    from truenewton.statics.layout import Layout

METHOD = typer.Option(
    None,
    metavar="[ml|svd|reciprocity|auto]",
    autocompletion=lambda: ["ml", "svd", "reciprocity", "auto"],
    help="ml: maximum likelihood. svd: the method of the paper. reciprocity: symmetry of the"
    " stiffness. auto: reciprocity if it is valid, otherwise ml. Default: ml for cycles, auto for"
    " a matrix or with --mirror.",
)
POPULATION = typer.Option(
    False, "--population", help="Assume that all alpha are drawn from one normal population (ml)."
)
MIRROR_MODEL = typer.Option(
    None,
    "--mirror",
    help="Mirror model (name or TOML file), used to model what the sensors measure.",
)
ANYWAY = typer.Option(
    False, "--anyway", help="Continue even if the verdict on alpha is 'rejected'."
)
EXCLUDE = typer.Option(
    None,
    "--exclude",
    metavar="ID,...",
    help="Actuators to leave out of the calibration, such as 17,18.",
)
ONE_SEGMENT = typer.Option(
    None, "--segment", help="Number of the segment to use (segmented mirrors only)."
)
SEGMENT = typer.Option(
    None,
    "--segment",
    help="Number of the segment to read (segmented mirrors only). By default, each segment is"
    " processed in turn, and the names of its outputs contain its number.",
)
JSON = typer.Option(False, "--json", help="Print numbers as JSON, for scripts.")
VERBOSE = typer.Option(False, "-v", "--verbose", help="Print all numbers, and all actuators.")
QUIET = typer.Option(False, "-q", "--quiet", help="Print only the files written and errors.")
FIDELITY = typer.Option(
    "static",
    metavar="[static|loop]",
    autocompletion=lambda: ["static", "loop"],
    help="static: shapes are exact. loop: closed loop, sample by sample.",
)
SEED = typer.Option(1, min=0, help="Seed of all random numbers.")
NOISE = typer.Option(
    1e-4, min=0.0, max=1.0, help="Standard deviation of one force reading [N] (static)."
)
OVERWRITE = typer.Option(False, "--overwrite", help="Replace an output that exists.")


def output(text: str, default: Any = None) -> Any:
    """Return the option of an output file or folder."""
    return typer.Option(default, "-o", "--output", help=text)


def paths(text: str, metavar: str = "PATH...") -> Any:
    """Return the argument of one or more paths."""
    return typer.Argument(..., metavar=metavar, help=text)


PATHS = paths("Cycle files or their folder, a stiffness file, or a calibration.")


def ids(text: str | None, option: str) -> list[int | str]:
    """Return the IDs, or texts, of a list with commas; none if the option was not given."""
    words = [word.strip() for word in text.split(",")] if text else []
    if not all(words):
        raise FormatError(f"{option} is '{text}'", remedy="give IDs, such as 17,18")
    return [int(word) if word.isdecimal() else word for word in words]


def require_suffix(
    output: Path | None, suffixes: tuple[str, ...], what: str, otherwise: str = ""
) -> None:
    """Refuse the name of an output that has none of the suffixes."""
    if output is not None and not output.name.lower().endswith(suffixes):
        remedy = f"use a name that ends in {suffixes[0]}{otherwise}"
        raise OutputFailed(f"is no name for a {what}", remedy=remedy, path=output)


def motion_of(mirror: str | None, data: Read) -> Array | None:
    """Return (6, n, n) what the sensors measure of the mirror model.

    None without --mirror, or for a calibration, which needs none.
    """
    if mirror is None:
        return None
    from truenewton.calibration.result import Calibration
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.sensor_model import sensor_model

    if isinstance(data, Calibration):
        return None
    return sensor_model(whole_mirror_from(mirror), data.layout)


def model_of(mirror: str | None, data: Read) -> Array | None:
    """Return the (n, n) stiffness by the mirror model, or that of a known mirror's name [N/m].

    None if neither is known, if it is in segments, or if actuators are not on its glass.
    """
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.known import KNOWN, Mirror
    from truenewton.mirrors.shell.shell_model import model_shell
    from truenewton.records.stiffness_matrix import StiffnessMatrix

    recorded = data.mirror if isinstance(data, StiffnessMatrix) else None
    name = mirror or recorded or str(getattr(data, "instrument", ""))
    known = whole_mirror_from(name) if mirror or name.lower() in KNOWN else None
    if isinstance(known, Mirror):
        with contextlib.suppress(GeometryError):
            return model_shell(replace(known, layout=data.layout)).stiffness
    return None


def edges_of(mirror: str | None, layout: Layout) -> Sequence[Array]:
    """Return the edges of the glass, (vertices, 2) each [m]; none without --mirror."""
    if mirror is None:
        return ()
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.sensor_model import edges_for

    return edges_for(whole_mirror_from(mirror), layout)
