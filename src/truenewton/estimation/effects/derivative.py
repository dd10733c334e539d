"""What an effect is: how readings, the load or the arms change with it, and what follows of that.

With theta the parameters of an effect and g = dc/dtheta what it does to readings at fixed true
forces, the balance of pooled rows (`pooling`) and what they leave of the means change by

    J = -A diag(alpha) U' r g,        g_R = g - U U' r g,

an effect on the load or on the arms gives J alone. With rho and S of the fit, s^2 the noise of a
reading, e the unknowns of the fit and H, D as in `likelihood`:

    score          U_t = sum J' S^-1 rho - sum r g_R (c - U y) / s^2
    information    M_tt = sum J' S^-1 J + sum r g_R^2 / s^2,      M_te = sum J' S^-1 J_e
    at the fit     B = (M_te - D_te) H^-1,      V = M_tt - M_te B' - B M_et + B M B'

V is the covariance of U_t, and alpha and the rest move by -B' theta.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from truenewton.arrays import Array
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.moments import Moments, WithinGroups
from truenewton.estimation.problem import Problem

Removal = Callable[[Problem, Moments, Array], tuple[Problem, Moments]]


@dataclass(frozen=True, eq=False)
class Derivative:
    """What k parameters of an effect do at a fit.

    Attributes
    ----------
    jacobian
        (R, 3, k) J.
    remove
        Takes an effect of (k,) parameters out of the data.
    score, information
        (k,) and (k, k) of what pooled rows leave, structure; 0 where an effect says nothing of it.
    feigned, feigned_information
        (k, n) D_te on alpha and (k, k) D_tt; 0 where noise of the fitted readings feigns nothing.
    """

    jacobian: Array
    remove: Removal
    score: Array | float = 0.0
    information: Array | float = 0.0
    feigned: Array | float = 0.0
    feigned_information: Array | float = 0.0


@dataclass(frozen=True, eq=False)
class Scored:
    """Score and information of an effect at a fit; k parameters, `free` unknowns of the fit.

    Attributes
    ----------
    score, variance
        (k,) U_t and (k, k) V.
    moves
        (k, free) B.
    information
        (k, k) H_tt - H_te H^-1 H_et: what the data say of the effect, all else being free.
    whole
        (k,) diagonal of M_tt: what they would say, were all else known.
    """

    score: Array
    variance: Array
    moves: Array
    information: Array
    whole: Array


def scored(fit: FittedRows, derivative: Derivative) -> Scored:
    """Return score and information of an effect."""
    n, k = fit.problem.n, derivative.jacobian.shape[2]
    white = np.einsum("ab,rbk->rak", fit.root, derivative.jacobian, optimize=True).reshape(-1, k)
    whole = white.T @ white + derivative.information
    cross = white.T @ fit.white_jacobian  # M_te
    told = cross.copy()
    told[:, :n] -= derivative.feigned
    moves = fit.solved(told)
    # M = H + D of the fit: B M B' = (M_te - D_te) B' + B D B'.
    by_noise = fit.minimum.noise_information @ moves[:, :n].T
    both = cross @ moves.T
    variance = whole - both - both.T + told @ moves.T + moves[:, :n] @ by_noise
    return Scored(
        score=white.T @ fit.white_rho + derivative.score,
        variance=0.5 * (variance + variance.T),
        moves=moves,
        information=whole - derivative.feigned_information - told @ moves.T,
        whole=np.diag(whole).copy(),
    )


@dataclass(frozen=True, eq=False)
class RowFunctions:
    """K functions h of a row, on which an effect on readings depends.

    Attributes
    ----------
    first, second
        (K, g) weighted sums of h and h^2 over the rows of each group.
    chosen
        Which they are of the functions of `moments.WithinGroups`; None where h is the same for all
        rows of a group.
    """

    first: Array
    second: Array
    chosen: slice | None = None


def of_groups(moments: Moments, h: Array) -> RowFunctions:
    """Return (K, g) functions that are the same for all rows of a group."""
    return RowFunctions(h * moments.weight, h**2 * moments.weight)


def of_rows(moments: Moments, within: WithinGroups, chosen: slice) -> RowFunctions:
    """Return some of the functions by which rows of one group differ."""
    counted = moments.weight > 0
    return RowFunctions(within.first[chosen] * counted, within.second[chosen] * counted, chosen)


def on_readings(
    fit: FittedRows, rows: RowFunctions, field: Array, *, each: bool, gain: bool = False
) -> Derivative:
    """Return the derivative of an effect on readings, g = h(row) e(group, actuator).

    Between groups e is taken at the fit; within them, where a gain changes, it is -c_mean.

    Parameters
    ----------
    fit, rows
        The fit; h.
    field
        (g, n) e.
    each
        Whether every actuator has its own parameter, in the order (K, n), or all share one.
    gain
        Whether e is -c^, which noise reaches; else 1 where rows of one group differ.
    """
    moments, noise, n = fit.moments, fit.problem.noise.variance, fit.problem.n
    pooling, k = moments.pooling, len(rows.first)
    weight = np.where(moments.weight > 0, moments.weight, 1.0)
    mean = rows.first / weight
    by_actuator = np.empty((len(fit.rows), k, n))
    for index, h in enumerate(mean):
        by_actuator[:, index] = pooling.rows(h[:, None] * field)
    score, information = np.zeros((k, n)), np.zeros((k, k, n))
    if fit.independent:
        score -= rows.first @ (field * fit.apart) / noise
        information -= np.einsum("rki,rli->kli", by_actuator, by_actuator, optimize=True) / noise
        information += _between(rows.first, mean, field) / noise
        if rows.chosen is not None and moments.within is not None:
            own, sums = _own(moments.within, gain=gain)
            score -= sums[rows.chosen] / noise
            for index in range(k):
                products = moments.within.products(range(*rows.chosen.indices(10**9))[index])
                spread = products[rows.chosen] * (moments.weight > 0) - mean * rows.first[index]
                information[index] += spread @ own**2 / noise
        else:
            spread = rows.second - rows.first * mean
            information[np.arange(k), np.arange(k)] += spread @ field**2 / noise
    feigned = np.zeros((k, n, n))
    if gain:
        trace = rows.first @ pooling.squared_lengths
        gram = fit.problem.a.T @ fit.root.T @ fit.root @ fit.problem.a
        feigned = trace[:, None, None] * (fit.alpha[:, None] * gram * fit.noise_covariance)

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        size = theta.reshape(k, n) if each else np.repeat(theta[:, None], n, axis=1)
        return problem, _without(before, rows, field, size, gain=gain)

    if each:
        jacobian = -fit.scaled_arms[:, None, :] * by_actuator[:, None]
        whole = np.zeros((k, n, k, n))
        whole[:, np.arange(n), :, np.arange(n)] = np.moveaxis(information, 2, 0)
        return Derivative(
            jacobian.reshape(len(fit.rows), 3, k * n),
            remove,
            score.ravel(),
            whole.reshape(k * n, k * n),
            feigned.reshape(k * n, n),
        )
    jacobian = -np.einsum("ai,rki->rak", fit.scaled_arms, by_actuator, optimize=True)
    return Derivative(
        jacobian, remove, score.sum(axis=1), information.sum(axis=2), feigned.sum(axis=1)
    )


def without_direction(derivative: Derivative, direction: Array) -> Derivative:
    """Return an effect whose (K, n) parameters do nothing along one (n,) direction."""
    n, unit = len(direction), direction / np.linalg.norm(direction)

    def left(values: Array) -> Array:
        each = values.reshape(*values.shape[:-1], -1, n)
        return np.asarray((each - (each @ unit)[..., None] * unit).reshape(values.shape))

    def both(values: Array | float) -> Array | float:
        return values if isinstance(values, float) else left(left(values).T)

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        return derivative.remove(problem, before, left(theta))

    score, feigned = derivative.score, derivative.feigned
    return Derivative(
        left(derivative.jacobian),
        remove,
        score if isinstance(score, float) else left(score),
        both(derivative.information),
        feigned if isinstance(feigned, float) else left(feigned.T).T,
        both(derivative.feigned_information),
    )


def _between(first: Array, mean: Array, field: Array) -> Array:
    """Return (K, K, n) sums over groups of r h h' e^2, with h the means of groups."""
    square = field**2
    return np.stack([(mean * one) @ square for one in first])


