"""From measurements to what the optical loop wants to know, before and after calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, overload

import numpy as np

from truenewton.arrays import Array, taking_units
from truenewton.calibration.methods import (
    Data,
    Seen,
    asked,
    calibrate,
    calibration_of,
    estimate_alpha,
    seen_of,
)
from truenewton.calibration.result import AnyCalibration, Calibration
from truenewton.calibration.verdict import REGARDLESS, refuse_unusable
from truenewton.calibration.workers import executor_for
from truenewton.errors import CampaignMismatch, NotToBeUsed, RankDeficient, UnknownName
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.screen import as_calibrated
from truenewton.estimation.readings.row_readers import read_rows
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.modal.actuator_roles import indices_of
from truenewton.modal.comparison import ModesComparison, compare_modes
from truenewton.modal.dissipation import EFFICIENCY, Budget, Dissipation
from truenewton.modal.measured_stiffness import MeasuredStiffness, motion_reader, stiffness_of
from truenewton.modal.modal_base import ModalBase, modal_base
from truenewton.modal.pupil import pupil_of, seen_turbulence
from truenewton.modal.shape_products import MotionReader
from truenewton.modal.static_force import static_force
from truenewton.modal.true_stiffness import TrueStiffness, true_stiffness
from truenewton.modal.turbulence import Atmosphere
from truenewton.records.campaign import Campaign
from truenewton.records.fault import Fault
from truenewton.records.notebook import html_table
from truenewton.records.parts import Parts, has_parts
from truenewton.records.segmented import SegmentedData
from truenewton.records.source import Source
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.statics.modes import StiffnessModes

MOST_COMPARED = 1000  # actuators; modes only to compare take as long, and as much memory, again
MISFIT = 2.0  # of the variance of repeats; hundreds of readings and more hold it within 10 %


@dataclass(frozen=True, eq=False, repr=False)
class ModalFindings:
    """The modal base that alpha gives, beside what would be taken for it without.

    Attributes
    ----------
    measured
        The stiffness that cycles gave, and how well; None for a stiffness file.
    calibration
        Where alpha is from.
    after
        The modal base with alpha as it is.
    uncalibrated
        Finds the modal base with alpha taken for 1; see ``before``.
    asymmetry, imbalance
        Of the stiffness with alpha taken for 1, and as it is; see `TrueStiffness`.
    sources
        The files that the stiffness is from.

    Examples
    --------
    >>> found = tn.find_modes(campaign, calibration)
    >>> found
    <ModalFindings of P45: 45 modes>
    >>> found.after.modes.stiffness.shape
    (45,)
    """

    measured: MeasuredStiffness | None
    calibration: Calibration
    after: ModalBase
    uncalibrated: Callable[[], ModalBase]
    asymmetry: tuple[float, float]
    imbalance: tuple[float, float]
    sources: tuple[Source, ...]

    def __repr__(self) -> str:
        base = self.after
        return f"<ModalFindings of {base.matrix.instrument}: {base.modes.stiffness.size} modes>"

    def _repr_html_(self) -> str:
        from truenewton.calibration.words import warning_lines
        from truenewton.modal.words import headline, summary_rows

        rows = [row for row in summary_rows(self) if row[1]]
        rows.append(("verdict on alpha", str(self.calibration.verdict)))
        return html_table(headline(self), rows, warning_lines(self.warnings))

    @cached_property
    def before(self) -> ModalBase:
        """The modal base with alpha taken for 1; found when first asked for."""
        return self.uncalibrated()

    @cached_property
    def comparison(self) -> ModesComparison:
        """Of the modes before with those after; found when first asked for."""
        after = self.after.modes
        return compare_modes(after.modes, self.before.modes.modes, after.stiffness)

    @property
    def compares(self) -> bool:
        """Whether words and figures compare with alpha taken for 1: not large mirrors."""
        return self.after.layout.n <= MOST_COMPARED

    @property
    def warnings(self) -> tuple[Finding | Fault, ...]:
        """What is wrong with the stiffness, or with alpha for it, and what to do about it."""
        warnings: list[Finding | Fault] = (
            list(self.measured.warnings) if self.measured is not None else []
        )
        if self.measured is not None and self.measured.misfit > MISFIT:
            warnings.append(
                Fault(
                    "shapes leave forces that no stiffness explains,"
                    f" {np.sqrt(self.measured.misfit):.2g} times what repeats scatter",
                    "look for actuators that act but are disabled, or for a mirror that drifted",
                )
            )
        if _true_already(self.calibration):
            warnings.append(
                Fault(
                    "STIFFNESS is symmetric and balanced, and taken for a true one: alpha is 1",
                    "if it was made so of a measured one, give that as it was measured",
                )
            )
        elif all(before < after for before, after in (self.asymmetry, self.imbalance)):
            warnings.append(
                Fault(
                    "with alpha the stiffness is less symmetric and less balanced than without",
                    "give alpha of this very mirror, and its stiffness in commanded Newtons",
                )
            )
        return tuple(warnings)

    def modes_between(self, cost: Dissipation, limits: Budget) -> tuple[int, int]:
        """Return the number of modes within limits, were alpha one E_ALPHA higher, and lower."""
        c = self.calibration
        at = indices_of(c.layout, self.after.stiffness.enabled.id)
        error: Array = c.error[at] / np.abs(c.alpha[at])
        fewest, most = (cost.modes_within(limits, alpha_error=e) for e in (error, -error))
        return fewest, most


@overload
def find_modes(
    data: Campaign | StiffnessMatrix, calibration: Calibration | None = None,
    atmosphere: Atmosphere | None = None, *, diameter: float | None = None,
    radius: float | None = None, efficiency: float = EFFICIENCY, sensor_gain: Array | None = None,
    motion: Array | None = None, off: Sequence[int] = (), slaved: Sequence[int] = (),
    reader: MotionReader | None = None, force: bool = False, processes: int | None = None,
) -> ModalFindings: ...  # fmt: skip
@overload
def find_modes(
    data: Data, calibration: AnyCalibration | None = None,
    atmosphere: Atmosphere | None = None, *, diameter: float | None = None,
    radius: float | None = None, efficiency: float = EFFICIENCY, sensor_gain: Array | None = None,
    motion: Seen | None = None, off: Sequence[int] = (), slaved: Sequence[int] = (),
    reader: MotionReader | None = None, force: bool = False, processes: int | None = None,
) -> ModalFindings | Parts[ModalFindings]: ...  # fmt: skip
@taking_units(diameter="m", radius="m", efficiency="N W(-1/2)", sensor_gain="")
def find_modes(
    data: Data,
    calibration: AnyCalibration | None = None,
    atmosphere: Atmosphere | None = None,
    *,
    diameter: float | None = None,
    radius: float | None = None,
    efficiency: float = EFFICIENCY,
    sensor_gain: Array | None = None,
    motion: Seen | None = None,
    off: Sequence[int] = (),
    slaved: Sequence[int] = (),
    reader: MotionReader | None = None,
    force: bool = False,
    processes: int | None = None,
) -> ModalFindings | Parts[ModalFindings]:
    """Find the stiffness modes of a mirror, and what turbulence costs with 1, 2, ... of them.

    Parameters
    ----------
    data
        Cycles with POSITION, or a measured stiffness; that alone counts which stands among cycles.
        Each of several segments has modes of its own.
    calibration
        Gives alpha; the data are calibrated where None. Of all segments if the data are.
    atmosphere
        The turbulence; 0.8 arcsec where None.
    diameter, radius
        Of the entrance pupil, and of the mirror that fills it [m]; see `pupil_of`. Each segment
        fills its part of it, seen from its own middle.
    efficiency
        Commanded force per root of power [N/W^1/2].
    sensor_gain, motion, off, slaved
        As in `true_stiffness`; the data are calibrated with ``motion``, too.
    reader
        What has read the cycles already, see `motion_reader`; they are read where None.
    force
        Take alpha whose verdict is 'rejected', too.
    processes
        As of `calibrate`.

    Raises
    ------
    NotToBeUsed
        The verdict on alpha, or most modes are negative; unless forced.
    RankDeficient, TooManyOutliers, NotConverged
        The data tell no stiffness, or no alpha.
    FormatError
        A number that cannot be: seeing, diameter, efficiency, sensor gain.
    CampaignMismatch
        Data and calibration are of two mirrors.
    UnknownName
        An ID that no enabled actuator has, or that is both off and slaved.

    Examples
    --------
    >>> found = tn.find_modes(campaign, calibration, tn.Atmosphere(seeing=0.8))
    >>> stiffness, zernike, karhunen_loeve = found.after.costs
    >>> stiffness.residual.shape  # for 1, 2, ... modes
    (45,)
    """
    options: dict[str, Any] = {
        "atmosphere": atmosphere, "diameter": diameter, "radius": radius, "efficiency": efficiency,
        "sensor_gain": sensor_gain, "motion": motion, "off": off, "slaved": slaved, "force": force,
    }  # fmt: skip
    if has_parts(data) and (calibration is None or has_parts(calibration)):
        return _of_segments(data, calibration, processes, **options)
    if has_parts(data) or has_parts(calibration):
        raise CampaignMismatch(
            "of data and calibration one is of several segments, the other of one body",
            remedy="choose the segment: --segment, or part(...) in Python",
        )
    return _of_body(data, calibration, reader, **options)


def _of_body(
    data: Campaign | StiffnessMatrix,
    calibration: Calibration | None,
    reader: MotionReader | None,
    *,
    atmosphere: Atmosphere | None,
    diameter: float | None,
    radius: float | None,
    efficiency: float,
    sensor_gain: Array | None,
    motion: Array | None,
    off: Sequence[int],
    slaved: Sequence[int],
    force: bool,
) -> ModalFindings:
    """Find the modes of one body, parameters as of `find_modes`."""
    if calibration is not None:
        refuse_unusable(calibration, force=force)
    matrix, measured, calibration, reader = _with_alpha(data, calibration, reader, motion)
    calibration = _usable(calibration, force=force)
    matrix = as_calibrated(matrix, calibration.effects)
    at_rest = None if reader is None else reader.force_at_rest
    stiffness_by = partial(
        true_stiffness, matrix, sensor_gain=sensor_gain, motion=motion, off=off, slaved=slaved
    )
    before = stiffness_by(None)
    faults = before.asymmetry, before.imbalance
    del before  # of large mirrors each matrix counts
    modes = (stiffness := stiffness_by(calibration)).modes
    _refuse_negative(modes, force=force)
    air, pupil = atmosphere or Atmosphere(0.8), pupil_of(matrix.layout, diameter, radius)
    seen = seen_turbulence(stiffness.enabled, stiffness.commanded, air, pupil)
    static = static_force(stiffness, calibration, at_rest)
    after = modal_base(matrix, stiffness, modes, seen, static, efficiency)
    return ModalFindings(
        measured, calibration, after,
        partial(_uncalibrated, after, calibration, at_rest, stiffness_by),
        (faults[0], stiffness.asymmetry), (faults[1], stiffness.imbalance),
        _sources(reader, matrix),
    )  # fmt: skip


def _of_segments(
    data: SegmentedData,
    calibration: Parts[Calibration] | None,
    processes: int | None,
    *,
    diameter: float | None,
    radius: float | None,
    motion: Seen | None,
    sensor_gain: Array | None,
    off: Sequence[int],
    slaved: Sequence[int],
    **same: Any,
) -> Parts[ModalFindings]:
    """Find the modes of each segment by itself, parameters as of `find_modes`.

    Raises
    ------
    RankDeficient, CampaignMismatch, UnknownName
    """
    layout = data.layout
    apart = "" if calibration is None else calibration.layout.other_actuators(layout)
    if apart:
        raise CampaignMismatch(
            f"data and calibration are of two mirrors: {apart}",
            remedy="give both of the same mirror",
        )
    pupil = pupil_of(layout, diameter, radius)
    for unknown in (name for name in (*off, *slaved) if name not in layout.id):
        raise UnknownName(f"there is no actuator {unknown}", remedy="give IDs of ACTUATORS")

    def solver(number: int) -> Callable[[Campaign | StiffnessMatrix], ModalFindings]:
        if calibration is not None and number in calibration.refused:
            fault, remedy = calibration.refused[number][0]
            raise RankDeficient(fault, remedy=remedy)
        here = data.of(number)
        own = pupil_of(layout.part(here)).radius
        return partial(
            find_modes, calibration=None if calibration is None else calibration.part(number),
            radius=own, diameter=pupil.diameter * own / pupil.radius,
            motion=seen_of(motion, layout, number),
            sensor_gain=None if sensor_gain is None else sensor_gain[here],
            off=data.own(number, off), slaved=data.own(number, slaved), **same,
        )  # fmt: skip

    return data.solved(solver, "modes", executor_for(layout, processes))


def _uncalibrated(
    after: ModalBase,
    calibration: Calibration,
    at_rest: Array | None,
    stiffness_by: Callable[[None], TrueStiffness],
) -> ModalBase:
    """Return the modal base that would be taken for it without alpha."""
    stiffness = stiffness_by(None)
    static = static_force(stiffness, calibration, at_rest)
    efficiency = after.costs[0].efficiency
    return modal_base(after.matrix, stiffness, stiffness.modes, after.seen, static, efficiency)


def _with_alpha(
    data: Campaign | StiffnessMatrix,
    calibration: Calibration | None,
    reader: MotionReader | None,
    motion: Array | None,
) -> tuple[StiffnessMatrix, MeasuredStiffness | None, Calibration, MotionReader | None]:
    """Return the stiffness, how it was measured, alpha, and what has read the cycles."""
    if isinstance(data, StiffnessMatrix):
        return data, None, calibration or calibrate(data, motion=motion), None
    if reader is None:
        screened = screen_campaign(data)
        reader = motion_reader(screened)
        if calibration is None:
            method, known = asked(data, None, population=False, motion=motion)
            estimate = estimate_alpha(screened, method, known)
            calibration = calibration_of(data, estimate, (reader.take,))
        else:
            read_rows(data, (reader.take,))
    calibration = calibration or calibrate(data, motion=motion)
    if data.stiffness is not None:
        return data.stiffness, None, calibration, reader
    measured = stiffness_of(reader)
    return measured.matrix, measured, calibration, reader


def _usable(calibration: Calibration, *, force: bool) -> Calibration:
    """Return the calibration, with alpha 1 where the stiffness is a true one already.

    Raises
    ------
    NotToBeUsed
    """
    if _true_already(calibration):
        return replace(calibration, alpha=calibration.alpha / calibration.alpha)  # NaN where off
    refuse_unusable(calibration, force=force)
    return calibration


def _true_already(calibration: Calibration) -> bool:
    """Tell whether the stiffness that was calibrated is a true one, as `modes` itself writes it."""
    return any(effect.code == Code.TRUE_STIFFNESS for effect in calibration.effects)


def _refuse_negative(modes: StiffnessModes, *, force: bool) -> None:
    """Refuse a stiffness most of whose elastic modes are negative, unless forced.

    Raises
    ------
    NotToBeUsed
    """
    elastic = modes.stiffness[3:]
    negative = int(np.count_nonzero(elastic < 0.0))
    if 2 * negative > elastic.size and not force:
        raise NotToBeUsed(
            f"{Level.REJECTED}: {negative} of {elastic.size} elastic modes are negative",
            remedy=f"reverse the sign of STIFFNESS, or of POSITION in cycles; {REGARDLESS}",
        )


def _sources(reader: MotionReader | None, matrix: StiffnessMatrix) -> tuple[Source, ...]:
    """Return the files of a stiffness: its own, or those of the cycles that hold POSITION."""
    if reader is None or not reader.positioned:
        source = matrix.source
        return (replace(source, rows=matrix.layout.n),) if source else ()
    lost = Counter(row.cycle for row in reader.rejected)
    return tuple(
        replace(c.source, rows=int(c.valid.sum()), rejected=lost[k])
        for k, c in enumerate(reader.positioned)
        if c.source
    )
