"""A short run beside an earlier calibration: its likelihood, its bad rows, who has moved.

Who has moved besides: with I the information of the prior and H^-1 M H^-1 the covariance of the
estimate (docs/likelihood.md), errors of the weights included, the pull of the prior and its
covariance are

    q = I (alpha - alpha_earlier),        I - 2 I H^-1 I + I H^-1 M H^-1 I,

and q_i over its standard deviation is standard normal unless actuator i has moved.

Others may have changed a little each, too: alpha = alpha_earlier (1 + e), e ~ N(0, s^2), which adds
s^2 D D' to the covariance of q, with D = (I - I H^-1 I) diag(alpha_earlier). From that s is
estimated as tracking does it from days (`tracking.scatter`); the prior then is
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
from truenewton.recalibration.known import EarlierCalibration
from truenewton.tracking.scatter import Scatter, scatter_of

LOOSE = 0.2  # relative, of a prior that lets everyone move: bad rows are judged by it
SCALE_HELD = 1e-4  # of the common scale in it
SMALL = 1e-6  # part of the prior's variance below which the run says nothing


def run_from(data: Any) -> Any:
    """Return the run, of one body or of several segments; refuse what is not cycles alone."""
    if not getattr(data, "cycles", ()):
        raise FormatError("holds no cycles", remedy="give the run after the change")
    if data.stiffness is not None:
        raise FormatError("a stiffness matrix stands among the cycles", remedy="leave it out")
    return data


def build_problem(
    known: EarlierCalibration, screened: ScreenedCampaign, errors: WeightErrors
) -> Problem:
    """Pose the problem of a run about the earlier alpha, of which nothing is held yet."""
    campaign = screened.sound
    problem = problem_of(campaign, reading_noise(campaign, screened.moments), errors)
    alpha = np.where(np.isfinite(known.alpha), known.alpha, np.nanmean(known.alpha))
    mean = np.zeros(problem.unknowns.total)
    mean[problem.unknowns.alpha] = alpha[campaign.layout.enabled]
    # Where all weigh the same, B takes up every error of a weight.
    held = load_fault(campaign) is not None
    return replace(problem, prior=replace(problem.prior, mean=mean, held=held))


def constrain(
    problem: Problem, known: EarlierCalibration, stay: NDArray[np.bool_], scatter: float = 0.0
) -> Problem:
    """Return the problem with the (n,) who stay held to their earlier calibration.

    ``scatter`` is what each may have changed by since, relative.
    """
    on = problem.campaign.layout.enabled
    at = np.ix_(stay, stay)
    information = np.zeros((problem.n, problem.n))
    covariance = known.covariance + np.diag((scatter * known.alpha) ** 2)
    information[at] = inverse_of_positive(covariance[np.ix_(on, on)][at])
    return replace(problem, prior=replace(problem.prior, information=information))


def _hardly_held(problem: Problem, new: NDArray[np.bool_]) -> Problem:
    """Return the problem with little held but the common scale; (n,) are new."""
    alpha = problem.prior.mean[: problem.n]
    size = np.where(new, 1e3, LOOSE) * alpha
    stay = ~new / alpha / np.count_nonzero(~new)
    information = np.diag(size**-2) + np.outer(stay, stay) / SCALE_HELD**2
    return replace(problem, prior=replace(problem.prior, information=information))


def balancing(
    posed: Problem, known: EarlierCalibration, screened: ScreenedCampaign, new: NDArray[np.bool_]
) -> tuple[Problem, Moments, Minimum, tuple[RejectedRow, ...]]:
    """Leave out shapes that do not balance, by a fit in which every actuator may have moved.

    Held to its earlier calibration, one that was replaced, of (n,) ``new``, would make good shapes
    look bad.
    """
    moments = screened.moments
    try:
        free = _hardly_held(posed, new)
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
    """Return equations less what the data say of the unknowns beside the prior."""
    inverse = inverse_of(problem, minimum)
    free = len(inverse)
    from_prior = float(np.sum(inverse * problem.prior.added_to(np.zeros((free, free)))))
    return 3 * moments.sums.shapes - free + from_prior


@dataclass(frozen=True, eq=False)
class Pulls:
    """How the prior is pulled by a run, of those who stay.

    Attributes
    ----------
    sigmas
        (n,) of each actuator given all others; 0 of who does not stay.
    variance
        (n,) of a change of alpha of each, relative, that would pull so.
    contrasts, covariance, shift
        (m,) independent pulls, the (m,) variances that they have, and the (m, s) changes that
        relative changes of alpha of the s who stay make.
    """

    sigmas: Array
    variance: Array
    contrasts: Array
    covariance: Array
    shift: Array

    @property
    def chi2(self) -> float:
        """Of all together, of as many degrees of freedom as there are contrasts."""
        return float(np.sum(self.contrasts**2 / self.covariance))

    @cached_property
    def scatter(self) -> Scatter:
        """By how much each of those who stay has changed, relative."""
        y, covariance = self.contrasts[None], np.diag(self.covariance)[None]
        if not y.size:
            return Scatter()
        everyone = np.ones(self.shift.shape[1], dtype=bool)
        return scatter_of(y, covariance, self.shift, everyone, common=False)


def prior_residuals(problem: Problem, minimum: Minimum, stay: NDArray[np.bool_]) -> Pulls:
    """Return how the (n,) who stay are pulled."""
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
    held = values > SMALL
    told = vectors[:, held].T
    of_each = np.einsum("ia,ab,ib->i", root, variance, root)
    of_each = np.maximum(of_each, SMALL * np.sum(root**2, axis=1))
    alpha = prior.mean[:n]
    sigmas, relative = np.zeros(n), np.zeros(n)
    sigmas[stay] = root @ pull / np.sqrt(of_each)
    relative[stay] = 1 / (alpha[stay] ** 2 * of_each)
    shift = told @ (one - inverse) @ root.T * alpha[stay]
    return Pulls(sigmas, relative, told @ pull, values[held], shift)
