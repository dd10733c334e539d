"""Score and information of the unknowns, as sums of Hadamard products.

The derivative of T = W'F with respect to each unknown has rank one, dT = p q':

    log alpha_i    p = W'e_i            q = F^'e_i
    log g_j        p = (D_g V)'e_j      q = F^'H e_j
    delta_j        p = (G D_g V)'e_j    q = F^'H e_j

with the likeliest forces F^ in place of F: by the envelope theorem that is the score of the
likelihood from which the unknown stiffness is eliminated, and noise does not meet noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.reciprocity.blocks import Likeliest, Residuals
from truenewton.estimation.reciprocity.sight import Sight
from truenewton.estimation.reciprocity.states import States, Weights
from truenewton.estimation.reciprocity.unknowns import OFFSETS, Kind, Values

ROWS = 64  # of actuators at once, so that what is made of them stays in the cache


@dataclass(frozen=True, eq=False)
class Design:
    """What one kind of unknowns does.

    Attributes
    ----------
    p, q
        (m, n) dT = p_j q_j' for unknown j.
    rigid
        (n, 3) c: dt = by_reading_j c_j' for unknown j; None where t does not feel it.
    """

    p: Array
    q: Array
    rigid: Array | None = None


@dataclass(frozen=True, eq=False)
class Point:
    """All that is known at one place of the unknowns.

    Attributes
    ----------
    states, left, weights, fitted
        As their classes say.
    designs
        Of each kind of unknowns that is asked for.
    """

    states: States
    left: Residuals
    weights: Weights
    fitted: Likeliest
    designs: dict[Kind, Design]


def designs(
    kinds: tuple[Kind, ...],
    values: Values,
    seen: Sight,
    states: States,
    fitted: Likeliest,
    length: float,
) -> dict[Kind, Design]:
    """Return the design of each kind; ``length`` is that of `sight.Places`."""
    gain = values.gain
    made: dict[Kind, Design] = {}
    read = gain[:, None] * states.readings
    q = (seen.motion.T @ fitted.forces).T
    for kind in kinds:
        if kind == Kind.ALPHA:
            made[kind] = Design(states.displacements.T, fitted.forces.T)
        elif kind == Kind.GAIN:
            made[kind] = Design(read.T, q, -states.rigid_readings)
        elif seen.slopes is not None:
            axis = OFFSETS.index(kind)
            tilt = -np.outer(1.0 / (gain * length), states.turn[1 + axis])
            made[kind] = Design((seen.slopes[axis] @ read).T, q, tilt)
    return made


def score(point: Point) -> Array:
    """Return (u,) the gradient of half the sum of squares."""
    states, left, weights = point.states, point.left, point.weights
    pull = weights.of_pairs * left.reciprocity
    by_rigid = point.fitted.by_reading @ (weights.rigid * left.rigid)
    parts = []
    for kind, design in point.designs.items():
        part = np.sum(design.p * (pull @ design.q), axis=0)
        if kind == Kind.ALPHA:
            on = (weights.statics * left.statics) @ point.fitted.forces.T
            part += np.sum(states.rigid * on.T, axis=1)
        if design.rigid is not None:
            part += np.sum(by_rigid * design.rigid, axis=1)
        parts.append(part)
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Leverage:
    """How much of each block of residuals a fit takes up: sums of leverages.

    Attributes
    ----------
    statics, rigid
        (3, b), (b, 3).
    reciprocity
        (b, b) of unordered pairs of bins, in either place.
    """

    statics: Array
    rigid: Array
    reciprocity: Array


@dataclass(frozen=True, eq=False)
class Fitted:
    """The covariance of the unknowns with the weights that it comes from."""

    covariance: Array
    weights: Weights


def information(point: Point, before: Fitted | None = None) -> tuple[Array, Leverage | None]:
    """Return (u, u) the information, and the leverages of a fit before, if there was one."""
    kinds, n = list(point.designs), point.states.readings.shape[0]
    total = np.zeros((n * len(kinds), n * len(kinds)))
    bins = len(point.weights.bins)
    taken = Leverage(np.zeros((3, bins)), np.zeros((bins, 3)), np.zeros((bins, bins)))
    for i, one in enumerate(kinds):
        for j, other in enumerate(kinds[i:], i):
            rows, columns = slice(i * n, (i + 1) * n), slice(j * n, (j + 1) * n)
            part = None
            if before is not None:
                part = Fitted(before.covariance[rows, columns] * (1 + (i != j)), before.weights)
            block = total[rows, columns]
            _add_reciprocity(block, point, one, other, part, taken)
            if one == other == Kind.ALPHA:
                _add_statics(block, point, part, taken)
            _add_rigid(block, point, one, other, part, taken)
            total[columns, rows] = block.T
    return total, None if before is None else taken


def _add_reciprocity(
    block: Array, point: Point, one: Kind, other: Kind, before: Fitted | None, taken: Leverage
) -> None:
    """Add the (n, n) sum over pairs of bins of w [(P'p) o (Q'q) - (P'q) o (Q'p)]."""
    a, b, weights = point.designs[one], point.designs[other], point.weights
    w, bins = weights.reciprocity, len(weights.bins)
    for start in range(0, len(block), ROWS):
        some = slice(start, start + ROWS)
        pp, qq, pq, qp = (
            np.stack([left[k, some].T @ right[k] for k in weights.bins]).reshape(bins, -1)
            for left, right in ((a.p, b.p), (a.q, b.q), (a.p, b.q), (a.q, b.p))
        )
        both = np.einsum("ak,ak->k", pp, w @ qq) - np.einsum("ak,ak->k", pq, w @ qp)
        block[some] += both.reshape(-1, block.shape[1])
        if before is not None:
            c = before.covariance[some].ravel()
            each = before.weights.reciprocity * ((pp * c) @ qq.T - (pq * c) @ qp.T)
            each = each + each.T
            each[np.diag_indices(bins)] *= 0.5
            taken.reciprocity[:] += each


def _add_statics(block: Array, point: Point, before: Fitted | None, taken: Leverage) -> None:
    """Add the (n, n) sum over the three equations of (Q_r Q_r') o (F^ diag(w) F^')."""
    q, f, weights = point.states.rigid, point.fitted.forces, point.weights
    for r in range(3):
        block += np.outer(q[:, r], q[:, r]) * ((f * weights.statics[r]) @ f.T)
        if before is not None:
            scaled = q[:, r, None] * f
            each = np.sum(scaled * (before.covariance @ scaled), axis=0)
            taken.statics[r] += _by_bin(each * before.weights.statics[r], weights)


def _add_rigid(
    block: Array, point: Point, one: Kind, other: Kind, before: Fitted | None, taken: Leverage
) -> None:
    """Add the (n, n) sum over the three rigid motions of (c_r d_r') o (KV diag(w) KV')."""
    c, d = point.designs[one].rigid, point.designs[other].rigid
    kv, weights = point.fitted.by_reading, point.weights
    if c is None or d is None:
        return
    for r in range(3):
        block += np.outer(c[:, r], d[:, r]) * ((kv * weights.rigid[:, r]) @ kv.T)
        if before is not None:
            each = np.sum(c[:, r, None] * kv * (before.covariance @ (d[:, r, None] * kv)), axis=0)
            taken.rigid[:, r] += _by_bin(each * before.weights.rigid[:, r], weights)


def _by_bin(values: Array, weights: Weights) -> Array:
    """Return (b,) sums of (m,) values of the states over each bin."""
    return np.asarray(np.add.reduceat(values, [some.start for some in weights.bins]))
