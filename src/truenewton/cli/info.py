"""`truenewton info`: what a file holds, and whether it is sound."""

from __future__ import annotations

from pathlib import Path

from truenewton.cli import options


def run(paths: list[Path] = options.PATHS, json: bool = options.JSON) -> None:
    """Say what files hold, and whether alpha can be had from them."""
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.survey import survey_campaign, survey_stiffness
    from truenewton.calibration.words import summary_lines, summary_values
    from truenewton.cli.terminal import print_json
    from truenewton.reading import read
    from truenewton.records.campaign import Campaign

    data = read(*paths)
    if isinstance(data, Calibration):
        if json:
            print_json({"holds": "calibration", **summary_values(data)})
        else:
            print(f"a calibration, method {data.method}, scale {data.scale}")
            print(*summary_lines(data), sep="\n")
        return
    values, lines = survey_campaign(data) if isinstance(data, Campaign) else survey_stiffness(data)
    if json:
        print_json(values)
        return
    print(*lines, sep="\n")
