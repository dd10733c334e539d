"""The earlier calibration as prior of a short run, its likelihood, and actuators that moved.

With I the information of the prior and H^-1 M H^-1 the covariance of the estimate
(docs/likelihood.md), errors of the weights included, the residual of the prior and its covariance
are

    q = I (alpha - alpha_earlier),        I - 2 I H^-1 I + I H^-1 M H^-1 I,

and q_i over its standard deviation is standard normal unless actuator i has moved.

The others may each have changed a little: alpha = alpha_earlier (1 + e), e ~ N(0, s^2). This adds
s^2 D D' to the covariance of q, with D = (I - I H^-1 I) diag(alpha_earlier). s is estimated as
tracking does it from days (`tracking.lines`); the prior is then
(I^-1 + s^2 diag(alpha_earlier^2))^-1.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refusal_of, refuse_unusable
from truenewton.errors import FormatError, NotConverged, RankDeficient
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    ErrorKind,
    ErrorSource,
    RejectedRow,
    Scale,
    WeightErrors,
    added_source,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding, Verdict, judged
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
from truenewton.estimation.readings.moments import Moments, reading_noise
from truenewton.estimation.screening.screen import ScreenedCampaign
from truenewton.files.fits import read_fits
from truenewton.linalg import factor_of, inverse_of_positive, mirrored
from truenewton.reading import read_calibration
from truenewton.records.campaign import Campaign, mean_temperature, refuse_other_mirror
from truenewton.records.cycle import Source
from truenewton.statics.load import Load
from truenewton.tracking.days import SAME_TEMPERATURE
from truenewton.tracking.law import Tracking, tracking_from
from truenewton.tracking.lines import Scatter, estimate_scatter

Known = Calibration | Tracking
AnyKnown = Known | str | os.PathLike[str]
EARLIER = ErrorSource(ErrorKind.EARLIER)


@dataclass(frozen=True, eq=False)
class PriorCalibration:
    """Alpha as it was; its error by the weights is split into a common scale and the rest."""

    name: str  # of the file
    alpha: Array  # (n,)
    covariance: Array  # (n, n); of the errors of the weights only ``uneven``
    scale: float  # relative standard uncertainty from the weights, common to all actuators
    uneven: Array  # (n, m) changes of alpha by errors of the weights beyond the common scale
    temperature: float  # of alpha [deg C]; NaN if unknown
    verdict: Verdict
    loads: tuple[Load, ...] = ()
    sources: tuple[Source, ...] = ()
    # of a law that depends on temperature: lowest and highest of its days [deg C]
    temperatures: tuple[float, float] | None = None


def prior_from(
    known: AnyKnown, campaign: Campaign, *, accept_rejected: bool = False
) -> PriorCalibration:
    """Return the prior for a campaign; a law is taken at its temperature and date.

    Raises `NotToBeUsed` if it is rejected, unless ``accept_rejected``.
    """
    name, given = known_for(known, campaign)
    n = given.layout.n
    further: dict[str, Any] = {}
    if isinstance(given, Tracking):
        verdict = _verdict_on_days(given, accept_rejected=accept_rejected, path=name)
        temperature = mean_temperature(campaign.cycles)
        recorded = bool(np.isfinite(temperature))
        at = given.alpha_at(temperature if recorded else None, campaign.cycles[0].date)
        alpha, covariance, systematic_covariance = at.alpha, at.covariance, at.systematic_covariance
        temperature = temperature if recorded else given.temperature
        further = {"temperatures": given.span}
    else:
        if given.scale == Scale.MEAN_ONE:
            raise FormatError(
                "gives alpha relative to its mean, so it contains no scale",
                remedy="give a calibration whose scale comes from weights",
                path=name,
            )
        refuse_unusable(given, accept_rejected=accept_rejected, path=name)
        verdict, alpha, temperature = given.verdict, given.alpha, given.temperature
        covariance = given.covariance[:n, :n]
        systematic_covariance = given.systematic_covariance[:n, :n]
        further = {"loads": given.loads, "sources": given.sources}
    on = np.isfinite(alpha)
    scale, uneven = _common_and_uneven(alpha[on], systematic_covariance[np.ix_(on, on)])
    uneven = alpha[:, None] * spread(uneven, on)
    covariance = covariance - systematic_covariance + uneven @ uneven.T
    try:
        inverse_of_positive(covariance[np.ix_(on, on)])
    except (ValueError, np.linalg.LinAlgError):  # it contains NaN, or is singular
        fault = "COVARIANCE less SYSTEMATIC is no covariance of alpha"
        raise FormatError(fault, remedy="calibrate again", path=name) from None
    return PriorCalibration(name, alpha, covariance, scale, uneven, temperature, verdict, **further)


def known_for(known: Any, run: Campaign) -> tuple[str, Any]:
    """Return the name and what is known from before a run."""
    name, given = "what is known from before", known
    if isinstance(known, str | os.PathLike):
        name, given = os.fspath(known), read_known(known)
    refuse_other_mirror(given, run, "the run", name, "give that of the same mirror")
    return name, given


def read_known(path: str | os.PathLike[str]) -> Known:
    """Read a calibration or a law."""
    if not Path(path).is_dir():
        file = read_fits(path)
        if "TRACKING" in file.extensions:
            return tracking_from(file)
    return read_calibration(path)


def _verdict_on_days(tracking: Tracking, *, accept_rejected: bool, path: str) -> Verdict:
    """Return the verdict on a law; raise `NotToBeUsed` if a day was rejected, unless forced."""
    days = [day.name for day in tracking.days if day.rejected]
    verdict = judged([Finding.of(Code.LAW_OF_REJECTED_DAY, day=day) for day in days[:1]])
    if days and not accept_rejected:
        fault = verdict.faults[0]
        raise refusal_of(verdict.level, fault.fault, fault.remedy, path)
    return verdict


def _common_and_uneven(alpha: Array, systematic_covariance: Array) -> tuple[float, Array]:
    """Return the relative error that all share, and the rest as (n, m) relative changes."""
    factor = factor_of(systematic_covariance / np.outer(alpha, alpha))
    mean = factor.mean(axis=0)
    scale = float(np.linalg.norm(mean))
    if scale == 0.0:
        return 0.0, factor
    turn = np.linalg.qr(np.column_stack([mean / scale, np.eye(len(mean))]))[0]
    turned = factor @ (turn * np.sign(mean @ turn[:, 0]))
    turned[:, 0] -= scale
    return scale, np.asarray(turned[:, np.abs(turned).max(axis=0) > 1e-6 * scale])


def shared_errors(known: PriorCalibration, campaign: Campaign) -> tuple[WeightErrors, float]:
    """Return the errors of the weights of a run, relative to the earlier scale, and its error.

    If alpha, B and the torques are all divided by 1 + s e, with s e the error of the earlier scale,
    the balance holds for weights W / (1 + s e): a change of -s W. If the same tool made the earlier
    scale and weighs in the run, both changes together leave only what B absorbs. The first source
    is the earlier scale.
    """
    weights = campaign.effective_weights
    errors = weight_errors(campaign)
    scale, change = known.scale, -known.scale * weights
    shared = _shared_source(known, campaign)
    if shared is not None:
        # Alpha is in proportion to the added weight, which is negative.
        scale, change = -scale, errors.pop(shared) - change
    away = mean_temperature(campaign.cycles) - known.temperature
    if abs(away) > SAME_TEMPERATURE:
        # All alphas have changed alike; the earlier scale holds at the earlier temperature.
        errors[ErrorSource(ErrorKind.TEMPERATURE)] = MAGNET_COEFFICIENT * away * weights
    return {EARLIER: change} | errors, scale


def _shared_source(known: PriorCalibration, campaign: Campaign) -> ErrorSource | None:
    """Return the error of the run that also made the earlier scale, if there is one."""
    made = [load for load in known.loads if load.added_error > 0]
    if len(made) != 1 or any(load.tilt for load in known.loads):
        return None
    for load in campaign.loads:
        alike = (load.added, load.added_error) == (made[0].added, made[0].added_error)
        if alike and load.added_error > 0 and made[0].tool in (None, load.tool):
            return added_source(load)
    return None


LOOSE_ERROR = 0.2  # relative error of each actuator, and of the common scale, in a prior with
SCALE_ERROR = 1e-4  # which every actuator may move: bad rows are judged by it
MIN_VARIANCE = 1e-6  # of a residual, in variances of the prior: below, the run does not constrain


def run_from(data: Any) -> Campaign:
    """Return the run; refuse data other than cycles."""
    if not isinstance(data, Campaign):
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


def balancing(
    posed: Problem, known: PriorCalibration, screened: ScreenedCampaign, new: NDArray[np.bool_]
) -> tuple[Problem, Moments, Minimum, tuple[RejectedRow, ...]]:
    """Leave out shapes that do not balance, by a fit in which every actuator may have moved.

    If the (n,) ``new`` actuators were held to their earlier calibration, good shapes would look
    bad.
    """
    moments, alpha = screened.moments, posed.prior.mean[: posed.n]
    size = np.where(new, 1e3, LOOSE_ERROR) * alpha
    stay = ~new / alpha / np.count_nonzero(~new)
    information = np.diag(size**-2) + np.outer(stay, stay) / SCALE_ERROR**2
    try:
        free = replace(posed, prior=replace(posed.prior, information=information))
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
    """Residuals of the prior, of the s actuators that are held."""

    sigmas: Array  # (n,) of each actuator given all others; 0 if it is not held
    variance: Array  # (n,) of a relative change of alpha of each, from its residual
    contrasts: Array  # (m,) independent residuals
    covariance: Array  # (m,) their variances
    shift: Array  # (m, s) their derivatives by relative changes of alpha

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
    # In units of the prior: variances from 0 (no information in the run) to 1.
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