def _own(within: WithinGroups, *, gain: bool) -> tuple[Array | float, Array]:
    """Return e as the rows of a group have it, and the (K, n) weighted sums of h (c - c_mean) e."""
    return (-within.mean, -within.gain) if gain else (np.ones_like(within.mean), within.zero)


def _without(
    moments: Moments, rows: RowFunctions, field: Array, size: Array, *, gain: bool
) -> Moments:
    """Return moments without an effect on readings of (K, n) sizes."""
    counted = moments.weight > 0
    total = np.where(counted, moments.weight, 1.0)[:, None]
    shift = (rows.first.T @ size) / total
    mean, within = moments.mean - shift * field, moments.within
    if rows.chosen is None or within is None:
        return replace(moments, mean=mean)
    own, sums = _own(within, gain=gain)
    sizes = np.zeros((len(within.first), size.shape[1]))
    sizes[rows.chosen] = size
    scatter = moments.scatter - 2.0 * np.sum(size * sums[rows.chosen], axis=0)
    zeros, gains = within.zero.copy(), within.gain.copy()
    for index, first in enumerate(within.first):
        together = within.products(index) * counted
        apart = (together.T @ sizes - (first * counted)[:, None] * shift) * own
        zeros[index] -= apart.sum(axis=0)
        gains[index] -= np.sum(apart * within.mean, axis=0)
        scatter += sizes[index] * np.sum(apart * own, axis=0)
    within = replace(within, zero=zeros, gain=gains)
    return replace(moments, mean=mean, scatter=np.maximum(scatter, 0.0), within=within)
