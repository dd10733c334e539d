"""From data to the findings of a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, overload

from truenewton.arrays import Array
from truenewton.calibration.methods import (
    Seen,
    calibrate,
    calibration_of,
    estimate_alpha,
    refusals,
    resolve_method,
)
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.errors import (
    NotConverged,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
)
from truenewton.estimation.findings.estimate import Estimate
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign
from truenewton.modal.findings import find_modes
from truenewton.modal.measured_stiffness import motion_reader
from truenewton.reading import Read, holds_alpha
from truenewton.records.campaign import Campaign
from truenewton.records.parts import Parts, has_parts
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.report.evidence import RowImbalance, campaign_evidence, stiffness_evidence
from truenewton.report.findings import Findings

MOST_MODES = 1500  # eigenmodes of thousands of actuators take minutes


@overload
def investigate(
    data: Campaign | StiffnessMatrix | Calibration, method: str | None = None, *,
    population: bool = False, motion: Array | None = None,
) -> Findings: ...  # fmt: skip
@overload
def investigate(
    data: Read, method: str | None = None, *, population: bool = False, motion: Seen | None = None
) -> Findings | Parts[Calibration]: ...
def investigate(
    data: Read,
    method: str | None = None,
    *,
    population: bool = False,
    motion: Seen | None = None,
) -> Findings | Parts[Calibration]:
    """Calibrate data and gather the evidence; data that do not suffice are diagnosed instead.

    Parameters
    ----------
    data
        What is to be reported on; a finished calibration is taken as it is. Several segments are
        calibrated, and nothing else.
    method, population, motion
        As in `calibrate`; (n, n).

    Raises
    ------
    UnknownName
        There is no such method, or it takes no such data.

    Examples
    --------
    >>> findings = tn.investigate(campaign)
    >>> findings.faults, findings.modes
    ((), <ModalFindings of P45: 45 modes>)
    """
    if has_parts(data):
        asked: Any = {"population": population, "motion": motion}
        return data if holds_alpha(data) else calibrate(data, method, **asked)
    assert not isinstance(motion, Mapping)
    if isinstance(data, Calibration):
        return Findings(data, data)
    method, options = resolve_method(data, method, population=population, motion=motion)
    screened: ScreenedCampaign | None = None
    try:
        if isinstance(data, StiffnessMatrix):
            calibration = calibrate(data, method, **options._asdict())
            evidence = stiffness_evidence(data, calibration)
            modes, no_modes = _modes(data, lambda: find_modes(data, calibration, force=True))
            return Findings(data, calibration, evidence, modes=modes, no_modes=no_modes)
        screened = screen_campaign(data)
        estimate = estimate_alpha(screened, method, options)
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        return Findings(data, None, faults=refusals(error, screened))
    return _findings_of(screened, estimate)


def _findings_of(screened: ScreenedCampaign, estimate: Estimate) -> Findings:
    """Return all that is told of a campaign; its rows are read once more for it."""
    campaign, n = screened.campaign, int(screened.campaign.layout.enabled.sum())
    imbalance = RowImbalance(screened, estimate.values[:n])
    reader, no_modes = _modes(campaign, lambda: motion_reader(screened))
    readers = [imbalance.take] if reader is None else [imbalance.take, reader.take]
    calibration = calibration_of(campaign, estimate, readers)
    evidence, modes = campaign_evidence(screened, calibration, imbalance), None
    if reader is not None:
        modes, no_modes = _modes(
            campaign, lambda: find_modes(campaign, calibration, reader=reader, force=True)
        )
    return Findings(campaign, calibration, evidence, modes=modes, no_modes=no_modes)


Modal = TypeVar("Modal")


def _modes(data: Campaign | StiffnessMatrix, find: Callable[[], Modal]) -> tuple[Modal | None, str]:
    """Return what is found towards the modal base, or why there is none."""
    if data.layout.n > MOST_MODES:
        return (
            None,
            f"Those of {data.layout.n} actuators take a while: truenewton modes finds them.",
        )
    try:
        return find(), ""
    except TrueNewtonError as error:
        why = "; ".join(filter(None, (error.fault, error.remedy)))
        return None, f"The data do not tell them: {why}."


def require_calibration(findings: Findings | Parts[Calibration]) -> AnyCalibration:
    """Return the calibration of what was found.

    Raises
    ------
    RankDeficient
        The data do not suffice.
    """
    if has_parts(findings):
        return findings
    if findings.calibration is None:
        fault, remedy = findings.faults[0]
        raise RankDeficient(fault, remedy=remedy)
    return findings.calibration
