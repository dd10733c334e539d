"""The unknowns: logarithms of alpha and of the sensor gains, and the sensors' offsets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from truenewton.arrays import Array


class Kind(StrEnum):
    """A kind of unknown, one of each actuator."""

    ALPHA = "log alpha"
    GAIN = "log g"
    X = "delta x"
    Y = "delta y"


OFFSETS = (Kind.X, Kind.Y)


@dataclass(frozen=True, eq=False)
class Values:
    """What the unknowns are.

    Attributes
    ----------
    log_alpha, log_gain
        (n,) of true / commanded Newton; of true displacement / reading.
    offset
        (2, n) x and y of magnet less sensor [m].
    """

    log_alpha: Array
    log_gain: Array
    offset: Array

    @property
    def alpha(self) -> Array:
        """(n,) true Newton / commanded Newton."""
        return np.exp(self.log_alpha)

    @property
    def gain(self) -> Array:
        """(n,) true displacement / reading."""
        return np.exp(self.log_gain)

    def same_sensors(self, other: Values) -> bool:
        """Return whether gains and offsets are those of others."""
        same_gain = np.array_equal(self.log_gain, other.log_gain)
        return same_gain and np.array_equal(self.offset, other.offset)

    def of(self, kind: Kind) -> Array:
        """Return the (n,) unknowns of a kind."""
        if kind in OFFSETS:
            return np.asarray(self.offset[OFFSETS.index(kind)])
        return self.log_alpha if kind == Kind.ALPHA else self.log_gain


def at_nominal(n: int) -> Values:
    """Return what is declared: every alpha and gain 1, sensors at their magnets."""
    return Values(np.zeros(n), np.zeros(n), np.zeros((2, n)))


@dataclass(frozen=True)
class Request:
    """What is asked of the data.

    Attributes
    ----------
    gain_spread
        Standard deviation of log g over the sensors; 0 if the gains are known, infinite if nothing
        is known of them.
    offset_spread
        Standard deviation of an offset along an axis [m]; 0 if sensors are at their magnets.
    estimated
        Whether the data give both spreads, where these are neither 0 nor infinite.
    """

    gain_spread: float = 0.0
    offset_spread: float = 0.0
    estimated: bool = False

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of unknowns, in their order."""
        gains = (Kind.GAIN,) if self.gain_spread else ()
        return (Kind.ALPHA, *gains, *(OFFSETS if self.offset_spread else ()))

    def information(self, n: int) -> Array:
        """Return (u,) what is known of the unknowns beforehand, each apart."""
        spreads = {Kind.ALPHA: np.inf, Kind.GAIN: self.gain_spread}
        return np.concatenate(
            [np.full(n, spreads.get(kind, self.offset_spread) ** -2.0) for kind in self.kinds]
        )

    def vector(self, values: Values) -> Array:
        """Return the (u,) unknowns that are asked for."""
        return np.concatenate([values.of(kind) for kind in self.kinds])

    def moved(self, values: Values, step: Array) -> Values:
        """Return the values after a (u,) step, what scale is free held at mean log 0."""
        by = dict(zip(self.kinds, np.split(step, len(self.kinds)), strict=True))
        nothing = np.zeros_like(values.log_alpha)
        log_alpha = values.log_alpha + by[Kind.ALPHA]
        log_gain = values.log_gain + by.get(Kind.GAIN, nothing)
        return replace(
            values,
            log_alpha=log_alpha - log_alpha.mean(),
            log_gain=log_gain - (log_gain.mean() if np.isinf(self.gain_spread) else 0.0),
            offset=values.offset + np.array([by.get(kind, nothing) for kind in OFFSETS]),
        )


# Spreads of log g and of offsets [m] to begin with; the data give their own.
START_REQUEST = Request(gain_spread=0.004, offset_spread=5e-4, estimated=True)
