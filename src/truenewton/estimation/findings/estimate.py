"""What every method returns: how well alpha is determined, how well the data fit, the estimate."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, StrEnum

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import Fault
from truenewton.estimation.findings.finding import Finding
from truenewton.records.campaign import Campaign, load_temperatures
from truenewton.statics.load import Load


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

    @property
    def as_values(self) -> str:
        """The same for a script."""
        return str(self)


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


class Scale(StrEnum):
    """What fixes the common scale of alpha."""

    WEIGHTS = "weights"
    GIVEN = "given"  # by an earlier calibration
    MEAN_ONE = "mean 1"  # nothing does: alpha is relative


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate over the enabled actuators.

    Attributes
    ----------
    method, scale
        As they stand in the calibration file; what fixes the common scale.
    values
        (n + 1 + 2 L,) alpha, B, then M_y, M_x of each load; (n,) from a stiffness matrix alone.
    reading_covariance, systematic_covariance
        Their covariance from the readings and from the weights.
    noise
        Standard deviation of one reading [N]; NaN if unknown.
    condition, rank
        As in the calibration file.
    solved_condition
        Of the system as the method solves it, where that is another; else NaN.
    diagnosis, goodness
        How well alpha is determined, and how well the data fit it; None where it has no meaning.
    declared_chi2
        Against FORCERR; NaN where not every file gives it.
    scale_errors
        Budget of the common scale.
    rejected
        Rows left out.
    effects
        What the bench did beside the model, as far as the data show it.
    unseen
        What they cannot show, and what of its usual size would do to the common scale.
    sensors
        What reciprocity finds of them; empty by other methods.
    """

    method: str
    scale: Scale
    values: Array
    reading_covariance: Array
    systematic_covariance: Array
    noise: float
    condition: float
    rank: int
    diagnosis: Diagnosis
    goodness: Goodness | None = None
    declared_chi2: float = float("nan")
    scale_errors: tuple[ScaleError, ...] = ()
    rejected: tuple[RejectedRow, ...] = ()
    effects: tuple[Finding, ...] = ()
    unseen: tuple[UnseenError, ...] = ()
    solved_condition: float = float("nan")
    sensors: tuple[Sensor, ...] = ()


def with_warnings(estimate: Estimate, more: tuple[Finding, ...]) -> Estimate:
    """Return an estimate with more of what is weak in it."""
    diagnosis = estimate.diagnosis
    return replace(estimate, diagnosis=replace(diagnosis, warnings=(*diagnosis.warnings, *more)))


FROM_READINGS = ErrorSource(ErrorKind.READINGS)
MAGNET_COEFFICIENT = -1.1e-3  # [1/K] of NdFeB, the law of a mirror that nobody tracked [lit]
# Sources of a relative error of the common scale below it are not listed.
NEGLIGIBLE_SCALE_ERROR = 1e-5

SAME_TEMPERATURE = 0.05  # [K] within which no load is warmer than another
# For each independent source, (L,) change of W of each load by one standard uncertainty [N].
WeightErrors = Mapping[ErrorSource, Array]


def weight_errors(campaign: Campaign) -> dict[ErrorSource, Array]:
    """Return (L,) changes [N] by each source of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads; loads with the same TOOL share one error of their added
    weight, each in proportion to its own; every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    errors = defaultdict[ErrorSource, Array](lambda: np.zeros(len(loads)))
    errors[ErrorSource(ErrorKind.MIRROR)] = campaign.weight_error * cosine
    for load_index, load in enumerate(loads):
        if load.added_error > 0:
            errors[added_source(load)][load_index] = load.added_error * cosine[load_index]
    for load_index, load in enumerate(loads):
        if load.tilt_error > 0:
            by_angle = -(campaign.weight + load.added) * sine[load_index]
            source = ErrorSource(ErrorKind.TILT, load.name)
            errors[source][load_index] = by_angle * np.radians(load.tilt_error)
    return {source: change for source, change in errors.items() if change.any()}


def temperature_errors(campaign: Campaign, force: Array) -> dict[ErrorSource, Array]:
    """Return (L,) changes of W [N] that stand for bias magnets warmer under one load than another.

    Their force B, of two magnets each, changes by twice `MAGNET_COEFFICIENT`, and no balance tells
    that from a weight. B from the loads, all alpha alike: W + B + s F = 0, F the mean sum of
    commanded forces.

    Parameters
    ----------
    campaign
        The cycles; nothing where one has no TEMPERATURE, or no load is warmer than another.
    force
        (L,) F [N].
    """
    weights = campaign.effective_weights
    warmth = load_temperatures(campaign)
    if len(weights) < 2 or not np.isfinite(warmth).all() or np.ptp(warmth) < SAME_TEMPERATURE:
        return {}
    bias = np.polyfit(force, -weights, 1)[1] if np.ptp(force) else 0.0
    changes = 2 * MAGNET_COEFFICIENT * bias * (warmth - warmth.mean())
    return {ErrorSource(ErrorKind.BETWEEN_LOADS): changes}


def added_source(load: Load) -> ErrorSource:
    """Return the source of the error of an added weight: its tool, or the load if none is named."""
    if load.tool:
        return ErrorSource(ErrorKind.TOOL, load.tool)
    return ErrorSource(ErrorKind.ADDED, load.name)


def scale_errors(
    alpha: Array, reading_covariance: Array, changes: Array, sources: Iterable[ErrorSource]
) -> tuple[ScaleError, ...]:
    """Return what each source does to the common scale of alpha, largest first.

    Parameters
    ----------
    alpha, reading_covariance
        (n,) and its (n, n) covariance from the readings.
    changes
        (sources, n) change of alpha by one standard uncertainty of each source.
    sources
        Of the errors of the weights.
    """
    direction = alpha / (alpha @ alpha)  # a relative change of all: alpha -> alpha (1 + e)
    lines = [scale_error_from_readings(alpha, reading_covariance)]
    lines += [
        ScaleError(source, abs(float(direction @ change)))
        for source, change in zip(sources, changes, strict=True)
    ]
    return tuple(sorted(lines, key=lambda line: -line.relative))


def scale_error_from_readings(alpha: Array, reading_covariance: Array) -> ScaleError:
    """Return the part of the readings, from (n,) alpha and its (n, n) covariance from them."""
    direction = alpha / (alpha @ alpha)
    return ScaleError(FROM_READINGS, float(np.sqrt(direction @ reading_covariance @ direction)))


def scale_budget(lines: Iterable[ScaleError]) -> dict[str, float]:
    """Return the relative errors of the common scale that are worth telling, by their source."""
    return {
        str(line.source): line.relative for line in lines if line.relative > NEGLIGIBLE_SCALE_ERROR
    }


def typical(error: Array, alpha: Array) -> float:
    """Return the median over actuators of an (n,) error relative to alpha; NaN where disabled."""
    return float(np.nanmedian(error / np.abs(alpha)))


def scale_total(lines: tuple[ScaleError, ...]) -> float:
    """Return the relative standard uncertainty of the common scale."""
    return float(np.sqrt(sum(line.relative**2 for line in lines)))


def tilt_as_load(weight: float, weight_error: float, tilt: float, tilt_error: float) -> float:
    """Return the relative error of the scale if the mirror's own tilt were the second load.

    The change of weight is P (1 - cos tilt); P in N, the tilt in degrees.
    """
    from_angle = np.radians(tilt_error) / np.tan(np.radians(tilt) / 2)
    return float(np.hypot(weight_error / weight, from_angle))
