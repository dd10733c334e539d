"""What a calibration costs beside what it cannot do without, all in one run.

    python benchmarks/speed.py [--actuators 45 336 672 1170] [--repeats 40]

The reference is one pass over the bytes, one DSYRK on the distinct shapes of each load, and one
Cholesky factorisation of order n for each iteration taken. It finds alpha only, from a start that
is given. What is missing, whoever computes it, is timed beside it with bare calls of numpy and
LAPACK: a factorisation for the start, and for the errors the scatter of repeats, which gives the
noise, and COVARIANCE, H^-1 + H^-1 D H^-1, from the factor of the last iteration; its diagonal, for
E_ALPHA alone, could do without the product. Behind each step stand its floating-point operations
in terms of n^3. `calibrate` starts from arrays in memory; E_CYCLE, which solves every cycle alone,
stands in a row of its own, as do reading, the checksums and SHA256. Each figure is the least of
several runs that take turns, in processor time: wall clock on one thread, where nobody else is at
work. All of them find the heap warm, as bare calls do; the first calibration of its size, in a row
of its own, pays for fresh memory as well.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotri

import truenewton as tn
from truenewton.calibration import methods
from truenewton.estimation import campaign_ml, likelihood, problem
from truenewton.estimation.paper.equations import system_e
from truenewton.estimation.paper.svd import cycle_errors
from truenewton.linalg import ROWS_AT_ONCE, mirrored
from truenewton.statics.arms import arms, enabled_arms

CYCLES, NOISE = 5, 1e-4
PRODUCT = "H^-1 D H^-1: 1 n^3"
HEAP = 31_000_000  # bytes; once as many are freed, glibc keeps for the next what is freed
GELSD_UP_TO = 672  # actuators; beyond, E alone takes gigabytes
START = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)


def ring_layout(n: int) -> tn.Layout:
    """Return rings of 9 + 6 k as on LBT672, the outermost with what is left of n."""
    counts: list[int] = []
    while sum(counts) < n:
        counts.append(min(9 + 6 * len(counts), n - sum(counts)))
    return tn.rings([0.043 + 0.0303 * k for k in range(len(counts))], counts)


def balanced_cycles(
    n: int, cycles: int, coil: float = 0, bias: float = 0, shapes: int | None = None
) -> Iterator[tn.Cycle]:
    """Yield cycles x 2 loads x 2 shapes (n unless given) of random forces that balance, and noise.

    With gradients of coils [1/m] and bias magnets [N/m] POSITION is recorded, too.
    """
    random, layout, m = np.random.default_rng(1), ring_layout(n), shapes or n
    a = arms(layout)
    inverse = np.linalg.pinv(a)
    alpha = random.uniform(0.9, 1.1, n)
    weight, bias_force = -0.065 * n, 0.097 * n
    elastic = 0.1 * random.standard_normal((m, n))
    z = 1e-6 * random.standard_normal((m, n))
    known: dict[str, Any] = (
        {"coil_gradient": coil, "bias_gradient": bias} if coil else {"force_error": NOISE}
    )
    for place, load in enumerate((tn.Load("bare"), tn.Load("ring", -0.5, 0.005, tool="ring"))):
        k = np.array([weight + load.added + bias_force, 0.02, -0.03])
        exact = np.empty((m, 2, n))
        for at, sign in enumerate((1.0, -1.0)):
            # All that the bias magnets change, the coils must balance.
            exact[:, at] = sign * elastic
            exact[:, at] -= (exact[:, at] @ a.T + sign * bias * z @ a.T + k) @ inverse.T
            exact[:, at] /= alpha * (1.0 + sign * coil * z)
        rows = exact.reshape(2 * m, n)
        for number in range(1, cycles + 1):
            force = random.standard_normal(rows.shape)
            force *= NOISE
            force += rows
            position = None
            if coil:
                position = np.stack([z, -z], axis=1).reshape(2 * m, n)
                position += 1e-5 * random.standard_normal(n)  # where each sensor has its zero
                position.setflags(write=False)
            force.setflags(write=False)
            yield tn.Cycle(
                instrument=f"RING{n}",
                date=START + datetime.timedelta(hours=place * cycles + number),
                number=number,
                load=load,
                weight=weight,
                weight_error=0.02,
                layout=layout,
                time=0.5 * np.arange(2 * m, dtype=float),
                shape=np.repeat(np.arange(1, m + 1), 2),
                sign=np.tile([1, -1], m),
                force=force,
                position=position,
                valid=np.ones(2 * m, dtype=bool),
                **known,
            )


@contextmanager
def replaced(module: Any, name: str, value: Any) -> Iterator[None]:
    """Put another value in place of a module's for a while."""
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


