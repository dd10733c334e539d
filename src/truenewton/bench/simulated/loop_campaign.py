"""The simulated mirror in closed loop: the same campaign as the static one, with its dynamics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from truenewton.arrays import Array
from truenewton.bench.simulated.control import Control
from truenewton.bench.simulated.loop import Loop, equilibrium
from truenewton.bench.simulated.plant import film_damping
from truenewton.bench.simulated.stability import closed_loop
from truenewton.bench.simulated.static import StaticBench, run_cycles
from truenewton.mirrors.shell.moving_mass import moving_mass
from truenewton.records.cycle import Cycle


def loop_of(bench: StaticBench) -> Loop:
    """Close the loop around the glass of a bench, its feed-forward as a calibration gives it.

    Raises
    ------
    LoopUnstable
        The gains do not hold it.
    """
    n = bench.mirror.layout.n
    mass, pucks = moving_mass(bench.glass)
    # M z'' + C z' + K~ z = S' f, in terms of f
    to_forces = np.asarray(np.linalg.inv(pucks.T), dtype=float)
    softer = bench.glass.stiffness - bench.coils.bias_gradient * np.eye(n)
    feed_forward = softer / bench.coils.alpha[:, None] * bench.sensors.gain
    return closed_loop(
        bench.glass.stiffness,
        to_forces @ mass,
        film_damping(bench.mirror.gap) * to_forces,
        bench.coils,
        bench.sensors,
        Control(feed_forward),
    )


def rest_displacement(bench: StaticBench) -> Array:
    """Return (L, n) the true displacement at which the loop holds the flat mirror under each load.

    Along +z [m]. There a coil gives alpha (1 + COILGRAD z), and that is what a campaign in closed
    loop can find; `Truth.alpha` is that at z = 0.
    """
    flat = np.zeros((bench.mirror.layout.n, len(bench.loads)))
    return equilibrium(loop_of(bench), flat, bench.load_force.T)[0].T


def run_loop_cycles(bench: StaticBench, cycles: int) -> Iterator[Cycle]:
    """Yield the cycles of a campaign in closed loop, all shapes of a cycle together.

    A row that has not settled is marked as not valid; what noise the forces have is left to their
    repeats to tell.

    Raises
    ------
    LoopUnstable, BenchFault
    """
    yield from run_cycles(bench, cycles, loop_of(bench))
