"""Beside the paper's laboratory: errors over the cycles, strokes, weight tools, its wedges.

python -m studies.paper [--seeds 4]

The simulated P45, 4 cycles without and with the ring, of shapes whose forces stay below a limit.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import truenewton as tn
from truenewton.bench.simulated.static import StaticBench, run_cycles, static_bench
from truenewton.mirrors.known import p45
from truenewton.mirrors.shell.shell_model import forces_under, model_shell, weight_on

LIMITS = (0.3, 0.1, 0.03, 0.01, 0.004)  # of the elastic forces of a shape [N]
NOISES = {"0.1 mN": 1e-4, "12 uN, as in closed loop": 12e-6}


def gentler(bench: StaticBench, limit: float) -> StaticBench:
    """Return the bench with shapes scaled so that elastic forces do not exceed the limit [N]."""
    force = np.abs(bench.shapes @ bench.glass.stiffness.T).max(axis=1)
    shrunk = np.minimum(1.0, limit / np.maximum(force, 1e-12))
    return replace(bench, shapes=shrunk[:, None] * bench.shapes)


def errors(seeds: int) -> None:
    """Print E_CYCLE, the paper's error, as a function of the forces of the shapes."""
    print("\npaper: errors 6.6e-4 to 1.6e-2, strokes of 1 um in tip and tilt only")
    print(f"{'forces below':>14}{'shapes at 1 um':>16}{'median':>10}" + "".join(
        f"{'E_CYCLE at ' + name:>38}" for name in NOISES))  # fmt: skip
    benches = [static_bench(p45(), seed) for seed in range(1, seeds + 1)]
    for limit in LIMITS:
        stroke = np.abs(gentler(benches[0], limit).shapes).max(axis=1)
        cells = [f"{1e3 * limit:11.0f} mN", f"{(stroke > 0.999e-6).sum():16d}",
                 f"{1e6 * np.median(stroke):7.3f} um"]  # fmt: skip
        for noise in NOISES.values():
            found = [
                tn.calibrate(tn.Campaign(tuple(
                    run_cycles(replace(gentler(bench, limit), force_noise=noise), 4)
                ))).cycle_error
                for bench in benches
            ]  # fmt: skip
            lowest, highest = np.median([(e.min(), e.max()) for e in found], axis=0)
            cells.append(f"{lowest:28.1e} to {highest:.1e}")
        print("".join(cells), flush=True)


def tools(seeds: int) -> None:
    """Print the effect of the weight of the tool on the scale."""
    print("\nscale of alpha, its stated error and its RMS error, against the weight of the tool")
    for times in (0.25, 0.5, 1.0, 2.0):
        mirror = replace(p45(), added_weight=times * p45().added_weight)
        off, stated = [], []
        for seed in range(1, 8 * seeds + 1):
            bench = static_bench(mirror, seed)
            found = tn.calibrate(tn.Campaign(tuple(run_cycles(bench, 1))))
            off.append(np.mean(found.alpha / bench.truth.alpha) - 1)
            stated.append(np.mean(found.error / found.alpha))
        print(f"  {times:5.2f} Q  {np.mean(stated):8.2%} {np.sqrt(np.mean(np.square(off))):8.2%}")


def wedges() -> None:
    """Print the difference of forces between the ring on its wedges and a uniform load."""
    glass = model_shell(p45())
    none = forces_under(glass, weight_on(p45(), p45().weight))
    ring = forces_under(glass, weight_on(p45(), p45().weight, p45().added_weight)) - none
    even = forces_under(glass, weight_on(p45(), p45().weight + p45().added_weight)) - none
    off = 1e3 * (ring - even)
    total = abs(p45().layout.nz @ off)
    apart = f"{np.sqrt(np.mean(off**2)):.1f} mN rms apart, {total:.0e} mN in the sum"
    print(f"the ring takes {1e3 * ring.min():.1f} to {1e3 * ring.max():.1f} mN an actuator on its"
          f" wedges, {1e3 * even.min():.1f} to {1e3 * even.max():.1f} if it were spread evenly:"
          f" {apart}")  # fmt: skip


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=4)
    seeds = parser.parse_args().seeds
    wedges()
    errors(seeds)
    tools(seeds)


if __name__ == "__main__":
    main()
