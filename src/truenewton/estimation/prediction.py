"""What a campaign will give, from the forces that it will command, before a reading is taken.

From noiseless forces the likelihood's own sums give the information on alpha that readings with
noise will hold (Fisher's; its inverse is the bound of Cramer and Rao), and the covariance that the
estimator will state: the same code, at the truth instead of at the minimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.campaign_ml import patterns_near_noise, tolerable, with_patterns_held
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Diagnosis, ScaleError
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.findings.scale_budget import scale_errors, typical
from truenewton.estimation.likelihood.minimum import Minimum
from truenewton.estimation.likelihood.objective import expected
from truenewton.estimation.paper.identifiability import (
    describe_pattern,
    load_fault,
    refuse,
    structural_faults,
)
from truenewton.estimation.problem import Problem, problem_of
from truenewton.estimation.readings.moments import Moments, ShapeSums
from truenewton.estimation.screening.noise import reading_noise
from truenewton.linalg import largest_eigenvalue
from truenewton.records.campaign import Campaign
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class Prediction:
    """The errors that a calibration will state, over the n enabled actuators.

    Attributes
    ----------
    layout
        The actuators, disabled ones among them.
    alpha
        (n,) the alpha that was reckoned with.
    reading_covariance, systematic_covariance
        (n, n) covariance of alpha from the readings and from the weights.
    scale_errors
        Budget of the common scale, largest first; empty where the scale is free.
    diagnosis
        What will be weak; its undetermined patterns are those that will stand hardly above noise.
    """

    layout: Layout
    alpha: Array
    reading_covariance: Array
    systematic_covariance: Array
    scale_errors: tuple[ScaleError, ...]
    diagnosis: Diagnosis

    @property
    def scale_is_free(self) -> bool:
        """Whether no two loads differ in weight; the readings then give patterns alone."""
        return not self.scale_errors

    @property
    def reading_error(self) -> Array:
        """(n,) E_STAT; of patterns alone where the scale is free."""
        return np.sqrt(np.diag(self.reading_covariance))

    @property
    def systematic_error(self) -> Array:
        """(n,) E_SYST; infinite where the scale is free."""
        if self.scale_is_free:
            return np.full(len(self.alpha), np.inf)
        return np.sqrt(np.diag(self.systematic_covariance))

    @property
    def error(self) -> Array:
        """(n,) E_ALPHA."""
        return np.hypot(self.reading_error, self.systematic_error)

    @property
    def typical(self) -> float:
        """Median over actuators of E_ALPHA relative to alpha."""
        return typical(self.error, self.alpha)


def predict(
    campaign: Campaign, moments: Moments, cycles: int = 1, alpha: Array | None = None
) -> Prediction:
    """Predict the errors of alpha from noiseless forces, whoever made them.

    Parameters
    ----------
    campaign
        One cycle for each load, of forces as the electronics would command them without noise;
        with alpha they balance. FORCERR is the noise that one reading will have.
    moments
        Of this campaign.
    cycles
        How often each cycle will be run.
    alpha
        (n,) of the enabled actuators; 1 unless told.

    Raises
    ------
    RankDeficient
        The shapes or the actuators cannot fix alpha, whatever the noise.
    """
    known = known_beforehand(campaign, moments, alpha)
    of_loads, *elastic = known.problem.data(moments)
    data = [replace(of_loads, sums=repeated(of_loads.sums, cycles)), *elastic]
    minimum = expected(known.problem.a, data, known.problem.prior, known.values)
    return stated(known, minimum, patterns_near_noise(minimum, of_loads.sums.shapes))


@dataclass(frozen=True, eq=False)
class Known:
    """What there is before a reading is taken.

    Attributes
    ----------
    problem
        The problem; the common scale is held where it is free.
    values
        (u,) unknowns for which the forces balance.
    free
        Why the common scale is free, if it is.
    """

    problem: Problem
    values: Array
    free: Finding | None


def known_beforehand(campaign: Campaign, moments: Moments, alpha: Array | None) -> Known:
    """Pose the problem of a campaign without noise, (n,) alpha known, as for `predict`.

    Raises
    ------
    RankDeficient
    """
    free = load_fault(campaign)
    refuse(fault for fault in structural_faults(campaign, moments) if fault != free)
    problem = problem_of(campaign, reading_noise(campaign, moments))
    alpha = np.ones(problem.n) if alpha is None else alpha
    values = _true_values(problem, moments, alpha)
    if free:
        problem = with_patterns_held(problem, alpha[:, None] / np.linalg.norm(alpha))
    return Known(problem, values, free)


def stated(known: Known, minimum: Minimum, undetermined: int = 0) -> Prediction:
    """Return what an estimate from such a minimum will state."""
    problem, n = known.problem, known.problem.n
    layout, alpha = problem.campaign.layout, known.values[:n]
    reading_covariance, changes = minimum.reading_covariance[:n, :n], minimum.changes[:n]
    warnings = (known.free, _undetermined(undetermined, n))
    value, vector = largest_eigenvalue(reading_covariance)
    return Prediction(
        layout=layout,
        alpha=alpha,
        reading_covariance=reading_covariance,
        systematic_covariance=changes @ changes.T,
        scale_errors=()
        if known.free
        else scale_errors(alpha, reading_covariance, changes.T, problem.errors),
        diagnosis=Diagnosis(
            undetermined=undetermined,
            warnings=tuple(warning for warning in warnings if warning),
            weakest=describe_pattern(vector, layout),
            weakest_share=value / float(np.trace(reading_covariance)),
        ),
    )


def _true_values(problem: Problem, moments: Moments, alpha: Array) -> Array:
    """Return the (u,) unknowns for which the forces balance: alpha, B, torques, no error."""
    sums = moments.sums
    mean = sums.force / sums.weight[:, None]
    k = -(mean * alpha) @ problem.a.T  # (W + B, M_y, -M_x) of each load
    unknowns = problem.unknowns
    values = np.zeros(unknowns.total)
    values[unknowns.alpha] = alpha
    values[unknowns.bias] = np.mean(k[:, 0] - problem.campaign.effective_weights)
    values[unknowns.torques] = (k[:, 1:] * [1.0, -1.0]).ravel()
    return values


def repeated(sums: ShapeSums, cycles: int) -> ShapeSums:
    """Return the sums over the same shapes, each read so many times."""
    names = ("weight", "force", "square", "known", "known_force", "known_square")
    return replace(sums, **{name: cycles * getattr(sums, name) for name in names})


def _undetermined(undetermined: int, n: int) -> Finding | None:
    """Return patterns that noise will decide; of a campaign that will be refused, that it will."""
    if not undetermined:
        return None
    usable = tolerable(Diagnosis(undetermined=undetermined, span=n), n)
    code = Code.PLANNED_WEAK_PATTERNS if usable else Code.PLANNED_REFUSAL
    return Finding.of(code, count=undetermined)
