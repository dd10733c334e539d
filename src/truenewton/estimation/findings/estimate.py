"""What every method returns: how well alpha is determined, how well the data fit, the estimate."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from typing import Self

import numpy as np

from truenewton.arrays import Array
from truenewton.errors import Fault
from truenewton.estimation.findings.finding import Finding
from truenewton.records.campaign import Campaign, load_temperatures
from truenewton.statics.load import Load, change_by_coil_shift


class NoiseSource(StrEnum):
    """Source of the noise of a reading."""

    REPEATS = "repeats"
    DECLARED = "FORCERR"
    MINIMUM = "minimum"  # only its shape is known: it fits by definition


@dataclass(frozen=True)
class Diagnosis:
    """How well the data determine alpha."""

    # Squared imbalance of patterns of alpha, in units of its noise if that is known,
    # ascending; the first belongs to alpha itself. Patterns that the data determine are well
    # above it.
    eigenvalues: tuple[float, ...] = ()
    undetermined: int = 0  # number of further patterns that cannot be distinguished from noise
    # What is missing, each with its remedy; empty if alpha can be determined.
    faults: tuple[Fault | Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()  # what is weak
    # Description of the least certain pattern of alpha; its share of the variance E_STAT^2
    # summed over actuators.
    weakest: str = ""
    weakest_share: float = float("nan")
    # (n,) share of each enabled actuator in the noise of the imbalance; they sum to 3. If it
    # is small, a fault of the actuator is hard to see.
    leverage: tuple[float, ...] = ()
    # Number of elastic directions in which the shapes exceed the noise; -1 if not computed.
    span: int = -1
    # Ratio of the second singular value to the first: how unique alpha is.
    separation: float = float("nan")


def separation_of(eigenvalues: Array) -> float:
    """Return the ratio of the second singular value to the first, of ascending eigenvalues."""
    if len(eigenvalues) < 2:
        return float("nan")
    rounding = np.finfo(float).eps * eigenvalues[-1]
    return float(np.sqrt(eigenvalues[1] / max(eigenvalues[0], rounding)))


@dataclass(frozen=True)
class Goodness:
    """How well the shapes balance, compared with their noise."""

    # Sum of squared imbalance in units of its noise; equations less unknowns.
    chi2: float
    degrees_of_freedom: int
    against: NoiseSource  # source of the noise
    probability: float  # of a larger chi2 by chance; NaN against 'minimum'

    @property
    def reduced(self) -> float:
        """chi2 over degrees of freedom."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


class ErrorKind(Enum):
    """Sources of an error of the common scale, with the name of the tool or load."""

    READINGS = "noise of the readings"
    MIRROR = "weight of the mirror"
    TOOL = "weight of '{}'"
    ADDED = "added weight of load '{}'"
    TILT = "tilt of load '{}'"
    COIL_SHIFT = "coil displacement under load '{}'"
    EARLIER = "earlier calibration"
    TEMPERATURE = "temperature since then"
    BETWEEN_LOADS = "temperature between the loads"


@dataclass(frozen=True)
class ErrorSource:
    """An independent source of error: its kind, and the tool or load."""

    kind: ErrorKind
    name: str = ""

    def __str__(self) -> str:
        return self.kind.value.format(self.name)

    @property
    def as_values(self) -> str:
        """The same in JSON."""
        return str(self)


@dataclass(frozen=True)
class ScaleError:
    """Relative standard uncertainty of the common scale of alpha that is due to one source."""

    source: ErrorSource
    relative: float


@dataclass(frozen=True)
class UnseenError:
    """An effect that the data cannot show; it is not part of any error."""

    name: str  # the assumed effect, with its usual size
    relative: float  # relative change of the common scale by it


@dataclass(frozen=True)
class RejectedRow:
    """A row that was left out."""

    # Index in the campaign's cycles; row of MEASUREMENTS, from 0.
    cycle: int
    row: int
    actuator: int  # ID of the actuator with the largest deviation
    sigmas: float  # deviation in standard deviations
    against: str  # 'repeats' of its shape, or 'balance'


