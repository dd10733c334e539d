"""What the data of a campaign cannot show, and what of its usual size would do to the common scale.

Under two loads the sums of the forces at rest are two equations for two unknowns, the common scale
and B: nothing is left over to test (docs/effects.md). So an effect of parameters theta, of usual
size s, moves alpha by -B' theta unseen, and the common scale by -(B v)' theta, with v its direction
and B as of any effect (`derivative`). What the data do tell of it leaves less of it,

    (B v)' C (B v),        C = (H_tt - H_te H^-1 H_et + 1 / s^2)^-1,

and nothing worth a line where they tell it well, as three loads do. Magnets whose positions have a
declared uncertainty (columns E_X and E_Y) add to the covariance in the same way.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.effects.catalogue import POSITIONS, on_balance, parts_of_positions
from truenewton.estimation.effects.correction import correction, with_error
from truenewton.estimation.effects.derivative import Derivative, FittedRows, scored
from truenewton.estimation.effects.examination import ExaminedFit
from truenewton.estimation.effects.readings import (
    Field,
    Sizes,
    Some,
    derivative_of,
    field_sums,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    NEGLIGIBLE_SCALE_ERROR,
    UnseenError,
)
from truenewton.estimation.likelihood import Minimum
from truenewton.records.campaign import load_temperatures

# Whose coils are judged each by itself: beyond, there is no room for it.
MAX_ACTUATORS_BY_COIL = 2000
MIN_REMAINING_SIZE = 0.1  # of the usual size: what is left of an effect that the data tell


def static_gain(fit: FittedRows) -> Derivative | None:
    """Let a coil's gain for elastic forces be another than for those at rest: g = -c^ + rest."""
    if fit.problem.n > MAX_ACTUATORS_BY_COIL:
        return None
    moments = fit.moments
    of_load = moments.of_load * moments.weight[:, None]
    share = (of_load / of_load.sum(axis=0)).T

    def elastic(_: Some, fitted: Array) -> Array:
        return np.asarray(0.01 * (moments.of_load @ (share @ fitted) - fitted))

    sums = field_sums(fit, [Field(elastic, moments.weight[None], each=1)])
    return derivative_of(fit, sums[0], Sizes(each=True))


def borne(fit: FittedRows) -> Derivative:
    """Let something else bear a part of each load but the first."""
    return on_balance(fit, 5e-3 * _up(fit))


def warmer_magnets(fit: FittedRows) -> Derivative | None:
    """Let the bias magnets, two each, be 1 K warmer under each load but the first."""
    if np.isfinite(load_temperatures(fit.problem.campaign)).all():
        return None  # E_SYST has it
    bias = float(fit.minimum.values[fit.problem.unknowns.bias])
    return on_balance(fit, 2 * MAGNET_COEFFICIENT * bias * _up(fit))


def with_magnets_unsure(left: ExaminedFit) -> Minimum:
    """Return the minimum, less sure by what the bias magnets lose if coils do by their warmth.

    Coils that lose theta under a load, where no TEMPERATURE is recorded, may be warmer by theta /
    `MAGNET_COEFFICIENT`; the bias magnets are so too, which nothing shows.
    """
    minimum = left.minimum
    lost = [e.size for e in left.effects if e.code == Code.GAIN_BY_LOAD and e.corrected]
    derivative = warmer_magnets(left.rows) if lost else None
    if derivative is None:
        return minimum
    warmer = (lost[0] / MAGNET_COEFFICIENT) ** 2 * np.eye(derivative.count)
    return with_error(minimum, scored(left.rows, derivative).moves, warmer)


def zero_by_load(fit: FittedRows) -> Derivative:
    """Move the zero of all readings under each load but the first."""
    size = 0.1 * float(np.sqrt(fit.problem.noise.variance.mean() * fit.moments.typical_variance))
    rows = (fit.moments.of_load * fit.moments.weight[:, None]).T[1:]
    field = Field(lambda *_: np.full((len(fit.moments.mean), 1), size), rows)
    return derivative_of(fit, field_sums(fit, [field])[0], Sizes(slice(0, len(rows))))


def _up(fit: FittedRows) -> Array:
    """(g, 3, L - 1) a force of 1 N in the balance under each load but the first."""
    return np.eye(3)[None, :, :1] * fit.moments.of_load[:, None, 1:]


# What may be, in words, with its usual size; the derivative by that, None where the budget has it.
UNDETECTABLE_EFFECTS: dict[str, Callable[[FittedRows], Derivative | None]] = {
    "5 mN of an added weight rests on something else": borne,
    "all zeros shift by a tenth of a reading's noise under a load": zero_by_load,
    "the bias magnets are 1 K warmer under a load": warmer_magnets,
    "coil gains differ by 1 % between static and elastic forces": static_gain,
}


def unseen_errors(left: ExaminedFit) -> tuple[UnseenError, ...]:
    """Return what the data cannot show would do to the common scale, the largest first."""
    found = list[UnseenError]()
    fit = left.rows
    # Of a relative change of all: alpha -> alpha (1 + e).
    direction = fit.alpha / (fit.alpha @ fit.alpha)
    for name, derivative_at in UNDETECTABLE_EFFECTS.items():
        derivative = derivative_at(fit)
        if derivative is None:
            continue
        result = scored(fit, derivative)
        along = result.moves_along(direction)
        told = result.information + np.eye(len(along))  # in units of 1 / s^2
        try:
            left_open = scipy.linalg.solve(told, along, assume_a="pos")
        except np.linalg.LinAlgError:  # noise feigns less than nothing
            left_open = along
        moved = float(np.sqrt(along @ left_open))
        if moved > max(NEGLIGIBLE_SCALE_ERROR, MIN_REMAINING_SIZE * float(np.linalg.norm(along))):
            found.append(UnseenError(name, moved))
    return tuple(sorted(found, key=lambda error: -error.relative))


def with_positions_unsure(left: ExaminedFit) -> Minimum:
    """Return the minimum of an examined fit with what unsure positions add to its covariance.

    Nothing where no uncertainty of theirs is declared. How far magnets stand off the data say
    themselves where they can; else as far as is declared.
    """
    layout = left.problem.campaign.layout
    if layout.x_error is None and layout.y_error is None:
        return left.minimum
    if any(effect.code == POSITIONS.code for effect in left.effects):
        return left.minimum  # they are unknowns already
    fit = left.rows
    taken_out = correction(fit, POSITIONS)
    if taken_out is not None:
        return taken_out.minimum
    errors = np.array(
        [
            np.zeros(fit.problem.n) if error is None else error[layout.enabled]
            for error in (layout.x_error, layout.y_error)
        ]
    )
    minimum, first = left.minimum, 0
    for part in parts_of_positions(fit):  # what all of them move does not fit into one array
        those = errors[:, first : first + part.count // 2]
        first += part.count // 2
        minimum = with_error(minimum, scored(fit, part).moves, np.diag(those.ravel() ** 2))
    return minimum
