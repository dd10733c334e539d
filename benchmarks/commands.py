"""What people wait for: what commands take, and in terms of what another release takes.

    [TRUENEWTON_REAL_DATA=FOLDER] python benchmarks/commands.py [--other PYTHON] [--ring 1170]

PYTHON is the interpreter of an environment that has the other release. k.fits is the measured
LBT672 where its folder is given, or a simulated matrix, which --ring makes of a ring of actuators.
Printed are seconds of processor, of the clock, GB at most, and the ratio of processor times.
"""

import argparse
import datetime
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

import truenewton as tn
from truenewton.acquisition.plan import template
from truenewton.bench.simulated.static import static_bench
from truenewton.mirrors.known import lbt672, ring

COMMANDS = """calibrate p45 -o p45.fits; info p45; report p45 -o p45.html;
plan p45.toml --target .001; plan mmt336.toml --target .001; plan lbt672.toml --target .001;
info k.fits; calibrate k.fits -o k.alpha.fits; report k.alpha.fits -o k.html;
modes k.fits --calibration k.alpha.fits -o k.modes.fits"""


def taken(python: str, command: str, folder: str) -> tuple[float, float, float]:
    """Return seconds of processor and of the clock, and GB, of a command of some release."""
    start = time.perf_counter()
    words = [python, "-m", "truenewton", *command.split(), "--quiet"]
    words += ["--overwrite"] * (" -o " in command)
    pid = subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL).pid
    _, status, usage = os.wait4(pid, 0)
    if status:
        print(f"{command} failed: its time is none", flush=True)
    seconds = usage.ru_utime + usage.ru_stime
    return seconds, time.perf_counter() - start, 1e-6 * usage.ru_maxrss


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--other", help="interpreter of the other release")
    parser.add_argument("--ring", type=int, help="actuators of a simulated matrix")
    options = parser.parse_args()
    if (data := os.environ.get("TRUENEWTON_REAL_DATA")) and not options.ring:
        matrix = tn.read_stiffness(Path(data) / "lbt672" / "lbt672-feedforward.fits")
    else:
        truth = static_bench(ring(options.ring) if options.ring else lbt672(), 1).truth
        noise = 2e-4 * np.random.default_rng(1).standard_normal(truth.stiffness.shape)
        k = truth.stiffness * (1.0 + noise) / truth.alpha[:, None]
        matrix = tn.StiffnessMatrix("MADE", datetime.datetime.now(datetime.UTC), truth.layout, k)
    with tempfile.TemporaryDirectory() as folder:
        taken(sys.executable, "simulate p45 -o p45", folder)
        for name in ("p45", "mmt336", "lbt672"):
            plan = template().replace('"p45"', f'"{name}"')
            Path(folder, f"{name}.toml").write_text(plan, encoding="utf-8")
        tn.write_stiffness(matrix, Path(folder, "k.fits"))
        for command in COMMANDS.replace("\n", " ").split("; "):
            if options.ring and "k." not in command:
                continue
            own = taken(sys.executable, command, folder)
            ratio = own[0] / taken(options.other, command, folder)[0] if options.other else np.nan
            print("{:58s}{:7.1f}{:7.1f}{:7.2f}{:7.2f}".format(command, *own, ratio), flush=True)


if __name__ == "__main__":
    main()
