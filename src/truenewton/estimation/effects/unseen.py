"""What the data of a campaign cannot show, and what of its usual size would do to the common scale.

Under two loads the sums of the forces at rest are two equations for two unknowns, the common scale
and B: nothing is left over to test (docs/effects.md). So an effect of parameters theta, of usual
size s, moves alpha by -B' theta unseen, and the common scale by -(B v)' theta, with v its direction
and B as of any effect (`derivative`). What the data do tell of it leaves less of it,

    (B v)' C (B v),        C = (H_tt - H_te H^-1 H_et + 1 / s^2)^-1,

and nothing worth a line where they tell it well, as three loads do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.estimation.diagnosis import UnseenError
from truenewton.estimation.effects.catalogue import ONLY, on_balance
from truenewton.estimation.effects.derivative import Derivative, scored
from truenewton.estimation.effects.examined import Examined
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.effects.readings import (
    Field,
    RowFunctions,
    always,
    of_all,
    of_each,
    on_readings,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.minimum import Minimum
from truenewton.estimation.weights import MAGNETS, NEGLIGIBLE
from truenewton.records.campaign import load_temperatures

MOST_ACTUATORS = 2000  # whose coils are judged each by itself: beyond, there is no room for it
TOLD = 0.1  # of the usual size: what is left of an effect that the data tell


@dataclass(frozen=True)
class Unseen:
    """An effect that two loads do not show.

    Attributes
    ----------
    name
        What may be, in words, with its usual size.
    derivative
        Of a fit, by one usual size; None where the budget has it already.
    """

    name: str
    derivative: Callable[[FittedRows], Derivative | None]


def static_gain(fit: FittedRows) -> Derivative | None:
    """Let a coil's gain for elastic forces be another than for those at rest: g = -c^ + rest."""
    if fit.problem.n > MOST_ACTUATORS:
        return None
    moments = fit.moments
    of_load = moments.of_load * moments.weight[:, None]
    share = (of_load / of_load.sum(axis=0)).T

    def elastic(at: FittedRows, some: slice) -> Array:
        fitted = at.fitted(some)
        return np.asarray(0.01 * (moments.of_load @ (share @ fitted) - fitted))

    field = Field("elastic", elastic)
    return of_each(fit, on_readings(fit, always(moments), field, ONLY), ONLY)


def borne(fit: FittedRows) -> Derivative:
    """Let something else bear a part of each load but the first."""
    return on_balance(fit, 5e-3 * _up(fit))


def warmer_magnets(fit: FittedRows) -> Derivative | None:
    """Let the bias magnets, two each, be 1 K warmer under each load but the first."""
    if np.isfinite(load_temperatures(fit.problem.campaign)).all():
        return None  # E_SYST has it
    bias = float(fit.minimum.values[fit.problem.unknowns.bias])
    return on_balance(fit, 2 * MAGNETS * bias * _up(fit))


def with_magnets_unsure(left: Examined) -> Minimum:
    """Return the minimum, less sure by what the bias magnets lose if coils do by their warmth.

    Coils that lose theta under a load, where no TEMPERATURE is recorded, may be warmer by theta /
    `MAGNETS`; the bias magnets are so too, which nothing shows.
    """
    minimum = left.minimum
    lost = [e.size for e in left.effects if e.code == Code.GAIN_BY_LOAD and e.corrected]
    fit = FittedRows(left.problem, left.moments, minimum, independent=True)
    derivative = warmer_magnets(fit) if lost else None
    if derivative is None:
        return minimum
    moves = scored(fit, derivative).moves
    t = min(len(minimum.reading_covariance), moves.shape[1])
    covariance = minimum.reading_covariance.copy()
    covariance[:t, :t] += (lost[0] / MAGNETS) ** 2 * moves[:, :t].T @ moves[:, :t]
    return replace(minimum, reading_covariance=covariance)


def zero_by_load(fit: FittedRows) -> Derivative:
    """Move the zero of all readings under each load but the first."""
    size = 0.1 * float(np.sqrt(fit.problem.noise.variance.mean() * fit.moments.typical_variance))
    rows = RowFunctions((fit.moments.of_load * fit.moments.weight[:, None]).T[1:])
    field = Field("zero", lambda at, _: np.full((len(at.moments.mean), 1), size))
    return of_all(fit, on_readings(fit, rows, field), slice(0, len(rows.first)))


def _up(fit: FittedRows) -> Array:
    """(g, 3, L - 1) a force of 1 N in the balance under each load but the first."""
    return np.eye(3)[None, :, :1] * fit.moments.of_load[:, None, 1:]


UNSEEN: tuple[Unseen, ...] = (
    Unseen("5 mN of an added weight rests on something else", borne),
    Unseen("all zeros shift by a tenth of a reading's noise under a load", zero_by_load),
    Unseen("the bias magnets are 1 K warmer under a load", warmer_magnets),
    Unseen("coil gains differ by 1 % between static and elastic forces", static_gain),
)


def unseen_errors(left: Examined) -> tuple[UnseenError, ...]:
    """Return what the data cannot show would do to the common scale, the largest first."""
    found = sorted(_unseen(left), key=lambda error: -error.relative)
    return tuple(found)


def _unseen(left: Examined) -> Iterator[UnseenError]:
    fit = FittedRows(left.problem, left.moments, left.minimum, independent=True)
    # Of a relative change of all: alpha -> alpha (1 + e).
    direction = fit.alpha / (fit.alpha @ fit.alpha)
    for effect in UNSEEN:
        derivative = effect.derivative(fit)
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
        if moved > max(NEGLIGIBLE, TOLD * float(np.linalg.norm(along))):
            yield UnseenError(effect.name, moved)