@dataclass(frozen=True)
class Sensor:
    """Gain and position of a sensor, estimated by reciprocity."""

    actuator: int  # ID
    # True displacement / reading, and its standard uncertainty.
    gain: float
    gain_error: float
    # Position of the actuator less that of the sensor [m].
    x: float
    x_error: float
    y: float
    y_error: float
    state: str  # 'fitted'; 'free' if the fit leaves the actuator and its sensor out


class Scale(StrEnum):
    """What determines the common scale of alpha."""

    WEIGHTS = "weights"
    GIVEN = "given"  # by an earlier calibration
    MEAN_ONE = "mean 1"  # it is not determined: alpha is relative

    @property
    def origin(self) -> str:
        """Where the common scale is from, in a sentence."""
        return {
            Scale.WEIGHTS: "from the weights",
            Scale.GIVEN: "from the earlier calibration",
            Scale.MEAN_ONE: "not measured (mean alpha is 1)",
        }[self]


@dataclass(frozen=True, eq=False, kw_only=True)
class EstimateFacts:
    """What a method states besides numbers of actuators; attributes as in `Calibration`."""

    method: str
    scale: str
    noise: float
    condition: float
    rank: int
    solved_condition: float = float("nan")
    diagnosis: Diagnosis = Diagnosis()
    goodness: Goodness | None = None
    chi2: float = float("nan")
    scale_errors: tuple[ScaleError, ...] = ()
    rejected_rows: tuple[RejectedRow, ...] = ()
    effects: tuple[Finding, ...] = ()
    unseen: tuple[UnseenError, ...] = ()
    sensors: tuple[Sensor, ...] = ()

    def with_warnings(self, more: Iterable[Finding]) -> Self:
        """Return the same with more warnings."""
        warnings = (*self.diagnosis.warnings, *more)
        return replace(self, diagnosis=replace(self.diagnosis, warnings=warnings))


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate(EstimateFacts):
    """An estimate over the enabled actuators."""

    # (n + 1 + 2 L,) alpha, B, then M_y, M_x of each load; (n,) from a stiffness matrix alone.
    values: Array
    # Their covariance from the readings and from the weights.
    reading_covariance: Array
    systematic_covariance: Array


# -- the budget of the common scale ---------------------------------------------------------------

FROM_READINGS = ErrorSource(ErrorKind.READINGS)
MAGNET_COEFFICIENT = -1.1e-3  # [1/K] of NdFeB, for a mirror that has not been tracked [lit]
NEGLIGIBLE_SCALE_ERROR = 1e-5  # relative; a source of a smaller error is not listed
SAME_TEMPERATURE = 0.05  # [K], difference of loads at the same temperature
# For each independent source, (L,) change of W of each load by one standard uncertainty [N].
WeightErrors = Mapping[ErrorSource, Array]


def weight_errors(campaign: Campaign) -> dict[ErrorSource, Array]:
    """Return (L,) changes [N] by each source of error of W = (P + Q) cos(tilt) (docs/files.md).

    The error of P is common to all loads. Loads with the same TOOL share one error of their added
    weight, each in proportion to its own. Every other error is independent.
    """
    loads = campaign.loads
    cosine = np.cos(np.radians([load.tilt for load in loads]))
    sine = np.sin(np.radians([load.tilt for load in loads]))
    errors = defaultdict[ErrorSource, Array](lambda: np.zeros(len(loads)))
    errors[ErrorSource(ErrorKind.MIRROR)] = campaign.weight_error * cosine
    for k, load in enumerate(loads):
        if load.added_error > 0:
            errors[added_source(load)][k] = load.added_error * cosine[k]
    for k, load in enumerate(loads):
        if load.tilt_error > 0:
            by_angle = -(campaign.weight + load.added) * sine[k]
            by_tilt = by_angle * np.radians(load.tilt_error)
            errors[ErrorSource(ErrorKind.TILT, load.name)][k] = by_tilt
    return {source: change for source, change in errors.items() if change.any()}


