"""What `truenewton calibrate` takes of memory for a campaign that may be larger than it.

    python benchmarks/memory.py [--actuators 1170] [--cycles 5]

Cycle files with FORCE, POSITION and both gradients are written one by one into a temporary folder
(5352 actuators: 9 GB), then calibrated by a process of its own, whose peak is what the system says
of it (ru_maxrss). Stages show their seconds and the peak until their end.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

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


def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function, which says what it took."""

    def run(*arguments: Any, **options: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*arguments, **options)
        finally:
            taken = time.perf_counter() - start
            peak = UNIT * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            print(f"  {name:36s} {taken:8.1f} s   peak so far {1e-6 * peak:7.0f} MB", flush=True)

    return run


def calibrate(folder: Path) -> None:
    """Run `truenewton calibrate`, its stages timed."""
    import truenewton.calibration.result
    import truenewton.reading
    from truenewton.calibration import methods
    from truenewton.cli.main import main as command
    from truenewton.estimation import campaign_ml, problem
    from truenewton.estimation.paper import svd

    for name, module, function in (
        ("tn.read: checksums, SHA256, checks", truenewton.reading, "read_data"),
        ("means of repeats, rows far from them", methods, "screen_campaign"),
        ("  a minimisation", problem, "minimise"),
        ("shapes against the balance", campaign_ml, "balancing_groups"),
        ("maximum likelihood, all of it", campaign_ml, "find"),
        ("E_CYCLE", svd, "read_rows"),
        ("calibrate, all of it", methods, "calibrate"),
        ("writing the calibration", truenewton.calibration.result.Calibration, "write"),
    ):
        setattr(module, function, timed(name, getattr(module, function)))
    sys.argv = ["truenewton", "calibrate", str(folder), "-o", str(folder.parent / "alpha.fits")]
    command()


def child(*arguments: object) -> tuple[float, float]:
    """Run this file in a process of its own; return its seconds and its peak [bytes].

    Nothing large may have been imported here: a child begins with the size of its parent.
    """
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, __file__, *map(str, arguments)])
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"exit code {process.returncode}")
    return time.perf_counter() - start, UNIT * used.ru_maxrss


def measure(n: int, cycles: int) -> None:
    """Make a campaign, calibrate it and print what that took."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        child("--make", folder, "--actuators", n, "--cycles", cycles)
        size = sum(path.stat().st_size for path in folder.iterdir())
        print(f"{n} actuators, {cycles} cycles x {LOADS} loads x {2 * n} rows: {size / 1e6:.0f} MB")
        sys.stdout.flush()
        taken, peak = child("--calibrate", folder)
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
    parser.add_argument("--calibrate", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        write_files(options.actuators, options.cycles, options.make)
    elif options.calibrate:
        calibrate(options.calibrate)
    else:
        measure(options.actuators, options.cycles)


if __name__ == "__main__":
    main()
