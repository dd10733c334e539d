"""Options and arguments that several commands share."""

from __future__ import annotations

import typer

METHOD = typer.Option(
    "ml", help="ml, maximum likelihood; svd, the paper's; reciprocity; auto, reciprocity or ml."
)
POPULATION = typer.Option(
    False, "--population", help="Take alpha for samples of one normal population (ml)."
)
GLASS = typer.Option(
    None, "--mirror", help="Its glass, known or a TOML file: what its sensors see (reciprocity)."
)
ANYWAY = typer.Option(
    False, "--anyway", help="Go on though the verdict on alpha is 'not to be used'."
)
FORCE = typer.Option(  # which is a number to `modes`
    False, "--force", "--anyway", help="Go on though the verdict on alpha is 'not to be used'."
)
JSON = typer.Option(False, "--json", help="Print figures as JSON, for scripts.")
OVERWRITE = typer.Option(False, "--overwrite", help="Replace an output that exists.")
PATHS = typer.Argument(
    ..., metavar="PATH...", help="Cycle files or their folder, a stiffness file, or a calibration."
)


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
