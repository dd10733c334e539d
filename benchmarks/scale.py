"""What a calibration by a dask cluster takes, against the number of files and of actuators.

    python benchmarks/scale.py [--actuators 45,132,336,892,1784,2676] [--files 4,8,16]
                               [--of-segments 45,132,336,892] [--figure]

For each size a campaign of FORCE, POSITION and both gradients is written into a temporary folder
and read and calibrated by processes of their own: a client and its workers, of which CPU time (the
machine may have other work) and the peak of memory above an idle process are printed, then how both
grow. So are mirrors of `--segments` segments of the sizes of `--of-segments`. `--figure` draws
docs/images/scale.png. At last what a year of telemetry of a mirror of `--segments` x `--segment`
actuators at `--rate` readings per second would take, by what was measured; nothing of that size is
run.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from memory import LOADS, UNIT

ROOT = Path(__file__).parent.parent
YEAR = 365.25 * 86400.0  # [s]
NIGHT = 0.35  # of the time that a telescope's loop is closed
TELEMETRY = 2 * 4  # bytes of a reading: FORCE and POSITION as 32-bit numbers
STORED = 2 * 8  # bytes, as `write_cycle` stores them


def used() -> tuple[float, float]:
    """Return CPU time [s] and peak of memory [bytes] of this process."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_utime + own.ru_stime, float(UNIT * own.ru_maxrss)


def warm() -> None:
    """Import what a task needs."""
    import truenewton.calibration.methods
    import truenewton.reading  # noqa: F401


def run(folder: Path, workers: int) -> None:
    """Calibrate a campaign by workers; print what it took, as JSON."""
    from distributed import Client, LocalCluster

    import truenewton as tn

    with (
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        Client(cluster) as client,
    ):
        warm()
        client.run(warm)
        before, start = {"client": used(), **client.run(used)}, time.perf_counter()
        tn.calibrate(tn.read(folder, client=client), client=client)
        wall = time.perf_counter() - start
        after = {"client": used(), **client.run(used)}
    took = {who: [b - a for a, b in zip(before[who], after[who], strict=True)] for who in before}
    print(json.dumps({"wall": wall, "client": took.pop("client"), "workers": list(took.values())}))


def join(folder: Path, segments: int) -> None:
    """Put so many mirrors in the place of one, as segments that have the same readings."""
    import truenewton as tn

    for path in sorted(folder.iterdir()):
        (cycle,) = tn.read_campaign(path)
        assert cycle.position is not None
        one, load = cycle.layout, cycle.load
        away = 1.1 * np.ptp(one.x) * np.arange(segments)
        layout = tn.layout(
            (one.x + away[:, None]).ravel(),
            np.tile(one.y, segments),
            nz=np.tile(one.nz, segments),
            segment=np.repeat(np.arange(1, segments + 1), one.n),
        )
        weights = cycle.weight, cycle.weight_error, load.added, load.added_error
        root = np.sqrt(segments)
        whole = replace(
            cycle,
            layout=layout,
            segments=tuple(tn.Segment(k, *weights) for k in range(1, segments + 1)),
            weight=segments * cycle.weight,
            weight_error=root * cycle.weight_error,
            load=replace(load, added=segments * load.added, added_error=root * load.added_error),
            force=np.tile(np.asarray(cycle.force), segments),
            position=np.tile(np.asarray(cycle.position), segments),
        )
        tn.write_cycle(whole, path, overwrite=True)


