"""What `truenewton calibrate` takes of memory for a campaign that may be larger than it.

    python benchmarks/memory.py [--actuators 1170] [--cycles 5]

Cycle files with FORCE, POSITION and both gradients are written one by one into a temporary folder
(5352 actuators: 9 GB), then calibrated by a process of its own, whose peak is what the system says
of it (ru_maxrss).
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


def write_files(n: int, cycles: int, folder: Path) -> None:
    """Write random forces that balance, and their noise, a cycle after the other."""
    from speed import balanced_cycles

    import truenewton as tn

    folder.mkdir()
    for number, cycle in enumerate(balanced_cycles(n, cycles, 600.0, 31.0), 1):
        tn.write_cycle(cycle, folder / f"{cycle.load.name}-{cycle.number:03d}.fits")
        print(f"  written: {number} of {LOADS * cycles} files", file=sys.stderr)


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


def measure(n: int, cycles: int) -> None:
    """Make a campaign, calibrate it and print what that took."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        child(__file__, "--make", folder, "--actuators", n, "--cycles", cycles)
        size = sum(path.stat().st_size for path in folder.iterdir())
        print(f"{n} actuators, {cycles} cycles x {LOADS} loads x {2 * n} rows: {size / 1e6:.0f} MB")
        sys.stdout.flush()
        taken, peak = child("-m", "truenewton", "calibrate", folder, "-o", f"{folder}.alpha.fits")
    square = 8e-6 * n**2
    shapes = LOADS * 2 * square
    print(
        f"  {taken:.0f} s; peak {1e-6 * peak:.0f} MB = distinct shapes {shapes:.0f} MB"
        f" + {(1e-6 * peak - shapes) / square:.1f} n^2 of {square:.0f} MB;"
        f" {size / peak:.2f} bytes of files for one of memory"
        + (" (wanted: under 2500 MB)" if n == 5352 else "")
    )


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", type=int, default=1170)
    parser.add_argument("--cycles", type=int, default=5)
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        write_files(options.actuators, options.cycles, options.make)
    else:
        measure(options.actuators, options.cycles)


if __name__ == "__main__":
    main()
