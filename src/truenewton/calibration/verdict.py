"""The verdict on a calibration: sound, limited, or not to be used; the same wherever it is asked.

It rests on what a calibration file holds and on nothing else, so that a file read back is judged as
the calibration was that wrote it.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truenewton.calibration.scale_faults import (
    UNTOLD,
    scale_faults,
    unit_fault,
    weights_along_axis,
)
from truenewton.errors import NotToBeUsed, TrueNewtonWarning
from truenewton.estimation.diagnosis import RejectedRow
from truenewton.estimation.effects.words import MISFIT, effect_warnings
from truenewton.estimation.estimate import Scale
from truenewton.estimation.findings.catalogue import Concern
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.identifiability import NO_LOAD_SEEN, alike_loads_fault
from truenewton.estimation.reciprocity.gate import BY_ML
from truenewton.estimation.weights import typical
from truenewton.records.fault import Fault
from truenewton.records.of_segments import alike
from truenewton.rounding import numbered, percent, with_error

if TYPE_CHECKING:
    from truenewton.calibration.result import Calibration
    from truenewton.calibration.segmented import SegmentedCalibration

FAR = 5.0  # robust standard deviations, for an actuator off the others
FEW = 0.03  # of the actuators, and two at least, may be dead or reversed: else all are in doubt
IMPROBABLE = 1e-3  # of a fit; as weights are warned of
MANY = 0.02  # of the rows left out
# Of chi2/DOF. E_STAT grows with its root, as if what is left were noise; where that is a hundred
# times the noise it is the data that are not what they say: with a mN of noise, 0.1 N per reading.
SENSELESS = 1e4
UNEVEN = 2.0  # times as much imbalance in modes that the fit has not seen: said
SIGMAS = 3.0  # within which alpha is 0


class Level(StrEnum):
    """What a calibration is good for."""

    SOUND = "sound"
    LIMITED = "limited"
    UNUSABLE = "not to be used"
    NONE = "no alpha"


GRAVITIES = (Level.SOUND, Level.LIMITED, Level.UNUSABLE, Level.NONE)


@dataclass(frozen=True)
class Verdict:
    """What to think of a calibration.

    Attributes
    ----------
    level
        'sound', 'limited', 'not to be used'; of data that give none 'no alpha'.
    faults
        What is wrong, the gravest first, each with what to do about it; none of a sound one.
    notes
        What is worth knowing and not wrong: why a better method was no use.
    """

    level: Level
    faults: tuple[Fault, ...] = ()
    notes: tuple[Fault, ...] = ()

    def __str__(self) -> str:
        if not self.faults:
            return str(self.level)
        more = f" (and {len(self.faults) - 1} more)" if len(self.faults) > 1 else ""
        return f"{self.level}: {'; '.join(filter(None, self.faults[0]))}{more}"

    @property
    def values(self) -> dict[str, Any]:
        """The same for a script."""
        faults, notes = ([each._asdict() for each in some] for some in (self.faults, self.notes))
        return {"level": str(self.level), "faults": faults, "notes": notes}


def verdict_on(calibration: Calibration) -> Verdict:
    """Judge a calibration by what its file holds of it."""
    grave = list(dict.fromkeys(_grave(calibration)))
    faults = tuple(dict.fromkeys((*grave, *_limits(calibration))))
    level = Level.UNUSABLE if grave else Level.LIMITED if faults else Level.SOUND
    return Verdict(level, faults, tuple(each for each in _warned(calibration) if _is_note(each)))


def verdict_on_segments(c: SegmentedCalibration) -> Verdict:
    """Judge a mirror in several segments: each fault names its segment, the gravest first.

    It can be used as long as a segment can; it is sound where all are.
    """
    judged = {number: one.verdict for number, one in c.segments.items()}
    judged |= {number: Verdict(Level.NONE, faults) for number, faults in c.refused.items()}
    faults = []
    for level in reversed(GRAVITIES):
        of_level = [(n, v) for n, v in sorted(judged.items()) if v.level == level]
        for numbers, (fault, remedy) in alike((n, each) for n, v in of_level for each in v.faults):
            of = numbered("segment", numbers) + (f", {level}" if level in GRAVITIES[2:] else "")
            faults.append(Fault(f"{of}: {fault}", remedy))
    levels = {one.level for one in judged.values()}
    if not levels & {Level.SOUND, Level.LIMITED}:
        return Verdict(Level.UNUSABLE, tuple(faults))
    return Verdict(Level.SOUND if levels == {Level.SOUND} else Level.LIMITED, tuple(faults))


def refuse_unusable(
    calibration: Calibration | SegmentedCalibration, *, force: bool, path: object = None
) -> None:
    """Raise `NotToBeUsed` where a calibration is not to be used, unless forced.

    Raises
    ------
    NotToBeUsed
    """
    verdict = calibration.verdict
    if verdict.level == Level.UNUSABLE and not force:
        fault, remedy = verdict.faults[0]
        remedy = f"{remedy}; --anyway, or force=True, takes it all the same"
        raise NotToBeUsed(f"{verdict.level}: {fault}", remedy=remedy, path=path)


def warn_of(calibration: Calibration | SegmentedCalibration, stacklevel: int = 3) -> None:
    """Warn in Python of what is not to be used, and of effects that were not taken out.

    Warns
    -----
    TrueNewtonWarning
    """
    verdict = calibration.verdict
    if verdict.level == Level.UNUSABLE or calibration.doubtful:
        warnings.warn(f"{calibration.instrument}: {verdict}", TrueNewtonWarning, stacklevel)


def _grave(c: Calibration) -> Iterator[Fault]:
    """Yield why a calibration is not to be used, causes before what they do."""
    fits = c.goodness is None or not c.goodness.probability < IMPROBABLE
    unit = unit_fault(c)
    grave = {Concern.FILES}
    if not fits:  # else the rows that disagreed were left out
        grave.add(Concern.ROWS)
    if unit is not None:
        grave.add(Concern.SILENT)
    yield from effect_warnings(_uncorrected(c, grave))
    if unit:
        yield unit
    yield from _harm(c)
    alpha = c.alpha[c.layout.enabled]
    few = max(2, FEW * alpha.size)
    negative, silent = int(np.count_nonzero(alpha <= 0)), _uncorrected(c, {Concern.SILENT})
    if len(silent) > few:
        yield Fault(
            f"{len(silent)} of {alpha.size} actuators are dead, or their readings stuck",
            "look at what drives and reads them; set ENABLED to F where there is no force",
        )
    senseless = list(_senseless(c))
    if negative > few or senseless:  # what was found of the bench is the cause
        yield from effect_warnings(_uncorrected(c))
    if negative > few and unit != NO_LOAD_SEEN:
        yield Fault(
            f"alpha is negative for {negative} of {alpha.size} actuators",
            "turn the sign of FORCE, which is positive upwards; or ADDED stands at the wrong load"
            if negative == alpha.size
            else "check the signs and the order of FORCE: z points up",
        )
    yield from senseless


def _senseless(c: Calibration) -> Iterator[Fault]:
    """Yield what no alpha can be believed with, whatever its cause."""
    weighed = c.scale == Scale.WEIGHTS
    if weighed and (not c.loads or np.ptp(weights_along_axis(c)) == 0.0):
        yield Fault(
            "no load differs from another, so nothing fixes the common scale",
            "add cycles under a load of another known weight",
        )
    error = typical(c.error, c.alpha)
    if error > UNTOLD:
        alike = alike_loads_fault(weights_along_axis(c)) if weighed else None
        if alike:
            yield alike
        by_weights = typical(c.systematic_error, c.alpha) > typical(c.reading_error, c.alpha)
        yield Fault(
            f"alpha is known to {percent(error)} typically, so it is not told from 0",
            "check E_WEIGHT, E_ADDED and E_TILT, standard uncertainties in N and deg; or take loads"
            " that differ more in weight"
            if by_weights
            else "add shapes and cycles, use larger forces, or loads that differ more in weight",
        )
    if c.goodness is not None and c.goodness.reduced > SENSELESS:
        yield Fault(
            f"what is left of the balance is {np.sqrt(c.goodness.reduced):.2g} times the noise",
            "look for copies among the files, and for a wrong LOAD, SHAPE, SIGN or order of FORCE",
        )


def _harm(c: Calibration) -> Iterator[Fault]:
    """Yield that modes which the fit has not seen balance worse than with alpha = 1."""
    if not c.imbalances:
        return
    _, *unseen = c.imbalances
    before, after = (
        float(np.sqrt(np.mean([getattr(line, name) ** 2 for line in unseen])))
        for name in ("before", "after")
    )
    # Soft modes may be all noise, and balance as badly with any alpha: not by chance alone.
    if after > before * (1.0 + 1.0 / np.sqrt(3 * c.shapes_used)):
        yield Fault(
            f"modes that the fit has not seen balance worse with alpha ({percent(after)} of"
            f" their force) than without ({percent(before)})",
            "measure the stiffness with less noise, or calibrate with cycles under weights",
        )


def _limits(c: Calibration) -> Iterator[Fault]:
    """Yield what limits a calibration that can be used, what the bench did first."""
    yield from effect_warnings(_uncorrected(c))
    if c.imbalances:
        fitted, *unseen = (line.after for line in c.imbalances)
        if max(unseen) > UNEVEN * fitted:
            yield Fault(
                f"modes that the fit has not seen are out of balance by up to"
                f" {percent(max(unseen))} of their force, fitted ones by {percent(fitted)}",
                "trust smooth patterns of alpha the least; cycles under known weights would hold"
                " them",
            )
    warned = [each for each in _warned(c) if not _is_note(each)]
    yield from warned
    fit = c.goodness
    said = any(fault.startswith(MISFIT) for fault, _ in warned)
    if fit is not None and fit.probability < IMPROBABLE and not said:
        yield Fault(
            f"the shapes are out of balance by {np.sqrt(fit.reduced):.2g} times what their noise"
            " explains",
            "take method ml, which looks for what the bench does beside the model"
            if c.method == "svd"
            else "look for what differs between files: a drift, a label, what touches the glass",
        )
    if c.rejected > MANY * (c.rejected + c.shapes_used):
        part = percent(c.rejected / (c.rejected + c.shapes_used))
        yield Fault(f"{part} of the rows do not fit", "find out what happened during the run")
    yield from scale_faults(c)
    yield from _row_faults(c)
    named = {actuator for effect in c.effects for actuator in effect.actuators}
    for k in _off_family(c):
        if c.layout.id[k] in named:
            continue
        alpha = with_error(float(c.alpha[k]), float(c.reading_error[k]))
        if abs(c.alpha[k]) < SIGMAS * c.reading_error[k]:
            yield Fault(
                f"actuator {c.layout.id[k]} is dead: alpha is {alpha}",
                "look at its coil and magnet; set ENABLED to F if it exerts no force",
            )
        else:
            yield Fault(
                f"actuator {c.layout.id[k]} stands off the others: alpha is {alpha}",
                "look at its coil, magnet and wiring",
            )


def _warned(c: Calibration) -> tuple[Fault, ...]:
    return c.diagnosis.warnings if c.diagnosis is not None else ()


def _is_note(warning: Fault) -> bool:
    """Tell what limits nothing: `ml` is as sound where reciprocity does not hold."""
    return warning.fault.startswith(BY_ML)


def _row_faults(c: Calibration) -> Iterator[Fault]:
    """Yield that rows were left out, and the farthest of them."""
    if not c.rejected:
        return
    rows, farthest = f"{c.rejected} rows do not fit and were", ""
    if c.rejected == 1:
        rows = "1 row does not fit and was"
    remedy = "see the report of the cycle files"
    if c.rejected_rows:
        row = max(c.rejected_rows, key=lambda row: row.sigmas)
        file = c.sources[row.cycle].file if row.cycle < len(c.sources) else f"cycle {row.cycle + 1}"
        farthest = f"; the farthest: {rejected_sentence(row, file)}"
        remedy = (
            "look at the residuals; an actuator that stands out again and again is worth a look"
        )
    yield Fault(f"{rows} left out{farthest}", remedy)


def rejected_sentence(row: RejectedRow, file: str) -> str:
    """Say of one row of a file how far it lay, and which actuator stands out."""
    return (
        f"{file} row {row.row + 1}, {row.sigmas:.0f} sigma from"
        f" {'its repeats' if row.against == 'repeats' else 'balance'}, actuator"
        f" {row.actuator} stands out"
    )


def _off_family(c: Calibration) -> NDArray[np.int64]:
    """Return the indices of actuators far from the others, in terms of their spread and error."""
    middle = np.nanmedian(c.alpha)
    spread = 1.4826 * np.nanmedian(np.abs(c.alpha - middle))
    far = np.abs(c.alpha - middle) > FAR * np.hypot(spread, c.reading_error)
    return np.flatnonzero(far)


def _uncorrected(c: Calibration, about: Collection[Concern] = tuple(Concern)) -> list[Finding]:
    """Return the effects that were not taken out, those about something."""
    return [e for e in c.effects if not e.corrected and e.concern in about]
