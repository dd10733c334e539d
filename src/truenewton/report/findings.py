"""`investigate`: a calibration, its evidence and modal base, or why the data give none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar, overload

from matplotlib.axes import Axes

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
    CampaignMismatch,
    Fault,
    NotConverged,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
    UnknownName,
)
from truenewton.estimation.readings.row_readers import RowReader, read_rows
from truenewton.estimation.screening.screen import ScreenedCampaign, screen_campaign
from truenewton.figures.style import on_screen
from truenewton.modal.findings import ModalFindings, find_modes
from truenewton.modal.measured_stiffness import motion_reader
from truenewton.reading import Read, holds_alpha
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.records.parts import Parts, has_parts, refuse_other_mirror
from truenewton.records.result import figures_of
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.report.evidence import (
    Evidence,
    RowImbalance,
    campaign_evidence,
    stiffness_evidence,
)

MAX_MODES = 1500  # actuators; eigenmodes of thousands take minutes
OWN_CALIBRATION = "give the calibration of these data"
Modal = TypeVar("Modal")


@dataclass(frozen=True, eq=False)
class Findings:
    """The content of a report on data, or on a finished calibration.

    Attributes
    ----------
    data
        Data, or a finished calibration.
    calibration
        Its result; None if the data cannot give one.
    evidence
        Residuals, balance and singular values; None without data or without calibration.
    faults
        Why there is no calibration, each with its remedy.
    modes
        The modal base of data and alpha, if there is one.
    no_modes
        Why there is none, in a sentence; empty without data or without calibration.
    """

    data: Campaign | StiffnessMatrix | Calibration
    calibration: Calibration | None
    evidence: Evidence | None = None
    faults: tuple[Fault, ...] = ()
    modes: ModalFindings | None = None
    no_modes: str = ""

    @property
    def inputs(self) -> tuple[Source, ...]:
        """The files of the calibration, or those that did not suffice."""
        known = self.calibration or self.data
        if isinstance(known, Calibration):
            return known.sources
        records = known.cycles if isinstance(known, Campaign) else (known,)
        return tuple(record.source for record in records if record.source)

    def plot(self, name: str, ax: Axes | None = None) -> Axes:
        """Draw a figure by its name, as 'budget', 'map-leverage' or 'modes'; return the axes.

        Raises
        ------
        UnknownName
            There is no such figure; the message lists those that exist.
        ValueError
            These findings do not contain what it shows.
        """
        drawn = figures_of(self)
        if name in drawn:
            with on_screen():
                axes: Axes = drawn[name](ax=ax)
                return axes
        if name in ("residuals", "singular-values", "balance"):
            raise ValueError("a calibration file contains no residuals; give the cycles")
        if name == "temperatures":
            raise ValueError("only the cycles of a campaign have times")
        if name.startswith("modes"):
            raise ValueError(self.no_modes or "a calibration file has no modes; give the data")
        remedy = f"choose {', '.join(drawn)}"
        raise UnknownName(f"there is no figure '{name}'", remedy=remedy, got=name)


@overload
def investigate(
    data: Campaign | StiffnessMatrix | Calibration, method: str | None = None, *,
    calibration: AnyCalibration | None = None, population: bool = False,
    motion: Array | None = None,
) -> Findings: ...  # fmt: skip
@overload
def investigate(
    data: Read, method: str | None = None, *, calibration: AnyCalibration | None = None,
    population: bool = False, motion: Seen | None = None,
) -> Findings | Parts[Calibration]: ...  # fmt: skip
def investigate(
    data: Read,
    method: str | None = None,
    *,
    calibration: AnyCalibration | None = None,
    population: bool = False,
    motion: Seen | None = None,
) -> Findings | Parts[Calibration]:
    """Calibrate data and collect the evidence; data that do not suffice are diagnosed instead.

    Parameters
    ----------
    data
        Data, or a finished calibration. Several segments are calibrated only.
    calibration
        The result of an earlier calibration of these data, which are then not fitted again.
    method, population, motion
        As in `calibrate`; (n, n).

    Raises
    ------
    CampaignMismatch
        The calibration is of another mirror, or of other files.
    UnknownName
        There is no such method, or it does not apply to the data.

    Examples
    --------
    >>> findings = tn.investigate(campaign)
    >>> findings.faults, findings.modes
    ((), <ModalFindings of P45: 45 modes>)
    """
    if calibration is not None:
        refuse_other_mirror(calibration, data, "the data", "the calibration", OWN_CALIBRATION)
    if has_parts(data):
        asked: Any = {"population": population, "motion": motion}
        given = data if holds_alpha(data) else calibration
        return calibrate(data, method, **asked) if given is None else given  # type: ignore
    assert not isinstance(motion, Mapping)
    assert not isinstance(calibration, Parts)
    if isinstance(data, Calibration):
        return Findings(data, data)
    method, options = resolve_method(data, method, population=population, motion=motion)
    screened: ScreenedCampaign | None = None
    try:
        if isinstance(data, StiffnessMatrix):
            return _of_matrix(data, calibration or calibrate(data, method, **options._asdict()))
        screened = screen_campaign(data)
        if calibration is not None:
            _refuse_other_files(calibration, data)
            alpha = calibration.alpha[calibration.layout.enabled]
            return _of_campaign(screened, alpha, partial(_read_for, calibration, data))
        estimate = estimate_alpha(screened, method, options)
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        return Findings(data, None, faults=refusals(error, screened))
    alpha = estimate.values[: int(data.layout.enabled.sum())]
    return _of_campaign(screened, alpha, partial(calibration_of, data, estimate))


def _refuse_other_files(calibration: Calibration, campaign: Campaign) -> None:
    """Raise `CampaignMismatch` if the calibration was made without a file of the campaign."""
    files = {source.sha256 for source in calibration.sources}
    for cycle in campaign.cycles:
        if files and cycle.source and cycle.source.sha256 not in files:
            raise CampaignMismatch(
                "was not used for the calibration", remedy=OWN_CALIBRATION, path=cycle.name
            )


def _read_for(
    calibration: Calibration, campaign: Campaign, readers: Sequence[RowReader]
) -> Calibration:
    read_rows(campaign, readers)
    return calibration


def _of_matrix(matrix: StiffnessMatrix, calibration: Calibration) -> Findings:
    evidence = stiffness_evidence(matrix, calibration)
    modes, no_modes = _modes(matrix, lambda: find_modes(matrix, calibration, force=True))
    return Findings(matrix, calibration, evidence, modes=modes, no_modes=no_modes)


def _of_campaign(
    screened: ScreenedCampaign,
    alpha: Array,
    calibrated: Callable[[Sequence[RowReader]], Calibration],
) -> Findings:
    """Return the findings of a campaign; ``calibrated`` reads its rows, for all readers at once."""
    campaign = screened.campaign
    imbalance = RowImbalance(screened, alpha)
    reader, no_modes = _modes(campaign, lambda: motion_reader(screened))
    readers = [imbalance.take] if reader is None else [imbalance.take, reader.take]
    calibration = calibrated(readers)
    evidence, modes = campaign_evidence(screened, calibration, imbalance), None
    if reader is not None:
        modes, no_modes = _modes(
            campaign, lambda: find_modes(campaign, calibration, reader=reader, force=True)
        )
    return Findings(campaign, calibration, evidence, modes=modes, no_modes=no_modes)


def _modes(data: Campaign | StiffnessMatrix, find: Callable[[], Modal]) -> tuple[Modal | None, str]:
    """Return the modal base, or a step towards it, or why there is none."""
    if data.layout.n > MAX_MODES:
        return None, f"Those of {data.layout.n} actuators take minutes: use truenewton modes."
    try:
        return find(), ""
    except TrueNewtonError as error:
        why = "; ".join(filter(None, (error.fault, error.remedy)))
        return None, f"The data do not determine them: {why}."


def require_calibration(findings: Findings | Parts[Calibration]) -> AnyCalibration:
    """Return the calibration; raise `RankDeficient` if the data do not suffice."""
    if has_parts(findings):
        return findings
    if findings.calibration is None:
        fault, remedy = findings.faults[0]
        raise RankDeficient(fault, remedy=remedy)
    return findings.calibration
