"""The memory that a campaign takes: its data, and about one copy of them.

    python benchmarks/memory.py [--actuators 1170] [--cycles 5] [--shapes N] [--position]

Cycle files are written one by one into a temporary folder. One process reads them and makes their
moments, another calibrates them if there are enough shapes. Their peaks are what the system reports
(ru_maxrss), less that of a process that only imports the same modules.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LOADS = 2
UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, in bytes
IMPORTS = """
from truenewton.calibration.methods import calibrate
from truenewton.estimation.screening.screen import campaign_moments
from truenewton.reading import read
"""
STEPS = {
    "reading": "read({0!r})",
    "reading and moments": "campaign_moments(read({0!r}))",
    "calibrate": "calibrate({0!r})",
}


def write_files(n: int, cycles: int, shapes: int, folder: Path, *, position: bool) -> None:
    """Write random forces that balance, and their noise, a cycle after the other."""
    from speed import balanced_cycles

    import truenewton as tn

    folder.mkdir()
    gradients = (600.0, 31.0) if position else (0.0, 0.0)
    for cycle in balanced_cycles(n, cycles, *gradients, shapes=shapes):
        tn.write_cycle(cycle, folder / f"{cycle.load.name}-{cycle.number:03d}.fits")


def child(*arguments: object) -> tuple[float, float]:
    """Run Python in a process of its own; return its seconds and its peak [bytes].

    Nothing large may have been imported here: a child begins with the size of its parent.
    """
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *map(str, arguments)])
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"exit code {process.returncode}")
    return time.perf_counter() - start, UNIT * used.ru_maxrss


def measure(n: int, cycles: int, shapes: int, *options: str) -> None:
    """Make a campaign, and print the memory of each step relative to its data."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        sizes = ("--actuators", n, "--cycles", cycles, "--shapes", shapes)
        child(__file__, "--make", folder, *sizes, *options)
        data = LOADS * cycles * 2 * shapes * n * 8 * (1 + len(options))
        print(f"{n} actuators, {LOADS} loads x {cycles} cycles x {2 * shapes} rows:", end=" ")
        print(f"{data / 1e6:.0f} MB of data", flush=True)
        _, before = child("-c", IMPORTS)
        for name, step in STEPS.items():
            if name == "calibrate" and shapes < n:
                continue
            taken, peak = child("-c", IMPORTS + step.format(str(folder)))
            peak -= before
            print(
                f"  {name:20} {taken:5.1f} s, {peak / 1e6:6.0f} MB = {peak / data:.2f} of the data"
            )


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", type=int, default=1170)
    parser.add_argument("--cycles", type=int, default=5)
    parser.add_argument("--shapes", type=int, help="of each sign; by default as many as actuators")
    parser.add_argument("--position", action="store_true", help="with POSITION and gradients")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    n, shapes = options.actuators, options.shapes or options.actuators
    own = ["--position"] if options.position else []
    if options.make:
        write_files(n, options.cycles, shapes, options.make, position=options.position)
    else:
        measure(n, options.cycles, shapes, *own)


if __name__ == "__main__":
    main()