def measure(n: int, files: int, workers: int, segments: int = 1) -> dict[str, Any]:
    """Make a campaign, calibrate it in processes of their own, and return what that took."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        memory = Path(__file__).with_name("memory.py")
        make = ["--make", folder, "--actuators", n, "--cycles", files // LOADS]
        subprocess.run(
            [sys.executable, memory, *map(str, make)], check=True, stderr=subprocess.DEVNULL
        )
        if segments > 1:
            # In a process of its own: a child begins with the peak of memory of its parent.
            joined = ["--join", str(folder), "--segments", str(segments)]
            subprocess.run([sys.executable, __file__, *joined], check=True)
        size = sum(path.stat().st_size for path in folder.iterdir())
        done = subprocess.run(
            [sys.executable, __file__, "--run", folder, "--workers", str(workers)],
            check=True,
            stdout=subprocess.PIPE,
        )
    took = json.loads(done.stdout.splitlines()[-1])
    cpu, peak = np.array(took["workers"]).T
    found = {
        "actuators": segments * n,
        "files": files,
        "bytes": size,
        "client_cpu": took["client"][0],
        "client_peak": took["client"][1],
        "worker_cpu": float(cpu.sum()),
        "worker_peak": float(peak.max()),
    }
    print(
        f"{f'{segments} x ' if segments > 1 else '':>4}{n:5d} actuators {files:3d} files"
        f" {1e-6 * size:7.1f} MB"
        f"   client {found['client_cpu']:7.2f} s {1e-6 * found['client_peak']:7.1f} MB"
        f"   workers {found['worker_cpu']:7.2f} s, largest {1e-6 * found['worker_peak']:7.1f} MB"
        f"   wall {took['wall']:.1f} s",
        flush=True,
    )
    return found


QUANTITIES = {
    "client_cpu": "CPU time of the client",
    "worker_cpu": "CPU time of all workers",
    "client_peak": "memory of the client",
    "worker_peak": "memory of the largest worker",
}


def exponents(rows: list[dict[str, Any]], by: str) -> None:
    """Print how what was measured grows with one of the sizes."""
    if len(rows) < 2:
        return
    x = np.log([row[by] for row in rows])
    for key, words in QUANTITIES.items():
        y = np.log(np.maximum([row[key] for row in rows], 1e-9))
        slopes = np.diff(y) / np.diff(x)
        print(
            f"  {words:30s} grows as {by}^{np.polyfit(x, y, 1)[0]:.2f}"
            f" (from step to step {', '.join(f'{s:.2f}' for s in slopes)})"
        )


def draw(series: dict[str, list[dict[str, Any]]], by_files: list[dict[str, Any]]) -> None:
    """Draw docs/images/scale.png: mirrors in one piece and in segments, and more files of one."""
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    from truenewton.figures.style import CURVES, STYLE

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        axes = figure.subplots(2, 2, sharex="col", sharey="row", width_ratios=(3, 2))
        for row, (key, unit) in enumerate((("cpu", 1.0), ("peak", 1e-6))):
            for column, (groups, by) in enumerate(
                ((series, "actuators"), ({"": by_files}, "files"))
            ):
                ax = axes[row, column]
                for colour, (words, rows) in zip(CURVES, groups.items(), strict=False):
                    for who, style, label in (
                        ("client", "o-", "client"),
                        ("worker", "s--", ("workers together", "largest worker")[row]),
                    ):
                        ax.loglog(
                            [r[by] for r in rows],
                            [unit * r[f"{who}_{key}"] for r in rows],
                            style,
                            color=colour,
                            markersize=3,
                            label=f"{label}, {words}",
                        )
                ax.grid(color="0.9", linewidth=0.5)
                for axis in (ax.xaxis, ax.yaxis):
                    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                    axis.set_major_formatter("{x:g}")
                    axis.set_minor_locator(NullLocator())
            axes[row, 0].legend()
        files = [r["files"] for r in by_files]
        axes[1, 1].set_xticks(files, list(map(str, files)))
        axes[1, 0].set_xlabel("actuators")
        axes[1, 1].set_xlabel(f"files, {by_files[0]['actuators']} actuators")
        axes[0, 0].set_ylabel("processor time (s)")
        axes[1, 0].set_ylabel("memory above an idle process (MB)")
        figure.savefig(ROOT / "docs" / "images" / "scale.png", dpi=200)


def on_paper(last: dict[str, Any], options: argparse.Namespace) -> None:
    """Print what a year of telemetry takes, by the bytes that workers took in a second."""
    n = options.segments * options.segment
    speed = last["bytes"] / last["worker_cpu"]
    seconds = NIGHT * YEAR
    raw = TELEMETRY * n * options.rate * seconds
    print(
        f"A year of {options.segments} x {options.segment} actuators at {options.rate:g}"
        f" readings a second, {100 * NIGHT:.0f} per cent of the time:\n"
        f"  raw, FORCE and POSITION of 32 bit: {1e-6 * TELEMETRY * n * options.rate:.0f} MB a"
        f" second, {1e-15 * raw:.2f} PB a year"
    )
    for period in (1.0 / options.rate, 1.0, 10.0):
        size = STORED * n * seconds / period
        hours = size / speed / 3600.0
        print(
            f"  a row for {period:g} s: {1e-12 * size:9.2f} TB in cycle files, {hours:9.0f} hours"
            f" of one worker, {hours / 24 / options.nodes:.2g} days of {options.nodes}"
        )
    shapes = LOADS * 2 * options.segment
    print(
        f"  the client holds {1e-6 * 8 * shapes * options.segment:.0f} MB of means of a segment,"
        f" {LOADS} loads x {2 * options.segment} shapes, however long the year"
        f"\n  (at {1e-6 * speed:.0f} MB of files a second of a worker's CPU, as measured at"
        f" {last['actuators']} actuators and {last['files']} files)"
    )


def numbers(text: str) -> list[int]:
    """Return the numbers of a list with commas."""
    return [int(word) for word in text.split(",")]


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", type=numbers, default=[45, 132, 336, 892, 1784, 2676])
    parser.add_argument("--of-segments", type=numbers, default=[45, 132, 336, 892])
    parser.add_argument("--files", type=numbers, default=[4, 8, 16])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--figure", action="store_true")
    parser.add_argument("--segments", type=int, default=6)
    parser.add_argument("--segment", type=int, default=892)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--nodes", type=int, default=64, help="workers of the year")
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--join", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.join:
        join(options.join, options.segments)
        return
    if options.run:
        run(options.run, options.workers)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    fewest, *more = options.files
    whole = [measure(n, fewest, options.workers) for n in options.actuators]
    exponents(whole, "actuators")
    middle = whole[len(whole) // 2]
    by_files = [middle, *(measure(middle["actuators"], m, options.workers) for m in more)]
    exponents(by_files, "files")
    parts = [measure(n, fewest, options.workers, options.segments) for n in options.of_segments]
    exponents(parts, "actuators")
    on_paper(parts[-1], options)
    if options.figure:
        draw({"in one piece": whole, f"{options.segments} segments": parts}, by_files)


if __name__ == "__main__":
    main()
