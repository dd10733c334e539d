"""After an actuator, a magnet or a coil was replaced: a short run beside the earlier calibration.

The earlier calibration is the prior of all actuators but those replaced; B and the torques are free
anew, since the bias magnet sits in the actuator. The others carry the scale, so that one load
suffices. The error of the earlier scale stays common to all (see `known.shared_errors`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.methods import calibration_of
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import warn_of
from truenewton.calibration.workers import executor_for
from truenewton.chance import FALSE_ALARM, chance_of_any, chi2_sf, t_sf
from truenewton.errors import RankDeficient, UnknownName
from truenewton.estimation.campaign_ml import estimate_of
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.estimate import (
    Diagnosis,
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
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.reading import Read, read
from truenewton.recalibration.known import (
    EARLIER,
    AnyKnown,
    EarlierCalibration,
    known_from,
    known_of,
    shared_errors,
)
from truenewton.recalibration.short_run import (
    Pulls,
    balancing,
    build_problem,
    constrain,
    degrees_of,
    inverse_of,
    prior_residuals,
    run_from,
)
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.records.parts import Parts, has_parts
from truenewton.records.segmented import SegmentedData
from truenewton.rounding import counted, percent
from truenewton.statics.arms import enabled_arms
from truenewton.statics.layout import Layout
from truenewton.tracking.days import OTHER_UNIT, SAME_TEMPERATURE
from truenewton.tracking.law import Outlier

ALL_TOGETHER = 1e-3  # chance below which the others are said to disagree as a whole
MOST = 0.25  # of the actuators that may have moved


@dataclass(frozen=True, eq=False)
class Recalibration:
    """What a short run after a replacement gives.

    Attributes
    ----------
    calibration
        Of all actuators; an ordinary calibration. TEMPERAT is where the earlier one holds, since
        the others carry its scale.
    asked
        IDs that were named as replaced, or had no earlier calibration.
    moved
        Others that no longer agree with their earlier calibration, the surest first; given anew
        as well.
    earlier
        (n,) alpha as it was.
    chi2, degrees_of_freedom, probability
        Of all that stayed against their earlier calibration; chance of a larger chi2.
    limits
        What cannot be said, in words.
    scatter
        By how much each that stayed has changed since, relative, beyond the errors of the earlier
        calibration and of the run; estimated from the run, and part of all errors.
    """

    calibration: Calibration
    asked: tuple[int, ...]
    moved: tuple[Outlier, ...]
    earlier: Array
    chi2: float
    degrees_of_freedom: int
    probability: float
    limits: tuple[str, ...]
    scatter: float = 0.0


@overload
def recalibrate(
    campaign: Campaign, known: AnyKnown, actuators: Sequence[int] = (), *, force: bool = False,
    processes: int | None = None,
) -> Recalibration: ...  # fmt: skip
@overload
def recalibrate(
    campaign: SegmentedData, known: AnyKnown, actuators: Sequence[int] = (), *, force: bool = False,
    processes: int | None = None,
) -> Parts[Recalibration]: ...  # fmt: skip
@overload
def recalibrate(
    campaign: Read | str | os.PathLike[str], known: AnyKnown, actuators: Sequence[int] = (), *,
    force: bool = False, processes: int | None = None,
) -> Recalibration | Parts[Recalibration]: ...  # fmt: skip
def recalibrate(
    campaign: Read | str | os.PathLike[str],
    known: AnyKnown,
    actuators: Sequence[int] = (),
    *,
    force: bool = False,
    processes: int | None = None,
) -> Recalibration | Parts[Recalibration]:
    """Calibrate replaced actuators by a short run, all others being known.

    Parameters
    ----------
    campaign
        The run after the replacement, or its path: one cycle under one load can do. Of a mirror in
        several segments each is recalibrated by itself.
    known
        The earlier calibration, or the law that tracking found, or a path to either; of all
        segments, or of the one.
    actuators
        IDs of the actuators replaced; if none are named, who changed is found out.
    force
        Take what is known whose verdict is 'rejected', too.
    processes
        As of `calibrate`.

    Raises
    ------
    NotToBeUsed
        The verdict on what is known, unless forced.
    UnreadableFile, FormatError, CampaignMismatch
        Files that cannot be used, or not together.
    UnknownName
        There is no such actuator.
    RankDeficient
        Too little data, or too many have moved; of all segments.
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
    run: Campaign | SegmentedData = run_from(
        read(campaign) if isinstance(campaign, str | os.PathLike) else campaign
    )
    if not has_parts(run):
        alone = _recalibrated(run, known, actuators, force=force)
        warn_of(alone.calibration)
        return alone
    _, before = known_of(known, run)
    _require_enabled(run.layout, actuators)

    def solver(number: int) -> Callable[[Any], Recalibration]:
        return partial(
            _recalibrated,
            known=before.part(number),
            actuators=run.own(number, actuators),
            force=force,
        )

    made = run.solved(solver, "alpha", executor_for(run.layout, processes))
    warn_of(made.map(attrgetter("calibration")))
    return made


