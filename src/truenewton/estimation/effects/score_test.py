"""Is an effect there? One score test for all of the catalogue.

With U_t and its covariance V of an effect at a fit without it (`derivative`): U' V^-1 U over the
directions that the data hold, chi^2 of as many degrees of freedom, for few parameters; for many
U' U, in units that make V's diagonal 1, against tr V chi^2(nu) / nu with nu = (tr V)^2 / tr V^2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special

from truenewton.estimation.effects.catalogue import CATALOGUE, Effect
from truenewton.estimation.effects.derivative import Derivative, scored, variance_at_least
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.multiple_tests import OF_EACH_KIND

FEW = 30  # parameters
MANY = 2  # parameters of each actuator, beyond which the structure alone tells
BLIND = 1e-6  # of the information that the data would hold, were all else known
# The same where readings share noise: c^ is uncorrelated with rho only where that is no noise of
# the readings, and what this adds to a score stands out in directions hardly seen.
DISTURBED = 1e-2


@dataclass(frozen=True, eq=False)
class EffectTest:
    """The test of one effect.

    Attributes
    ----------
    effect, derivative
        What was tested.
    statistic, degrees_of_freedom, log_probability
        A chi^2, its degrees of freedom, and the logarithm of the chance of a larger one.
    """

    effect: Effect
    derivative: Derivative
    statistic: float
    degrees_of_freedom: float
    log_probability: float


def tests(fit: FittedRows) -> list[EffectTest]:
    """Test the catalogue at a fit, the likeliest effect first; those that no data tell are left."""
    found = [_tested(fit, *pair) for pair in _derivatives(fit)]
    return sorted((test for test in found if test), key=lambda test: test.log_probability)


def named(fit: FittedRows) -> list[EffectTest]:
    """Return the effects that are there; of four hundred sound campaigns one is accused of one.

    Of effects with a parameter of each actuator tr V^2 is asked only where tr V leaves a doubt.
    """
    found, sound = [], 0
    for effect, derivative in _derivatives(fit):
        if surely_sound(fit, derivative):
            sound += 1
        elif test := _tested(fit, effect, derivative):
            found.append(test)
    return there(found, sound)


def there(found: Sequence[EffectTest], sound: int = 0) -> list[EffectTest]:
    """Return those that chance does not make, among so many sound ones, the likeliest first."""
    limit = np.log(-np.expm1(np.log1p(-OF_EACH_KIND) / max(len(found) + sound, 1)))
    chosen = [test for test in found if test.log_probability < limit]
    return sorted(chosen, key=lambda test: test.log_probability)


def _derivatives(fit: FittedRows) -> Iterator[tuple[Effect, Derivative]]:
    for effect in CATALOGUE:
        derivative = effect.derivative(fit)
        if derivative is not None and derivative.count:
            yield effect, derivative


def _blind(fit: FittedRows) -> float:
    return DISTURBED if np.any(fit.problem.disturbance) else BLIND


def surely_sound(fit: FittedRows, derivative: Derivative) -> bool:
    """Tell whether an effect of many parameters would not be named even if it alone were asked.

    With f = U' U / tr V the chance is that of chi^2(nu) > f nu. tr V is known, or more than taken
    for. nu lies between 1 and the number of parameters, and there the chance is least at either
    end: as nu grows it grows first, then falls.
    """
    k = derivative.count
    if not FEW < k <= MANY * fit.problem.n:
        return False
    at_least = variance_at_least(fit, derivative)
    if at_least is None:
        return False
    score, whole, variance = at_least
    if not (variance > _blind(fit) * whole).all():
        return False
    f = float(np.sum(score**2 / whole) / np.sum(variance / whole))
    least = min(log_chance(f * nu, nu) for nu in (1.0, float(k)))
    return least > float(np.log(OF_EACH_KIND))


def _tested(fit: FittedRows, effect: Effect, derivative: Derivative) -> EffectTest | None:
    """Test one effect; None where the data are blind to it."""
    if derivative.count > MANY * fit.problem.n:
        return _tested_by_structure(effect, derivative)
    result = scored(fit, derivative)
    blind = _blind(fit)
    seen = np.diag(result.variance) > blind * result.whole
    if not seen.any():
        return None
    unit = 1.0 / np.sqrt(result.whole[seen])
    u = result.score[seen] * unit
    v = result.variance[np.ix_(seen, seen)] * unit[:, None] * unit
    if len(u) <= FEW:
        values, vectors = np.linalg.eigh(v)
        held = values > max(1e2 * BLIND * values[-1], blind)
        if not held.any():
            return None
        statistic = float(np.sum((vectors[:, held].T @ u) ** 2 / values[held]))
        freedom = float(np.count_nonzero(held))
    else:
        scale = float(np.sum(v**2) / np.trace(v))
        statistic, freedom = float(u @ u) / scale, float(np.trace(v)) / scale
    return EffectTest(effect, derivative, statistic, freedom, log_chance(statistic, freedom))


def _tested_by_structure(effect: Effect, derivative: Derivative) -> EffectTest | None:
    """Test an effect of several parameters of each actuator by what pooled rows leave alone."""
    information, score = derivative.information, derivative.score
    if isinstance(information, float) or isinstance(score, float) or not information.any():
        return None
    blocks = np.moveaxis(information, 2, 0)
    values, vectors = np.linalg.eigh(blocks)
    held = values > 1e2 * BLIND * values.max()
    along = np.einsum("nab,an->nb", vectors, score.reshape(information.shape[1:]))
    statistic = float(np.sum(along[held] ** 2 / values[held]))
    freedom = float(np.count_nonzero(held))
    return EffectTest(effect, derivative, statistic, freedom, log_chance(statistic, freedom))


def log_chance(chi2: float, freedom: float) -> float:
    """Return the logarithm of the chance of a larger chi^2, however small it is."""
    chance = float(scipy.special.chdtrc(freedom, chi2))
    if chance > 0.0:
        return float(np.log(chance))
    half = 0.5 * freedom  # the first term of the incomplete Gamma function's expansion
    return float((half - 1.0) * np.log(0.5 * chi2) - 0.5 * chi2 - scipy.special.gammaln(half))
