"""`truenewton recalibrate`: a short run after a part was replaced."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from truenewton.cli import options

if TYPE_CHECKING:
    from truenewton.tracking import Recalibration

NAME = "recalibrate"


def run(
    paths: list[Path] = typer.Argument(
        ..., metavar="PATH...", help="Cycle files of the run after the change, or their folder."
    ),
    known: Path = typer.Option(..., "--known", help="Calibration from before, or a tracking file."),
    actuators: str = typer.Option(
        ..., "--actuators", help="IDs that were replaced, as 17,18; or auto: find who changed."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Calibration file to write."),
    overwrite: bool = options.OVERWRITE,
    json: bool = options.JSON,
) -> None:
    """Calibrate replaced actuators by a short run; all others keep their calibration."""
    from truenewton.campaign import Campaign
    from truenewton.cli.printing import print_json
    from truenewton.cli.summary import print_summary
    from truenewton.errors import FormatError
    from truenewton.outputs import refuse_existing
    from truenewton.reading import read_data
    from truenewton.tracking import recalibrate

    auto = actuators.strip().casefold() == "auto"
    ids = [] if auto else options.ids(actuators, "--actuators")
    if output is not None:
        refuse_existing(output, overwrite=overwrite)
    data = read_data(*paths)
    if not isinstance(data, Campaign):
        raise FormatError("holds no cycles", remedy="give the run after the change", path=paths[0])
    made = recalibrate(data, known, ids)
    if output is not None:
        made.calibration.write(output, overwrite=overwrite)
    if json:
        print_json(_values(made))
        return
    print_summary(made.calibration)
    for line in _lines(made):
        print(line)
    print(f"written: {output}" if output is not None else "not written; -o FILE keeps it")


def _lines(made: Recalibration) -> list[str]:
    from truenewton.cli.printing import by_chance
    from truenewton.rounding import with_error

    c = made.calibration
    anew = [(name, "replaced") for name in made.asked]
    anew += [
        (one.actuator, f"MOVED: {abs(one.sigmas):.1f} sigma, {by_chance(one.probability)}")
        for one in made.moved
    ]
    lines = [f"  {'given anew':<14}{'before':<12}{'now':<22}change"] if anew else []
    for name, words in anew:
        at = int((c.layout.id == name).argmax())
        before, now = float(made.earlier[at]), float(c.alpha[at])
        lines.append(
            f"  {name:<14}{before:<12.4g}{with_error(now, float(c.error[at])):<22}"
            f"{100 * (now / before - 1):+.2f} %, {words}"
        )
    if not anew:
        lines.append("  nobody changed")
    lines.append(
        f"  the others against their earlier calibration: chi2/DOF ="
        f" {made.chi2 / max(made.degrees_of_freedom, 1):.3g}, DOF {made.degrees_of_freedom},"
        f" probability {made.probability:.2g}; "
        + ("the rest agree" if made.moved else "none has moved (false alarm on 1 % of mirrors)")
    )
    return lines + [f"  WARNING: {limit}" for limit in made.limits]


def _values(made: Recalibration) -> dict[str, Any]:
    from dataclasses import asdict

    from truenewton.cli.summary import summary_values

    return {
        **summary_values(made.calibration),
        "asked": list(made.asked),
        "moved": [asdict(one) for one in made.moved],
        "earlier": made.earlier,
        "others": {
            "chi2": made.chi2,
            "degrees_of_freedom": made.degrees_of_freedom,
            "probability": made.probability,
        },
        "limits": list(made.limits),
    }
