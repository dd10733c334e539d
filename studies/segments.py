"""A mirror in segments from end to end: time, memory, and errors beside each segment's own bound.

    python -m studies.segments [--mirror m4] [--cycles 2] [--seed 1] [--noise 1e-4]
    python -m studies.segments --campaigns 24 [...]

Prints the processor time, elapsed time and peak memory of computing the glass of each different
segment, and of the commands `simulate`, `calibrate`, `report` and `modes`. Then for each segment:
the Cramer-Rao bound; E_STAT and the rms error of alpha relative to it, for the true weight of the
tool; e' C^-1 e / n; the coverage of 95 % intervals of E_STAT by actuator and by pattern; the
coverage of E_ALPHA for the declared weight; the error of the tool's weight in sigma. C is
COVARIANCE - SYSTEMATIC, and patterns are its eigenvectors, whose errors are independent. A few weak
patterns (the common scale and two tilts) dominate the error of every actuator, so that coverage is
correlated within a segment.

--campaigns simulates more campaigns with independent noise, of one segment after the other.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import truenewton as tn
from studies.accuracy import TWO_SIGMA, information_of, rms
from truenewton.arrays import Array
from truenewton.bench.simulated.static import (
    SEEDS_PER_MIRROR,
    SegmentedBench,
    StaticBench,
    bench_of,
    held_command,
    rows_of_cycle,
    run_cycles,
)
from truenewton.bench.simulated.truth import truth_path
from truenewton.estimation.paper.equations import Unknowns
from truenewton.mirrors.file import whole_mirror_from
from truenewton.mirrors.segmented import SegmentedMirror
from truenewton.mirrors.shell.shell_model import model_shell
from truenewton.statics.arms import enabled_arms


def timed(name: str, command: Sequence[object]) -> None:
    """Run a command in a process of its own; print its time and memory."""
    begun = time.monotonic()
    child = subprocess.Popen([sys.executable, *map(str, command)], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        sys.exit(f"{name} failed")
    print(
        f"  {name:<28}{used.ru_utime + used.ru_stime:8.1f} s{time.monotonic() - begun:10.1f} s"
        f"{used.ru_maxrss / 1024:10.0f} MB",
        flush=True,
    )


def bound(bench: StaticBench, cycles: int) -> Array:
    """Return the (n,) Cramer-Rao bound of alpha for known weights.

    The unknown true forces of every shape under every load are eliminated. The information on
    alpha, B and the torques is then the sum of r J' S^-1 J over shapes.
    """
    alpha, a = bench.truth.alpha, enabled_arms(bench.mirror.layout)
    _, _, position = rows_of_cycle(bench)
    # Alpha multiplies the command corrected for the position of the coil. Without correction the
    # force COILGRAD f z would unbalance each shape.
    coil = 1.0 + bench.coils.coil_gradient * position * bench.sensors.gain
    beside = Unknowns(len(alpha), len(bench.loads)).external_load_derivative()
    shapes = (held_command(bench, load, position) * coil for load in range(len(bench.loads)))
    information = cycles * information_of(a, alpha, bench.force_noise, shapes, beside)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))[: len(alpha)]))


HEAD = "bound     E_STAT/bound   error/bound   e'C^-1e/n   E_STAT %   patterns %   E_ALPHA %   tool"


def figures(bench: StaticBench, least: Array, found: tn.Calibration) -> Array:
    """Return the columns of `HEAD` for a calibration and its (n,) bound."""
    declared, true = bench.loads[-1].added, bench.truth.added[-1]
    off = found.alpha * true / declared - bench.truth.alpha
    n = len(off)
    sizes, axes = np.linalg.eigh((found.covariance - found.systematic_covariance)[:n, :n])
    patterns = (axes.T @ off) / np.sqrt(sizes)
    return np.array([
        rms(least),
        rms(found.statistical_error) / rms(least),
        rms(off) / rms(least),
        np.mean(patterns**2),
        100 * np.mean(np.abs(off) < TWO_SIGMA * found.statistical_error),
        100 * np.mean(np.abs(patterns) < TWO_SIGMA),
        100 * np.mean(np.abs(found.alpha - bench.truth.alpha) < TWO_SIGMA * found.error),
        (true / declared - 1) * declared / bench.loads[-1].added_error,
    ])  # fmt: skip


def line(name: object, of: Array) -> str:
    """Return a line of the table below `HEAD`."""
    return (
        f"  {name:<10}{of[0]:<10.2e}{of[1]:<15.3f}{of[2]:<14.3f}{of[3]:<12.3f}{of[4]:<11.1f}"
        f"{of[5]:<13.1f}{of[6]:<12.1f}{of[7]:+.2f}"
    )


def errors(bench: SegmentedBench, work: Path, cycles: int) -> None:
    """Print the errors of each segment."""
    truth = tn.read_truth(truth_path(work / "campaign"))
    print(f"  segment   {HEAD}")
    for number, one in enumerate(bench.benches, 1):
        found = tn.read_calibration(work / f"calibration-{number}.fits")
        assert np.array_equal(one.truth.alpha, truth.alpha[truth.layout.segment == number])
        print(line(number, figures(one, bound(one, cycles), found)), flush=True)


def many(bench: SegmentedBench, cycles: int, count: int) -> None:
    """Print errors of campaigns of one segment after the other, and their means."""
    of_all, least = [], [bound(one, cycles) for one in bench.benches]
    print(f"  segment   {HEAD}")
    for number in range(count):
        k = number % len(bench.benches)
        one = bench.benches[k]
        noise = replace(one.truth, seed=one.truth.seed + SEEDS_PER_MIRROR * (number + 1))
        one = replace(one, truth=noise)
        found = tn.calibrate(tn.Campaign(tuple(run_cycles(one, cycles))))
        of_all.append(figures(one, least[k], found))
        print(line(k + 1, of_all[-1]), flush=True)
    each = np.array(of_all)
    square = each[:, 2] ** 2
    mean, uncertain = each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(count)
    mean[2] = np.sqrt(square.mean())
    uncertain[2] = 0.5 * square.std(ddof=1) / np.sqrt(count) / mean[2]
    print(line("all", mean))
    print(line("+-", uncertain))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mirror", default="m4")
    parser.add_argument("--cycles", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", type=float, default=1e-4)
    parser.add_argument("--glass", type=int, help="only compute the glass of this segment")
    parser.add_argument("--campaigns", type=int, help="of one segment after the other")
    arguments = parser.parse_args()
    mirror = whole_mirror_from(arguments.mirror)
    if not isinstance(mirror, SegmentedMirror):
        parser.error(f"{arguments.mirror} is in one piece")
    if arguments.glass:
        model_shell(mirror.segments[arguments.glass - 1])
        return

    def draw() -> SegmentedBench:
        noise = arguments.noise
        bench = bench_of(mirror, arguments.seed, force_noise=noise, temperature=20.0)
        assert isinstance(bench, SegmentedBench)
        return bench

    if arguments.campaigns:
        many(draw(), arguments.cycles, arguments.campaigns)
        return
    print(f"{mirror.name}: {len(mirror.segments)} segments, {mirror.layout.n} actuators")
    print("                              processor      clock    memory")
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        for _, (number, *_others) in mirror.kinds:
            shared = ("--mirror", arguments.mirror, "--glass", number)
            timed(f"glass of segment {number}", ("-m", "studies.segments", *shared))
        campaign, calibration = work / "campaign", work / "calibration.fits"
        drawn = ("--cycles", arguments.cycles, "--seed", arguments.seed, "--noise", arguments.noise)
        run = ("-m", "truenewton")
        timed("simulate", (*run, "simulate", arguments.mirror, "-o", campaign, *drawn))
        timed("calibrate", (*run, "calibrate", campaign, "-o", calibration))
        timed("report", (*run, "report", campaign, "-o", work / "report.html"))
        timed("modes", (*run, "modes", campaign, "--calibration", calibration))
        errors(draw(), work, arguments.cycles)


if __name__ == "__main__":
    main()