def _recalibrated(
    data: Campaign, known: AnyKnown, actuators: Sequence[int], *, force: bool
) -> Recalibration:
    """Recalibrate one body."""
    before = known_from(known, data, force=force)
    ids = data.layout.id[data.layout.enabled]
    new = _new(data, before, actuators)
    screened = screen_campaign(data)
    _refuse_too_little(screened.sound, screened.moments, int(new.sum()))
    errors, scale = shared_errors(before, data)
    problem = build_problem(before, screened, errors)
    problem, moments, minimum, lost = balancing(problem, before, screened, new)
    problem, minimum, stay, moved, against = _who_moved(problem, before, moments, minimum, ~new)
    problem, minimum = with_noise_from_minimum(problem, moments, minimum, degrees_of)
    rejected = (*screened.rejected, *lost)
    calibration = _calibration(before, problem, moments, minimum, rejected, scale, stay)
    degrees = len(against.contrasts)
    probability = float(chi2_sf(against.chi2, degrees)) if degrees else float("nan")
    limits = tuple(_limits(before, data, probability, against.scatter.own))
    effects = (*calibration.effects, *screened.suspects, *screened.frozen)
    calibration = replace(calibration, effects=effects)
    calibration = _with_faults(calibration, before, limits)
    return Recalibration(
        calibration=calibration,
        asked=tuple(ids[new].tolist()),
        moved=tuple(moved),
        earlier=before.alpha,
        chi2=against.chi2,
        degrees_of_freedom=degrees,
        probability=probability,
        limits=limits,
        scatter=against.scatter.own,
    )


