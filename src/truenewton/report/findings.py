"""What a report shows of data: the calibration and its evidence, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes

from truenewton.calibration.result import Calibration
from truenewton.errors import Fault, UnknownName
from truenewton.figures.style import on_screen
from truenewton.modal.findings import ModalFindings
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.records.result import figures_of
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.report.evidence import Evidence


@dataclass(frozen=True, eq=False)
class Findings:
    """All that a report tells of one set of data, or of a finished calibration.

    Attributes
    ----------
    data
        What was given: data, or a finished calibration.
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

    data: Campaign | StiffnessMatrix | Calibration
    calibration: Calibration | None
    evidence: Evidence | None = None
    faults: tuple[Fault, ...] = ()
    modes: ModalFindings | None = None
    no_modes: str = ""

    @property
    def inputs(self) -> tuple[Source, ...]:
        """The files: those that went into the calibration, or those that did not suffice."""
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
            There is no such figure; the message names those that are.
        ValueError
            These findings do not hold what it shows.
        """
        drawn = figures_of(self)
        if name in drawn:
            with on_screen():
                axes: Axes = drawn[name](ax=ax)
                return axes
        if name in ("residuals", "singular-values", "balance"):
            raise ValueError("a calibration file holds no residuals; give the cycles")
        if name == "temperatures":
            raise ValueError("only the cycles of a campaign have times")
        if name.startswith("modes"):
            raise ValueError(self.no_modes or "a calibration file tells no modes; give the data")
        remedy = f"choose {', '.join(drawn)}"
        raise UnknownName(f"there is no figure '{name}'", remedy=remedy, got=name)
