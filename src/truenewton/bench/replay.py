"""A bench that answers what was recorded: the rows of a campaign's files."""

from __future__ import annotations

import datetime
import os

import numpy as np

from truenewton.bench.protocol import Reading, Shape, Status, check_samples
from truenewton.errors import BenchFault, FormatError, UnknownName
from truenewton.records.file import campaign_from, fits_paths, read_file
from truenewton.statics.load import Load

ANOTHER = 0.1  # of its largest displacement: so far from the recorded shape it is another one


class ReplayBench:
    """A recorded campaign, read again shape by shape.

    At rest it answers with the mean of the cycle's shapes, in which the elastic forces cancel.

    Parameters
    ----------
    folder
        Of the campaign.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch

    Attributes
    ----------
    instrument, layout, gap, gradients
        As of `Bench` and `Graded`; gradients None without POSITION.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        campaign = campaign_from(read_file(path) for path in fits_paths([folder]))
        cycles = campaign.cycles
        self._loads = {load.key: load.name for load in campaign.loads}
        self._cycles = {(cycle.load.key, cycle.number): cycle for cycle in cycles}
        first = cycles[0]
        if first.gap is None or any(cycle.gap != first.gap for cycle in cycles):
            raise FormatError("its files give no GAP, or several", remedy="record it", path=folder)
        self._counter = 0
        self._shape: Shape | None = None
        self.instrument, self.layout, self.gap = first.instrument, first.layout, first.gap
        self.gradients = (
            (None, None) if first.position is None else (first.coil_gradient, first.bias_gradient)
        )

    def put_on(self, load: Load) -> None:
        """Take a load for on, if it was recorded.

        Raises
        ------
        UnknownName
        """
        if load.key not in self._loads:
            names = tuple(self._loads.values())
            raise UnknownName(
                f"no load '{load.name}' was recorded", remedy=f"there are {', '.join(names)}",
                got=load.name, want=names,
            )  # fmt: skip

    def wait(self, seconds: float) -> None:
        """Let time pass, which was recorded too."""

    def command(self, shape: Shape) -> None:
        """Look a shape up.

        Raises
        ------
        BenchFault
            It was not recorded, or in another shape.
        """
        self._shape = None
        self._row(shape)
        self._shape = shape

    def read(self, samples: int) -> Reading:
        """Return what was recorded of the shape that is set, whatever the number of samples."""
        check_samples(samples)
        shape = self._shape
        if shape is None:
            raise BenchFault("the mirror is at rest", remedy="command a shape before reading")
        cycle, rows = self._cycles[shape.load.key, shape.cycle], self._row(shape)
        n = self.layout.n
        position = shape.position if cycle.position is None else cycle.position[rows].mean(axis=0)
        noise = np.nan if cycle.force_error is None else cycle.force_error * np.sqrt(samples)
        self._counter += 1
        return Reading(
            time=cycle.date + datetime.timedelta(seconds=float(cycle.time[rows[-1]])),
            force=cycle.force[rows].mean(axis=0),
            position=position,
            force_scatter=np.full(n, noise),
            position_scatter=np.full(n, np.nan),
            temperature=np.nan if cycle.temperature is None else float(cycle.temperature[rows[-1]]),
            counter=self._counter,
            settled=bool(cycle.valid[rows].all()),
            force_error=None if cycle.force_error is None else np.full(n, cycle.force_error),
        )

    def status(self) -> Status:
        """Return how the bench is."""
        return Status(True, "replays a recorded campaign", self._counter)

    def rest(self) -> None:
        """Forget the shape."""
        self._shape = None

    def _row(self, shape: Shape) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Return the row of a shape; of the mirror at rest all that are valid."""
        cycle = self._cycles.get((shape.load.key, shape.cycle))
        if cycle is None:
            raise BenchFault(f"cycle {shape.cycle} under '{shape.load.name}' was not recorded")
        if shape.number == 0:
            return np.flatnonzero(cycle.valid)
        rows = np.flatnonzero((cycle.shape == shape.number) & (cycle.sign == shape.sign))[-1:]
        if not rows.size:
            raise BenchFault(f"shape {shape.number} of sign {shape.sign:+d} was not recorded")
        if cycle.position is not None:
            off = np.abs(cycle.position[rows[0]] - shape.position)[cycle.layout.enabled].max()
            if off > ANOTHER * np.abs(shape.position).max():
                raise BenchFault(
                    f"shape {shape.number} was recorded in another shape, {off:.3g} m off",
                    remedy="replay the plan that was recorded",
                )
        return rows
