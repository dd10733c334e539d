"""`truenewton acquire`: run a plan on a bench; again, to go on."""

from __future__ import annotations

import datetime
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from truenewton.cli import options
from truenewton.cli.terminal import print_result, say
from truenewton.errors import BenchFault, printable

if TYPE_CHECKING:
    from truenewton.acquisition.taker import Progress
    from truenewton.statics.load import Load

MOST_FILES = 5  # named in one line


def run(
    plan: Path = typer.Argument(..., metavar="PLAN", help="The plan of the campaign (TOML)."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for the cycle files."),
    segment: int | None = options.SEGMENT,
    yes: bool = typer.Option(
        False, "--yes", help="Take every load for put on, and ask nobody; the forces are checked."
    ),
    json: bool = options.JSON,
    quiet: bool = options.QUIET,
) -> None:
    """Run a plan on a bench into OUTPUT; the same command resumes what was stopped."""
    from truenewton.acquisition.acquire import acquire, chosen_bench, simulated_bench
    from truenewton.acquisition.folder import invalid_rows, is_complete, refuse_other_plan
    from truenewton.acquisition.plan import read_plan
    from truenewton.bench.protocol import Operator
    from truenewton.bench.simulated.truth import truth_path
    from truenewton.files.outputs import refuse_existing
    from truenewton.rounding import counted

    wanted, beside = read_plan(plan), plan.parent
    wanted = wanted if segment is None else replace(wanted, segment=segment)
    simulated, complete = wanted.bench.kind == "simulated", is_complete(output, wanted)
    if simulated and not output.exists():
        refuse_existing(truth_path(output))
    if complete:
        refuse_other_plan(output, wanted, beside)
    else:
        bench, terminal = chosen_bench(wanted, beside), Terminal(yes, apart=json or quiet)
        try:
            operator = None if isinstance(bench, Operator) else terminal
            acquire(bench, wanted, output, beside=beside, operator=operator, onlooker=terminal)
        finally:
            terminal.stop()
            if hasattr(bench, "close"):
                bench.close()
    if simulated:
        simulated_bench(wanted, beside).write_truth(output, overwrite=True)
    already = " already" if complete else ""
    loads, cycles = counted(wanted.loads, "load"), counted(wanted.cycles, "cycle")
    rows = invalid_rows(output, wanted)
    values = {
        "folder": str(output),
        "before": complete,
        "loads": [load.name for load in wanted.loads],
        "cycles": wanted.cycles,
        "invalid": {name: invalid for name, (invalid, _) in rows.items() if invalid},
    }
    not_valid = _not_valid(rows)
    if quiet and not_valid:
        say(f"{output}: complete{not_valid}", stream=sys.stderr)
    line = f"{output}: complete{already}, {loads} x {cycles}{not_valid}"
    written = (output,) if quiet else ()
    as_values = values if json else None
    print_result([line], *written, values=as_values, schema="acquire", quiet=quiet)


def _not_valid(rows: dict[str, tuple[int, int]]) -> str:
    """Say how many rows of which files are not valid, and how to take them again, or nothing."""
    from truenewton.rounding import listed

    spoilt = [f"{name} {invalid}" for name, (invalid, _) in rows.items() if invalid]
    if not spoilt:
        return ""
    invalid, every = (sum(column) for column in zip(*rows.values(), strict=True))
    return (
        f", but {invalid} of {every} rows are not valid ({listed(spoilt, MOST_FILES)}); to take a"
        " cycle again remove its file and give the same command"
    )


class Terminal:
    """The person at the terminal: looks on, and puts the loads on, or takes them for put on.

    One progress bar on standard error, where a person looks at it, and lines beside it: on
    standard output, or apart from it, where that is for a script.
    """

    def __init__(self, yes: bool, *, apart: bool = False) -> None:
        self._yes = yes
        self._stream = sys.stderr if apart else sys.stdout
        self._bar: Any = None

    def put_on(self, load: Load) -> None:
        """Ask for a load, and wait until Enter says that it is on.

        Raises
        ------
        BenchFault
            There is nobody to ask.
        """
        self.stop()
        if load.added:
            what = f"put '{load.name}' on the mirror ({-load.added:g} N)"
        else:
            what = f"take every weight off the mirror ('{load.name}')"
        if load.tilt:
            what += f", tilted by {load.tilt:g} deg"
        if self._yes:
            self.say(f"{what}: taken for done")
        elif sys.stdin is None or not sys.stdin.isatty():
            raise BenchFault(
                f"somebody must {what}", remedy="run it at a terminal, or give --yes where it is on"
            )
        else:
            question = f"{what[0].upper()}{what[1:]}, then press Enter: "
            say(question, stream=self._stream, end="")
            input()

    def progress(self, now: Progress) -> None:
        """Draw the bar: what is done, figures, and the time that is left."""
        if not sys.stderr.isatty():
            return
        shape, sign = now.shape, "+" if now.shape.sign > 0 else "-"
        invalid = f", {now.invalid} not valid" if now.invalid else ""
        shown = {
            "completed": now.done,
            "total": now.total,
            "description": printable(
                f"{shape.load.name} cycle {shape.cycle}/{now.cycles}"
                f" shape {shape.number}/{now.shapes} {sign}"
            ),
            "figures": f"most {now.largest_force:.3f} N, least gap {1e6 * now.smallest_gap:.1f} um"
            f"{invalid}",
            "left": datetime.timedelta(seconds=round(now.seconds_left)),
        }
        if self._bar is None:
            self._bar = _bar()
            self._bar.add_task(**shown)
            self._bar.start()
        self._bar.update(0, **shown)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._bar is None:
            say(line, stream=self._stream)
        else:
            self._bar.console.print(printable(line), markup=False, highlight=False)

    def stop(self) -> None:
        """Take the bar away, as before a question; it comes back when it is drawn again."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TextColumn("{task.fields[figures]}", markup=False),
        TextColumn("{task.fields[left]} left", markup=False),
        console=Console(stderr=True),
        transient=True,
    )
