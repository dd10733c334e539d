"""What a report tells of: the calibration, or why there is none, and the evidence for it."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes

from truenewton.calibration.methods import (
    calibrate,
    calibration_of,
    find_alpha,
    refuse_method,
)
from truenewton.calibration.result import Calibration
from truenewton.errors import (
    NotConverged,
    RankDeficient,
    TooManyOutliers,
    TrueNewtonError,
    UnknownName,
)
from truenewton.estimation.identifiability import diagnose
from truenewton.estimation.sifted import Sifted, sift
from truenewton.modal.findings import ModalFindings, find_modes, modes_reader
from truenewton.modal.shape_products import MotionReader
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.report.evidence import (
    Evidence,
    RowImbalance,
    campaign_evidence,
    stiffness_evidence,
)

MOST_MODES = 1500  # eigenmodes of thousands of actuators take minutes


@dataclass(frozen=True, eq=False)
class Findings:
    """All that a report tells of one set of data, or of a finished calibration.

    Attributes
    ----------
    data
        What was calibrated; None where a calibration file was given.
    calibration
        Its result; None where the data cannot give one.
    evidence
        Residuals, balance and singular values; None without data or without calibration.
    faults
        Why there is no calibration, each with its remedy.
    modes
        The modal base that the data and alpha give, if they do.
    no_modes
        Why they do not, in a sentence; empty without data or without calibration.
    """

    data: Campaign | StiffnessMatrix | None
    calibration: Calibration | None
    evidence: Evidence | None = None
    faults: tuple[Fault, ...] = ()
    modes: ModalFindings | None = None
    no_modes: str = ""

    @property
    def instrument(self) -> str:
        """The mirror's name."""
        known = self.calibration or self.data
        return known.instrument if known is not None else ""

    @property
    def inputs(self) -> tuple[Source, ...]:
        """The files: those that went into the calibration, or those that did not suffice."""
        if self.calibration is not None:
            return self.calibration.sources
        records = self.data.cycles if isinstance(self.data, Campaign) else (self.data,)
        sources = [record.source for record in records if record is not None]
        return tuple(source for source in sources if source)

    def plot(self, name: str, ax: Axes | None = None) -> Axes:
        """Draw a figure by its name, as 'budget', 'map-leverage' or 'modes'; return the axes.

        Raises
        ------
        UnknownName
            There is no such figure; the message names those that are.
        ValueError
            These findings do not hold what it shows.
        """
        from truenewton.report.figures import figures_of

        drawn = figures_of(self)
        if name in drawn:
            return drawn[name](ax=ax)
        if name in ("residuals", "singular-values", "balance"):
            raise ValueError("a calibration file holds no residuals; give the cycles")
        if name == "temperatures":
            raise ValueError("only the cycles of a campaign have times")
        if name.startswith("modes"):
            raise ValueError(self.no_modes or "a calibration file tells no modes; give the data")
        remedy = f"choose {', '.join(drawn)}"
        raise UnknownName(f"there is no figure '{name}'", remedy=remedy, got=name)


def investigate(
    data: Campaign | StiffnessMatrix | Calibration, method: str = "ml", *, population: bool = False
) -> Findings:
    """Calibrate data and gather the evidence; data that do not suffice are diagnosed instead.

    Parameters
    ----------
    data
        What is to be reported on; a finished calibration is taken as it is.
    method, population
        As in `calibrate`.

    Raises
    ------
    UnknownName
        There is no such method, or it takes no such data.
    """
    if isinstance(data, Calibration):
        return Findings(None, data)
    refuse_method(data, method, population=population)
    sifted: Sifted | None = None
    try:
        if isinstance(data, StiffnessMatrix):
            return _of_stiffness(data, method, population=population)
        sifted = sift(data)
        return _of_campaign(sifted, method, population=population)
    except (RankDeficient, TooManyOutliers, NotConverged) as error:
        # The estimator names the first fault only.
        faults = diagnose(sifted.sound, sifted.moments).faults if sifted is not None else ()
        return Findings(data, None, faults=faults or (Fault(error.fault, error.remedy),))


def _of_stiffness(matrix: StiffnessMatrix, method: str, *, population: bool) -> Findings:
    calibration = calibrate(matrix, method, population=population)
    evidence = stiffness_evidence(matrix, calibration, method, population=population)
    modes, no_modes = _modes(matrix, calibration)
    return Findings(matrix, calibration, evidence, modes=modes, no_modes=no_modes)


def _of_campaign(sifted: Sifted, method: str, *, population: bool) -> Findings:
    """Calibrate a campaign; its rows are read once more, for all that is told of them."""
    campaign = sifted.campaign
    estimate = find_alpha(sifted, method, population=population)
    imbalance = RowImbalance(sifted, estimate.values[: int(campaign.layout.enabled.sum())])
    reader, no_modes = _modes_reader(sifted)
    readers = (imbalance,) if reader is None else (imbalance, reader)
    calibration = calibration_of(campaign, estimate, readers)
    evidence = campaign_evidence(sifted, calibration, imbalance)
    modes = None
    if reader is not None:
        modes, no_modes = _modes(campaign, calibration, reader)
    return Findings(campaign, calibration, evidence, modes=modes, no_modes=no_modes)


def _modes_reader(sifted: Sifted) -> tuple[MotionReader | None, str]:
    """Return who reads what modes need, or why there are none."""
    if sifted.campaign.layout.n > MOST_MODES:
        return None, _too_many(sifted.campaign)
    try:
        return modes_reader(sifted), ""
    except TrueNewtonError as error:
        return None, _no_modes(error)


def _modes(
    data: Campaign | StiffnessMatrix, calibration: Calibration, reader: MotionReader | None = None
) -> tuple[ModalFindings | None, str]:
    """Return the modal base, or why there is none."""
    if data.layout.n > MOST_MODES:
        return None, _too_many(data)
    try:
        return find_modes(data, calibration, reader=reader), ""
    except TrueNewtonError as error:
        return None, _no_modes(error)


def _too_many(data: Campaign | StiffnessMatrix) -> str:
    return f"Those of {data.layout.n} actuators take a while: truenewton modes finds them."


def _no_modes(error: TrueNewtonError) -> str:
    why = "; ".join(filter(None, (error.fault, error.remedy)))
    return f"The data do not tell them: {why}."
