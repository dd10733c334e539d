"""The verdict on a calibration: whether its stated errors are valid.

It depends only on what a calibration file contains, so that the verdict on a file is that on the
calibration that was written. The findings are those of the data and of the fit, and those that
follow here from the numbers of the result. The level is that of the worst finding.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.errors import NotToBeUsed, TrueNewtonWarning
from truenewton.estimation.checks import MAX_ALPHA_SIGMAS
from truenewton.estimation.findings.code import LIMITS, Code, Concern, Level
from truenewton.estimation.findings.estimate import (
    FROM_READINGS,
    ErrorKind,
    RejectedRow,
    Scale,
    ScaleError,
    added_source,
    scale_total,
    tilt_as_load,
    typical,
)
from truenewton.estimation.findings.finding import Finding, Verdict, judged
from truenewton.estimation.paper.identifiability import (
    NO_LOAD_SEEN,
    SIMILAR_LOADS_FRACTION,
    similar_loads,
)
from truenewton.records.result import verdict_of
from truenewton.records.tables import size_doubt
from truenewton.rounding import percent, significant, with_error
from truenewton.statics.arms import effective_weight
from truenewton.statics.load import MIN_LEAN

REGARDLESS = (
    "to use it regardless, for a diagnosis only: --anyway (in Python: accept_rejected=True)"
)
MATRIX_REMEDY = (
    "check order and sign of the rows and columns of STIFFNESS. If they are correct, measure the"
    " stiffness with less noise"
)


@verdict_of.register(Calibration)
def verdict_on(calibration: Calibration) -> Verdict:
    """Judge a calibration by what its file holds of it."""
    return judged([*_rejecting(calibration), *_of_data(calibration), *_of_result(calibration)])


def refusal_of(level: Level, fault: str, remedy: str, path: object = None) -> NotToBeUsed:
    """Return the refusal of a result that is used only if forced."""
    remedy = f"{remedy}; {REGARDLESS}".lstrip("; ")
    return NotToBeUsed(f"{level}: {fault}", remedy=remedy, path=path)


def refuse_unusable(
    calibration: Calibration, *, accept_rejected: bool, path: object = None
) -> None:
    """Raise `NotToBeUsed` if a calibration is rejected, unless forced."""
    verdict = calibration.verdict
    if verdict.level <= Level.REJECTED and not accept_rejected:
        first = verdict.faults[0]
        raise refusal_of(verdict.level, first.fault, first.remedy, path)


def warn_of(calibration: Calibration, stacklevel: int = 3) -> None:
    """Issue a TrueNewtonWarning if a calibration is doubtful or rejected."""
    verdict = calibration.verdict
    if any(each.level <= Level.DOUBTFUL for each in verdict.findings):
        warnings.warn(f"{calibration.instrument}: {verdict}", TrueNewtonWarning, stacklevel)


def _rejecting(c: Calibration) -> Iterator[Finding]:
    """Yield why a calibration is rejected, causes before what they do."""
    unit = unit_fault(c)
    grave = {Concern.FILES}
    if _misfits(c):  # otherwise the rows that disagreed were left out
        grave.add(Concern.ROWS)
    if unit is not None:
        grave.add(Concern.SILENT)
    yield from _graver(c, grave)
    if unit:
        yield unit
    yield from _harm(c)
    alpha = c.alpha[c.layout.enabled]
    few = max(2, LIMITS.bad_fraction * alpha.size)
    negative = int(np.count_nonzero(alpha <= 0))
    silent = sum(max(len(each.actuators), 1) for each in _uncorrected(c, {Concern.SILENT}))
    if silent > few:
        yield Finding.of(Code.MANY_SILENT, count=silent, n=alpha.size)
    senseless = list(_senseless(c))
    if negative > few or senseless:  # what was found of the bench is the cause
        yield from _graver(c, set(Concern))
    if negative > few and not (unit and unit.code is Code.NO_LOAD_SEEN):
        code = Code.ALL_NEGATIVE if negative == alpha.size else Code.MANY_NEGATIVE
        yield Finding.of(code, count=negative, n=alpha.size, remedy=_of_matrix(c))
    yield from senseless


def _of_matrix(c: Calibration) -> str:
    """Return the remedy of a senseless alpha of a matrix; '' of cycles, as in the catalogue."""
    return MATRIX_REMEDY if c.scale == Scale.MEAN_ONE else ""


def _misfits(c: Calibration) -> bool:
    """Return whether the misfit is larger than by chance; it may not have been judged."""
    return c.goodness is not None and c.goodness.probability < LIMITS.fit_probability


def _senseless(c: Calibration) -> Iterator[Finding]:
    """Yield what makes alpha meaningless, whatever its cause."""
    weighed = c.scale == Scale.WEIGHTS
    if weighed and (not c.loads or np.ptp(weights_along_axis(c)) == 0.0):
        yield Finding.of(Code.NO_OTHER_LOAD)
    error = typical(c.statistical_error, c.alpha)  # a scale that is known badly is known to be so
    if error > LIMITS.relative_error:
        similar = similar_loads(weights_along_axis(c)) if weighed else None
        if similar:
            yield replace(similar, graded=Level.REJECTED)
        yield Finding.of(Code.ERROR_TOO_LARGE, error=error, remedy=_of_matrix(c))
    if c.goodness is not None and c.goodness.reduced > LIMITS.reduced_chi2:
        yield Finding.of(Code.MISFIT_SENSELESS, factor=np.sqrt(c.goodness.reduced))


def _harm(c: Calibration) -> Iterator[Finding]:
    """Yield that held-out modes balance worse than with alpha = 1."""
    if not c.imbalances:
        return
    _, *held_out = c.imbalances
    before, after = (
        float(np.sqrt(np.mean([getattr(line, name) ** 2 for line in held_out])))
        for name in ("before", "after")
    )
    # Soft modes may be all noise, and balance as badly with any alpha: not by chance alone.
    if after > before * (1.0 + 1.0 / np.sqrt(3 * c.shapes_used)):
        yield Finding.of(Code.HARMFUL_ALPHA, before=before, after=after)


def _of_data(c: Calibration) -> Iterator[Finding]:
    """Yield the findings of the file: first the effects that were not corrected, as causes."""
    yield from _uncorrected(c)
    largest = 2.0 * LIMITS.load_gain * typical(c.error, c.alpha)
    for effect in c.effects:
        if effect.corrected:  # a gain that differs between loads may change the scale
            by_load = effect.code is Code.GAIN_BY_LOAD and c.scale == Scale.WEIGHTS
            doubtful = by_load and abs(effect.size) > largest
            yield replace(effect, graded=Level.DOUBTFUL) if doubtful else effect
    yield from c.diagnosis.warnings


def _of_result(c: Calibration) -> Iterator[Finding]:
    """Yield what the numbers of the result show."""
    if c.imbalances:
        fitted, *held_out = (line.after for line in c.imbalances)
        if max(held_out) > LIMITS.held_out_ratio * fitted:
            yield Finding.of(Code.HELD_OUT_IMBALANCE, held_out=max(held_out), fitted=fitted)
    known = {each.code for each in c.diagnosis.warnings}
    if _misfits(c) and not known & {Code.MISFIT, Code.MISFIT_EXPLAINED}:
        code = Code.MISFIT_OF_SVD if c.method == "svd" else Code.MISFIT
        yield Finding.of(code, factor=np.sqrt(c.goodness.reduced) if c.goodness else np.nan)
    rows = c.rejected + c.shapes_used
    if c.rejected > LIMITS.rejected_fraction * rows:
        yield Finding.of(Code.MANY_ROWS_REJECTED, share=c.rejected / rows)
    doubt = size_doubt(c.layout, c.weight) if np.isfinite(c.weight) else None
    if doubt is not None:
        yield Finding.of(Code.SIZE_IMPLAUSIBLE, fault=doubt.fault, advice=doubt.remedy)
    yield from scale_faults(c)
    if c.rejected:
        yield _rejected(c)
    named = {actuator for effect in c.effects for actuator in effect.actuators}
    middle = np.nanmedian(c.alpha)
    spread = 1.4826 * np.nanmedian(np.abs(c.alpha - middle))
    far = np.abs(c.alpha - middle) > LIMITS.outlier_spreads * np.hypot(spread, c.statistical_error)
    for k in np.flatnonzero(far):
        if c.layout.id[k] not in named:
            dead = abs(c.alpha[k]) < MAX_ALPHA_SIGMAS * c.statistical_error[k]
            yield Finding.of(
                Code.ALPHA_ZERO if dead else Code.ALPHA_OUTLIER,
                actuators=[c.layout.id[k]],
                alpha=with_error(float(c.alpha[k]), float(c.error[k])),
            )


def _rejected(c: Calibration) -> Finding:
    """Return that rows were left out, and the farthest of them."""
    farthest = ""
    if c.rejected_rows:
        row = max(c.rejected_rows, key=lambda row: row.sigmas)
        file = c.sources[row.cycle].file if row.cycle < len(c.sources) else f"cycle {row.cycle + 1}"
        farthest = f"; the farthest: {rejected_sentence(row, file)}"
    was = "was" if c.rejected == 1 else "were"
    return Finding.of(Code.ROWS_REJECTED, count=c.rejected, was=was, farthest=farthest)


def rejected_sentence(row: RejectedRow, file: str) -> str:
    """Return of one row of a file how far it lay, and which actuator stands out."""
    return (
        f"{file} row {row.row + 1}, {row.sigmas:.0f} sigma from"
        f" {'its repeats' if row.against == 'repeats' else 'balance'}, mainly because of"
        f" actuator {row.actuator}"
    )


def _uncorrected(c: Calibration, about: Collection[Concern] = tuple(Concern)) -> list[Finding]:
    """Return the effects that were not corrected, those about something."""
    return [e for e in c.effects if not e.corrected and e.concern in about]


def _graver(c: Calibration, about: Collection[Concern]) -> Iterator[Finding]:
    """Yield the effects about something for which the calibration is rejected."""
    for each in _uncorrected(c, about):
        yield replace(each, graded=Level.REJECTED)


# -- the common scale: its unit, the weights, and their errors ------------------------------------

NO_ERROR = 1e-6  # of the common scale; no weight is known better
MIN_WEIGHING_ERROR = 1.5e-5  # of a weight: a tenth of the buoyancy of air on steel
WEIGHED = (ErrorKind.MIRROR, ErrorKind.TOOL, ErrorKind.ADDED)  # errors that a better balance lowers
OTHER_SCALE_REMEDIES = {  # of errors that neither a better balance nor a better angle lowers
    ErrorKind.COIL_SHIFT: "measure how far the coils move as the mirror leans (COILZ and E_COILZ)",
    ErrorKind.BETWEEN_LOADS: "keep the temperature the same under all loads, or take bare and"
    " loaded cycles in turn",
    ErrorKind.EARLIER: "repeat the earlier calibration with a smaller error of its scale",
    ErrorKind.TEMPERATURE: "measure at the temperature of the earlier calibration",
}
GRAVITY = 9.81  # [m/s^2]
FORCE_IN = "correct the unit of FORCE where it is declared, or convert its values to N"
WEIGHTS_IN = f"store WEIGHT and ADDED in N: {-GRAVITY} for a kilogram"
POUND = 4.4482216  # [N], of force
FORCE_UNITS = {  # alpha that each unit of FORCE makes of 1
    "uN": 1e-6, "mN": 1e-3, "gf (grams)": 1e-3 * GRAVITY, "lbf (pounds)": POUND,
    "kgf (kilograms)": GRAVITY, "kN": 1e3,
}  # fmt: skip
WEIGHT_UNITS = {"kg": 1 / GRAVITY, "lbf": 1 / POUND, "g": 1e3 / GRAVITY, "mN": 1e3}
OTHER_UNIT = "FORCE looks as if in counts or volts of the electronics, or in another unit than N"
ONE_LOAD_FROM_REST = "FORCE of one load counts from rest or belongs to another load"
NEAR_ONE = (0.6, 1.6)  # the typical alpha of mirrors, which a single mistake is to bring back
MAX_DEVIATION, MIN_LIKE_OTHERS = 0.5, 0.9  # from the median, of how many; otherwise no unit


def unit_fault(c: Calibration) -> Finding | None:
    """Return that alpha is so far from 1 that a unit must be wrong, and which one it may be.

    Or that no load is seen in the forces: then alpha is large, but no more than noise.
    """
    median = float(np.nanmedian(c.alpha))
    if c.scale == Scale.WEIGHTS and typical(c.statistical_error, c.alpha) > LIMITS.relative_error:
        return NO_LOAD_SEEN if abs(median) > LIMITS.highest_alpha else None
    alike = np.abs(c.alpha[c.layout.enabled] / median - 1.0) < MAX_DEVIATION
    if LIMITS.lowest_alpha < abs(median) < LIMITS.highest_alpha or np.mean(alike) < MIN_LIKE_OTHERS:
        return None
    fitting = {
        fault: remedy
        for factor, fault, remedy in _mistakes(c)
        if NEAR_ONE[0] < abs(median) / factor < NEAR_ONE[1]
    }
    looks = ", or ".join(fitting) or OTHER_UNIT
    remedy = "; or ".join(dict.fromkeys(fitting.values())) or FORCE_IN
    looks += ", and FORCE of the other sign" if median < 0.0 else ""
    if c.scale == Scale.WEIGHTS:
        times = f"{significant(max(abs(median), 1 / abs(median)))} times too"
        looks += f", or ADDED is about {times} {'large' if abs(median) > 1.0 else 'small'}"
        looks += f", or {ONE_LOAD_FROM_REST}"
    return Finding.of(
        Code.ALPHA_FAR_FROM_ONE, alpha=significant(median), looks=looks, remedy=remedy
    )


def _mistakes(c: Calibration) -> Iterator[tuple[float, str, str]]:
    """Yield single mistakes: the alpha that each makes of 1, its description and its remedy."""
    added = min((load.added for load in c.loads), default=0.0)
    alone = added - c.weight
    if alone < 0.0:
        fault = "ADDED looks as if the weight of the mirror were in it"
        yield added / alone, fault, f"store what was added alone, {significant(alone, 3)} N"
    for unit, factor in FORCE_UNITS.items():
        yield factor, f"FORCE looks as if in {unit}", FORCE_IN
    for unit, factor in WEIGHT_UNITS.items():
        yield factor, f"WEIGHT and ADDED look as if in {unit}", WEIGHTS_IN


def scale_faults(c: Calibration) -> Iterator[Finding]:
    """Yield that the weights limit the common scale, or are given without their errors."""
    if c.scale == Scale.MEAN_ONE:
        return
    weights, readings = typical(c.systematic_error, c.alpha), typical(c.statistical_error, c.alpha)
    if c.scale == Scale.WEIGHTS:
        alike = similar_loads(weights_along_axis(c))
        if alike and typical(c.error, c.alpha) > SIMILAR_LOADS_FRACTION:
            yield alike
        yield from _weights_without_errors(c, weights)
    if weights > LIMITS.scale_share * readings:
        limit = scale_limit(c)
        yield limit or Finding.of(Code.SCALE_BY_WEIGHTS, error=weights, share="")


def _weights_without_errors(c: Calibration, error: float) -> Iterator[Finding]:
    """Yield that weights or tilts have no error, or a smaller one than any weighing has.

    ``error`` is that of the common scale.
    """
    least = {load.name: MIN_WEIGHING_ERROR * abs(load.added) for load in c.loads}
    exact = [f"'{load.name}'" for load in c.loads if load.added and not load.added_error]
    small = [
        f"E_ADDED of '{load.name}' is {1e3 * load.added_error:.2g} mN, less than a tenth of"
        f" the buoyancy of air ({1e3 * least[load.name]:.2g} mN)"
        for load in c.loads
        if 0.0 < load.added_error < least[load.name]
    ]
    leaning = [f"'{q.name}'" for q in c.loads if abs(q.tilt) > MIN_LEAN and not q.tilt_error]
    which = [f"E_ADDED of {' and '.join(exact)} is 0"] if exact else []
    which += [f"E_TILT of {' and '.join(leaning)} is 0"] if leaning else []
    if which or small or error < NO_ERROR:
        inside = "; ".join([*which, *small])
        yield Finding.of(Code.WEIGHTS_WITHOUT_ERRORS, which=f" ({inside})" if inside else "")


def weights_along_axis(c: Calibration) -> Array:
    """Return (L,) weights of mirror and load along the axis [N]."""
    return effective_weight(c.weight, [q.added for q in c.loads], [q.tilt for q in c.loads])


def scale_limit(c: Calibration) -> Finding | None:
    """Return what limits the common scale and what would help; None where the weights do not."""
    if not c.scale_errors or c.scale_errors[0].source == FROM_READINGS:
        return None
    total, largest = scale_total(c.scale_errors), c.scale_errors[0]
    share = "nearly all of it" if largest.relative > 0.9 * total else "most of it"
    return Finding.of(
        Code.SCALE_BY_WEIGHTS,
        error=total,
        share=f", and {share} comes from the {largest.source}",
        remedy=_scale_remedy(c, largest, total),
    )


def _scale_remedy(c: Calibration, largest: ScaleError, total: float) -> str:
    """Return what lowers the largest error of the common scale; '' for that of the catalogue."""
    kind, name = largest.source.kind, largest.source.name
    better = f"the scale error falls to {percent(np.sqrt(total**2 - 0.99 * largest.relative**2))}"
    if kind == ErrorKind.TILT:
        error = max((load.tilt_error for load in c.loads if load.name == name), default=0.0)
        return f"if you measure the tilt of '{name}' to {0.1 * error:.2g} degrees, {better}"
    if kind not in WEIGHED:
        return OTHER_SCALE_REMEDIES[kind]
    weighed = [load.added_error for load in c.loads if added_source(load) == largest.source]
    remedies = []
    if (error := max(weighed, default=c.weight_error)) > 0.0:
        what = f"'{name}'" if weighed else "the mirror"
        remedies.append(f"if you weigh {what} to {100 * error:.2g} mN, {better}")
    tilted = tilt_as_load(c.weight, c.weight_error, 60.0, 0.1)
    if tilted < total and not any(load.tilt for load in c.loads):
        remedies.append(
            f"{'If' if remedies else 'if'} you use a tilt of 60 ± 0.1 degrees as the load, the"
            f" scale error is {percent(tilted)}"
        )
    return ". ".join(remedies)
