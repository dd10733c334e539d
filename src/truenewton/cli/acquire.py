"""`truenewton acquire`: run a plan on a bench; again, to go on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truenewton.acquisition.plan import CampaignPlan
    from truenewton.acquisition.progress import Progress
    from truenewton.statics.load import Load


def run(
    plan: Path = typer.Argument(..., metavar="PLAN", help="The plan of the campaign (TOML)."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the cycle files."),
    yes: bool = typer.Option(
        False, "--yes", help="Take every load for put on, and ask nobody; the forces are checked."
    ),
) -> None:
    """Run a plan on a bench into OUTPUT; the same command resumes what was stopped."""
    from truenewton.acquisition.benches import seal_truth
    from truenewton.acquisition.folder import is_complete, plan_text, refuse_other_plan
    from truenewton.acquisition.plan import read_plan
    from truenewton.bench.simulated.truth import truth_path
    from truenewton.files.outputs import refuse_existing

    wanted, beside = read_plan(plan), plan.parent
    simulated, complete = wanted.bench.kind == "simulated", is_complete(output, wanted)
    if simulated and not output.exists():
        refuse_existing(truth_path(output))
    if complete:
        refuse_other_plan(output, plan_text(wanted, beside))
    else:
        _acquire(wanted, beside, output, yes)
    if simulated:
        seal_truth(wanted, beside, output)
    already = " already" if complete else ""
    loads, cycles = len(wanted.loads), wanted.cycles
    print(f"{output}: complete{already}, {loads} loads x {cycles} cycles")


def _acquire(plan: CampaignPlan, beside: Path, output: Path, yes: bool) -> None:
    """Build the bench and run the plan on it."""
    from truenewton.acquisition.acquire import acquire
    from truenewton.acquisition.benches import chosen_bench
    from truenewton.bench.protocol import Operator

    bench, terminal = chosen_bench(plan, beside), Terminal(yes)
    try:
        operator = None if isinstance(bench, Operator) else terminal
        acquire(bench, plan, output, beside=beside, operator=operator, onlooker=terminal)
    finally:
        terminal.bar.stop()
        if hasattr(bench, "close"):
            bench.close()


class Terminal:
    """The person at the terminal: looks on, and puts the loads on.

    Parameters
    ----------
    yes
        Whether every load is taken for put on.
    """

    def __init__(self, yes: bool) -> None:
        from truenewton.cli.terminal import ProgressBar

        self.bar, self._yes = ProgressBar(), yes

    def put_on(self, load: Load) -> None:
        """Ask for a load, and wait until Enter says that it is on.

        Raises
        ------
        BenchFault
            There is nobody to ask.
        """
        from truenewton.errors import BenchFault

        self.bar.stop()
        if load.added:
            what = f"put '{load.name}' on the mirror ({-load.added:g} N)"
        else:
            what = f"take every weight off the mirror ('{load.name}')"
        if load.tilt:
            what += f", tilted by {load.tilt:g} deg"
        if self._yes:
            print(f"{what}: taken for done", flush=True)
        elif sys.stdin is None or not sys.stdin.isatty():
            raise BenchFault(
                f"somebody must {what}", remedy="run it at a terminal, or give --yes where it is on"
            )
        else:
            input(f"{what[0].upper()}{what[1:]}, then press Enter: ")

    def say(self, line: str) -> None:
        """Print a line."""
        self.bar.say(line)

    def progress(self, now: Progress) -> None:
        """Draw the bar."""
        shape = now.shape
        sign = "+" if shape.sign > 0 else "-"
        self.bar.show(
            now.done,
            now.total,
            f"{shape.load.name} cycle {shape.cycle}/{now.cycles}"
            f" shape {shape.number}/{now.shapes} {sign}",
            f"{now.largest_force:.3f} N, gap {1e6 * now.smallest_gap:.1f} um"
            + (f", {now.invalid} not valid" if now.invalid else ""),
            now.seconds_left,
        )
