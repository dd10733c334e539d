"""What acquisition itself costs for each shape, and for the file of each cycle.

    python benchmarks/acquisition.py [--actuators 45 672 5352] [--shapes 30]

Time inside the bench (command, read, status) is taken out; what is left is checks and log. Medians
over shapes. Beyond 1,000 actuators the bench is a stub that answers at once.
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import truenewton as tn
from truenewton.acquisition.plan import CampaignPlan, PlannedShapes
from truenewton.acquisition.taker import Progress
from truenewton.bench.protocol import Bench, Reading, Shape, Status
from truenewton.files.fits import write_fits
from truenewton.files.format import FileFormat, ImageFormat
from truenewton.mirrors.file import mirror_from
from truenewton.mirrors.known import Mirror

SIMULATED_UP_TO = 1000  # actuators; beyond, the model of the shell takes minutes
START = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)


class AnsweringBench:
    """Any mirror, at once: forces that only the count of the reading decides."""

    def __init__(self, mirror: Mirror) -> None:
        self.instrument, self.layout, self.gap = mirror.name, mirror.layout, mirror.gap
        self.counter, self.scatter = 0, np.full(mirror.layout.n, 1e-3)
        self.force = np.full(mirror.layout.n, 0.1)
        self.shape: Shape | None = None

    def put_on(self, load: tn.Load) -> None:
        """Lift nothing."""

    def command(self, shape: Shape) -> None:
        self.shape = shape

    def read(self, samples: int) -> Reading:  # noqa: ARG002
        self.counter += 1
        assert self.shape is not None
        return Reading(
            time=START + datetime.timedelta(seconds=self.counter),
            force=self.force + 1e-6 * self.counter,
            position=self.shape.position,
            force_scatter=self.scatter,
            position_scatter=self.scatter,
            temperature=20.0,
            counter=self.counter,
            settled=True,
        )

    def status(self) -> Status:
        return Status(True, "", self.counter)

    def rest(self) -> None:
        """Stay."""


def simulated(mirror: Mirror, plan: CampaignPlan) -> Any:
    if mirror.layout.n > SIMULATED_UP_TO:
        return AnsweringBench(mirror)
    return tn.SimulatedBench(mirror, 1, loads=plan.loads)


class Timed:
    """A bench, and the time spent in it."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.inside = bench, 0.0
        self.instrument, self.layout, self.gap = bench.instrument, bench.layout, bench.gap

    def __getattr__(self, name: str) -> Any:
        method = getattr(self.bench, name)
        if not callable(method):
            return method

        def timed(*arguments: Any) -> Any:
            start = time.perf_counter()
            try:
                return method(*arguments)
            finally:
                self.inside += time.perf_counter() - start

        return timed


class Stopwatch:
    """Notes after each shape the time that passed outside the bench."""

    def __init__(self, bench: Timed) -> None:
        self.bench = bench
        self.outside: list[float] = []
        self.start()

    def start(self) -> None:
        self.since, self.bench.inside = time.perf_counter(), 0.0

    def progress(self, now: Progress) -> None:  # noqa: ARG002
        self.outside.append(time.perf_counter() - self.since - self.bench.inside)
        self.start()

    def say(self, line: str) -> None:
        """Keep quiet."""


def measure(n: int, count: int, root: Path) -> tuple[float, float]:
    """Return seconds for a shape, and for the file of a cycle."""
    name = {45: "p45", 672: "lbt672"}.get(n, f"ring{n}")
    mirror = mirror_from(name)
    folder = root / name
    folder.mkdir()
    random = np.random.default_rng(1)
    image = 1e-9 * random.standard_normal((count, n))
    form = FileFormat(extensions=(ImageFormat("SHAPES", "", "m"),))
    write_fits(folder / "shapes.fits", form, image)
    plan = CampaignPlan(
        name,
        (tn.Load("bare"),),
        cycles=2,
        settling=0.0,
        shapes=PlannedShapes(source="shapes.fits", force=0.1),
    )
    bench = Timed(simulated(mirror, plan))
    watch = Stopwatch(bench)
    tn.acquire(bench, plan, folder / "campaign", beside=folder, onlooker=watch)
    first = 2 * count  # before which the file of the first cycle is written
    shapes = [t for k, t in enumerate(watch.outside) if k not in (0, first)]
    return median(shapes), watch.outside[first] - median(shapes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--actuators", type=int, nargs="+", default=[45, 672, 5352])
    parser.add_argument("--shapes", type=int, default=30, help="Each with both signs, two cycles.")
    chosen = parser.parse_args()
    print("milliseconds")
    print(f"{'actuators':>9} {'a shape':>9} {'file/cycle':>11}")
    for n in chosen.actuators:
        with tempfile.TemporaryDirectory() as root:
            shape, file = measure(n, chosen.shapes, Path(root))
        print(f"{n:9d} {1e3 * shape:9.2f} {1e3 * file:11.1f}")


if __name__ == "__main__":
    main()
