"""What the likelihood is asked: data, noise, unknowns and priors of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.scale_budget import WeightErrors, weight_errors
from truenewton.estimation.likelihood.minimum import DataSet, Minimum, Prior
from truenewton.estimation.likelihood.objective import minimise, start_values
from truenewton.estimation.matrix.ml import likeliest, mode_data
from truenewton.estimation.matrix.modes import elastic_modes
from truenewton.estimation.paper.equations import (
    MEDIAN_CHI2,
    Unknowns,
    imbalance_covariance,
    squared_distances,
    standing_out,
)
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.noise import Noise
from truenewton.estimation.screening.screen import ScreenedCampaign
from truenewton.records.campaign import Campaign
from truenewton.statics.arms import comparable_arms, enabled_arms, external_load


def load_data(
    campaign: Campaign, moments: Moments, variance: Array, errors: WeightErrors
) -> DataSet:
    """Return the shapes of all loads, whose readings have the (n,) variance [N^2], with weights."""
    unknowns = Unknowns(len(variance), len(campaign.loads), len(errors))
    nuisance = unknowns.external_load_derivative(tuple(errors.values()))
    known = external_load(campaign.effective_weights, 0.0, 0.0, 0.0)
    return DataSet(moments.sums, variance, known, nuisance)


@dataclass(frozen=True, eq=False)
class Problem:
    """All that the likelihood needs besides the moments.

    Attributes
    ----------
    campaign
        The campaign.
    errors
        Of the weights; their size is the last of the unknowns.
    noise
        Of a reading.
    prior
        Of the errors of the weights, and of alpha where it is one of a population.
    elastic
        Shapes from a stiffness matrix.
    moved
        (3, n) how far the arms are from those of the layout; 0 unless positions were corrected.
    disturbance
        (3, 3) of `minimum.DataSet`.
    """

    campaign: Campaign
    errors: WeightErrors
    noise: Noise
    prior: Prior
    elastic: tuple[DataSet, ...] = ()
    moved: Array | float = 0.0
    disturbance: Array | float = 0.0

    @property
    def dependent(self) -> bool:
        """Whether the readings of a row depend on each other, as far as the balance feels it."""
        return bool(np.isfinite(self.noise.share_freedom))

    @cached_property
    def a(self) -> Array:
        """(3, n) arms of the enabled actuators."""
        return np.asarray(enabled_arms(self.campaign.layout) + self.moved)

    @property
    def n(self) -> int:
        """Number of enabled actuators."""
        return int(self.a.shape[1])

    @property
    def unknowns(self) -> Unknowns:
        """The order of the unknowns, errors of the weights among them."""
        return Unknowns(self.n, len(self.campaign.loads), len(self.errors))

    def degrees_of_freedom(self, moments: Moments) -> int:
        """Return equations less unknowns; errors of the weights are measured, so neither."""
        shapes = moments.sums.shapes + sum(part.sums.shapes for part in self.elastic)
        return 3 * shapes - self.unknowns.count

    def data(self, moments: Moments) -> list[DataSet]:
        """Return the shapes of each load, with its weight and unknowns, and the elastic ones."""
        of_loads = load_data(self.campaign, moments, self.noise.in_balance, self.errors)
        excess, disturbance = 1.0 / self.noise.share, self.disturbance
        return [replace(of_loads, excess=excess, disturbance=disturbance), *self.elastic]

    def fitted(self, moments: Moments, start: Array | None = None) -> Minimum:
        """Return the likeliest values, from a (u,) start where there is a better one than usual."""
        data = self.data(moments)
        begin = start_values(self.a, data, self.prior) if start is None else start
        return minimise(self.a, data, self.prior, begin)

    def imbalance(self, values: Array, moments: Moments) -> tuple[Array, Array]:
        """Return (g, 3) rho of the groups, and S."""
        scaled_arms = self.a * values[: self.n]
        of_loads = load_data(self.campaign, moments, self.noise.in_balance, self.errors)
        k = of_loads.external(values[self.n :])
        rho = (scaled_arms @ moments.mean.T).T + moments.known + k[moments.labels[:, 0]]
        return rho, imbalance_covariance(scaled_arms, self.noise.in_balance) + self.disturbance

    def distances(self, values: Array, moments: Moments) -> Array:
        """Return (g,) squared Mahalanobis distances of the groups."""
        rho, s = self.imbalance(values, moments)
        return squared_distances(rho, moments.weight, s)

    def standing_out(self, values: Array, moments: Moments) -> NDArray[np.int64]:
        """Return (g,) the ID that would best explain the imbalance of each group."""
        rho, s = self.imbalance(values, moments)
        ids = self.campaign.layout.id[self.campaign.layout.enabled]
        return np.asarray(ids[standing_out(rho, self.a * values[: self.n], s)])


def problem_of(campaign: Campaign, noise: Noise, errors: WeightErrors | None = None) -> Problem:
    """Pose the problem of a campaign, whose weights have their declared errors unless given."""
    errors = weight_errors(campaign) if errors is None else errors
    n = int(campaign.layout.enabled.sum())
    unknowns = Unknowns(n, len(campaign.loads), len(errors))
    elastic: tuple[DataSet, ...] = ()
    if campaign.stiffness is not None:
        modes = elastic_modes(campaign.stiffness)
        data = mode_data(
            modes, likeliest(modes, comparable_arms(campaign.stiffness.layout)).variance
        )
        elastic = (replace(data, nuisance=np.zeros((1, 3, unknowns.total - n))),)
    mean, nothing = np.zeros(unknowns.total), np.zeros((0, 0))
    prior = Prior(mean, nothing, len(errors), held=len(campaign.loads) < 3)
    return Problem(campaign, errors, noise, prior, elastic)


def roughly_scaled(problem: Problem, moments: Moments) -> Problem:
    """Give an unknown noise a first size, from the imbalance that least squares leave."""
    if problem.noise.source != NoiseSource.MINIMUM:
        return problem
    start = start_values(problem.a, problem.data(moments), problem.prior)
    # From the median, and rather too small: bad rows shall not swell it, lest D outgrow M.
    distance = problem.distances(start, moments)[moments.rows > 0]
    size = 0.25 * float(np.median(distance)) / MEDIAN_CHI2
    variance = problem.noise.variance * max(size, 1.0)
    return replace(problem, noise=replace(problem.noise, variance=variance))


def with_share_in_balance(problem: Problem, screened: ScreenedCampaign, alpha: Array) -> Problem:
    """Return the problem with the share of the repeats' scatter that reaches the balance.

    From the imbalance of deviations from the mean, A diag(alpha) (c - c_mean), of some repeated
    rows; 1 unless they say otherwise by more than four standard errors. Where more reaches it than
    independent readings would bring, something pushes many actuators at once, most in one
    direction: then it disturbs the balance by as much, direction by direction.
    """
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    scaled_arms, moments = problem.a * alpha, screened.moments
    rho = np.concatenate([sample @ scaled_arms.T for sample in screened.samples])
    s = imbalance_covariance(scaled_arms, problem.noise.seen)
    share = float(squared_distances(rho, np.ones(len(rho)), s).mean() / 3)
    share = max(share, problem.noise.least / problem.noise.seen.mean())
    repeats = moments.rows[moments.rows > 1]
    freedom = 3 * len(rho) * float(1.0 - repeats.size / repeats.sum())  # their means are theirs
    if abs(share - 1.0) < 4 * np.sqrt(2 / freedom):
        return problem
    if share > 1.0:
        size, directions = scipy.linalg.eigh(rho.T @ rho / len(rho), s)
        pushed = (s @ directions) * np.sqrt(np.maximum(size - 1.0, 0.0))
        noise = replace(problem.noise, share_freedom=freedom)
        return replace(problem, disturbance=pushed @ pushed.T, noise=noise)
    return replace(problem, noise=replace(problem.noise, share=share, share_freedom=freedom))


def with_noise_from_minimum(
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    freedom: Callable[[Problem, Moments, Minimum], float] = lambda problem, moments, _: (
        problem.degrees_of_freedom(moments)
    ),
) -> tuple[Problem, Minimum]:
    """Give the noise its size from the minimum, where nothing else does; with it D.

    Degrees of freedom are those of the problem, unless a function gives those of a minimum.
    """
    for _ in range(20):
        if problem.noise.source != NoiseSource.MINIMUM:
            break
        size = minimum.chi2 / max(freedom(problem, moments, minimum), 1.0)
        variance = np.maximum(problem.noise.variance * size, problem.noise.least)
        if np.allclose(variance, problem.noise.variance, rtol=1e-6, atol=0.0):
            break
        problem = replace(problem, noise=replace(problem.noise, variance=variance))
        minimum = problem.fitted(moments, minimum.values)
    return problem, minimum
