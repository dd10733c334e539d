"""What is written down of a shape in closed loop: means over the samples of a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.bench.protocol import BATCHES, error_of_mean
from truenewton.bench.simulated.loop import Loop, samples_of, slowest_creep
from truenewton.bench.simulated.noise import SAMPLES
from truenewton.errors import LoopUnstable

RAMPED = 2e-3  # after which commands and filters stand still [s, derived]
CREEPS = 8.0  # time constants of the slowest motion, which leave 3e-4 of it [derived]
RELEASED = 12e-3  # with the pseudo-integrator let go, before the first sample [s, derived]
DRIFT = 1e-9  # between the halves of a record, of what has settled [m, derived]
GROWTH = 1.5  # of the noise between the halves, of what is stable
QUIET = 10e-3  # twice the usual scatter of force; below it nothing is said to grow [N]


@dataclass(frozen=True, eq=False)
class Record:
    """What is written down of each shape.

    Attributes
    ----------
    force, force_scatter
        (n, batch) mean and standard deviation of what the DAC was told [N].
    position, position_scatter
        (n, batch) mean and standard deviation of the reading along +z [m].
    settled
        (batch,) no mean reading changed by more than `DRIFT` between the halves: through the air
        film a steady drift pulls by 64 N s/m x 1 nm / 14 ms = 4 uN at most.

    force_error
        (n, batch) standard deviation of the mean force, by batch means [N]; None of a record too
        short for it. Samples follow each other closely: of the forces, whose scatter is mostly what
        the derivative makes of noise, it is far less than scatter / samples^1/2.
    """

    force: Array
    force_scatter: Array
    position: Array
    position_scatter: Array
    settled: NDArray[np.bool_]
    force_error: Array | None


def record(
    loop: Loop,
    shapes: Array,
    load_force: Array,
    noise: Sequence[np.random.Generator] = (),
    *,
    settling: float | None = None,
    samples: int = SAMPLES,
) -> Record:
    """Step from the flat mirror to each shape, wait, and record.

    The pseudo-integrator would take some 100 ms. So it is put at once where it ends, which is
    known, and let go when the glass has crept there through the air film. Arguments are those of
    `samples_of`, the settling from the command to the first sample [s], by itself as long as that
    takes, and the samples of the record.

    Raises
    ------
    BenchFault
        A coil saturated, a gap closed, a sensor went out of range.
    LoopUnstable
        The noise grew during the record.
    """
    swift = RAMPED + CREEPS * slowest_creep(loop)
    wait = round((swift + RELEASED if settling is None else settling) * loop.control.rate)
    held = min(round(swift * loop.control.rate), wait)
    steps = samples_of(loop, shapes, load_force, noise, wait + samples, held=held)
    recorded = (np.array([force, read]) for force, read, _ in islice(steps, wait, None))
    # Sums about the first sample, so that squares do not drown what they differ by.
    first = next(recorded)
    total, square = (np.zeros((parts, 2, *shapes.shape)) for parts in (BATCHES, 2))
    for k, value in enumerate(recorded, start=1):
        off, batch = value - first, BATCHES * k // samples
        total[batch] += off
        square[2 * batch // BATCHES] += off * off
    size = np.bincount(BATCHES * np.arange(samples) // samples, minlength=BATCHES)
    halves = total.reshape(2, -1, *total.shape[1:]).sum(axis=1)
    in_half = np.maximum(size.reshape(2, -1).sum(axis=1), 1)[:, None, None, None]
    halves /= in_half
    _refuse_growth(np.sqrt(np.maximum(square / in_half - halves**2, 0))[:, 0])
    mean = total.sum(axis=0) / samples
    scatter = np.sqrt(np.maximum(square.sum(axis=0) / samples - mean**2, 0))
    batch_means = total[:, 0] / np.maximum(size, 1)[:, None, None]
    return Record(
        force=first[0] + mean[0],
        force_scatter=scatter[0],
        position=first[1] + mean[1],
        position_scatter=scatter[1],
        settled=np.abs(halves[1, 1] - halves[0, 1]).max(axis=0) <= DRIFT,
        force_error=error_of_mean(batch_means) if size.all() else None,
    )


def _refuse_growth(scatter: Array) -> None:
    """Refuse (2, n, batch) scatters of the force in both halves of which the second is larger."""
    grown = scatter[1] > np.maximum(GROWTH * scatter[0], QUIET)
    if grown.any():
        actuator, column = np.argwhere(grown)[0]
        raise LoopUnstable(
            f"the noise of actuator {actuator} in shape {column} grows",
            remedy="lower the gains",
            got=float(scatter[1, actuator, column]),
            want=float(scatter[0, actuator, column]),
        )
