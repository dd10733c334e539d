"""`recalibrate`: a short run after actuators were replaced, with the earlier calibration as prior.

The prior constrains all actuators that were not replaced, and with them the scale, so that one load
suffices. B and the torques are free, since the bias magnet is part of the actuator. The error of
the earlier scale stays common to all (`prior.shared_errors`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.methods import calibration_of
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.chance import FALSE_ALARM, chance_of_any, t_sf
from truenewton.errors import RankDeficient, UnknownName
from truenewton.estimation.campaign_ml import estimate_of
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.estimate import (
    RejectedRow,
    Scale,
    ScaleError,
    scale_error_from_readings,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.paper.equations import Unknowns
from truenewton.estimation.paper.identifiability import geometry_fault, refuse
from truenewton.estimation.problem import Problem, with_noise_from_minimum
from truenewton.estimation.readings.moments import Moments
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign
from truenewton.reading import Read, read
from truenewton.recalibration.prior import (
    EARLIER,
    AnyKnown,
    PriorCalibration,
    PriorResiduals,
    balancing,
    build_problem,
    constrain,
    degrees_of,
    inverse_of,
    prior_from,
    prior_residuals,
    run_from,
    shared_errors,
)
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.rounding import counted, percent
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import Layout
from truenewton.tracking.days import OTHER_UNIT, SAME_TEMPERATURE
from truenewton.tracking.law import Outlier, probability_of

MIN_PROBABILITY = 1e-3  # of chi2; below, all others together disagree with their calibration
MAX_MOVED_FRACTION = 0.25  # of the actuators


@dataclass(frozen=True, eq=False)
class Recalibration:
    """The result of a short run after a replacement.

    Attributes
    ----------
    calibration
        Of all actuators, like any other. TEMPERAT is that of the earlier one, whose scale it has.
    asked
        IDs that were named as replaced, or had no earlier calibration.
    moved
        Others that disagree with their earlier calibration, the most significant first; estimated
        from the run as well.
    earlier
        (n,) alpha of the earlier calibration.
    chi2, degrees_of_freedom
        Of all others against their earlier calibration.
    limits
        Limitations, in sentences.
    scatter
        Relative change of each of the others since, beyond the errors of the earlier calibration
        and of the run; estimated from the run, and included in all errors.
    """

    calibration: Calibration
    asked: tuple[int, ...]
    moved: tuple[Outlier, ...]
    earlier: Array
    chi2: float
    degrees_of_freedom: int
    limits: tuple[str, ...]
    scatter: float = 0.0

    @property
    def probability(self) -> float:
        """Probability of a larger chi2; NaN without degrees of freedom."""
        return probability_of(self.chi2, self.degrees_of_freedom)


def recalibrate(
    campaign: Read | str | os.PathLike[str],
    known: AnyKnown,
    actuators: Sequence[int] = (),
    *,
    accept_rejected: bool = False,
) -> Recalibration:
    """Calibrate replaced actuators from a short run and an earlier calibration of the others.

    Parameters
    ----------
    campaign
        The run after the replacement, or its path: one cycle under one load can suffice.
    known
        The earlier calibration, or the law of `track`, or a path to either.
    actuators
        IDs of the actuators replaced; if empty, actuators that changed are found.
    accept_rejected
        Use an earlier calibration with the verdict 'rejected', too.

    Raises
    ------
    NotToBeUsed
        The earlier calibration is rejected, and ``accept_rejected`` is not set.
    UnreadableFile, FormatError, CampaignMismatch
        Files that cannot be used, or not together.
    UnknownName
        There is no such actuator.
    RankDeficient
        Too few data, or too many actuators moved.
    TooManyOutliers, NotConverged

    Warns
    -----
    TrueNewtonWarning
        The verdict is 'rejected' or 'doubtful'.

    Examples
    --------
    >>> short_run = tn.Campaign(campaign.cycles[:1])
    >>> new = tn.recalibrate(short_run, calibration, [17])
    >>> new.asked, new.moved
    ((17,), ())
    """
    run = run_from(read(campaign) if isinstance(campaign, str | os.PathLike) else campaign)
    made = _recalibrated(run, known, actuators, accept_rejected=accept_rejected)
    warn_of(made.calibration)
    return made


def _recalibrated(
    data: Campaign, known: AnyKnown, actuators: Sequence[int], *, accept_rejected: bool
) -> Recalibration:
    """Recalibrate one body."""
    before = prior_from(known, data, accept_rejected=accept_rejected)
    ids = data.layout.id[data.layout.enabled]
    new = _new(data, before, actuators)
    screened = screen_campaign(data)
    refuse([geometry_fault(enabled_arms(screened.sound.layout))])
    found, wanted = (
        len(screened.moments.rows),
        Unknowns(int(new.sum()), len(screened.sound.loads)).count,
    )
    if 3 * found <= wanted:
        raise RankDeficient(
            f"there are too few shapes: {found} for {new.sum()} new actuators, bias and torques",
            remedy="apply more shapes, both signs",
        )
    errors, scale = shared_errors(before, data)
    problem = build_problem(before, screened, errors)
    problem, moments, minimum, lost = balancing(problem, before, screened, new)
    problem, minimum, stay, moved, against = _find_moved(problem, before, moments, minimum, ~new)
    problem, minimum = with_noise_from_minimum(problem, moments, minimum, degrees_of)
    rejected = (*screened.rejected, *lost)
    calibration = _calibration(before, problem, moments, minimum, rejected, scale, stay)
    made = Recalibration(
        calibration=calibration,
        asked=tuple(ids[new].tolist()),
        moved=tuple(moved),
        earlier=before.alpha,
        chi2=against.chi2,
        degrees_of_freedom=len(against.contrasts),
        limits=(),
        scatter=against.scatter.own,
    )
    limits = tuple(_limits(before, data, made.probability, made.scatter))
    return _with_findings(replace(made, limits=limits), before, screened)


def _find_moved(
    problem: Problem,
    known: PriorCalibration,
    moments: Moments,
    minimum: Minimum,
    stay: NDArray[np.bool_],
) -> tuple[Problem, Minimum, NDArray[np.bool_], list[Outlier], PriorResiduals]:
    """Release actuators that moved, the worst first, and return the fit in which they are free.

    Also (n,) those that are still held, the outliers, and the residuals of the prior as it was
    given. Raises `RankDeficient` if too many moved, or all by too much.
    """
    ids = problem.campaign.layout.id[problem.campaign.layout.enabled]
    moved: list[Outlier] = []
    stay = stay.copy()
    while True:
        problem = constrain(problem, known, stay)
        minimum = problem.fitted(moments, minimum.values)
        found = against = prior_residuals(problem, minimum, stay)
        scatter = against.scatter
        if scatter.own > OTHER_UNIT:
            raise RankDeficient(
                f"all other actuators disagree with {known.name}: each has changed by"
                f" {percent(scatter.own)}",
                remedy="check units and sign of FORCE and ADDED in the run; or calibrate all again",
            )
        if scatter.own:
            problem = constrain(problem, known, stay, scatter.own)
            minimum = problem.fitted(moments, minimum.values)
            found = prior_residuals(problem, minimum, stay)
        sigmas = found.sigmas
        worst = int(np.abs(sigmas).argmax())
        freedom = scatter.degrees_of(float(found.variance[worst]))
        chance = float(2 * t_sf(abs(sigmas[worst]), freedom))
        mirror = chance_of_any(chance, int(stay.sum()))
        if mirror >= FALSE_ALARM:
            moved.sort(key=lambda one: one.probability)
            return problem, minimum, stay, moved, against
        moved.append(Outlier(int(ids[worst]), "moved", float(sigmas[worst]), mirror))
        stay[worst] = False
        if len(moved) > MAX_MOVED_FRACTION * len(stay):
            raise RankDeficient(
                f"more than {counted(len(moved) - 1, 'actuator')} disagree with {known.name}",
                remedy="calibrate all actuators again",
            )


def _with_findings(
    made: Recalibration, known: PriorCalibration, screened: ScreenedCampaign
) -> Recalibration:
    """Add the limitations, and the findings on the run and on the earlier calibration.

    Otherwise a rejected calibration could be used after a short run.
    """
    warnings = (
        *(Finding.of(Code.RECALIBRATION_LIMIT, limit=limit) for limit in made.limits),
        *(Finding.of(Code.EARLIER_FINDING, cause=each) for each in known.verdict.faults),
    )
    effects = (*made.calibration.effects, *screened.suspects, *screened.frozen)
    if known.verdict.level <= Level.REJECTED:
        effects += (
            Finding(
                code=Code.UNUSABLE_CALIBRATION,
                where=known.name,
                remedy=known.verdict.faults[0].remedy,
            ),
        )
    calibration = replace(made.calibration.with_warnings(warnings), effects=effects)
    return replace(made, calibration=calibration)


def _new(
    campaign: Campaign, known: PriorCalibration, actuators: Sequence[int]
) -> NDArray[np.bool_]:
    """Return which of the (n,) enabled actuators are named, or have no earlier calibration."""
    ids, on = campaign.layout.id, campaign.layout.enabled
    _require_enabled(campaign.layout, actuators)
    new = np.asarray(np.isin(ids[on], list(actuators)) | ~np.isfinite(known.alpha[on]))
    if 2 * new.sum() > new.size:
        raise RankDeficient(
            f"{new.sum()} of {new.size} actuators are new, more than the others can constrain",
            remedy="calibrate all actuators again",
        )
    return new


def _require_enabled(layout: Layout, actuators: Sequence[int]) -> None:
    """Raise `UnknownName` for an ID that no enabled actuator has."""
    for name in actuators:
        if name not in layout.id[layout.enabled]:
            raise UnknownName(
                f"there is no actuator {name} that is enabled",
                remedy=f"IDs run from {layout.id.min()} to {layout.id.max()}",
            )


def _calibration(
    known: PriorCalibration,
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    rejected: tuple[RejectedRow, ...],
    scale: float,
    stay: NDArray[np.bool_],
) -> Calibration:
    """Return the calibration; the error of the earlier scale is common to all."""
    campaign, n = problem.campaign, problem.n
    values = minimum.values[: problem.unknowns.count]
    changes = minimum.changes.copy()
    changes[:, 0] += scale * values
    # Uneven errors of the earlier weights come through the prior.
    uneven = known.uneven[campaign.layout.enabled][stay]
    information = problem.prior.information[np.ix_(stay, stay)]
    inverse = inverse_of(problem, minimum)[: len(values), :n][:, stay]
    through = inverse @ information @ uneven
    reading_covariance = minimum.reading_covariance - through @ through.T
    by_readings = scale_error_from_readings(values[:n], reading_covariance[:n, :n])
    budget = (by_readings, ScaleError(EARLIER, known.scale))
    freedom = degrees_of(problem, moments, minimum)
    estimate = replace(
        estimate_of("ml, recalibrated", problem, moments, minimum, rejected, 0, freedom),
        scale=Scale.GIVEN if problem.prior.held else Scale.WEIGHTS,
        reading_covariance=reading_covariance,
        systematic_covariance=changes @ changes.T + through @ through.T,
        scale_errors=tuple(sorted(budget, key=lambda line: -line.relative)),
    )
    made = calibration_of(campaign, estimate)
    temperature = known.temperature if np.isfinite(known.temperature) else made.temperature
    return replace(made, temperature=temperature, sources=(*made.sources, *known.sources))


def _limits(
    known: PriorCalibration, campaign: Campaign, probability: float, scatter: float
) -> Iterator[str]:
    if probability < MIN_PROBABILITY and scatter:
        yield (
            f"each of the other actuators has changed by {percent(scatter)} since its earlier"
            " calibration, and its error includes this change. If the error is too large, calibrate"
            " all actuators again"
        )
    elif probability < MIN_PROBABILITY:
        yield (
            "the other actuators together disagree with their earlier calibration, but none is an"
            " outlier. Calibrate all actuators again"
        )
    then, now = known.temperature, mean_temperature(campaign.cycles)
    low, high = known.temperatures or (now, now)
    if not (np.isfinite(then) and np.isfinite(now)):
        yield (
            "not all temperatures are recorded, and a change of temperature can look like changed"
            " actuators"
        )
    elif not low - SAME_TEMPERATURE <= now <= high + SAME_TEMPERATURE:
        yield (
            f"the run was taken at {now:.1f} deg C, but the tracking file covers only {low:.1f} to"
            f" {high:.1f} deg C. Track a calibration at {now:.0f} deg C"
        )
    elif abs(now - then) > SAME_TEMPERATURE:
        yield (
            f"the earlier calibration was taken at {then:.1f} deg C and the run at {now:.1f} deg C."
            " This difference can look like changed actuators. Alpha applies at"
            f" {then:.1f} deg C. To correct for temperature, use a tracking file as --known"
        )
