"""The simulated bench, with the methods of any other bench; the truth stays inside."""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence

from truenewton.bench.protocol import Reading, Shape, Status, check_samples
from truenewton.bench.simulated.static import (
    PAUSE,
    SECONDS_PER_SHAPE,
    START,
    loop_of,
    static_bench,
    take,
)
from truenewton.bench.simulated.truth import truth_path, write_truth
from truenewton.errors import BenchFault, UnknownName
from truenewton.mirrors.known import Mirror
from truenewton.quantities import taking_units
from truenewton.statics.load import Load

FIDELITIES = ("static", "loop")


class SimulatedBench:
    """A simulated mirror with its electronics and weights.

    Parameters
    ----------
    mirror
        The nominal mirror.
    seed
        Of all random numbers. The noise of a reading depends on seed, load, cycle, number and sign
        of the shape only, so that readings can be repeated in any order.
    loads
        Those that can be put on, as declared; by default the bare mirror and its own tool.
    force_noise
        Standard deviation of one commanded-force reading of 2,048 samples [N]; not for a loop.
    fidelity
        'static': every shape is held exactly. 'loop': closed loop, sample by sample.

    Raises
    ------
    UnknownName
        There is no such fidelity.

    Attributes
    ----------
    instrument, layout, gap, gradients
        As of `Bench` and `gradients_of`.

    Examples
    --------
    >>> bench = tn.SimulatedBench(tn.mirrors.p45(), seed=1, force_noise=1e-4)
    >>> bench.instrument, bench.layout.n
    ('P45', 45)
    """

    @taking_units(force_noise="N")
    def __init__(
        self,
        mirror: Mirror,
        seed: int = 1,
        *,
        loads: Sequence[Load] = (),
        force_noise: float = 1e-4,
        fidelity: str = "static",
    ) -> None:
        if fidelity not in FIDELITIES:
            raise UnknownName(
                f"there is no fidelity '{fidelity}'", remedy=f"choose {', '.join(FIDELITIES)}"
            )
        self._bench = static_bench(mirror, seed, loads=loads, force_noise=force_noise)
        self._loop = loop_of(self._bench) if fidelity == "loop" else None
        self._loads = [load.key for load in self._bench.loads]
        self._load_index, self._counter, self._clock = 0, 0, START
        self._shape: Shape | None = None
        self.instrument, self.layout, self.gap = mirror.name, mirror.layout, mirror.gap
        self.gradients = mirror.coil_gradient, mirror.bias_gradient

    def put_on(self, load: Load) -> None:
        """Put a load on, or take it off for the bare mirror."""
        if load.key not in self._loads:
            raise UnknownName(
                f"the simulated bench has no load '{load.name}'",
                remedy=f"it has {', '.join(self._loads)}",
            )
        self._load_index = self._loads.index(load.key)
        self._clock += PAUSE

    def wait(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._clock += datetime.timedelta(seconds=seconds)

    def command(self, shape: Shape) -> None:
        """Bring the mirror to a shape."""
        if shape.position.shape != (self.layout.n,):
            raise BenchFault(
                f"{shape.position.size} displacements for {self.layout.n} actuators",
                remedy="plan for this mirror",
            )
        self._shape = shape

    def read(self, samples: int) -> Reading:
        """Return the mean of so many samples of the shape that is set."""
        check_samples(samples)
        shape, bench = self._shape, self._bench
        if shape is None:
            raise BenchFault("the mirror is at rest", remedy="command a shape before reading")
        self._counter += 1
        self._clock += datetime.timedelta(seconds=SECONDS_PER_SHAPE)
        label = shape.load.key, shape.cycle, shape.number, shape.sign
        taken = take(bench, self._loop, self._load_index, shape.position[None], [label], samples)
        return Reading(
            time=self._clock,
            force=taken.force[:, 0],
            position=taken.position[:, 0],
            force_scatter=taken.force_scatter[:, 0],
            position_scatter=taken.position_scatter[:, 0],
            temperature=float(bench.coils.temperature),
            counter=self._counter,
            settled=bool(taken.settled[0]),
            force_error=None if taken.force_error is None else taken.force_error[:, 0],
        )

    def status(self) -> Status:
        """Return the state of the bench."""
        return Status(True, "at rest" if self._shape is None else "in shape", self._counter)

    def rest(self) -> None:
        """Bring the mirror to rest."""
        self._shape = None

    def write_truth(self, campaign: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the truth into a file beside a campaign's folder, for scoring only."""
        write_truth(self._bench.truth, truth_path(campaign), overwrite=overwrite)
