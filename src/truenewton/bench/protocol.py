"""The protocol between acquisition and a bench."""

from __future__ import annotations

import contextlib
import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import BenchFault, TrueNewtonError
from truenewton.files.content import YEARS
from truenewton.statics.layout import Layout
from truenewton.statics.load import LARGEST_FORCE, Load

MAX_SAMPLES = 10**9  # of one reading
BATCHES = 4  # of a record, for the error of its mean


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape to be taken, and its place in the campaign.

    Attributes
    ----------
    load, cycle, number, sign
        Load, cycle (from 1), shape (from 1; 0 is the mirror at rest), and +1 or -1.
    position
        (n,) displacement along +z from rest, by the sensors [m].

    Examples
    --------
    >>> rest = tn.Shape(tn.Load("bare"), cycle=1, number=0, sign=1, position=np.zeros(45))
    >>> rest.number
    0
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
        When it was taken; UTC if it has no zone.
    force, position
        (n,) mean commanded force [N] and displacement along +z by the sensors [m].
    force_scatter, position_scatter
        (n,) standard deviation of one sample [N], [m].
    temperature
        [deg C]; NaN if it is not measured.
    counter
        Increases with every new reading of the electronics; otherwise the reading is stale.
    settled
        Whether the mirror had come to rest before the first sample.
    force_error
        (n,) standard deviation of the mean force [N], as from `error_of_mean`; None if the
        correlation of the samples is unknown.

    Raises
    ------
    BenchFault
        A value is not numeric, a standard deviation is negative, or the time is not valid.

    Examples
    --------
    >>> bench = tn.SimulatedBench(tn.mirrors.p45())
    >>> bench.command(tn.Shape(tn.Load("bare"), 1, 1, 1, np.zeros(45)))
    >>> reading = bench.read(samples=16)
    >>> reading.force.shape, reading.settled
    ((45,), True)
    """

    time: datetime.datetime
    force: Array
    position: Array
    force_scatter: Array
    position_scatter: Array
    temperature: float
    counter: int
    settled: bool
    force_error: Array | None = None

    def __post_init__(self) -> None:
        if getattr(self.time, "year", None) not in YEARS:
            raise BenchFault(
                f"the time of a reading is {self.time}",
                remedy="set the clock of the bench; it is UTC",
            )
        aware = self.time if self.time.tzinfo else self.time.replace(tzinfo=datetime.UTC)
        object.__setattr__(self, "time", aware.astimezone(datetime.UTC))
        for name in ("force", "position", "force_scatter", "position_scatter", "force_error"):
            value = getattr(self, name)
            try:
                values = None if value is None else np.asarray(value, dtype=float)
            except (TypeError, ValueError) as error:
                raise BenchFault(
                    f"the {name} of a reading is no array of numbers", remedy="see to the bench"
                ) from error
            if values is not None and name.endswith(("scatter", "error")):
                wrong = values[~(np.isnan(values) | ((values >= 0) & (values <= LARGEST_FORCE)))]
                if wrong.size:
                    raise BenchFault(
                        f"the {name} of a reading is {wrong[0]:.4g}",
                        remedy="give standard deviations, NaN if they are unknown",
                    )
            object.__setattr__(self, name, values)


@dataclass(frozen=True)
class Status:
    """The state of a bench.

    Attributes
    ----------
    ready
        Whether it takes commands.
    message
        Its state in one line; a fault if it is not ready.
    counter
        As in `Reading`.

    Examples
    --------
    >>> tn.SimulatedBench(tn.mirrors.p45()).status().ready
    True
    """

    ready: bool
    message: str
    counter: int


def error_of_mean(batch_means: Array) -> Array:
    """Return the (n,) standard deviation of the mean of a record from its batch means.

    Samples of a closed loop are correlated, so that the error of their mean may be a tenth of
    scatter / root(samples), or many times that. The means of batches that are much longer than the
    memory of the loop are not (method of batch means; Law and Kelton, Simulation Modeling and
    Analysis, section 9.5). One value has BATCHES - 1 degrees of freedom: use the RMS over many.

    Parameters
    ----------
    batch_means
        (batches, n) means of equal parts of a record, in the order of time [N].
    """
    return np.asarray(batch_means.std(axis=0, ddof=1) / np.sqrt(len(batch_means)))


def check_samples(samples: int) -> None:
    """Raise BenchFault if there is no mean of so many samples."""
    if not 1 <= samples <= MAX_SAMPLES:
        raise BenchFault(f"a reading of {samples} samples", remedy=f"ask for 1 to {MAX_SAMPLES}")


class Bench(Protocol):
    """A mirror that can be set to shapes and read.

    Every method may raise `BenchFault`.
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
        """Return the state of the bench, without changing it."""

    def rest(self) -> None:
        """Bring the mirror to rest, whatever happened: no displacement."""


@runtime_checkable
class Operator(Protocol):
    """A person or machine that puts the loads on."""

    def put_on(self, load: Load) -> None:
        """Return when this load is on the mirror."""


def gradients_of(bench: Bench) -> tuple[float | None, float | None]:
    """Return COILGRAD [1/m] and BIASGRAD [N/m] of a bench, its attribute ``gradients``.

    None if a bench does not know them. BenchFault if they are not two plausible numbers.
    """
    given = getattr(bench, "gradients", (None, None))
    try:
        coil, bias = (None if each is None else float(each) for each in given)
        plausible = all(abs(each or 0.0) <= LARGEST_FORCE for each in (coil, bias))
    except (TypeError, ValueError):
        plausible = False
    if not plausible:
        raise BenchFault(
            f"the bench gives gradients {given!r}", remedy="give 1/m and N/m, None if unknown"
        )
    return coil, bias


@runtime_checkable
class OwnTime(Protocol):
    """A bench with simulated time: acquisition does not sleep for it."""

    def wait(self, seconds: float) -> None:
        """Let simulated time pass."""


def lacking(thing: object, protocol: type) -> list[str]:
    """Return the names of a protocol that an object lacks."""
    names = [name for name in vars(protocol) if not name.startswith("_")]
    return [name for name in names if getattr(thing, name, None) is None]


@contextlib.contextmanager
def faults_of(what: str) -> Iterator[None]:
    """Turn any exception of a bench's own code into a `BenchFault` that names it and its cause."""
    try:
        yield
    except TrueNewtonError:
        raise
    except Exception as error:
        fault = f"{what} fails ({type(error).__name__}: {error})"
        raise BenchFault(fault, remedy="check the bench") from error
