"""The simulated bench: what it costs, what its noise is worth, which imperfection costs what.

python -m studies.bench                    times of the shell models and of the closed loop
python -m studies.bench --large 5352       a static bench of actuators on rings
python -m studies.bench --coverage 200     closed-loop campaigns of P45: errors and chi^2
python -m studies.bench --imperfections 5  error caused by each neglected imperfection
python -m studies.bench --rings 10         336 actuators on a curved shell, noise of the loop
python -m studies.bench --settling         settling of the loop of P45; waiting time
python -m studies.bench --tilt 50          coils that shift when the mirror is tilted
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np

import truenewton as tn
from studies.accuracy import TWO_SIGMA, large_mirror, rms
from studies.closed_loop import only, settling_time, step_responses
from studies.matrices import measured_lbt672
from truenewton.arrays import Array
from truenewton.bench.simulated.loop import Loop, samples_of, slowest_creep
from truenewton.bench.simulated.static import (
    StaticBench,
    loop_of,
    rest_displacement,
    run_cycles,
    static_bench,
)
from truenewton.figures.style import CURVES, INK, STYLE, new_figure
from truenewton.mirrors.glass import Annulus, Points
from truenewton.mirrors.known import lbt672, mmt336, p45, ring
from truenewton.mirrors.shell.mesh import shell_mesh
from truenewton.mirrors.shell.meshed_shell import MeshedShell
from truenewton.mirrors.shell.round_shell import RoundShell
from truenewton.mirrors.shell.shell_model import (
    condense,
    model_shell,
    rigid_motions,
)

T = TypeVar("T")


def timed(what: str, step: Callable[[], T]) -> T:
    """Run a step; print its duration and the peak memory so far."""
    start = time.perf_counter()
    result = step()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"  {what:58s} {time.perf_counter() - start:8.2f} s, {peak:7.0f} MB so far", flush=True)
    return result


def stiffness(free: RoundShell | MeshedShell, at: Points, sensor: Annulus | None = None) -> Array:
    """Return force per reading of a shell with free rigid-body motions 1, x, y [N/m]."""
    return condense(free.influence(at, at, sensor), rigid_motions(*at)).stiffness


def costs() -> None:
    """Print times of the shell models and the loop, and the agreement of the models."""
    mirror = lbt672()
    at = mirror.shell.along(mirror.layout.x, mirror.layout.y)
    print("LBT672, stiffness between 672 actuators read by annulus sensors")
    shell, sensor = mirror.shell, mirror.sensor
    series = timed("semi-analytic", lambda: stiffness(RoundShell(shell), at, sensor))
    mesh = timed(
        "finite elements of 15 mm",
        lambda: stiffness(MeshedShell(shell, shell_mesh(shell, *at, mesh_size=15e-3)), at, sensor),
    )
    one, other = (np.linalg.svd(k, compute_uv=False)[:-3] for k in (series, mesh))
    print(f"  their singular values agree to {np.abs(other / one - 1).max():.1e}")
    print("P45, 4 cycles x 2 loads x 90 shapes")
    bench = timed("the bench: shell, truth, shapes", lambda: static_bench(p45(), 1))
    timed("static", lambda: list(run_cycles(bench, 4)))
    timed(
        "closed loop, 1,433 + 2,048 samples of each",
        lambda: list(run_cycles(bench, 4, loop_of(bench))),
    )


def large(n: int) -> None:
    """Print time and memory of a static bench of n actuators."""
    bench = timed(f"static bench of {n} actuators", lambda: static_bench(ring(n), 1))
    most = np.abs(bench.load_force).max()
    print(f"  {len(bench.shapes)} shapes; the flat mirror takes {most:.2g} N an actuator at most")


def reduced_chi2(found: tn.Calibration) -> float:
    assert found.goodness is not None
    return found.goodness.reduced


def known(bench: StaticBench) -> np.ndarray:
    """Return alpha for the declared weight of the ring; alpha is proportional to Q."""
    return bench.truth.alpha * bench.loads[1].added / bench.truth.added[1]


def at_mean(bench: StaticBench, rest: np.ndarray) -> np.ndarray:
    """Return 1 + COILGRAD z at the mean z of a campaign in closed loop, from (L, n) z of the loads.

    True alpha refers to the nominal gap, but the rest position depends on the load. A campaign
    measures alpha at the mean position of its cycles, computed from the loop (`rest_displacement`).
    """
    return 1.0 + bench.coils.coil_gradient * rest.mean(axis=0)


def coverage(seeds: int) -> None:
    """Print coverage, errors and chi^2 of closed-loop campaigns of P45, 2 cycles per load.

    Errors refer to alpha at the campaign's mean position (`at_mean`). chi^2 is also
    printed for true declared weights: BIASGRAD, assumed exact, fixes the scale through piston.
    """
    inside, outside, sizes, ratio, plain, weighed, rests = [], [], [], [], [], [], []
    for seed in range(seeds):
        bench = static_bench(p45(), seed)
        cycles = tuple(run_cycles(bench, 2, loop_of(bench)))
        found = tn.calibrate(tn.Campaign(cycles))
        rests.append(rest_displacement(bench))
        there = at_mean(bench, rests[-1])
        error = found.alpha - known(bench) * there
        inside.append(np.mean(np.abs(error) < TWO_SIGMA * found.statistical_error))
        beside = found.alpha - bench.truth.alpha * there
        outside.append(np.mean(np.abs(beside) < TWO_SIGMA * found.error))
        ratio.append(np.mean((error / found.statistical_error) ** 2))
        sizes.append(reduced_chi2(found))
        added = dict(zip(bench.loads, bench.truth.added, strict=True))
        exact = tuple(replace(c, load=replace(c.load, added=added[c.load])) for c in cycles)
        weighed.append(reduced_chi2(tn.calibrate(tn.Campaign(exact))))
        bare = tuple(replace(c, coil_gradient=None, bias_gradient=None) for c in cycles)
        if seed < 5:
            plain.append(reduced_chi2(tn.calibrate(tn.Campaign(bare))))
        if seed % 20 == 0:
            print(f"  {seed} of {seeds}", file=sys.stderr)
    spread = np.std(inside, ddof=1) / np.sqrt(seeds)
    print(f"P45 in closed loop, 2 cycles x 2 loads, {seeds} seeds")
    print(f"  95 % intervals of E_STAT cover {100 * np.mean(inside):.1f} +- {100 * spread:.1f} %"
          " (weights known)")  # fmt: skip
    wide = np.std(outside, ddof=1) / np.sqrt(seeds)
    print(f"  95 % intervals of E_ALPHA cover {100 * np.mean(outside):.1f} +- {100 * wide:.1f} %")
    print(f"  RMS error / E_STAT {np.sqrt(np.mean(ratio)):.3f}")
    for what, chi2 in (("as declared", sizes), ("true weights declared", weighed)):
        close = np.std(chi2, ddof=1) / np.sqrt(seeds)
        print(f"  chi2/DOF, {what}: {np.mean(chi2):.3f} +- {close:.3f},"
              f" from {min(chi2):.2f} to {max(chi2):.2f}")  # fmt: skip
    print(f"  chi2/DOF, gradients left out: {np.mean(plain):.0f}")
    off, apart = 1e9 * rms(np.mean(rests, axis=1)), 1e9 * rms(np.diff(rests, axis=1))
    print(f"  the glass rests {off:.0f} nm rms from its nominal place, {apart:.0f} nm rms apart"
          f" between loads, {1e9 * np.abs(np.diff(rests, axis=1)).max():.0f} at most")  # fmt: skip


def imperfect() -> Iterator[tuple[str, Callable[[StaticBench], StaticBench], dict[str, Any]]]:
    """Yield imperfections: name, change of the bench, and replaced declarations of the files."""

    def same(bench: StaticBench) -> StaticBench:
        return bench

    def even(bench: StaticBench) -> StaticBench:
        return replace(bench, sensors=replace(bench.sensors, gain=np.ones(bench.mirror.layout.n)))

    layout = p45().layout
    flat = tn.layout(layout.x, layout.y, id=layout.id)
    moved = np.random.default_rng(0).normal(0.0, 0.1e-3, (2, layout.n))
    off = tn.layout(layout.x + moved[0], layout.y + moved[1], nz=layout.nz)
    yield "nothing left out", same, {}
    yield "sensors of exact gain, for comparison", even, {}
    yield "COILGRAD not declared", same, {"coil_gradient": None}
    yield "BIASGRAD not declared", same, {"bias_gradient": None}
    yield "nz taken as 1, as in the paper", same, {"layout": flat}
    yield "magnets 0.1 mm off their declared places", same, {"layout": off}


def imperfections(seeds: int) -> None:
    """Print the error caused by each neglected imperfection, in closed loop and at 0.1 mN."""
    errors: dict[tuple[str, bool], list[float]] = defaultdict(list)
    sizes: dict[tuple[str, bool], list[float]] = defaultdict(list)
    for bench in (static_bench(p45(), seed) for seed in range(seeds)):
        for closed in (True, False):
            exact = tuple(run_cycles(bench, 4, loop_of(bench) if closed else None))
            for name, change, declared in imperfect():
                other, made = change(bench), exact
                if other is not bench:
                    made = tuple(run_cycles(other, 4, loop_of(other) if closed else None))
                found = tn.calibrate(tn.Campaign(tuple(replace(c, **declared) for c in made)))
                relative = found.alpha / known(bench)
                if closed:
                    relative /= at_mean(bench, rest_displacement(other))
                errors[name, closed].append(np.std(relative))
                sizes[name, closed].append(reduced_chi2(found))
    print(f"P45, 4 cycles x 2 loads, {seeds} seeds: RMS error of alpha beside the common scale")
    head = ("closed loop", "chi2/DOF", "at 0.1 mN", "chi2/DOF")
    print(f"  {'left out':44s}" + "".join(f"{name:>14s}" for name in head))
    for name, _, _ in imperfect():
        print(f"  {name:44s}", *(
            f"{rms(np.array(errors[name, closed])):13.1e}{np.mean(sizes[name, closed]):14.2f}"
            for closed in (True, False)
        ))  # fmt: skip


def rings(count: int) -> None:
    """Print the error of ml relative to its bound on MMT336, with two cycles and loop noise."""
    print("MMT336, curved shell, 2 cycles, ml")
    large_mirror(mmt336(), count, (4e-6, 12e-6, 1e-4))


def tilt(seeds: int) -> None:
    """Print the error of the scale from a tilt of 60 degrees, relative to the stated error."""
    print(f"P45, bare and leaning by 60 +- 0.1 deg, 2 cycles each, {seeds} seeds from 1000")
    print("  rms error of the scale over that stated; stated error")
    ungraded: dict[str, Any] = {"coil_gradient": None, "bias_gradient": None}
    glass = model_shell(p45())
    for what, left_out in (
        ("COILZ +- 0.5 um", {}),
        ("no COILZ", {}),
        ("no COILZ, COILGRAD, BIASGRAD", ungraded),
    ):
        print(f"  {what:30s}", end="")
        for shift in (0.0, 2e-6, 5e-6, 10e-6):
            declared = what.startswith("COILZ")
            tilted = tn.Load(
                "tilted", tilt=60.0, tilt_error=0.1, coil_shift=shift,
                coil_shift_error=0.5e-6 if declared else None,
            )  # fmt: skip
            found = []
            for seed in range(1000, 1000 + seeds):
                bench = static_bench(p45(), seed, loads=(tn.Load("bare"), tilted), glass=glass)
                cycles = tuple(replace(cycle, **left_out) for cycle in run_cycles(bench, 2))
                if not declared:
                    cycles = tuple(
                        replace(cycle, load=replace(cycle.load, coil_shift=None))
                        for cycle in cycles
                    )
                made = tn.calibrate(tn.Campaign(cycles))
                along = made.alpha / (made.alpha @ made.alpha)
                stated = np.sqrt(along @ made.covariance[:45, :45] @ along)
                found.append((along @ (bench.truth.alpha - made.alpha), stated))
            off, stated = np.array(found).T
            print(f"   {1e6 * shift:2.0f} um {rms(off / stated):.2f}, {100 * rms(stated):.2f} %",
                  end="", flush=True)  # fmt: skip
        print()


WAITS = (0.02, 0.05, 0.1, 0.15, 0.2)  # [s]


def settling() -> None:
    """Print how the loop of P45 settles."""
    bench = static_bench(p45(), 1)
    loop = loop_of(bench)
    print(f"P45, damping {bench.mirror.damping:g} N s/m per actuator")
    print(f"  longest time constant, integrator still: {1e3 * slowest_creep(loop):.2f} ms")
    steps = step_responses(loop, bench.glass.stiffness, duration=12e-3)
    after = ", ".join(f"{1e3 * t:.2f}" for t in settling_time(steps.time, steps.position, 0.1))
    print(f"  step of the softest, median and stiffest mode, within 10 % after: {after} ms")
    print("  pseudo-integrator and all: waited, what readings and the sum of true forces miss")
    for wait, off, force in left_to_go(bench, loop):
        print(f"  {wait:8.2f} s {1e9 * off:8.2f} nm {1e6 * force:8.0f} uN")


def left_to_go(bench: StaticBench, loop: Loop) -> Iterator[tuple[float, float, float]]:
    """Yield waiting times [s], and remaining changes of readings [m] and of the net force [N]."""
    every, alpha = 60, loop.coils.alpha[:, None]
    quiet = only(loop, (), ())
    shapes, load_force = bench.shapes[::5].T, bench.load_force[0][:, None]
    steps = samples_of(quiet, shapes, load_force, (), round(0.4 * loop.control.rate))
    walk = [(force, z) for force, _, z in islice(steps, 0, None, every)]
    force, z = (np.array(each) for each in zip(*walk, strict=True))
    for wait in WAITS:
        k = round(wait * loop.control.rate / every)
        summed = (alpha * (force[k] - force[-1])).sum(axis=0)
        yield wait, float(np.abs(z[k] - z[-1]).max()), float(np.abs(summed).max())


def glass(path: str) -> None:
    """Draw the singular values of the model of LBT672 and the measured ones."""
    matrix = measured_lbt672()
    mirror = lbt672()
    at = mirror.shell.along(matrix.layout.x, matrix.layout.y)
    measured = np.linalg.svd(matrix.stiffness, compute_uv=False)[::-1]
    flat = replace(mirror.shell, radius_of_curvature=np.inf)
    models = {
        "model, curved, sensors": stiffness(RoundShell(mirror.shell), at, mirror.sensor),
        "model, curved, points": stiffness(RoundShell(mirror.shell), at),
        "model, flat, sensors": stiffness(RoundShell(flat), at, mirror.sensor),
    }
    figure = new_figure(0.8)
    ax = figure.add_subplot()
    with mpl.rc_context(STYLE):
        order = np.arange(1, len(measured) + 1)
        ax.loglog(order, measured, color=INK, linewidth=1.6, label="measured, 2011")
        for (name, k), colour, line in zip(models.items(), CURVES, ("-", ":", "--"), strict=False):
            values = np.linalg.svd(k, compute_uv=False)[::-1]
            ax.loglog(order[3:], values[3:], line, color=colour, label=name)
            soft, middle = (np.median(values[part] / measured[part]) for part in
                            (slice(8, 25), slice(300, 350)))  # fmt: skip
            print(f"{name}: modes 9 to 25 {soft:.2f} of the measured, the middle {middle:.2f},"
                  f" the stiffest {values[-1] / measured[-1]:.2f}")  # fmt: skip
        ax.set_xlabel("mode, softest first")
        ax.set_ylabel("stiffness (N/m)")
        ax.legend(fontsize=6.5, frameon=False)
    figure.savefig(path, dpi=200)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parts: tuple[tuple[Callable[[Any], None], type, str], ...] = (
        (large, int, "N"), (coverage, int, "SEEDS"), (imperfections, int, "SEEDS"),
        (rings, int, "CAMPAIGNS"), (glass, str, "PNG"), (tilt, int, "SEEDS"),
    )  # fmt: skip
    for part, kind, metavar in parts:
        parser.add_argument(f"--{part.__name__}", type=kind, metavar=metavar)
    parser.add_argument("--settling", action="store_true")
    options = vars(parser.parse_args())
    for part, *_ in parts:
        if options[part.__name__]:
            part(options[part.__name__])
            return
    if options["settling"]:
        settling()
    else:
        costs()


if __name__ == "__main__":
    main()
