"""A short run beside an earlier calibration: its likelihood, its bad rows, who has moved.

Who has moved besides: with I the information of the prior and H^-1 M H^-1 the covariance of the
estimate (docs/likelihood.md), errors of the weights included, the pull of the prior and its
covariance are

    q = I (alpha - alpha_earlier),        I - 2 I H^-1 I + I H^-1 M H^-1 I,

and q_i over its standard deviation is standard normal unless actuator i has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.identifiability import load_fault
from truenewton.estimation.minimum import Minimum, Prior
from truenewton.estimation.moments import Moments, chosen_groups
from truenewton.estimation.noise import Noise, reading_noise
from truenewton.estimation.outliers import balancing_groups, rows_of
from truenewton.estimation.problem import (
    Problem,
    with_noise_from_minimum,
    with_share_in_balance,
)
from truenewton.estimation.sifted import Sifted, refuse_too_many
from truenewton.estimation.unknowns import Unknowns
from truenewton.estimation.weights import WeightErrors
from truenewton.linalg import mirrored
from truenewton.recalibration.known import EarlierCalibration
from truenewton.records.campaign import Campaign

LOOSE = 0.2  # relative, of a prior that lets everyone move: bad rows are judged by it
SCALE_HELD = 1e-4  # of the common scale in it
SMALL = 1e-6  # part of the prior's variance below which the run says nothing


@dataclass(frozen=True, eq=False)
class ShortRun:
    """A run and what is known beside it; (n,) arrays over its enabled actuators."""

    known: EarlierCalibration
    campaign: Campaign
    errors: WeightErrors
    alpha: Array
    covariance: Array

    @property
    def held(self) -> bool:
        """Whether B takes up every error of a weight: all loads weigh the same."""
        return load_fault(self.campaign) is not None

    def problem(self, noise: Noise, information: Array) -> Problem:
        """Pose the problem with (n, n) information on alpha."""
        errors = len(self.errors)
        unknowns = Unknowns(len(self.alpha), len(self.campaign.loads), errors)
        mean = np.zeros(unknowns.total)
        mean[unknowns.alpha] = self.alpha
        prior = Prior(mean, information, errors, self.held)
        return Problem(self.campaign, self.errors, noise, prior)

    def tight(self, stay: NDArray[np.bool_]) -> Array:
        """Return the (n, n) information of the earlier calibration on the (n,) who stay."""
        information = np.zeros_like(self.covariance)
        at = np.ix_(stay, stay)
        information[at] = scipy.linalg.inv(self.covariance[at])
        return information

    def loose(self, new: NDArray[np.bool_]) -> Array:
        """Return (n, n) information that holds little but the common scale; (n,) are new."""
        size = np.where(new, 1e3, LOOSE) * self.alpha
        stay = ~new / self.alpha / np.count_nonzero(~new)
        return np.asarray(np.diag(size**-2) + np.outer(stay, stay) / SCALE_HELD**2)


def balancing(
    run: ShortRun, sifted: Sifted, new: NDArray[np.bool_]
) -> tuple[Problem, Moments, Minimum, list[RejectedRow]]:
    """Leave out shapes that do not balance, by a fit in which every actuator may have moved.

    Held to its earlier calibration, one that was replaced, of (n,) ``new``, would make good shapes
    look bad.
    """
    moments = sifted.moments
    noise = reading_noise(run.campaign, moments)
    try:
        posed = run.problem(noise, run.loose(new))
        belongs, distance, (problem, minimum) = balancing_groups(posed, moments)
    except (RankDeficient, NotConverged):  # too little data to let everyone move
        posed = run.problem(noise, run.tight(~new))
        belongs, distance, (problem, minimum) = balancing_groups(posed, moments)
    shared = with_share_in_balance(posed, sifted, minimum.values[: problem.n])
    if shared.noise.share != 1.0:
        belongs, distance, (problem, minimum) = balancing_groups(shared, moments)
    lost: list[RejectedRow] = []
    if not belongs.all():
        actuator = problem.standing_out(minimum.values, moments)
        lost = rows_of(run.campaign, ~belongs, distance, actuator)
        refuse_too_many(len(lost), int(moments.rows.sum()))
        moments = chosen_groups(moments, belongs)
    problem, minimum = with_noise(problem, moments, minimum)
    return problem, moments, minimum, lost


def inverse_of(problem: Problem, minimum: Minimum) -> Array:
    """Return H^-1 of the unknowns that are not held."""
    prior = problem.prior
    free = len(minimum.values) - (prior.measured if prior.held else 0)
    return np.asarray(scipy.linalg.inv(mirrored(minimum.information[:free, :free])))


def degrees_of(problem: Problem, moments: Moments, inverse: Array) -> float:
    """Return equations less what the data say of the u unknowns, by (u, u) ``inverse``."""
    free = len(inverse)
    from_prior = float(np.sum(inverse * problem.prior.added_to(np.zeros((free, free)))))
    return 3 * moments.groups - free + from_prior


def with_noise(problem: Problem, moments: Moments, minimum: Minimum) -> tuple[Problem, Minimum]:
    """Give the noise its size from the minimum where nothing else does."""

    def degrees(problem: Problem, minimum: Minimum) -> float:
        return degrees_of(problem, moments, inverse_of(problem, minimum))

    return with_noise_from_minimum(problem, moments, minimum, degrees)


def pulls(problem: Problem, minimum: Minimum, stay: NDArray[np.bool_]) -> tuple[Array, float, int]:
    """Return (n,) how far each who stays is pulled, in sigmas; chi2 of all together; degrees."""
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
    variance = np.eye(len(apart)) - 2 * inverse + spread
    pull = root.T @ apart
    values, vectors = scipy.linalg.eigh(variance)
    held = values > SMALL
    chi2 = float(np.sum((vectors[:, held].T @ pull) ** 2 / values[held]))
    z = np.zeros(n)
    of_each = np.einsum("ia,ab,ib->i", root, variance, root)
    z[stay] = root @ pull / np.sqrt(np.maximum(of_each, SMALL * np.sum(root**2, axis=1)))
    return z, chi2, int(np.count_nonzero(held))
