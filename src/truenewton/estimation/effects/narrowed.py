"""Effects on readings with fewer parameters: of single actuators, or counted from their mean.

A driver fails, a coil loses turns: actuator by actuator, what pooled rows leave of the readings
tells, by U_t' M_tt^-1 U_t of its parameters, chi^2 (`score_test`). Those that stand out have
parameters, the others none, so that alpha is no less sure for what might have happened to them.
"""

from __future__ import annotations

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.effects.derivative import Derivative, OnReadings
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.moments import Moments
from truenewton.estimation.multiple_tests import OF_EACH_KIND
from truenewton.estimation.problem import Problem

SELDOM = 1e-2 * OF_EACH_KIND  # that any actuator of a sound mirror is chosen
FEW = 0.1  # of the actuators: beyond it is no matter of single ones
HELD = 1e-4  # of the largest information: directions that the data hold


def of_single(fit: FittedRows, effect: OnReadings) -> Derivative | None:
    """Return the derivative of an effect with parameters of the actuators that stand out alone.

    In the order (K, chosen); None where there is no such actuator, or many.
    """
    chosen, n = fit.struck, fit.problem.n
    if chosen is None:
        chosen = standing_out(effect.score, effect.information)
        if not 0 < chosen.size <= max(1, FEW * n):
            return None
    count, k, _ = effect.rows.shape

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        size = np.zeros((k, n))
        size[:, chosen] = theta.reshape(k, -1)
        return problem, effect.remove(before, size)

    own = effect.information[:, :, chosen]
    information = np.zeros((k, chosen.size, k, chosen.size))
    at = np.arange(chosen.size)
    information[:, at, :, at] = np.moveaxis(own, 2, 0)
    feigned = effect.feigned
    return Derivative(
        remove,
        arms=-np.tile(fit.scaled_arms[:, chosen], k),
        rows=effect.rows[:, :, chosen].reshape(count, -1),
        score=effect.score[:, chosen].ravel(),
        information=information.reshape(k * chosen.size, -1),
        feigned=None if feigned is None else feigned[:, chosen].reshape(-1, n),
        actuators=chosen,
    )


def standing_out(score: Array, information: Array) -> NDArray[np.intp]:
    """Return the actuators whose (K, n) scores, of (K, K, n) information, chance does not make."""
    if not information.any():
        return np.empty(0, dtype=np.intp)
    values, vectors = np.linalg.eigh(np.moveaxis(information, 2, 0))
    held = values > HELD * values.max()
    along = np.einsum("nab,an->nb", vectors, score)
    chi2 = np.sum(np.where(held, along**2 / np.where(held, values, 1.0), 0.0), axis=1)
    chance = scipy.stats.chi2.sf(chi2, np.count_nonzero(held, axis=1))
    return np.flatnonzero(chance < SELDOM / score.shape[1])


def about_mean(effect: OnReadings, weight: Array) -> OnReadings:
    """Return an effect whose (K,) functions count from their mean, of (K,) weights of theirs.

    So alpha stays that of the whole campaign, and none of its error is that of the mean.
    """
    k = len(weight)
    left = np.eye(k) - np.outer(np.ones(k), weight / weight.sum())  # of sizes

    def remove(before: Moments, size: Array) -> Moments:
        return effect.remove(before, left @ size)

    turned = np.einsum("kl,kmn->lmn", left, effect.information, optimize=True)
    return OnReadings(
        remove,
        np.einsum("rki,kl->rli", effect.rows, left, optimize=True),
        left.T @ effect.score,
        np.einsum("lmn,mo->lon", turned, left, optimize=True),
        None if effect.feigned is None else np.tensordot(left.T, effect.feigned, axes=1),
    )
