"""Effects that the data of a campaign cannot show, and their influence on the common scale.

Under two loads the sums of the forces at rest are two equations for two unknowns, the common scale
and B, and no test is possible (docs/effects.md). An effect of parameters theta, of usual size s,
moves alpha by -B' theta, and the common scale by -(B v)' theta, with v the direction of a common
factor and B as of any effect (`derivative`). The information in the data reduces this to

    (B v)' C (B v),        C = (H_tt - H_te H^-1 H_et + 1 / s^2)^-1,

which is negligible if they determine the effect, as three loads do. Magnets whose positions have a
declared uncertainty (columns E_X and E_Y) add to the covariance in the same way.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.effects.catalogue import POSITIONS, on_balance, parts_of_positions
from truenewton.estimation.effects.derivative import Derivative, FittedRows, Some, scored
from truenewton.estimation.effects.examination import ExaminedFit, correction, with_error
from truenewton.estimation.effects.fields import Field, derivative_of, field_sums
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    NEGLIGIBLE_SCALE_ERROR,
    UnseenError,
)
from truenewton.estimation.likelihood import Minimum
from truenewton.records.campaign import load_temperatures

MIN_REMAINING_SIZE = 0.1  # of the usual size, below which the data determine an effect


def static_gain(fit: FittedRows) -> Derivative | None:
    """Return coil gains that differ by 1 % between elastic forces and those at rest."""
    if fit.problem.n > 2000:  # with a parameter of each coil, more do not fit into memory
        return None
    moments = fit.moments
    of_load = moments.of_load * moments.weight[:, None]
    share = (of_load / of_load.sum(axis=0)).T

    def elastic(_: Some, fitted: Array) -> Array:
        return np.asarray(0.01 * (moments.of_load @ (share @ fitted) - fitted))

    sums = field_sums(fit, [Field(elastic, moments.weight[None], each=1)])
    return derivative_of(fit, sums[0], each=True)


def supported(fit: FittedRows) -> Derivative:
    """Return a support of 5 mN of each load but the first."""
    return on_balance(fit, 5e-3 * _up(fit))


def warmer_magnets(fit: FittedRows) -> Derivative | None:
    """Return bias magnets, two each, that are 1 K warmer under each load but the first."""
    if np.isfinite(load_temperatures(fit.problem.campaign)).all():
        return None  # E_SYST has it
    bias = float(fit.minimum.values[fit.problem.unknowns.bias])
    return on_balance(fit, 2 * MAGNET_COEFFICIENT * bias * _up(fit))


def with_magnets_unsure(left: ExaminedFit) -> Minimum:
    """Return the minimum with the error that bias magnets have if coils lose force by warming.

    Coils that lose theta under a load may be warmer by theta / `MAGNET_COEFFICIENT`. Then the bias
    magnets are warmer too, which only TEMPERATURE would show.
    """
    minimum = left.minimum
    lost = [e.size for e in left.effects if e.code == Code.GAIN_BY_LOAD and e.corrected]
    derivative = warmer_magnets(left.rows) if lost else None
    if derivative is None:
        return minimum
    warmer = (lost[0] / MAGNET_COEFFICIENT) ** 2 * np.eye(derivative.count)
    return with_error(minimum, scored(left.rows, derivative).moves, warmer)


def zero_by_load(fit: FittedRows) -> Derivative:
    """Return a shift of the zero of all readings under each load but the first."""
    size = 0.1 * float(np.sqrt(fit.problem.noise.variance.mean() * fit.moments.typical_variance))
    rows = (fit.moments.of_load * fit.moments.weight[:, None]).T[1:]
    field = Field(lambda *_: np.full((len(fit.moments.mean), 1), size), rows)
    return derivative_of(fit, field_sums(fit, [field])[0], slice(0, len(rows)))


def _up(fit: FittedRows) -> Array:
    """(g, 3, L - 1) a force of 1 N in the balance under each load but the first."""
    return np.eye(3)[None, :, :1] * fit.moments.of_load[:, None, 1:]


# The derivative by each effect in units of its usual size; None if the error budget contains it.
UNDETECTABLE_EFFECTS: dict[str, Callable[[FittedRows], Derivative | None]] = {
    "5 mN of an added weight rests on something else": supported,
    "all force zeros shift under a load by 10 % of the noise of a reading": zero_by_load,
    "the bias magnets are 1 K warmer under a load": warmer_magnets,
    "coil gains differ by 1 % between static and elastic forces": static_gain,
}


def unseen_errors(left: ExaminedFit) -> tuple[UnseenError, ...]:
    """Return the influence of undetectable effects on the common scale, the largest first."""
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
        information = result.information + np.eye(len(along))  # in units of 1 / s^2
        try:
            left_open = scipy.linalg.solve(information, along, assume_a="pos")
        except np.linalg.LinAlgError:  # D_tt exceeds M_tt
            left_open = along
        moved = float(np.sqrt(along @ left_open))
        if moved > max(NEGLIGIBLE_SCALE_ERROR, MIN_REMAINING_SIZE * float(np.linalg.norm(along))):
            found.append(UnseenError(name, moved))
    return tuple(sorted(found, key=lambda error: -error.relative))


def with_positions_unsure(left: ExaminedFit) -> Minimum:
    """Return the minimum with the declared uncertainty of positions in its covariance.

    If the data determine the positions, with their own estimate of the uncertainty instead.
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
    for part in parts_of_positions(fit):  # B of all of them does not fit into memory
        those = errors[:, first : first + part.count // 2]
        first += part.count // 2
        minimum = with_error(minimum, scored(fit, part).moves, np.diag(those.ravel() ** 2))
    return minimum