def without_cycle_errors(campaign: tn.Campaign) -> tn.Calibration:
    """Calibrate, but for E_CYCLE."""
    with replaced(methods, "cycle_errors", lambda data, _: np.full(data.layout.n, np.nan)):
        return tn.calibrate(campaign)


def without_the_unseen(campaign: tn.Campaign) -> tn.Calibration:
    """Calibrate, but do not ask what no data show."""
    with replaced(campaign_ml, "unseen_errors", lambda _: ()):
        return without_cycle_errors(campaign)


def without_catalogue(campaign: tn.Campaign) -> tn.Calibration:
    """Calibrate, but look for no effects, nor for what no data show."""

    with replaced(campaign_ml, "examined", lambda plain, *_: plain):
        return without_the_unseen(campaign)


def iterations_taken(campaign: tn.Campaign) -> int:
    """Count the steps of all minimisations of one calibration."""
    taken: list[int] = []
    minimise = likelihood.minimise  # as problem.py imports it

    def counted(*arguments: Any, **options: Any) -> Any:
        estimate = minimise(*arguments, **options)
        taken.append(estimate.iterations)
        return estimate

    with replaced(problem, "minimise", counted):
        without_catalogue(campaign)
    return sum(taken)


def distinct_shapes(campaign: tn.Campaign) -> list[np.ndarray]:
    """Return (2 n, n) mean forces of each load; every cycle has its shapes in the same order."""
    return [
        np.mean(
            [c.force for c, at in zip(campaign.cycles, campaign.load_index, strict=True)
             if at == place], axis=0
        )
        for place in range(len(campaign.loads))
    ]  # fmt: skip


def reference_steps(campaign: tn.Campaign, iterations: int) -> dict[str, Callable[[], Any]]:
    """Return what no calibration can do without, as three steps."""
    means = distinct_shapes(campaign)
    n = campaign.layout.n
    regular = np.asfortranarray(dsyrk(1.0, means[0].T) + np.eye(n))

    def factor() -> None:
        for _ in range(iterations):
            scipy.linalg.cholesky(regular, check_finite=False)

    return {
        "one pass over the bytes": lambda: [np.asarray(c.force).sum() for c in campaign.cycles],
        f"one DSYRK a load: {2 * len(means)} n^3": lambda: [dsyrk(1.0, mean.T) for mean in means],
        f"Cholesky x {iterations} iterations: {iterations / 3:.2f} n^3": factor,
    }


def steps_of_errors(campaign: tn.Campaign) -> dict[str, Callable[[], Any]]:
    """Return what start and errors cost besides, each step as bare as can be."""
    means = distinct_shapes(campaign)
    n = campaign.layout.n
    regular = np.asfortranarray(dsyrk(1.0, means[0].T) + np.eye(n))
    factor = np.asfortranarray(scipy.linalg.cholesky(regular))
    diagonal = np.ones(n)[:, None]

    def scatter() -> None:
        total, furthest = np.zeros(n), np.zeros(n)
        for cycle, place in zip(campaign.cycles, campaign.load_index, strict=True):
            for start in range(0, len(cycle.force), ROWS_AT_ONCE):
                rows = slice(start, start + ROWS_AT_ONCE)
                apart = cycle.force[rows] - means[place][rows]
                apart *= apart
                total += apart.sum(axis=0)
                np.maximum(furthest, apart.max(axis=0), out=furthest)

    inverse = np.asfortranarray(scipy.linalg.inv(regular))

    def product() -> None:
        dsyrk(1.0, diagonal * inverse, trans=True, beta=1.0, c=inverse)

    return {
        "scatter of the repeats": scatter,
        "Cholesky for the start: 0.33 n^3": lambda: scipy.linalg.cholesky(
            regular, check_finite=False
        ),
        "H^-1: 0.67 n^3": lambda: mirrored(dpotri(factor)[0]),
        PRODUCT: product,
    }


def reading_steps(campaign: tn.Campaign, folder: Path) -> dict[str, Callable[[], Any]]:
    """Return what a calibration from files costs besides."""
    tn.write_campaign(campaign.cycles, folder)
    paths = sorted(folder.iterdir())
    contents = [path.read_bytes() for path in paths]
    return {
        "reading the bytes": lambda: [path.read_bytes() for path in paths],
        "SHA256": lambda: [hashlib.sha256(raw).hexdigest() for raw in contents],
        "one FITS checksum": lambda: [
            int(np.frombuffer(raw, dtype=">u4").sum(dtype=np.uint64)) for raw in contents
        ],
        "tn.read: all of it, and checks": lambda: tn.read(folder),
    }


