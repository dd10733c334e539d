"""Effects on readings with fewer parameters: of single actuators, or counted from their mean.

A driver fails, a coil loses turns: actuator by actuator, what pooled rows leave of the readings
tells, by U_t' M_tt^-1 U_t of its parameters, chi^2 (`score_test`). Those that stand out have
parameters, the others none, so that alpha is no less sure for what might have happened to them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.chance import chi2_sf
from truenewton.estimation.effects.derivative import Derivative, OfEach
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.effects.readings import OnReadings, means, traces, without
from truenewton.estimation.moments import Moments
from truenewton.estimation.multiple_tests import OF_EACH_KIND
from truenewton.estimation.problem import Problem

SELDOM = 1e-2 * OF_EACH_KIND  # that any actuator of a sound mirror is chosen
FEW = 0.1  # of the actuators: beyond it is no matter of single ones
HELD = 1e-4  # of the largest information: directions that the data hold


def of_single(
    fit: FittedRows, effect: OnReadings, chosen: slice, weight: Array
) -> Derivative | None:
    """Return the derivative of an effect with parameters of the actuators that stand out alone.

    In the order (K, actuators), of some functions, which count from their mean (`about_mean`); None
    where there is no such actuator, or many.
    """
    n, left = fit.problem.n, _from_mean(weight)
    here = slice(chosen.start - effect.each.start, chosen.stop - effect.each.start)
    score = left.T @ effect.each_score[here]
    information = np.einsum("kl,kmn->lmn", left, effect.each_information[here, here], optimize=True)
    information = np.einsum("lmn,mo->lon", information, left, optimize=True)
    struck = fit.struck
    if struck is None:
        struck = standing_out(score, information)
        if not 0 < struck.size <= max(1, FEW * n):
            return None
    k, some = len(weight), struck
    h = left.T @ means(fit.moments, effect.functions)[chosen]
    values = effect.field.values(fit, slice(None))[:, some]
    rows = np.stack([fit.moments.pooling.weighed(one) @ values for one in h], axis=1)
    arms = fit.scaled_arms[:, some]
    pulled = fit.root @ arms
    pull = np.einsum("ra,rkc->akc", fit.white_rho.reshape(-1, 3), rows, optimize=True)

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        size = np.zeros((k, n))
        size[:, some] = left @ theta.reshape(k, -1)
        return problem, without(fit, before, effect, chosen, size)

    def feigns() -> tuple[Array, float]:
        gram = fit.white_arms[:, some].T @ fit.white_arms
        each = fit.alpha[some, None] * gram * fit.noise_covariance(some)
        trace = left.T @ traces(fit, effect)[chosen]
        return (trace[:, None, None] * each).reshape(-1, n), 0.0

    return Derivative(
        k * some.size,
        remove,
        of_each=OfEach(
            arms=-np.tile(arms, k),
            rows=lambda: rows.reshape(len(rows), -1),
            score=-np.sum(pulled[:, None] * pull, axis=0).ravel(),
            whole=(np.sum(pulled**2, axis=0) * np.sum(rows**2, axis=0)).ravel(),
        ),
        score=score[:, some].ravel(),
        information=information[:, :, some],
        feigns=feigns if effect.field.gain else None,
        actuators=some,
    )


def standing_out(score: Array, information: Array) -> NDArray[np.intp]:
    """Return the actuators whose (K, n) scores, of (K, K, n) information, chance does not make."""
    if not information.any():
        return np.empty(0, dtype=np.intp)
    values, vectors = np.linalg.eigh(np.moveaxis(information, 2, 0))
    held = values > HELD * values.max()
    along = np.einsum("nab,an->nb", vectors, score)
    chi2 = np.sum(np.where(held, along**2 / np.where(held, values, 1.0), 0.0), axis=1)
    chance = chi2_sf(chi2, np.count_nonzero(held, axis=1))
    return np.flatnonzero(chance < SELDOM / score.shape[1])


def about_mean(derivative: Derivative, weight: Array) -> Derivative:
    """Return an effect of all actuators whose (K,) parameters count from their weighed mean.

    So alpha stays that of the whole campaign, and none of its error is that of the mean.
    """
    left, feigns = _from_mean(weight), derivative.feigns
    assert derivative.jacobian is not None

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        return derivative.remove(problem, before, left @ theta)

    def turned() -> tuple[Array, Array | float]:
        assert feigns is not None
        on_alpha, own = feigns()
        return left.T @ on_alpha, own

    return Derivative(
        derivative.count,
        remove,
        jacobian=derivative.jacobian @ left,
        score=left.T @ derivative.score,
        information=left.T @ derivative.information @ left,
        feigns=turned if feigns else None,
    )


def _from_mean(weight: Array) -> Array:
    """Return (K, K) of sizes less their mean, of (K,) weights."""
    k = len(weight)
    return np.asarray(np.eye(k) - np.outer(np.ones(k), weight / weight.sum()))
