"""The likelihood of a short run with an earlier calibration as prior; actuators that moved.

With I the information of the prior and H^-1 M H^-1 the covariance of the estimate
(docs/likelihood.md), errors of the weights included, the residual of the prior and its covariance
are

    q = I (alpha - alpha_earlier),        I - 2 I H^-1 I + I H^-1 M H^-1 I,

and q_i over its standard deviation is standard normal unless actuator i has moved.

The others may each have changed a little: alpha = alpha_earlier (1 + e), e ~ N(0, s^2). This adds
s^2 D D' to the covariance of q, with D = (I - I H^-1 I) diag(alpha_earlier). s is estimated as
tracking does it from days (`tracking.scatter`); the prior is then
(I^-1 + s^2 diag(alpha_earlier^2))^-1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError, NotConverged, RankDeficient
from truenewton.estimation.findings.estimate import RejectedRow, WeightErrors
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.paper.identifiability import load_fault
from truenewton.estimation.problem import (
    Problem,
    balancing_groups,
    balancing_moments,
    problem_of,
    with_noise_from_minimum,
    with_share_in_balance,
)
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import reading_noise
from truenewton.estimation.screening.screen import ScreenedCampaign
from truenewton.linalg import inverse_of_positive, mirrored
from truenewton.recalibration.prior import PriorCalibration
from truenewton.tracking.scatter import Scatter, estimate_scatter

LOOSE_ERROR = 0.2  # relative error of each actuator, and of the common scale, in a prior with
SCALE_ERROR = 1e-4  # which every actuator may move: bad rows are judged by it
MIN_VARIANCE = 1e-6  # of a residual, in variances of the prior: below, the run does not constrain


def run_from(data: Any) -> Any:
    """Return the run, of one body or of several segments; refuse data other than cycles."""
    if not getattr(data, "cycles", ()):
        raise FormatError("contains no cycles", remedy="give the run after the change")
    if data.stiffness is not None:
        raise FormatError("contains a stiffness matrix beside the cycles", remedy="leave it out")
    return data


def build_problem(
    known: PriorCalibration, screened: ScreenedCampaign, errors: WeightErrors
) -> Problem:
    """Return the problem of a run about the earlier alpha, without information of the prior."""
    campaign = screened.sound
    problem = problem_of(campaign, reading_noise(campaign, screened.moments), errors)
    alpha = np.where(np.isfinite(known.alpha), known.alpha, np.nanmean(known.alpha))
    mean = np.zeros(problem.unknowns.total)
    mean[problem.unknowns.alpha] = alpha[campaign.layout.enabled]
    # Where all weigh the same, B takes up every error of a weight.
    held = load_fault(campaign) is not None
    return replace(problem, prior=replace(problem.prior, mean=mean, held=held))


def constrain(
    problem: Problem, known: PriorCalibration, stay: NDArray[np.bool_], scatter: float = 0.0
) -> Problem:
    """Return the problem with the (n,) actuators ``stay`` held to their earlier calibration.

    ``scatter`` is the relative change of each since then.
    """
    on = problem.campaign.layout.enabled
    at = np.ix_(stay, stay)
    information = np.zeros((problem.n, problem.n))
    covariance = known.covariance + np.diag((scatter * known.alpha) ** 2)
    information[at] = inverse_of_positive(covariance[np.ix_(on, on)][at])
    return replace(problem, prior=replace(problem.prior, information=information))


def _loosely_constrained(problem: Problem, new: NDArray[np.bool_]) -> Problem:
    """Return the problem with the common scale held, and each actuator loosely unless (n,) new."""
    alpha = problem.prior.mean[: problem.n]
    size = np.where(new, 1e3, LOOSE_ERROR) * alpha
    stay = ~new / alpha / np.count_nonzero(~new)
    information = np.diag(size**-2) + np.outer(stay, stay) / SCALE_ERROR**2
    return replace(problem, prior=replace(problem.prior, information=information))


def balancing(
    posed: Problem, known: PriorCalibration, screened: ScreenedCampaign, new: NDArray[np.bool_]
) -> tuple[Problem, Moments, Minimum, tuple[RejectedRow, ...]]:
    """Leave out shapes that do not balance, by a fit in which every actuator may have moved.

    If the (n,) ``new`` actuators were held to their earlier calibration, good shapes would look
    bad.
    """
    moments = screened.moments
    try:
        free = _loosely_constrained(posed, new)
        belongs, distance, (problem, minimum) = balancing_groups(free, moments)
    except (RankDeficient, NotConverged):  # too little data to let everyone move
        free = constrain(posed, known, ~new)
        belongs, distance, (problem, minimum) = balancing_groups(free, moments)
    free = with_share_in_balance(free, screened, minimum.values[: problem.n])
    if free.dependent:
        belongs, distance, (problem, minimum) = balancing_groups(free, moments)
    moments, lost = balancing_moments(screened, belongs, distance, (problem, minimum))
    problem, minimum = with_noise_from_minimum(problem, moments, minimum, degrees_of)
    return problem, moments, minimum, lost


def inverse_of(problem: Problem, minimum: Minimum) -> Array:
    """Return H^-1 of the f unknowns that are not held, (f, f)."""
    prior = problem.prior
    free = len(minimum.values) - (prior.measured if prior.held else 0)
    return inverse_of_positive(mirrored(minimum.information[:free, :free]))


def degrees_of(problem: Problem, moments: Moments, minimum: Minimum) -> float:
    """Return the equations less the information of the data on the unknowns beyond the prior."""
    inverse = inverse_of(problem, minimum)
    free = len(inverse)
    from_prior = float(np.sum(inverse * problem.prior.added_to(np.zeros((free, free)))))
    return 3 * moments.sums.shapes - free + from_prior


@dataclass(frozen=True, eq=False)
class PriorResiduals:
    """Residuals of the prior, of the actuators that are held.

    Attributes
    ----------
    sigmas
        (n,) of each actuator given all others; 0 if it is not held.
    variance
        (n,) of a relative change of alpha of each, from its residual.
    contrasts, covariance, shift
        (m,) independent residuals, their (m,) variances, and the (m, s) derivatives by relative
        changes of alpha of the s that are held.
    """

    sigmas: Array
    variance: Array
    contrasts: Array
    covariance: Array
    shift: Array

    @property
    def chi2(self) -> float:
        """Of all together, with as many degrees of freedom as contrasts."""
        return float(np.sum(self.contrasts**2 / self.covariance))

    @cached_property
    def scatter(self) -> Scatter:
        """Relative change of each actuator that is held."""
        y, covariance = self.contrasts[None], np.diag(self.covariance)[None]
        if not y.size:
            return Scatter()
        everyone = np.ones(self.shift.shape[1], dtype=bool)
        return estimate_scatter(y, covariance, self.shift, everyone, common=False)


def prior_residuals(problem: Problem, minimum: Minimum, stay: NDArray[np.bool_]) -> PriorResiduals:
    """Return the residuals of the prior of the (n,) actuators that stay."""
    n = problem.n
    at = np.ix_(stay, stay)
    prior = problem.prior
    information = prior.information[at]
    apart = (minimum.values - prior.mean)[:n][stay]
    root = scipy.linalg.cholesky(information, lower=True)
    # In units of the prior: variances 0 (the run says nothing) to 1 (it says all).
    inverse = root.T @ inverse_of(problem, minimum)[:n, :n][at] @ root
    by_weights = minimum.changes[:n][stay]
    spread = root.T @ (minimum.reading_covariance[:n, :n][at] + by_weights @ by_weights.T) @ root
    one = np.eye(len(apart))
    variance = one - 2 * inverse + spread
    pull = root.T @ apart
    values, vectors = scipy.linalg.eigh(variance)
    held = values > MIN_VARIANCE
    told = vectors[:, held].T
    of_each = np.einsum("ia,ab,ib->i", root, variance, root)
    of_each = np.maximum(of_each, MIN_VARIANCE * np.sum(root**2, axis=1))
    alpha = prior.mean[:n]
    sigmas, relative = np.zeros(n), np.zeros(n)
    sigmas[stay] = root @ pull / np.sqrt(of_each)
    relative[stay] = 1 / (alpha[stay] ** 2 * of_each)
    shift = told @ (one - inverse) @ root.T * alpha[stay]
    return PriorResiduals(sigmas, relative, told @ pull, values[held], shift)
