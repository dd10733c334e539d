"""Options and arguments that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truenewton.arrays import Array
    from truenewton.calibration.methods import Seen
    from truenewton.reading import Read
    from truenewton.statics.layout import Layout

METHOD = typer.Option(
    None,
    metavar="[ml|svd|reciprocity|auto]",
    autocompletion=lambda: ["ml", "svd", "reciprocity", "auto"],
    help="ml, maximum likelihood; svd, the paper's; reciprocity; auto, reciprocity where it holds,"
    " else ml. Unless given, auto of a matrix and with --mirror, else ml.",
)
POPULATION = typer.Option(
    False, "--population", help="Take alpha for samples of one normal population (ml)."
)
GLASS = typer.Option(
    None, "--mirror", help="Its glass, known or a TOML file: what its sensors see."
)
ANYWAY = typer.Option(False, "--anyway", help="Go on although the verdict on alpha is 'rejected'.")
FORCE = typer.Option(  # which is a number to `modes`
    False, "--force", "--anyway", help="Go on although the verdict on alpha is 'rejected'."
)
EXCLUDE = typer.Option(
    None, "--exclude", metavar="ID,...", help="Actuators whose alpha is not wanted, as 17,18."
)
SEGMENT = typer.Option(
    None, "--segment", help="Number of one segment, which is taken alone (mirrors in segments)."
)
JSON = typer.Option(False, "--json", help="Print figures as JSON, for scripts.")
QUIET = typer.Option(False, "-q", "--quiet", help="Print only what was written and what is wrong.")
FIDELITY = typer.Option(
    "static",
    metavar="[static|loop]",
    autocompletion=lambda: ["static", "loop"],
    help="static: shapes are held exactly; loop: in closed loop, sample by sample.",
)
OVERWRITE = typer.Option(False, "--overwrite", help="Replace an output that exists.")
CLUSTER = typer.Option(
    None, "--cluster", metavar="ADDRESS", help="Let the workers of a dask scheduler read the files."
)
PATHS = typer.Argument(
    ..., metavar="PATH...", help="Cycle files or their folder, a stiffness file, or a calibration."
)


def motion_of(mirror: str | None, data: Read) -> Seen | None:
    """Return (6, n, n) what sensors see of the glass of data, None without --mirror.

    Of several segments that of each by its number; None of a calibration, which is ready.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError, CampaignMismatch
    """
    if mirror is None:
        return None
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.segmented import SegmentedMirror
    from truenewton.mirrors.sensor_model import segment_sensor_models, sensor_model
    from truenewton.reading import holds_alpha

    if holds_alpha(data):
        return None
    known = whole_mirror_from(mirror)
    if isinstance(known, SegmentedMirror) and data.layout.segments:
        return segment_sensor_models(known, data.layout)
    return sensor_model(known, data.layout)


def edges_of(mirror: str | None, layout: Layout) -> Sequence[Array]:
    """Return the edges of the glass behind actuators, (vertices, 2) each [m]; of --mirror alone.

    Raises
    ------
    UnknownName, UnreadableFile, FormatError, GeometryError, CampaignMismatch
    """
    if mirror is None:
        return ()
    from truenewton.mirrors.file import whole_mirror_from
    from truenewton.mirrors.sensor_model import edges_for

    return edges_for(whole_mirror_from(mirror), layout)


def ids(text: str, option: str) -> list[int]:
    """Return the IDs of a list with commas.

    Raises
    ------
    FormatError
    """
    from truenewton.errors import FormatError

    try:
        return [int(word) for word in text.split(",")]
    except ValueError:
        raise FormatError(f"{option} is '{text}'", remedy="give IDs, as 17,18", got=text) from None
