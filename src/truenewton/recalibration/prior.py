"""The earlier calibration as prior, and errors of weights that it shares with a new run."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array, spread
from truenewton.calibration.result import CALIBRATIONS, AnyCalibration, Calibration
from truenewton.calibration.verdict import refusal_of, refuse_unusable
from truenewton.errors import FormatError
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    ErrorKind,
    ErrorSource,
    Scale,
    WeightErrors,
    added_source,
    weight_errors,
)
from truenewton.estimation.findings.finding import Finding, Verdict, judged
from truenewton.files.fits import read_fits
from truenewton.linalg import factor_of, inverse_of_positive
from truenewton.reading import select_segment
from truenewton.records.campaign import Campaign, mean_temperature
from truenewton.records.cycle import Source
from truenewton.records.parts import (
    InParts,
    Parts,
    body_or_parts_from,
    has_parts,
    refuse_other_mirror,
)
from truenewton.statics.load import Load
from truenewton.tracking.days import SAME_TEMPERATURE
from truenewton.tracking.law import TRACKINGS, Tracking

Known = Calibration | Tracking
KnownOfSegments = Parts[Calibration] | Parts[Tracking]
AnyKnown = Known | KnownOfSegments | str | os.PathLike[str]
EARLIER = ErrorSource(ErrorKind.EARLIER)


@dataclass(frozen=True, eq=False)
class PriorCalibration:
    """Alpha as it was; its error by the weights is split into a common scale and the rest.

    Attributes
    ----------
    name
        Of the file.
    alpha, covariance
        (n,) and (n, n); of the errors of the weights only ``uneven``.
    scale
        Relative standard uncertainty from the weights that is common to all actuators.
    uneven
        (n, m) changes of alpha by errors of the weights beyond the common scale.
    temperature
        Of alpha [deg C]; NaN if unknown.
    loads, sources, verdict
        Of the earlier calibration.
    temperatures
        Of a law that depends on temperature: lowest and highest of its days [deg C].
    """

    name: str
    alpha: Array
    covariance: Array
    scale: float
    uneven: Array
    temperature: float
    loads: tuple[Load, ...]
    sources: tuple[Source, ...]
    verdict: Verdict
    temperatures: tuple[float, float] | None = None


def prior_from(known: AnyKnown, campaign: Campaign, *, force: bool = False) -> PriorCalibration:
    """Return the prior for a campaign; a law is taken at its temperature and date.

    Raises
    ------
    NotToBeUsed
        It is rejected, and ``force`` is not set.
    UnreadableFile, FormatError, CampaignMismatch, RankDeficient
    """
    loads: tuple[Load, ...] = ()
    sources: tuple[Source, ...] = ()
    name, given = known_for(known, campaign)
    n, temperatures = given.layout.n, None
    if isinstance(given, Tracking):
        verdict = _verdict_on_days(given, force=force, path=name)
        temperature = mean_temperature(campaign.cycles)
        recorded = bool(np.isfinite(temperature))
        at = given.alpha_at(temperature if recorded else None, campaign.cycles[0].date)
        alpha, covariance, systematic_covariance = at.alpha, at.covariance, at.systematic_covariance
        temperature = temperature if recorded else given.temperature
        temperatures = given.span
    else:
        if given.scale == Scale.MEAN_ONE:
            raise FormatError(
                "gives alpha relative to its mean, so it contains no scale",
                remedy="give a calibration whose scale comes from weights",
                path=name,
            )
        refuse_unusable(given, force=force, path=name)
        verdict = given.verdict
        alpha, temperature = given.alpha, given.temperature
        covariance = given.covariance[:n, :n]
        systematic_covariance = given.systematic_covariance[:n, :n]
        loads, sources = given.loads, given.sources
    on = np.isfinite(alpha)
    scale, uneven = _common_and_uneven(alpha[on], systematic_covariance[np.ix_(on, on)])
    uneven = alpha[:, None] * spread(uneven, on)
    covariance = covariance - systematic_covariance + uneven @ uneven.T
    try:
        inverse_of_positive(covariance[np.ix_(on, on)])
    except (ValueError, np.linalg.LinAlgError):  # it contains NaN, or is singular
        fault = "COVARIANCE less SYSTEMATIC is no covariance of alpha"
        raise FormatError(fault, remedy="calibrate again", path=name) from None
    return PriorCalibration(
        name=name,
        alpha=alpha,
        covariance=covariance,
        scale=scale,
        uneven=uneven,
        temperature=temperature,
        loads=loads,
        sources=sources,
        verdict=verdict,
        temperatures=temperatures,
    )


def known_for(known: AnyKnown, run: Campaign | InParts[Any]) -> tuple[str, Any]:
    """Return the name and the earlier calibration for a run, of one body or of all segments."""
    name, given = "the earlier calibration", known
    if isinstance(known, str | os.PathLike):
        name, given = os.fspath(known), read_known(known)
    if has_parts(run) and not has_parts(given):
        raise FormatError(
            f"is of one body, and the run has {len(run.numbers)} segments",
            remedy="choose the segment: --segment",
            path=name,
        )
    if has_parts(given) and not has_parts(run):
        segment = run.layout.segment
        given = select_segment(given, None if segment is None else int(segment[0]), name)
    refuse_other_mirror(given, run, "the run", name, "give the calibration of the same mirror")
    return name, given


def read_known(path: str | os.PathLike[str]) -> Known | KnownOfSegments:
    """Read a calibration or a law, of one body or of several segments."""
    remedy = "give --known the file that `calibrate -o` or `track -o` wrote"
    if Path(path).is_dir():
        raise FormatError("is a folder", remedy=remedy, path=os.fspath(path))
    file = read_fits(path)
    if "TRACKING" in file.extensions:
        law: Tracking | Parts[Tracking] = body_or_parts_from(file, TRACKINGS)
        return law
    if "CALIBRATION" in file.extensions:
        found: AnyCalibration = body_or_parts_from(file, CALIBRATIONS)
        return found
    raise FormatError("is not a calibration", remedy=remedy, path=os.fspath(path))


def _verdict_on_days(tracking: Tracking, *, force: bool, path: str) -> Verdict:
    """Return the verdict on a law; raise `NotToBeUsed` if a day was rejected, unless forced."""
    days = [day.name for day in tracking.days if day.rejected]
    verdict = judged([Finding.of(Code.LAW_OF_REJECTED_DAY, day=day) for day in days[:1]])
    if days and not force:
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
