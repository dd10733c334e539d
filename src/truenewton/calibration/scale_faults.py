"""What is wrong with the common scale: its unit, the weights, and the errors of these."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import ErrorKind, Scale
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.findings.scale_budget import (
    FROM_READINGS,
    scale_total,
    tilt_as_load,
    typical,
)
from truenewton.estimation.findings.thresholds import LIMITS
from truenewton.estimation.paper.identifiability import (
    NO_LOAD_SEEN,
    SIMILAR_LOADS_FRACTION,
    similar_loads,
)
from truenewton.rounding import percent, significant
from truenewton.statics.arms import effective_weight

if TYPE_CHECKING:
    from truenewton.calibration.result import Calibration

NO_ERROR = 1e-6  # of the common scale: below, nobody knows a weight so well
WEIGHED = (ErrorKind.MIRROR, ErrorKind.TOOL, ErrorKind.ADDED)  # errors that a better balance lowers
GRAVITY = 9.81  # [m/s^2]
FORCE_IN = "correct the unit that the column FORCE declares, or convert its values to N"
WEIGHTS_IN = f"store WEIGHT and ADDED in N: {-GRAVITY} for a kilogram"


class Mistake(NamedTuple):
    """A keyword or unit that is not what the file contract says.

    Attributes
    ----------
    factor
        What it makes of an alpha of 1.
    said, remedy
        How it looks; what to do.
    """

    factor: float
    said: str
    remedy: str


POUND = 4.4482216  # [N], of force
MISTAKES = (
    Mistake(1e-6, "FORCE looks as if in uN", FORCE_IN),
    Mistake(1e-3, "FORCE looks as if in mN", FORCE_IN),
    Mistake(1e-3 * GRAVITY, "FORCE looks as if in gf (grams)", FORCE_IN),
    Mistake(POUND, "FORCE looks as if in lbf (pounds)", FORCE_IN),
    Mistake(GRAVITY, "FORCE looks as if in kgf (kilograms)", FORCE_IN),
    Mistake(1e3, "FORCE looks as if in kN", FORCE_IN),
    Mistake(1 / GRAVITY, "WEIGHT and ADDED look as if in kg", WEIGHTS_IN),
    Mistake(1 / POUND, "WEIGHT and ADDED look as if in lbf", WEIGHTS_IN),
    Mistake(1e3 / GRAVITY, "WEIGHT and ADDED look as if in g", WEIGHTS_IN),
    Mistake(1e3, "WEIGHT and ADDED look as if in mN", WEIGHTS_IN),
)
OTHER_UNIT = "FORCE looks as if in counts or volts of the electronics, or in another unit than N"
ONE_LOAD_FROM_REST = "FORCE of one load counts from rest or belongs to another load"
NEAR_ONE = (0.6, 1.6)  # the typical alpha of mirrors, which a single mistake is to bring back
LIKE_OTHERS, MOST = 0.5, 0.9  # relative to the median, of how many: else it is no unit alone


def unit_fault(c: Calibration) -> Finding | None:
    """Return that alpha is so far from 1 that a unit must be wrong, and which one it may be.

    Or that no load is seen: then alpha is large, but no more than noise.
    """
    median = float(np.nanmedian(c.alpha))
    if c.scale == Scale.WEIGHTS and typical(c.reading_error, c.alpha) > LIMITS.relative_error:
        return NO_LOAD_SEEN if abs(median) > LIMITS.highest_alpha else None
    alike = np.abs(c.alpha[c.layout.enabled] / median - 1.0) < LIKE_OTHERS
    if LIMITS.lowest_alpha < abs(median) < LIMITS.highest_alpha or np.mean(alike) < MOST:
        return None
    fitting = [
        each
        for each in (*_added_with_weight(c), *MISTAKES)
        if NEAR_ONE[0] < abs(median) / each.factor < NEAR_ONE[1]
    ]
    looks = ", or ".join(each.said for each in fitting) or OTHER_UNIT
    remedy = "; or ".join(dict.fromkeys(each.remedy for each in fitting)) or FORCE_IN
    looks += ", and FORCE of the other sign" if median < 0.0 else ""
    if c.scale == Scale.WEIGHTS:
        looks += f", or {ONE_LOAD_FROM_REST}"
    return Finding.of(
        Code.ALPHA_FAR_FROM_ONE, alpha=significant(median), looks=looks, remedy=remedy
    )


def _added_with_weight(c: Calibration) -> Iterator[Mistake]:
    """Yield that ADDED includes the weight of the mirror: the load seems heavier by it."""
    added = min((load.added for load in c.loads), default=0.0)
    alone = added - c.weight
    if alone < 0.0:
        yield Mistake(
            added / alone,
            "ADDED looks as if the weight of the mirror were in it",
            f"store what was added alone, {significant(alone, 3)} N",
        )


def scale_faults(c: Calibration) -> Iterator[Finding]:
    """Yield that the weights limit the common scale, or are given without their errors."""
    if c.scale == Scale.MEAN_ONE:
        return
    weights, readings = typical(c.systematic_error, c.alpha), typical(c.reading_error, c.alpha)
    if c.scale == Scale.WEIGHTS:
        alike = similar_loads(weights_along_axis(c))
        if alike and typical(c.error, c.alpha) > SIMILAR_LOADS_FRACTION:
            yield alike
        exact = [f"'{load.name}'" for load in c.loads if load.added and not load.added_error]
        if exact or weights < NO_ERROR:
            which = f" (E_ADDED of {' and '.join(exact)} is 0)" if exact else ""
            yield Finding.of(Code.WEIGHTS_WITHOUT_ERRORS, which=which)
    if weights > LIMITS.scale_share * readings:
        limit = scale_limit(c)
        yield limit or Finding.of(Code.SCALE_BY_WEIGHTS, error=weights, share="")


def weights_along_axis(c: Calibration) -> Array:
    """Return (L,) weights of mirror and load along the axis [N]."""
    return effective_weight(c.weight, [q.added for q in c.loads], [q.tilt for q in c.loads])


def scale_limit(c: Calibration) -> Finding | None:
    """Return what limits the common scale and what would help; None where the weights do not."""
    if not c.scale_errors or c.scale_errors[0].source == FROM_READINGS:
        return None
    total, largest = scale_total(c.scale_errors), c.scale_errors[0]
    share = "nearly all of it" if largest.relative > 0.9 * total else "most of it"
    remedies = []
    heaviest = max(c.loads, key=lambda load: load.added_error)
    if largest.source.kind in WEIGHED and heaviest.added_error:
        better = np.sqrt(total**2 - 0.99 * largest.relative**2)
        finer = 1e3 * heaviest.added_error / 10
        remedies.append(f"weigh it to {finer:.2g} mN and it falls to {percent(better)}")
    if not any(load.tilt for load in c.loads):
        tilted = tilt_as_load(c.weight, c.weight_error, 60.0, 0.1)
        if tilted < total:
            remedies.append(f"a 60 degree tilt known to 0.1 degree gives {percent(tilted)}")
    return Finding.of(
        Code.SCALE_BY_WEIGHTS,
        error=total,
        share=f", {share} from the {largest.source}",
        remedy="; ".join(remedies),
    )
