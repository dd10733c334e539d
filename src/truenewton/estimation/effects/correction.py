"""Effects that only the errors contain.

A force that comes and goes at one actuator (friction, dust in its gap, a cable that pulls) adds
a_i f_r to the imbalance of every row, a_i the arms of the actuator and f_r unknown. With
u_i = S^-1/2 a_i / |S^-1/2 a_i| the rows S^-1/2 rho have along u_i

    T_i = sum (u_i' S^-1/2 rho)^2,      R - u_i' (sum J H^-1 J') u_i  degrees of freedom,

J in terms of S^-1/2. If one stands out, S + tau^2 a_i a_i' replaces S, with tau^2 such that T_i is
as expected; so the other actuators are judged without this disturbance.

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
from truenewton.estimation.effects.catalogue import (
    POSITIONS,
    on_balance,
    on_loads,
    parts_of_positions,
)
from truenewton.estimation.effects.derivative import FittedRows, scored
from truenewton.estimation.effects.joint import correction
from truenewton.estimation.effects.score_test import log_chance
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import (
    MAGNET_COEFFICIENT,
    NEGLIGIBLE_SCALE_ERROR,
    UnseenError,
    bias_per_gain,
    weight_by_coil_shift,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.problem import Fitted, Problem
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


# -- effects that the data cannot show -------------------------------------------------------------

MISALIGNMENT = 1.0  # of a mirror that is tilted by hand, or by the angles of a telescope [deg]
MIN_REMAINING_SIZE = 0.1  # of the usual size, below which the data determine an effect


def supported(fit: FittedRows) -> Array | None:
    """Return a support of 5 mN of each added weight, (g, 3, K); under the first load there is none.

    Loads that differ by their tilt alone have no added weight that something else could support.
    """
    added = [k > 0 and bool(load.added) for k, load in enumerate(fit.problem.campaign.loads)]
    return 5e-3 * on_loads(fit, added) if any(added) else None


def misaligned_tilt(fit: FittedRows) -> Array | None:
    """Return a tilt that is wrong by 1 degree under each of K loads that lean, (g, 3, K).

    None if every E_TILT is at least as large: then E_SYST contains it.
    """
    loads = fit.problem.campaign.loads
    which = [
        bool(lean) and load.tilt_error < MISALIGNMENT
        for load, lean in zip(loads, leaning(loads), strict=True)
    ]
    if not any(which):
        return None
    sine = np.sin(np.radians([load.tilt for load in loads]))
    held = fit.problem.campaign.weight + np.array([load.added for load in loads])
    change = -held * sine * np.radians(MISALIGNMENT)
    return np.asarray(change[which] * on_loads(fit, which))


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
    "the tilt is wrong by 1 degree": misaligned_tilt,
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


def with_magnets_unsure(fit: FittedRows, effects: Sequence[Finding]) -> Fitted:
    """Return problem and fit with the error of bias magnets if coils lose force under a load.

    Coils that lose theta may be warmer by theta / `MAGNET_COEFFICIENT`. Then the bias magnets are
    warmer too, which only TEMPERATURE would show. If the mirror leans they have moved instead, and
    so have the bias magnets, which only COILGRAD and BIASGRAD show.
    """
    problem, minimum = fit.problem, fit.minimum
    lost = [e for e in effects if e.code == Code.GAIN_BY_LOAD and e.corrected]
    loads, ratio = problem.campaign.loads, bias_per_gain(problem.campaign)
    if not lost:
        return problem, minimum
    size, where = lost[0].size, [load.name == lost[0].where for load in loads]
    if not (leaning(loads) & where).any():
        change = warmer_magnets(fit)
        size /= MAGNET_COEFFICIENT
    else:
        coil, bias = TYPICAL_GRADIENTS
        change = problem.n * bias / coil * on_loads(fit, where) if ratio is None else None
    if change is None:
        return problem, minimum
    derivative = on_balance(fit, change)
    covariance = size**2 * np.eye(derivative.count)
    return problem.with_error(minimum, scored(fit, derivative).moves, covariance)


def with_positions_unsure(fit: FittedRows, effects: Sequence[Finding]) -> Fitted:
    """Return problem and fit with the declared uncertainty of positions in their covariance.

    If the data determine the positions, with their own estimate of the uncertainty instead.
    """
    problem, minimum = fit.problem, fit.minimum
    layout = problem.campaign.layout
    if layout.x_error is None and layout.y_error is None:
        return problem, minimum
    if any(effect.code == POSITIONS.code for effect in effects):
        return problem, minimum  # they are unknowns already
    taken_out = correction(fit, POSITIONS)
    if taken_out is not None:
        return taken_out.problem, taken_out.minimum
    errors = np.array(
        [
            np.zeros(problem.n) if error is None else error[layout.enabled]
            for error in (layout.x_error, layout.y_error)
        ]
    )
    first = 0
    for part in parts_of_positions(fit):  # B of all of them does not fit into memory
        those = errors[:, first : first + part.count // 2]
        first += part.count // 2
        covariance = np.diag(those.ravel() ** 2)
        problem, minimum = problem.with_error(minimum, scored(fit, part).moves, covariance)
    return problem, minimum
