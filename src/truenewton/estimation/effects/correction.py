"""Effects that are taken out of the data, or that only the errors contain.

A force that comes and goes at one actuator (friction, dust in its gap, a cable that pulls) adds
a_i f_r to the imbalance of every row, a_i the arms of the actuator and f_r unknown. With
u_i = S^-1/2 a_i / |S^-1/2 a_i| the rows S^-1/2 rho have along u_i

    T_i = sum (u_i' S^-1/2 rho)^2,      R - u_i' (sum J H^-1 J') u_i  degrees of freedom,

J in terms of S^-1/2. If one stands out, S + tau^2 a_i a_i' replaces S, with tau^2 such that T_i is
as expected; so the other actuators are judged without this disturbance.

The parameters theta of an effect are unknowns with a normal prior about 0 of spread tau. At every
theta the data without the effect are fitted as usual (`Derivative.remove`), and theta takes a
Newton step with its score and information, all else being free. The data determine tau (MacKay
1992, Neural Computation 4, 415): with C the covariance of theta,

    tau^2 <- sum theta^2 / nu,        nu = sum (1 - C_ii / tau^2).

Under two loads the sums of the forces at rest are two equations for two unknowns, the common scale
and B, and no test is possible (docs/effects.md). An effect of parameters theta, of usual size s,
moves alpha by -B' theta, and the common scale by -(B v)' theta, with v the direction of a common
factor and B as of any effect (`derivative`). The information in the data reduces this to

    (B v)' C (B v),        C = (H_tt - H_te H^-1 H_et + 1 / s^2)^-1,

which is negligible if they determine the effect, as three loads do. Magnets whose positions have a
declared uncertainty (columns E_X and E_Y) add to the covariance in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.chance import OF_EACH_KIND, chance_of_any
from truenewton.errors import NotConverged, RankDeficient
from truenewton.estimation.effects.catalogue import (
    POSITIONS,
    Effect,
    on_balance,
    on_loads,
    parts_of_positions,
)
from truenewton.estimation.effects.derivative import FittedRows, log_chance, scored
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    NEGLIGIBLE_SCALE_ERROR,
    NoiseSource,
    UnseenError,
    bias_per_gain,
    weight_by_coil_shift,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.likelihood import Minimum
from truenewton.estimation.problem import Problem
from truenewton.estimation.readings.moments import Moments, reading_noise
from truenewton.linalg import inverse_of_positive
from truenewton.records.campaign import load_temperatures
from truenewton.statics.load import LIKELY_COIL_SHIFT, TYPICAL_GRADIENTS, leaning


@dataclass(frozen=True)
class UnknownForce:
    """An unknown force at one actuator."""

    # Index among the enabled, and ID
    index: int
    actuator: int
    log_probability: float  # logarithm of the probability that any actuator stands out so far
    size: float  # tau, rms force at one row of weight 1 [N]


def unknown_force(fit: FittedRows) -> UnknownForce | None:
    """Return the most significant unknown force; None if there is none."""
    pulled = fit.root @ fit.problem.a
    square = np.sum(pulled**2, axis=0)
    towards = pulled / np.sqrt(square)
    rows = fit.white_rho.reshape(-1, 3)
    statistic = np.sum((rows @ towards) ** 2, axis=0)
    solved = fit.half_solved(fit.white_jacobian)
    by_row = solved.T.reshape(len(rows), 3, -1)
    taken = np.einsum("rak,rbk->ab", by_row, by_row, optimize=True)
    freedom = np.maximum(len(rows) - np.einsum("an,ab,bn->n", towards, taken, towards), 1.0)
    chances = log_chance(statistic, freedom)
    worst = int(chances.argmin())
    chance = float(chances[worst])
    if chance_of_any(float(np.exp(chance)), len(chances)) >= OF_EACH_KIND:
        return None
    excess = float(statistic[worst] / freedom[worst]) - 1.0
    ids = fit.problem.campaign.layout.id[fit.problem.campaign.layout.enabled]
    return UnknownForce(
        worst,
        int(ids[worst]),
        chance + float(np.log(len(chances))),
        float(np.sqrt(max(excess, 0.0) / square[worst])),
    )


def disturbed(problem: Problem, force: UnknownForce) -> Problem:
    """Return the problem with an unknown force at an actuator."""
    arm = problem.a[:, force.index]
    added = force.size**2 * np.outer(arm, arm)
    return replace(problem, disturbance=problem.disturbance + added)


# -- an effect taken out ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Correction:
    """Data without an effect, and the fit to them."""

    # (k,) its parameters, their (k, k) covariance, and nu
    theta: Array
    covariance: Array
    effective_parameters: float
    # The data without it and their fit, whose covariance includes the error of the effect
    problem: Problem
    moments: Moments
    minimum: Minimum


def correction(fit: FittedRows, effect: Effect) -> Correction | None:
    """Estimate an effect together with alpha; None if it does not converge, or is too large."""
    first = effect.derivative(fit)
    # A matrix of 10,000 parameters takes 0.8 GB, and several are needed.
    if first is None or first.count > 10_000:
        return None
    result, theta = scored(fit, first), np.zeros(first.count)
    # A first spread from the score itself: U U' = V of the effect, on the average.
    size = np.trace(result.variance) / np.sum(result.variance**2)
    tau2 = float(max(np.sum(result.score**2) * size - 1.0, 1e-3)) * float(size)
    at, derivative, settled = fit, first, False
    for _ in range(30):
        information = result.information + np.eye(len(theta)) / tau2
        try:  # an effect without any size does not converge
            inverse = inverse_of_positive(0.5 * (information + information.T), overwrite=True)
        except np.linalg.LinAlgError:
            return None
        uphill = result.score + theta / tau2
        effective_parameters = float(np.sum(1.0 - np.diag(inverse) / tau2))
        # Theta has converged if its step is below 0.01 standard errors.
        if settled and float(uphill @ inverse @ uphill) < 1e-4:
            minimum = with_error(at.minimum, result.moves, inverse)
            return Correction(theta, inverse, effective_parameters, at.problem, at.moments, minimum)
        theta = theta - inverse @ uphill
        before, tau2 = tau2, max(float(theta @ theta) / max(effective_parameters, 1e-3), 1e-300)
        settled = abs(np.log(before / tau2)) < 1e-2
        problem, moments = derivative.remove(fit.problem, fit.moments, theta)
        problem = _with_new_noise(problem, moments)
        try:
            minimum = problem.fitted(moments, at.minimum.values)
        except (NotConverged, RankDeficient):
            return None
        removed = fit.removed + fit.moments.mean - moments.mean
        at = FittedRows(problem, moments, minimum, fit.independent, removed, first.actuators)
        again = effect.derivative(at)
        if again is None:
            return None
        derivative, result = again, scored(at, again)
    return None


def _with_new_noise(problem: Problem, moments: Moments) -> Problem:
    """Return the problem with the noise of repeats without the effect."""
    if problem.noise.source != NoiseSource.REPEATS:
        return problem
    noise = reading_noise(problem.campaign, moments)
    share, freedom = problem.noise.share, problem.noise.share_freedom
    return replace(problem, noise=replace(noise, share=share, share_freedom=freedom))


def with_error(minimum: Minimum, moves: Array, covariance: Array) -> Minimum:
    """Return a minimum with B' C B added to its covariance, (k, k) C and (k, free) B."""
    added = minimum.reading_covariance.copy()
    t = min(len(added), moves.shape[1])
    added[:t, :t] += moves[:, :t].T @ covariance @ moves[:, :t]
    return replace(minimum, reading_covariance=added)


