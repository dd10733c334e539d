"""The errors that a calibration will state, from the forces of a plan, before it is measured.

Noiseless forces and the sums of the likelihood give the information on alpha that noisy readings
will contain (Fisher's; its inverse is the bound of Cramer and Rao) and the covariance that the
estimator will state. The code is that of the estimator, at the truth instead of at the minimum.

For reciprocity, the information of one cycle of the shapes comes from its fit at the truth; the
mean forces under the loads go through the likelihood of `ml`, as in a fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.campaign_ml import patterns_near_noise, tolerable, with_patterns_held
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    Diagnosis,
    ScaleError,
    errors_between_loads,
    scale_errors,
    typical,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import expected
from truenewton.estimation.paper.identifiability import (
    describe_pattern,
    load_fault,
    refuse,
    structural_faults,
)
from truenewton.estimation.problem import Problem, problem_of
from truenewton.estimation.readings.moments import Moments, ShapeSums, reading_noise
from truenewton.estimation.reciprocity.campaign import alpha_information, mean_forces
from truenewton.estimation.reciprocity.information import information
from truenewton.estimation.reciprocity.iteration import point_at
from truenewton.estimation.reciprocity.regression import Regressed, refuse_unheld
from truenewton.estimation.reciprocity.sensor_model import Kind, Places, Request, at_nominal
from truenewton.linalg import largest_eigenvalue
from truenewton.records.campaign import Campaign
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class Prediction:
    """The errors that a calibration will state, of the n enabled actuators."""

    layout: Layout  # the actuators, disabled ones included
    alpha: Array  # (n,) the alpha that was assumed
    # (n, n) covariance of alpha from the readings and from the weights
    reading_covariance: Array
    systematic_covariance: Array
    # budget of the common scale, largest first; empty where the scale is free
    scale_errors: tuple[ScaleError, ...]
    diagnosis: Diagnosis  # weak patterns; its undetermined ones will hardly exceed the noise

    @property
    def scale_is_free(self) -> bool:
        """Whether no two loads differ in weight, so that only patterns of alpha are known."""
        return not self.scale_errors

    @property
    def statistical_error(self) -> Array:
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
        return np.hypot(self.statistical_error, self.systematic_error)

    @property
    def typical_errors(self) -> tuple[float, float, float]:
        """Medians over actuators of E_ALPHA, E_STAT and E_SYST, relative to alpha."""
        error, statistical, systematic = (
            typical(each, self.alpha)
            for each in (self.error, self.statistical_error, self.systematic_error)
        )
        return error, statistical, systematic

    @property
    def typical(self) -> float:
        """Median over actuators of E_ALPHA relative to alpha."""
        return self.typical_errors[0]


@dataclass(frozen=True, eq=False)
class SensorInformation:
    """The information of one cycle of the shapes on alpha and on the sensors."""

    asked: Request
    # (u, u) information on the unknowns, relative alpha first; proportional to the cycles
    data: Array

    def after(self, cycles: int) -> Array:
        """Return (u, u) the information of so many cycles and of what is known before."""
        n = len(self.data) // len(self.asked.kinds)
        return np.asarray(cycles * self.data + np.diag(self.asked.information(n)))


def sensor_information(
    places: Places,
    asked: Request,
    shapes: Array,
    force: Array,
    *,
    force_noise: float,
    position_noise: float,
) -> SensorInformation:
    """Return the information of noiseless forces and readings on relative alpha and the sensors.

    The (N, n) readings [m] and commanded forces [N] are those of one cycle under all loads, less
    those at rest: every shape has both signs, so that their means are 0. The noises are standard
    deviations of one reading [N], [m]. A RankDeficient tells that no shape contains some motion of
    the mirror.
    """
    square = shapes.T @ shapes
    refuse_unheld(square)
    stiffness = np.asarray(np.linalg.solve(square, shapes.T @ force).T)
    noise = force_noise**2 * np.eye(places.n) + position_noise**2 * stiffness @ stiffness.T
    states = Regressed(stiffness, square, np.asarray(noise)).states
    point = point_at(places, at_nominal(places.n), asked, states)
    return SensorInformation(asked, information(point)[0])


def predict(
    campaign: Campaign,
    moments: Moments,
    cycles: int,
    alpha: Array,
    gained: SensorInformation | None = None,
) -> Prediction:
    """Predict the errors of alpha from noiseless forces, by `ml` or by reciprocity.

    The campaign has one cycle for each load with the forces that would be commanded without noise,
    and these moments; with (n,) alpha they balance. FORCERR is the noise that one
    reading will have, and each cycle will be run ``cycles`` times. With what reciprocity obtains
    from the same shapes, ``gained``, the errors are those of reciprocity.
    """
    free = load_fault(campaign)
    refuse(fault for fault in structural_faults(campaign, moments) if fault != free)
    force = moments.sums.force.sum(axis=1) / moments.sums.weight
    errors = weight_errors(campaign) | errors_between_loads(campaign, force)
    problem = problem_of(campaign, reading_noise(campaign, moments), errors)
    n, layout = problem.n, campaign.layout
    values = _true_values(problem, moments, alpha)
    if free:
        problem = with_patterns_held(problem, alpha[:, None] / np.linalg.norm(alpha))
    of_loads, *elastic = problem.data(moments)
    prior = problem.prior
    if gained is not None:
        of_loads, elastic = mean_forces(problem, moments), []
        relative = alpha_information(gained.after(cycles), gained.asked)
        prior = prior.with_more(relative / np.outer(alpha, alpha))
    data = [replace(of_loads, sums=repeated(of_loads.sums, cycles)), *elastic]
    minimum = expected(problem.a, data, prior, values)
    weak = 0 if gained is not None else patterns_near_noise(minimum, of_loads.sums.shapes)
    reading_covariance, changes = minimum.reading_covariance[:n, :n], minimum.changes[:n]
    value, vector = largest_eigenvalue(reading_covariance)
    budget = () if free else scale_errors(alpha, reading_covariance, changes.T, problem.errors)
    return Prediction(
        layout=layout,
        alpha=alpha,
        reading_covariance=reading_covariance,
        systematic_covariance=changes @ changes.T,
        scale_errors=budget,
        diagnosis=Diagnosis(
            undetermined=weak,
            warnings=tuple(filter(None, (free, _undetermined(weak, n)))),
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
    """Return the sums over the same shapes, each read in so many cycles."""
    names = ("weight", "force", "square", "known", "known_force", "known_square")
    return replace(sums, **{name: cycles * getattr(sums, name) for name in names})


def _undetermined(undetermined: int, n: int) -> Finding | None:
    """Return a finding of patterns that noise will dominate, or of a refusal because of them."""
    if not undetermined:
        return None
    usable = tolerable(Diagnosis(undetermined=undetermined, span=n), n)
    code = Code.PLANNED_WEAK_PATTERNS if usable else Code.PLANNED_REFUSAL
    return Finding.of(code, count=undetermined)


def sensor_errors(gained: SensorInformation, cycles: int) -> dict[Kind, Array]:
    """Return the (n,) errors of log gains and of offsets [m], as far as they are unknown."""
    whole, kinds = gained.after(cycles), gained.asked.kinds
    n = len(whole) // len(kinds)
    whole[:n, :n] += np.trace(whole[:n, :n]) / n**2  # relative alpha alone
    unit = 1.0 / np.sqrt(np.diag(whole))
    inverse = scipy.linalg.inv(unit[:, None] * whole * unit, check_finite=False)
    errors = np.split(unit * np.sqrt(np.diag(inverse)), len(kinds))
    return dict(zip(kinds[1:], errors[1:], strict=True))
