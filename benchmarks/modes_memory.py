"""What `find_modes` takes of memory and time, in matrices of n x n.

    python benchmarks/modes_memory.py [--actuators 500,1170] [--sensors]

A random stiffness that lets rigid motions go free, alpha known, and with --sensors gains and places
of the sensors, too. What Python allocates (tracemalloc), LAPACK's work space included: its peak and
what is kept, stage by stage, beside the stiffness and the calibration that are given.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from speed import START, ring_layout

import truenewton as tn
from truenewton.estimation.findings.estimate import Sensor
from truenewton.modal import findings, true_stiffness
from truenewton.statics.arms import arms

STAGES = ((findings, "true_stiffness"), (true_stiffness, "stiffness_modes"),
          (findings, "seen_turbulence"), (findings, "modal_base"))  # fmt: skip
OFFSET = 3e-4  # of a sensor off its magnet along an axis [m]


def staged(function: Callable[..., Any], unit: float) -> Callable[..., Any]:
    """Return the function, which says what it took."""

    def run(*arguments: Any, **options: Any) -> Any:
        tracemalloc.reset_peak()
        start = time.process_time()
        made = function(*arguments, **options)
        held, peak = (size / unit for size in tracemalloc.get_traced_memory())
        taken = time.process_time() - start
        print(f"  {function.__name__:18s} peak {peak:5.2f}, after it {held:5.2f}; {taken:7.2f} s")
        return made

    return run


def mirror_of(n: int) -> tuple[tn.StiffnessMatrix, tn.Calibration]:
    """Return a random mirror of n actuators, and its calibration, which knows the sensors too."""
    random, layout = np.random.default_rng(1), ring_layout(n)
    rigid = np.linalg.qr(arms(layout).T)[0]
    root = random.standard_normal((n, n))
    root -= (root @ rigid) @ rigid.T
    alpha = random.uniform(0.9, 1.1, n)
    matrix = tn.StiffnessMatrix(f"RING{n}", START, layout, 1e3 / n * root.T @ root / alpha[:, None])
    with warnings.catch_warnings(action="ignore"):
        calibration = tn.calibrate(matrix, "svd")
    sensors = tuple(
        Sensor(k, gain, 1e-3, x, 1e-5, y, 1e-5, "fitted")
        for k, gain, (x, y) in zip(
            layout.id.tolist(),
            random.normal(1.0, 0.003, n),
            random.normal(0.0, OFFSET, (n, 2)),
            strict=True,
        )
    )
    return matrix, replace(calibration, sensors=sensors)


def measure(n: int, *, sensors: bool) -> None:
    """Find the modes of a mirror of n actuators; print what that took."""
    matrix, calibration = mirror_of(n)
    if not sensors:
        calibration = replace(calibration, sensors=())
    known = "known" if sensors else "not known"
    print(f"{n} actuators, in matrices of {8e-6 * n * n:.1f} MB; sensors {known}:")
    before = [getattr(*stage) for stage in STAGES]
    for stage, function in zip(STAGES, before, strict=True):
        setattr(*stage, staged(function, 8.0 * n * n))
    tracemalloc.start()
    try:
        tn.find_modes(matrix, calibration, accept_rejected=True, diameter=8.2)
    finally:
        tracemalloc.stop()
        for stage, function in zip(STAGES, before, strict=True):
            setattr(*stage, function)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", default="500,1170")
    parser.add_argument("--sensors", action="store_true")
    asked = parser.parse_args()
    for n in map(int, asked.actuators.split(",")):
        measure(n, sensors=asked.sensors)


if __name__ == "__main__":
    main()