# -- effects that the data cannot show -------------------------------------------------------------

MIN_REMAINING_SIZE = 0.1  # of the usual size, below which the data determine an effect


def supported(fit: FittedRows) -> Array:
    """Return a support of 5 mN of each load but the first, (g, 3, L - 1)."""
    return 5e-3 * on_loads(fit)


def zero_by_load(fit: FittedRows) -> Array:
    """Return a shift of the zero of all readings under each load but the first, (g, 3, L - 1)."""
    size = 0.1 * float(np.sqrt(fit.problem.noise.variance.mean() * fit.moments.typical_variance))
    moved = size * fit.scaled_arms.sum(axis=1)
    return np.asarray(moved[None, :, None] * fit.moments.of_load[:, None, 1:])


def warmer_magnets(fit: FittedRows) -> Array | None:
    """Return bias magnets, two each, 1 K warmer under each load but the first, (g, 3, L - 1)."""
    if np.isfinite(load_temperatures(fit.problem.campaign)).all():
        return None  # E_SYST has it
    return 2 * MAGNET_COEFFICIENT * fit.bias * on_loads(fit)


def shifted_coils(fit: FittedRows) -> Array | None:
    """Return coils that move by 5 um under each of K loads under which the mirror leans, (g, 3, K).

    Elastic forces would show it as a gain by load, but only POSITION tells that from larger shapes,
    and only gradients tell by how much bias magnets change.
    """
    campaign = fit.problem.campaign
    unknown = [
        lean and load.coil_shift is None and load.coil_shift_error is None
        for load, lean in zip(campaign.loads, leaning(campaign.loads), strict=True)
    ]
    measured = fit.moments.displacement is not None and fit.moments.pooled
    if not any(unknown) or (measured and bias_per_gain(campaign) is not None):
        return None
    change = weight_by_coil_shift(campaign, fit.bias)[unknown]
    return LIKELY_COIL_SHIFT * change * on_loads(fit, unknown)


# Each effect changes the balance of groups, (g, 3, K), by its usual size; None if the error budget
# contains it.
UNDETECTABLE_EFFECTS: dict[str, Callable[[FittedRows], Array | None]] = {
    "something else supports 5 mN of an added weight": supported,
    "all force zeros shift under one load by 10 % of the noise of a reading": zero_by_load,
    "the bias magnets are 1 K warmer under one load": warmer_magnets,
    "the coils move by 5 um when the mirror is tilted": shifted_coils,
}
STATIC_GAIN = "coil gains differ by 1 % between static and elastic forces"


