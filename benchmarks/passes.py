"""How often the rows of a campaign are read, and what a report takes.

    python benchmarks/passes.py [--actuators 45 672] [--against PATH/TO/OTHER/src]

Rows are counted where they are taken: those of FORCE that `used` of a reader hands out, over those
that there are in the files. A report is what `truenewton report` does but reading the files: the
campaign investigated and its page written. Times are the least of three, of the processor. With
--against, the sources of another version are measured as well, each version by a process of its
own on the same files, and the ratios are printed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CYCLES = 4  # under each of two loads
REPEATS = 3


def write_files(n: int, folder: Path) -> None:
    """Write P45's campaign, or that of a mirror of so many actuators, FORCE and POSITION."""
    from memory import write_files as write_large

    import truenewton as tn

    if n == 45:
        tn.write_campaign(tn.run_cycles(tn.static_bench(tn.mirrors.p45(), 1), CYCLES), folder)
        return
    write_large(n, CYCLES, folder)


def counting_rows(campaign: Any) -> list[int]:
    """Return a list to which every taking of rows of FORCE adds their number."""
    import truenewton as tn

    forces, taken = {id(cycle.force) for cycle in campaign.cycles}, list[int]()

    def counting(used: Callable[..., Any]) -> Callable[..., Any]:
        def counted(reader: Any, values: Any, rows: Any) -> Any:
            chosen = used(reader, values, rows)
            if id(values) in forces:
                taken.append(len(chosen))
            return chosen

        return counted

    from truenewton.estimation.displaced_rows import BalancedRows

    for reader in (tn.Cycle, BalancedRows):
        if hasattr(reader, "used"):  # of another version it goes through Cycle
            reader.used = counting(reader.used)  # type: ignore[method-assign]
    return taken


def measure(folder: Path) -> dict[str, float]:
    """Count and time one version of truenewton on the files of a folder."""
    import truenewton as tn

    campaign = tn.read(folder)
    taken, rows = counting_rows(campaign), sum(len(cycle.time) for cycle in campaign.cycles)
    steps: dict[str, Callable[[], Any]] = {
        "calibrate": lambda: tn.calibrate(campaign),
        "investigate": lambda: tn.investigate(campaign),
        "report": lambda: tn.write_report(
            folder.parent / "report.html", tn.investigate(campaign), overwrite=True
        ),
    }
    figures: dict[str, float] = {}
    for name, step in steps.items():
        step()
        figures[f"{name} reads FORCE, times"] = sum(taken) / rows
        seconds = []
        for _ in range(REPEATS):
            start = time.process_time()
            step()
            seconds.append(time.process_time() - start)
        figures[f"{name} [s]"] = min(seconds)
        taken.clear()
    return figures


def child(source: Path, folder: Path) -> dict[str, float]:
    """Measure the version whose sources stand in a folder, in a process of its own."""
    found = subprocess.run(
        [sys.executable, __file__, "--measure", str(folder)],
        env={**os.environ, "PYTHONPATH": str(source)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(json.loads(found.stdout))


def compare(n: int, against: Path | None) -> None:
    """Print the table of one mirror."""
    here = Path(__file__).parents[1] / "src"
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        write_files(n, folder)
        size = sum(path.stat().st_size for path in folder.iterdir())
        before = child(against, folder) if against is not None else {}
        now = child(here, folder)
    print(f"{n} actuators, {CYCLES} cycles x 2 loads, {size / 1e6:.0f} MB of files")
    if before:
        print(f"  {'':<36}{'against':>9}{'now':>9}{'ratio':>9}")
    for name, value in now.items():
        old = f"{before[name]:9.2f}" if before else ""
        ratio = f"{before[name] / value:9.2f}" if before else ""
        print(f"  {name:<36}{old}{value:9.2f}{ratio}")
    sys.stdout.flush()


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", type=int, nargs="+", default=[45, 672])
    parser.add_argument("--against", type=Path, help="src of another version")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure)))
        return
    for n in options.actuators:
        compare(n, options.against)


if __name__ == "__main__":
    main()
