"""A force that comes and goes at one actuator: friction, dust in its gap, a cable that pulls.

At actuator i, of arms a_i, it adds a_i f_r to the imbalance of every row, f_r unknown. With
u_i = S^-1/2 a_i / |S^-1/2 a_i| the rows S^-1/2 rho have along u_i

    T_i = sum (u_i' S^-1/2 rho)^2,      R - u_i' (sum J H^-1 J') u_i  degrees of freedom,

J in terms of S^-1/2. Where one stands out, S + tau^2 a_i a_i' takes the place of S, with tau^2 such
that T_i is what chance lets expect; so the others are judged without what disturbs that one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.effects.score_test import log_chance
from truenewton.estimation.multiple_tests import OF_EACH_KIND, chance_of_any
from truenewton.estimation.problem import Problem


@dataclass(frozen=True)
class UnknownForce:
    """Where a force comes and goes.

    Attributes
    ----------
    index, actuator
        Among the enabled; its ID.
    log_probability
        Logarithm of the chance that any actuator stands out so far.
    size
        tau, root mean square force at one row of weight 1 [N].
    """

    index: int
    actuator: int
    log_probability: float
    size: float


def unknown_force(fit: FittedRows) -> UnknownForce | None:
    """Return the actuator at which an unknown force stands out; None if there is none."""
    pulled = fit.root @ fit.problem.a
    square = np.sum(pulled**2, axis=0)
    towards = pulled / np.sqrt(square)
    rows = fit.white_rho.reshape(-1, 3)
    statistic = np.sum((rows @ towards) ** 2, axis=0)
    solved = fit.half_solved(fit.white_jacobian)
    by_row = solved.T.reshape(len(rows), 3, -1)
    taken = np.einsum("rak,rbk->ab", by_row, by_row, optimize=True)
    freedom = np.maximum(len(rows) - np.einsum("an,ab,bn->n", towards, taken, towards), 1.0)
    chances = np.array([log_chance(*pair) for pair in zip(statistic, freedom, strict=True)])
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