def errors_between_loads(campaign: Campaign, force: Array) -> dict[ErrorSource, Array]:
    """Return (L,) changes of W [N] equivalent to bias magnets and coils that differ between loads.

    - Temperature: the bias force B, of two magnets each, changes by twice `MAGNET_COEFFICIENT`.
      Only if all loads have TEMPERATURE, and they differ.
    - COILZ: an error of the displacement of coils changes W as `change_by_coil_shift`.

    B is estimated from the loads and their (L,) mean sums of commanded forces F [N]:
    W + B + s F = 0.
    """
    loads, weights, warmth = campaign.loads, campaign.effective_weights, load_temperatures(campaign)
    warmed = np.isfinite(warmth).all() and np.ptp(warmth) >= SAME_TEMPERATURE
    shifts = np.diag([load.coil_shift_error or 0.0 for load in loads])
    if len(weights) < 2 or not (warmed or shifts.any()):
        return {}
    bias = float(np.polyfit(force, -weights, 1)[1]) if np.ptp(force) else 0.0
    changes = {
        ErrorSource(ErrorKind.COIL_SHIFT, load.name): shift * weight_by_coil_shift(campaign, bias)
        for load, shift in zip(loads, shifts, strict=True)
        if shift.any()
    }
    if warmed:
        by_warmth = 2 * MAGNET_COEFFICIENT * bias * (warmth - warmth.mean())
        changes[ErrorSource(ErrorKind.BETWEEN_LOADS)] = by_warmth
    return changes


def weight_by_coil_shift(campaign: Campaign, bias: float) -> Array:
    """Return (L,) `change_by_coil_shift` under the loads of a campaign, with B of all magnets."""
    layout, first = campaign.layout, campaign.cycles[0]
    nz = float(layout.nz[layout.enabled].sum())
    held = campaign.effective_weights + bias
    return change_by_coil_shift(held, nz, first.coil_gradient, first.bias_gradient)


def bias_per_gain(campaign: Campaign) -> float | None:
    """Return BIASGRAD / COILGRAD: what a bias force gains [N] if its coil gains 1; None if unknown.

    Both gain if the coils come nearer.
    """
    first = campaign.cycles[0]
    if not first.coil_gradient or first.bias_gradient is None:
        return None
    return first.bias_gradient / first.coil_gradient


def added_source(load: Load) -> ErrorSource:
    """Return the source of the error of an added weight: its tool, or the load if it has none."""
    if load.tool:
        return ErrorSource(ErrorKind.TOOL, load.tool)
    return ErrorSource(ErrorKind.ADDED, load.name)


def scale_errors(
    alpha: Array, reading_covariance: Array, changes: Array, sources: Iterable[ErrorSource]
) -> tuple[ScaleError, ...]:
    """Return the error of the common scale by each source, largest first.

    From (n,) alpha, its (n, n) covariance from the readings, and the (sources, n) change of alpha
    by one standard uncertainty of each source.
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
    """Return the relative errors of the common scale that are not negligible, by their source."""
    return {
        str(line.source): line.relative for line in lines if line.relative > NEGLIGIBLE_SCALE_ERROR
    }


def typical(error: Array, alpha: Array) -> float:
    """Return the median over actuators of an (n,) error relative to alpha, without NaN."""
    return float(np.nanmedian(error / np.abs(alpha)))


def scale_total(lines: tuple[ScaleError, ...]) -> float:
    """Return the relative standard uncertainty of the common scale."""
    return float(np.sqrt(sum(line.relative**2 for line in lines)))


def tilt_as_load(weight: float, weight_error: float, tilt: float, tilt_error: float) -> float:
    """Return the relative error of the scale if a tilt of the mirror were the second load.

    The change of weight is P (1 - cos tilt); P in N, the tilt in degrees.
    """
    from_angle = np.radians(tilt_error) / np.tan(np.radians(tilt) / 2)
    return float(np.hypot(weight_error / weight, from_angle))