def unseen_errors(fit: FittedRows) -> tuple[UnseenError, ...]:
    """Return the influence of undetectable effects on the common scale, the largest first."""
    moves = dict[str, tuple[Array, Array]]()  # B v and C B v
    # Of a relative change of all: alpha -> alpha (1 + e).
    direction = np.zeros((1, fit.free))
    direction[0, : fit.problem.n] = fit.alpha / (fit.alpha @ fit.alpha)
    half = fit.half_solved(direction)
    for name, change_at in UNDETECTABLE_EFFECTS.items():
        change = change_at(fit)
        if change is not None:
            result = scored(fit, on_balance(fit, change))
            along = (half.T @ result.half)[0]
            information = result.information + np.eye(len(along))  # in units of 1 / s^2
            try:
                moves[name] = along, scipy.linalg.solve(information, along, assume_a="pos")
            except np.linalg.LinAlgError:  # H_te H^-1 H_et exceeds H_tt by noise
                moves[name] = along, along
    moves[STATIC_GAIN] = moves_by_static_gain(fit, fit.solved(half)[:, 0])
    found = list[UnseenError]()
    for name, (along, left_open) in moves.items():
        moved = float(np.sqrt(along @ left_open))
        if moved > max(NEGLIGIBLE_SCALE_ERROR, MIN_REMAINING_SIZE * float(np.linalg.norm(along))):
            found.append(UnseenError(name, moved))
    return tuple(sorted(found, key=lambda error: -error.relative))


def moves_by_static_gain(fit: FittedRows, solved: Array) -> tuple[Array, Array]:
    """Return (n,) B v and C B v of coil gains that differ by 1 % from elastic forces to statics.

    ``solved`` is (free,) H^-1 v. Elastic forces of each coil change alike in all rows, as with its
    alpha: so C differs from 1 along few directions, and conjugate gradients need few steps.
    """
    share, fitted = fit.share, fit.fitted_rows
    statics = (share / (fit.moments.weight @ fit.moments.of_load)).T @ fitted
    rows, pulled = 0.01 * (share @ statics - fitted), fit.root @ fit.scaled_arms

    def on_gains(white: Array) -> Array:
        return np.asarray(np.sum(pulled.T * (rows.T @ white), axis=1))

    def inverse_of_c(theta: Array) -> Array:
        return theta + on_gains(fit.left_by_fit(rows @ (pulled * theta).T))

    along = on_gains(fit.white_change(solved))
    theta, rest = np.zeros_like(along), along.copy()
    direction, square = rest, float(rest @ rest)
    wanted = 1e-24 * square
    while square > wanted:
        changed = inverse_of_c(direction)
        curvature = float(direction @ changed)
        if curvature <= 0.0:  # D_tt exceeds M_tt
            return along, along
        theta += square / curvature * direction
        rest -= square / curvature * changed
        before, square = square, float(rest @ rest)
        direction = rest + square / before * direction
    return along, theta


def with_magnets_unsure(fit: FittedRows, effects: Sequence[Finding]) -> Minimum:
    """Return the minimum with the error that bias magnets have if coils lose force under a load.

    Coils that lose theta may be warmer by theta / `MAGNET_COEFFICIENT`. Then the bias magnets are
    warmer too, which only TEMPERATURE would show. If the mirror leans they have moved instead, and
    so have the bias magnets, which only COILGRAD and BIASGRAD show.
    """
    minimum = fit.minimum
    lost = [e for e in effects if e.code == Code.GAIN_BY_LOAD and e.corrected]
    loads, ratio = fit.problem.campaign.loads, bias_per_gain(fit.problem.campaign)
    if not lost:
        return minimum
    size, where = lost[0].size, [load.name == lost[0].where for load in loads]
    if not (leaning(loads) & where).any():
        change = warmer_magnets(fit)
        size /= MAGNET_COEFFICIENT
    else:
        coil, bias = TYPICAL_GRADIENTS
        change = fit.problem.n * bias / coil * on_loads(fit, where) if ratio is None else None
    if change is None:
        return minimum
    derivative = on_balance(fit, change)
    return with_error(minimum, scored(fit, derivative).moves, size**2 * np.eye(derivative.count))


def with_positions_unsure(fit: FittedRows, effects: Sequence[Finding]) -> Minimum:
    """Return the minimum with the declared uncertainty of positions in its covariance.

    If the data determine the positions, with their own estimate of the uncertainty instead.
    """
    layout = fit.problem.campaign.layout
    if layout.x_error is None and layout.y_error is None:
        return fit.minimum
    if any(effect.code == POSITIONS.code for effect in effects):
        return fit.minimum  # they are unknowns already
    taken_out = correction(fit, POSITIONS)
    if taken_out is not None:
        return taken_out.minimum
    errors = np.array(
        [
            np.zeros(fit.problem.n) if error is None else error[layout.enabled]
            for error in (layout.x_error, layout.y_error)
        ]
    )
    minimum, first = fit.minimum, 0
    for part in parts_of_positions(fit):  # B of all of them does not fit into memory
        those = errors[:, first : first + part.count // 2]
        first += part.count // 2
        minimum = with_error(minimum, scored(fit, part).moves, np.diag(those.ravel() ** 2))
    return minimum
