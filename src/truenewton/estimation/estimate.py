"""What every method hands over: values, covariances, and how they came about."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import (
    Diagnosis,
    Goodness,
    RejectedRow,
    ScaleError,
    Sensor,
    UnseenError,
)
from truenewton.estimation.findings.finding import Finding


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
