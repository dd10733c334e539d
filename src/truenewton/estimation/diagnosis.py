"""The verdict on data: what they fix, how well they fit, what was left out, what limits them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum

import numpy as np

from truenewton.errors import Fault
from truenewton.estimation.findings.finding import Finding


class NoiseSource(StrEnum):
    """Where the noise of a reading is from."""

    REPEATS = "repeats"
    DECLARED = "FORCERR"
    MINIMUM = "minimum"  # only its shape is known: it fits by definition


@dataclass(frozen=True)
class Diagnosis:
    """How well the data fix what was asked of them.

    Attributes
    ----------
    eigenvalues
        Squared imbalance that the data leave in patterns of alpha, in terms of its noise where that
        is known, ascending; the first belongs to alpha itself, and every pattern that the data hold
        stands above it.
    undetermined
        Number of further patterns that the data cannot tell from noise.
    faults
        What is missing, each with its remedy; empty when alpha can be had.
    warnings
        What is weak.
    weakest
        The pattern of alpha that the data hold least, in words; its share of the variance E_STAT^2
        summed over actuators follows.
    weakest_share
        That share.
    leverage
        (n,) share of each enabled actuator in the noise of the imbalance; they sum to 3. Where it
        is small a fault of the actuator is hard to see.
    span
        Elastic directions in which the shapes stand above the noise; -1 where that was not asked.
    """

    eigenvalues: tuple[float, ...] = ()
    undetermined: int = 0
    faults: tuple[Fault | Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    weakest: str = ""
    weakest_share: float = float("nan")
    leverage: tuple[float, ...] = ()
    span: int = -1

    @property
    def separation(self) -> float:
        """Ratio of the second singular value to the first: how clearly alpha stands apart."""
        if len(self.eigenvalues) < 2:
            return float("nan")
        rounding = np.finfo(float).eps * self.eigenvalues[-1]
        return float(np.sqrt(self.eigenvalues[1] / max(self.eigenvalues[0], rounding)))


@dataclass(frozen=True)
class Goodness:
    """How well the shapes balance, against what their noise lets expect.

    Attributes
    ----------
    chi2, degrees_of_freedom
        Sum of squared imbalance in terms of its noise; equations less unknowns.
    against
        Where the noise comes from.
    probability
        Of a larger chi2 by chance; NaN against 'minimum'.
    """

    chi2: float
    degrees_of_freedom: int
    against: NoiseSource
    probability: float

    @property
    def reduced(self) -> float:
        """chi2 over degrees of freedom."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


class ErrorKind(Enum):
    """What an error of the common scale comes from; in words, with the name of tool or load."""

    READINGS = "noise of the readings"
    MIRROR = "weight of the mirror"
    TOOL = "weight of '{}'"
    ADDED = "added weight of load '{}'"
    TILT = "tilt of load '{}'"
    EARLIER = "earlier calibration"
    TEMPERATURE = "temperature since then"
    BETWEEN_LOADS = "temperature between the loads"


@dataclass(frozen=True)
class ErrorSource:
    """An independent source of error: its kind, and of which tool or load it is."""

    kind: ErrorKind
    name: str = ""

    def __str__(self) -> str:
        return self.kind.value.format(self.name)


@dataclass(frozen=True)
class ScaleError:
    """What one source of error does to the common scale of alpha.

    Attributes
    ----------
    source
        Reads as words.
    relative
        Its part of the relative standard uncertainty of the common scale.
    """

    source: ErrorSource
    relative: float


@dataclass(frozen=True)
class UnseenError:
    """What data could not show, and would do to the common scale of alpha; no part of any error.

    Attributes
    ----------
    name
        What may be, with its usual size, in words.
    relative
        How far it would move the common scale.
    """

    name: str
    relative: float


@dataclass(frozen=True)
class RejectedRow:
    """A row that was left out.

    Attributes
    ----------
    cycle, row
        Place in the campaign's cycles; row of MEASUREMENTS, from 0.
    actuator
        ID of the actuator that stands out.
    sigmas
        How far, in standard deviations.
    against
        'repeats' of its shape, or 'balance'.
    """

    cycle: int
    row: int
    actuator: int
    sigmas: float
    against: str


@dataclass(frozen=True)
class Sensor:
    """A sensor as the data show it.

    Attributes
    ----------
    actuator
        ID.
    gain, gain_error
        True displacement / reading, and its standard uncertainty.
    x, x_error, y, y_error
        Of its place: the actuator's less the sensor's [m].
    state
        'fitted'; 'free' where the fit leaves the actuator out, with its sensor.
    """

    actuator: int
    gain: float
    gain_error: float
    x: float
    x_error: float
    y: float
    y_error: float
    state: str