def _who_moved(
    problem: Problem,
    known: EarlierCalibration,
    moments: Moments,
    minimum: Minimum,
    stay: NDArray[np.bool_],
) -> tuple[Problem, Minimum, NDArray[np.bool_], list[Outlier], Pulls]:
    """Find who has moved besides, the surest first; return the fit in which they are free.

    With it (n,) who stays, who moved, and how the run pulls at the earlier calibration as it is.

    Raises
    ------
    RankDeficient
        Too many have moved, or all by too much.
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
                f"all others no longer agree with {known.name}: they have changed by"
                f" {percent(scatter.own)} each",
                remedy="check units and sign of FORCE and ADDED in the run; or calibrate anew",
                got=scatter.own,
                want=OTHER_UNIT,
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
        if len(moved) > MOST * len(stay):
            raise RankDeficient(
                f"more than {counted(len(moved) - 1, 'actuator')} no longer agree with"
                f" {known.name}",
                remedy="calibrate anew",
                got=len(moved),
                want=MOST * len(stay),
            )


def _with_faults(
    calibration: Calibration, known: EarlierCalibration, limits: Sequence[str]
) -> Calibration:
    """Return the calibration with what cannot be said, and with the faults of the earlier one.

    Otherwise a rejected calibration could be used after a short run.
    """
    diagnosis = calibration.diagnosis or Diagnosis()
    warnings = (
        *diagnosis.warnings,
        *(Finding.of(Code.RECALIBRATION_LIMIT, limit=limit) for limit in limits),
        *(Finding.of(Code.EARLIER_FINDING, cause=each) for each in known.verdict.faults),
    )
    effects = calibration.effects
    if known.verdict.level <= Level.REJECTED:
        effects += (
            Finding(
                code=Code.UNUSABLE_CALIBRATION,
                where=known.name,
                remedy=known.verdict.faults[0].remedy,
            ),
        )
    return replace(calibration, diagnosis=replace(diagnosis, warnings=warnings), effects=effects)


def _new(
    campaign: Campaign, known: EarlierCalibration, actuators: Sequence[int]
) -> NDArray[np.bool_]:
    """Return (n,) who of the enabled is named, or has no earlier calibration."""
    ids, on = campaign.layout.id, campaign.layout.enabled
    _require_enabled(campaign.layout, actuators)
    new = np.asarray(np.isin(ids[on], list(actuators)) | ~np.isfinite(known.alpha[on]))
    if 2 * new.sum() > new.size:
        raise RankDeficient(
            f"{new.sum()} of {new.size} actuators are new, too many for the others to carry them",
            remedy="calibrate anew",
        )
    return new


def _require_enabled(layout: Layout, actuators: Sequence[int]) -> None:
    """Refuse IDs that no enabled actuator has.

    Raises
    ------
    UnknownName
    """
    for name in actuators:
        if name not in layout.id[layout.enabled]:
            raise UnknownName(
                f"there is no actuator {name} that is enabled",
                remedy=f"IDs run from {layout.id.min()} to {layout.id.max()}",
                got=name,
            )


def _refuse_too_little(campaign: Campaign, moments: Moments, new: int) -> None:
    refuse([geometry_fault(enabled_arms(campaign.layout))])
    wanted = Unknowns(new, len(campaign.loads)).count
    if 3 * len(moments.rows) <= wanted:
        raise RankDeficient(
            f"there are too few shapes: {len(moments.rows)} for {new} new actuators, bias and"
            " torques",
            remedy="apply more shapes, both signs",
            got=3 * len(moments.rows),
            want=wanted + 1,
        )


def _calibration(
    known: EarlierCalibration,
    problem: Problem,
    moments: Moments,
    minimum: Minimum,
    rejected: tuple[RejectedRow, ...],
    scale: float,
    stay: NDArray[np.bool_],
) -> Calibration:
    """Return an ordinary calibration, the error of the earlier scale common to all."""
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
    known: EarlierCalibration, campaign: Campaign, probability: float, scatter: float
) -> Iterator[str]:
    """Yield what cannot be said."""
    if probability < ALL_TOGETHER and scatter:
        yield (
            f"the others have changed by {percent(scatter)} each since their earlier calibration,"
            " and are held no better than that: calibrate anew where it is too much"
        )
    elif probability < ALL_TOGETHER:
        yield (
            "all others together disagree with their earlier calibration, though none stands out:"
            " calibrate anew"
        )
    then, now = known.temperature, mean_temperature(campaign.cycles)
    if not (np.isfinite(then) and np.isfinite(now)):
        yield "the temperatures are not all known: others may seem to have moved"
    elif known.temperatures and not _within(now, known.temperatures):
        low, high = known.temperatures
        yield (
            f"the run was at {now:.1f} deg C, and the days of the law between {low:.1f} and"
            f" {high:.1f}: how alpha goes on from there is not known; track a day"
            f" at {now:.0f} deg C"
        )
    elif abs(now - then) > SAME_TEMPERATURE:
        yield (
            f"the earlier calibration holds at {then:.1f} deg C, the run was at {now:.1f}: others"
            f" may seem to have moved; alpha is given at {then:.1f} deg C (a tracking file as"
            " --known takes temperature into account)"
        )


def _within(temperature: float, ends: tuple[float, float]) -> bool:
    return ends[0] - SAME_TEMPERATURE <= temperature <= ends[1] + SAME_TEMPERATURE