def gelsd_on_e(campaign: tn.Campaign) -> Callable[[], Any]:
    """Return LAPACK's gelsd on the explicit E; building E is not counted."""
    e, r = system_e(campaign, enabled_arms(campaign.layout))
    return lambda: scipy.linalg.lstsq(e, r, lapack_driver="gelsd", check_finite=False)


def least(steps: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Return the least seconds of each step, the steps taking turns."""
    for step in steps.values():
        step()
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(repeats):
        for name, step in steps.items():
            start = time.process_time()
            step()
            seconds[name].append(time.process_time() - start)
    return {name: min(values) for name, values in seconds.items()}


def peak_memory(step: Callable[[], Any]) -> float:
    """Return the peak of what a step allocates [MB]."""
    tracemalloc.start()
    step()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1e6


def measure(n: int, repeats: int) -> None:
    """Measure one mirror and print its table."""
    print(f"n = {n}: making the campaign", file=sys.stderr)
    campaign = tn.Campaign(tuple(balanced_cycles(n, CYCLES)))
    size = sum(np.asarray(cycle.force).nbytes for cycle in campaign.cycles) / 1e6
    begin = time.process_time()
    iterations = iterations_taken(campaign)
    first = time.process_time() - begin
    np.empty(HEAP, dtype=np.uint8)
    reference = reference_steps(campaign, iterations)
    calibration = without_cycle_errors(campaign)
    values = np.concatenate(
        [calibration.alpha, [calibration.bias_force],
         np.column_stack([calibration.torque_y, calibration.torque_x]).ravel()]
    )  # fmt: skip
    print(f"n = {n}: timing", file=sys.stderr)
    errors = steps_of_errors(campaign)
    main = {
        **reference,
        **errors,
        "calibrate": lambda: without_catalogue(campaign),
        "calibrate, effects looked for": lambda: without_the_unseen(campaign),
        "calibrate, all of it": lambda: without_cycle_errors(campaign),
    }
    taken = least(main, repeats)
    beside = {"E_CYCLE": lambda: cycle_errors(campaign, values)}
    if n <= GELSD_UP_TO:
        beside["gelsd on E"] = gelsd_on_e(campaign)
    taken |= least(beside, min(repeats, 3))
    with tempfile.TemporaryDirectory() as folder:
        taken |= least(reading_steps(campaign, Path(folder) / "campaign"), min(repeats, 3))
    whole = sum(taken[name] for name in reference)
    with_errors = whole + sum(taken[name] for name in errors)
    peak = peak_memory(main["calibrate"])
    square = 8e-6 * n**2

    print(
        f"\n{n} actuators, {CYCLES} cycles x {len(campaign.loads)} loads x {2 * n} shapes:"
        f" {size:.0f} MB of forces"
    )
    lines = [(name, taken[name]) for name in reference]
    lines += [("reference, the sum of these", whole)]
    lines += [(name, taken[name]) for name in errors]
    lines += [("reference with start and errors", with_errors), ("calibrate", taken["calibrate"])]
    lines += [("calibrate, the first of its size", first)]
    lines += [(name, taken[name]) for name in taken if name not in main]
    for name, seconds in lines:
        print(f"  {name:35s} {1e3 * seconds:9.1f} ms {seconds / whole:8.2f} x reference")
    shapes = 16e-6 * n**2 * len(campaign.loads)
    print(
        f"  peak memory of calibrate beside the forces {peak:.1f} MB"
        f" = distinct shapes {shapes:.1f} MB + {(peak - shapes) / square:.1f} n^2"
    )
    calibrated = taken["calibrate"]
    catalogue = taken["calibrate, effects looked for"] - calibrated
    unseen = taken["calibrate, all of it"] - taken["calibrate, effects looked for"]
    ratios = [
        ("the catalogue of effects / calibrate", catalogue / calibrated, 2),
        ("what no data can show / calibrate", unseen / calibrated, None),
        ("calibrate / reference", calibrated / whole, 1.5),
        ("E_ALPHA without COVARIANCE / reference", (with_errors - taken[PRODUCT]) / whole, None),
        ("reference with start and errors / reference", with_errors / whole, None),
        ("calibrate / reference with start and errors", calibrated / with_errors, 1.5),
    ]
    if "gelsd on E" in taken:
        wanted = 10 if n == 672 else None
        ratios += [("gelsd on E / calibrate", taken["gelsd on E"] / calibrated, wanted)]
    for name, ratio, at_most in ratios:
        print(f"  {name:45s} = {ratio:.2f}" + (f"  (wanted: {at_most})" if at_most else ""))
    sys.stdout.flush()


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", type=int, nargs="+", default=[45, 336, 672, 1170])
    parser.add_argument("--repeats", type=int, default=40)
    options = parser.parse_args()
    for n in options.actuators:
        measure(n, options.repeats)


if __name__ == "__main__":
    main()
