"""A mirror that follows the deformable-mirror protocol of opticalib 2 as a bench.

opticalib's devices share `n_acts`, `set_shape(cmd, differential)` and `get_shape()`. Those with
force sensing (`AdOpticaDm`, `DP`, `M4AU` in opticalib.devices 2.3) add `get_force()`. Any object
with these four works, without opticalib; `get_temperature()` is called if it exists.
"""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from truenewton.arrays import Array
from truenewton.bench.protocol import (
    BATCHES,
    Reading,
    Shape,
    Status,
    check_samples,
    error_of_mean,
    faults_of,
    lacking,
)
from truenewton.errors import BenchFault
from truenewton.mirrors.known import Mirror

REST_SAMPLES = 64  # of the position at rest
MIN_DRIFT_SAMPLES = 32  # samples, to detect a drift
DRIFT_SIGMAS = 6.0  # standard errors of the mean, beyond which the mirror still moves


class DeformableMirror(Protocol):
    """The methods that the object must have: metres along +z, newtons."""

    @property
    def n_acts(self) -> int:
        """Number of actuators."""

    def set_shape(self, cmd: Array, differential: bool, /) -> None:
        """Command (n,) displacements [m] from rest, or from the present shape if differential."""

    def get_shape(self) -> ArrayLike:
        """Return the (n,) positions by the sensors [m], with any zero."""

    def get_force(self) -> ArrayLike:
        """Return the (n,) commanded forces [N]."""


class OpticalibMirror:
    """A bench around an object that follows opticalib's protocol.

    Displacements are relative to the positions at rest before the first command, because
    opticalib's devices add the shape of their bias.

    Parameters
    ----------
    device
        The object.
    mirror
        Name, actuators in the order of the device, gap.
    settling
        Time given to the mirror after each command [s].

    Raises
    ------
    BenchFault
        The object lacks a method, or has another number of actuators.

    Attributes
    ----------
    instrument, layout, gap, gradients
        Those of the mirror.

    Examples
    --------
    >>> class Device:
    ...     n_acts, shape = 45, np.zeros(45)
    ...
    ...     def set_shape(self, cmd: np.ndarray, differential: bool = False) -> None:
    ...         self.shape = cmd
    ...
    ...     def get_shape(self) -> np.ndarray:
    ...         return self.shape
    ...
    ...     def get_force(self) -> np.ndarray:
    ...         return 1e5 * self.shape
    >>> bench = tn.OpticalibMirror(Device(), tn.mirrors.p45(), settling=0.0)
    >>> bench.command(tn.Shape(tn.Load("bare"), 1, 1, 1, np.full(45, 1e-7)))
    >>> bench.read(samples=4).force[:3]
    array([0.01, 0.01, 0.01])
    """

    def __init__(self, device: DeformableMirror, mirror: Mirror, *, settling: float = 0.2) -> None:
        self._name = type(device).__name__
        if missing := lacking(device, DeformableMirror):
            raise BenchFault(
                f"{self._name} has no {', '.join(missing)}",
                remedy="give a mirror after opticalib's protocol, with forces",
            )
        if int(device.n_acts) != mirror.layout.n:
            raise BenchFault(
                f"{self._name} has {device.n_acts} actuators, {mirror.name} has {mirror.layout.n}",
                remedy="give the mirror that it is",
            )
        self.instrument, self.layout, self.gap = mirror.name, mirror.layout, mirror.gap
        self.gradients = mirror.coil_gradient, mirror.bias_gradient
        self._device, self._settling = device, settling
        self._rest: Array | None = None  # the positions there [m]
        self._in_shape = False
        self._since = 0.0  # when the last command was given
        self._last: Array | None = None
        self._counter = 0

    def command(self, shape: Shape) -> None:
        """Bring the mirror to a shape."""
        if shape.position.shape != (self.layout.n,):
            raise BenchFault(
                f"{shape.position.size} displacements for {self.layout.n} actuators",
                remedy="plan for this mirror",
            )
        if self._rest is None:
            self.rest()
            self._settle()
            self._rest = self._samples(self._device.get_shape, REST_SAMPLES).mean(axis=0)
        self._set(shape.position)
        self._in_shape = True

    def read(self, samples: int) -> Reading:
        """Return the mean of so many calls of get_force and get_shape.

        The counter stays if the last sample is identical to that of the reading before.
        """
        check_samples(samples)
        if not self._in_shape or self._rest is None:
            raise BenchFault("the mirror is at rest", remedy="command a shape before reading")
        self._settle()
        now = datetime.datetime.now(datetime.UTC)
        both = self._samples(lambda: (self._device.get_force(), self._device.get_shape()), samples)
        force, position = both[:, 0], both[:, 1] - self._rest
        if self._last is None or not np.array_equal(both[-1], self._last):
            self._counter += 1
        self._last = both[-1]
        with faults_of(f"{self._name}.get_temperature"):
            temperature = float(getattr(self._device, "get_temperature", lambda: np.nan)())
        batches = np.array_split(force, BATCHES) if samples >= BATCHES else []
        return Reading(
            time=now,
            force=force.mean(axis=0),
            position=position.mean(axis=0),
            force_scatter=force.std(axis=0, ddof=min(1, samples - 1)),
            position_scatter=position.std(axis=0, ddof=min(1, samples - 1)),
            temperature=temperature,
            counter=self._counter,
            settled=_still(position),
            force_error=error_of_mean(np.array([each.mean(axis=0) for each in batches]))
            if batches
            else None,
        )

    def status(self) -> Status:
        """Return how the bench is."""
        return Status(True, "in shape" if self._in_shape else "at rest", self._counter)

    def rest(self) -> None:
        """Bring the mirror to rest."""
        self._in_shape = False
        self._set(np.zeros(self.layout.n))

    def _set(self, displacement: Array) -> None:
        with faults_of(f"{self._name}.set_shape"):
            # A copy: some devices add to what they are given. By place: the names differ.
            self._device.set_shape(displacement.copy(), False)
        self._since = time.monotonic()

    def _settle(self) -> None:
        time.sleep(max(0.0, self._since + self._settling - time.monotonic()))

    def _samples(self, get: Callable[[], Any], samples: int) -> Array:
        """Return (samples, ..., n) values of a call."""
        with faults_of(f"{self._name}.get_shape or get_force"):
            values = np.array([get() for _ in range(samples)], dtype=float)
        if values.shape[-1] != self.layout.n or not np.isfinite(values).all():
            raise BenchFault(
                f"readings of shape {values.shape[1:]}, finite: {np.isfinite(values).all()}",
                remedy=f"return one finite number for each of the {self.layout.n} actuators",
            )
        return values


def _still(position: Array) -> bool:
    """Return whether both halves of (samples, n) positions have the same mean.

    Within `DRIFT_SIGMAS` standard errors, for each actuator; always true for few samples.
    """
    half = len(position) // 2
    if len(position) < MIN_DRIFT_SAMPLES:
        return True
    first, second = position[:half], position[half : 2 * half]
    error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / half)
    return bool((np.abs(second.mean(axis=0) - first.mean(axis=0)) <= DRIFT_SIGMAS * error).all())
