"""What acquisition asks of a bench: hardware, a server, or a simulation alike."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from truenewton.arrays import Array
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape to be taken, and its place in the campaign.

    Attributes
    ----------
    load, cycle, number, sign
        Under which load, in which cycle (from 1), which shape (from 1; 0 is the mirror at rest),
        +1 or -1.
    position
        (n,) displacement along +z from rest, by the sensors [m].
    """

    load: Load
    cycle: int
    number: int
    sign: int
    position: Array


@dataclass(frozen=True, eq=False)
class Reading:
    """The mean of some samples of a mirror at rest in its shape.

    Attributes
    ----------
    time
        When it was taken, UTC.
    force, position
        (n,) mean commanded force [N] and displacement along +z by the sensors [m].
    force_scatter, position_scatter
        (n,) standard deviation of one sample [N], [m].
    temperature
        [deg C]; NaN where nobody measures it.
    counter
        Grows with every new reading of the electronics: one that stands still is stale.
    settled
        Whether the mirror had come to rest before the first sample.
    """

    time: datetime.datetime
    force: Array
    position: Array
    force_scatter: Array
    position_scatter: Array
    temperature: float
    counter: int
    settled: bool


@dataclass(frozen=True)
class Status:
    """How the bench is.

    Attributes
    ----------
    ready
        Whether it takes commands.
    message
        What it says of itself, one line; a fault where it is not ready.
    counter
        As in `Reading`.
    """

    ready: bool
    message: str
    counter: int


class Bench(Protocol):
    """A mirror that can be set to shapes and read.

    Every method may raise `BenchFault`; after one the bench is at rest or says what it knows.
    """

    @property
    def instrument(self) -> str:
        """The mirror's name, as in INSTRUME."""

    @property
    def layout(self) -> Layout:
        """Its actuators."""

    @property
    def gap(self) -> float:
        """Nominal distance from the reference plate [m]."""

    def command(self, shape: Shape) -> None:
        """Bring the mirror to a shape; returns when it has been commanded, not when it settled."""

    def read(self, samples: int) -> Reading:
        """Wait until the mirror has settled, and return the mean of so many samples."""

    def status(self) -> Status:
        """Return how the bench is; never changes anything."""

    def rest(self) -> None:
        """Bring the mirror to rest, whatever happened: the shape without displacement."""


@runtime_checkable
class Operator(Protocol):
    """Who lifts the glass and puts the weight on."""

    def put_on(self, load: Load) -> None:
        """Return when the mirror bears this load."""


@runtime_checkable
class Graded(Protocol):
    """A bench that knows how its forces change with the gap."""

    @property
    def gradients(self) -> tuple[float | None, float | None]:
        """COILGRAD [1/m] and BIASGRAD [N/m]; None where nobody knows."""


@runtime_checkable
class OwnTime(Protocol):
    """A bench whose time is not ours: nobody need sleep for it."""

    def wait(self, seconds: float) -> None:
        """Let so much of its time pass."""
