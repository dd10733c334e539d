"""What `find_modes` takes of memory and time, in matrices of n x n.

    python benchmarks/modes_memory.py [--actuators 300,600]

A random stiffness that lets rigid motions go free, alpha known; what Python allocates
(tracemalloc), its peak and what the findings keep, stage by stage.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from speed import START, ring_layout

import truenewton as tn
from truenewton.modal import findings
from truenewton.statics.arms import arms

STAGES = ("true_stiffness", "seen_turbulence", "modal_base", "compare_modes")


def staged(function: Callable[..., Any], unit: float) -> Callable[..., Any]:
    """Return the function, which says what it took."""

    def run(*arguments: Any, **options: Any) -> Any:
        tracemalloc.reset_peak()
        start = time.process_time()
        made = function(*arguments, **options)
        held, peak = (size / unit for size in tracemalloc.get_traced_memory())
        taken = time.process_time() - start
        print(f"  {function.__name__:18s} peak {peak:5.1f}, after it {held:5.1f}; {taken:7.2f} s")
        return made

    return run


def measure(n: int) -> None:
    """Find the modes of a random mirror of n actuators; print what that took."""
    random, layout = np.random.default_rng(1), ring_layout(n)
    rigid = np.linalg.qr(arms(layout).T)[0]
    root = random.standard_normal((n, n))
    root -= (root @ rigid) @ rigid.T
    alpha = random.uniform(0.9, 1.1, n)
    stiffness = 1e3 / n * root.T @ root / alpha[:, None]
    matrix = tn.StiffnessMatrix(f"RING{n}", START, layout, stiffness)
    del root, stiffness
    with warnings.catch_warnings(action="ignore"):
        calibration = tn.calibrate(matrix)
    print(f"{n} actuators, in matrices of {8e-6 * n * n:.1f} MB:")
    before = {name: getattr(findings, name) for name in STAGES}
    for name, function in before.items():
        setattr(findings, name, staged(function, 8.0 * n * n))
    tracemalloc.start()
    try:
        tn.find_modes(matrix, calibration, force=True)
    finally:
        tracemalloc.stop()
        for name, function in before.items():
            setattr(findings, name, function)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--actuators", default="300,600")
    for n in map(int, parser.parse_args().actuators.split(",")):
        measure(n)


if __name__ == "__main__":
    main()
