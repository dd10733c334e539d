"""`truenewton demo`: simulate P45, calibrate it, compare with the truth, report and draw it."""

from __future__ import annotations

import shlex
from pathlib import Path

import typer

from truenewton.cli import options

OURS = ("p45", ".fits", ".html", "figures")  # what a folder of an older demo holds


def run(
    output: Path = typer.Option(
        Path("truenewton-demo"), "-o", "--output", help="Folder for everything made."
    ),
    seed: int = typer.Option(1, min=0, help="Decides everything random."),
    overwrite: bool = options.OVERWRITE,
    quiet: bool = options.QUIET,
) -> None:
    """Show the whole story on a simulated P45: campaign, calibration, truth, report, figures."""
    from truenewton.bench.simulated.static import run_cycles, static_bench
    from truenewton.bench.simulated.truth import truth_path, write_truth
    from truenewton.calibration.figures import write_figures
    from truenewton.calibration.methods import calibrate
    from truenewton.calibration.summary import summary_lines
    from truenewton.cli import terminal
    from truenewton.files.outputs import folder_beside
    from truenewton.mirrors.known import p45
    from truenewton.reading import read_campaign
    from truenewton.records.file import write_campaign
    from truenewton.report.findings import investigate
    from truenewton.report.page.page import write_report
    from truenewton.studies.scoring import score, truth_lines

    def say(*lines: object) -> None:
        if not quiet:
            terminal.say(*lines)

    with folder_beside(output, OURS, overwrite=overwrite) as work:
        bench, campaign = static_bench(p45(), seed), work / "p45"
        say("1. A campaign: P45 without and with the ring, 4 cycles of 90 shapes each (simulated)")
        write_campaign(run_cycles(bench, 4), campaign)
        write_truth(bench.truth, truth_path(campaign))
        say(f"   {output / 'p45'}", "")

        say("2. The calibration, by maximum likelihood")
        data = read_campaign(campaign)
        findings = investigate(data)  # reads the rows once for all that is told of them
        calibration = findings.calibration
        assert calibration is not None  # the campaign is sound
        calibration.write(work / "alpha.fits")
        say(*summary_lines(calibration))
        say(f"   {output / 'alpha.fits'}", "")

        say("3. The truth beside it, since this is a simulation")
        scores = [score(each, bench.truth) for each in (calibration, calibrate(data, "svd"))]
        told = truth_lines(calibration, bench.truth, bench.loads, *scores)
        say(*(f"   {line}" for line in told), "")

        say("4. The report and the figures of the paper")
        page = output / "report.html"
        command = shlex.join(["truenewton", "report", str(output / "p45"), "-o", str(page)])
        write_report(work / page.name, findings, command=command)
        say(f"   {page}: opens in any browser")
        written = write_figures(calibration, work / "figures")
        names = ", ".join(path.stem for path in written[::2])
        say(f"   {output / 'figures'}: {names} (PDF, PNG)")
    if quiet:
        terminal.say(f"written: {output}")
