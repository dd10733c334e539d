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
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.moments import Moments, WithinGroups
from truenewton.estimation.problem import Problem

NO_NOISE = 1e-3  # share of D in terms of H, below which it is not worth its products

Removal = Callable[[Problem, Moments, Array], tuple[Problem, Moments]]


@dataclass(frozen=True, eq=False)
class Derivative:
    """What k parameters of an effect do at a fit.

    Attributes
    ----------
    remove
        Takes an effect of (k,) parameters out of the data.
    jacobian
        (R, 3, k) J; None where each actuator has parameters of its own.
    arms, rows
        (3, k) and (R, k), whose products by elements make J of these; (R, k / 2) where x and y
        have the same rows.
    score, information
        (k,) and (k, k) of what pooled rows leave, structure, 0 where an effect says nothing of it;
        where each actuator has K parameters (K, K, n), as those of different ones share nothing.
    feigned, feigned_information
        (k, n) D_te on alpha and (k, k) D_tt; None where noise of fitted readings feigns nothing.
    actuators
        Whose the parameters are, over and over; None where of all, or of none.
    """

    remove: Removal
    jacobian: Array | None = None
    arms: Array | None = None
    rows: Array | None = None
    score: Array | float = 0.0
    information: Array | float = 0.0
    feigned: Array | None = None
    feigned_information: Array | float = 0.0
    actuators: NDArray[np.intp] | None = None

    @property
    def count(self) -> int:
        """K."""
        parameters = self.jacobian if self.jacobian is not None else self.arms
        return 0 if parameters is None else int(parameters.shape[-1])


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
    information: Array
    whole: Array
    moved: Callable[[], Array]

    @cached_property
    def moves(self) -> Array:
        """(k, free) B."""
        return self.moved()


def scored(fit: FittedRows, derivative: Derivative) -> Scored:
    """Return score and information of an effect."""
    n = fit.problem.n
    score, whole, told = _from_balance(fit, derivative)
    whole += _of_all(derivative.information)
    if derivative.feigned is not None:
        told[:, :n] -= derivative.feigned  # M_te - D_te
    half = fit.half_solved(told)
    by_fit = half.T @ half
    result = Scored(
        score=score + derivative.score,
        variance=whole - by_fit,
        information=whole - derivative.feigned_information - by_fit,
        whole=np.diag(whole).copy(),
        moved=lambda: fit.solved_half(half),
    )
    # B M B' = (M_te - D_te) B' + B D B', as M = H + D at the fit.
    if fit.minimum.noise_share > NO_NOISE:
        on_alpha, noise = result.moves[:, :n], fit.minimum.noise_information
        less = on_alpha @ noise.root.T
        result.variance[:] += (on_alpha * noise.diagonal) @ on_alpha.T - less @ less.T
    if derivative.feigned is not None:
        both = derivative.feigned @ result.moves[:, :n].T
        result.variance[:] -= both + both.T
    return result


def _from_balance(fit: FittedRows, derivative: Derivative) -> tuple[Array, Array, Array]:
    """Return (k,) sum of J' S^-1 rho, (k, k) of J' S^-1 J, and (k, free) M_te."""
    if derivative.jacobian is not None:
        k = derivative.count
        white = np.einsum("ab,rbk->rak", fit.root, derivative.jacobian, optimize=True)
        white = white.reshape(-1, k)
        return white.T @ fit.white_rho, white.T @ white, white.T @ fit.white_jacobian
    arms, rows = derivative.arms, derivative.rows
    assert arms is not None and rows is not None  # noqa: PT018  # the one or the other
    pulled, times = fit.root @ arms, arms.shape[1] // rows.shape[1]
    n, white_rho = fit.problem.n, fit.white_rho.reshape(-1, 3)
    score = np.sum(pulled * np.tile(white_rho.T @ rows, times), axis=0)
    cross = np.empty((derivative.count, fit.free))
    fitted = np.tile(rows.T @ fit.fitted_rows, (times, 1))
    np.multiply(pulled.T @ fit.white_arms, fitted, out=cross[:, :n])
    share = np.tile(rows.T @ fit.share, (times, 1))
    cross[:, n:] = np.einsum("kl,ak,lau->ku", share, pulled, fit.white_beside, optimize=True)
    return score, (pulled.T @ pulled) * np.tile(rows.T @ rows, (times, times)), cross


def _of_all(information: Array | float) -> Array | float:
    """Return (k, k) information, spread out where it is that of each actuator by itself."""
    if isinstance(information, float) or information.ndim == 2:
        return information
    k, _, n = information.shape
    whole = np.zeros((k, n, k, n))
    whole[:, np.arange(n), :, np.arange(n)] = np.moveaxis(information, 2, 0)
    return whole.reshape(k * n, k * n)


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


@dataclass(frozen=True, eq=False)
class OnReadings:
    """What an effect on readings does, g = h(row) e(group, actuator), by actuator.

    Attributes
    ----------
    remove
        Takes the effect of (K, n) sizes out of moments.
    rows
        (R, K, n) U' r h e.
    score, information
        (K, n) and (K, K, n) of what pooled rows leave.
    feigned
        (K, n, n) D_te of each actuator on alpha; None where noise does not reach e.
    """

    remove: Callable[[Moments, Array], Moments]
    rows: Array
    score: Array
    information: Array
    feigned: Array | None


def on_readings(
    fit: FittedRows, functions: RowFunctions, field: Array, *, gain: bool = False
) -> OnReadings:
    """Return what an effect on readings does.

    Between groups e is taken at the fit; within them, where a gain changes, it is -c_mean.

    Parameters
    ----------
    fit, functions
        The fit; h.
    field
        (g, n) e.
    gain
        Whether e is -c^, which noise reaches; else 1 where rows of one group differ.
    """
    moments, noise, first = fit.moments, fit.problem.noise.variance, functions.first
    k, n, pooling = len(first), fit.problem.n, moments.pooling
    mean = first / np.where(moments.weight > 0, moments.weight, 1.0)
    rows = np.empty((len(fit.rows), k, n))
    for index, h in enumerate(mean):
        rows[:, index] = pooling.rows(field, h)
    score, information = np.zeros((k, n)), np.zeros((k, k, n))
    if fit.independent:
        square = field**2
        score -= first @ (field * fit.apart)
        information -= np.einsum("rki,rli->kli", rows, rows, optimize=True)
        information += np.stack([(mean * one) @ square for one in first])
        if functions.chosen is not None and moments.within is not None:
            own, sums = _own(moments.within, gain=gain)
            score -= sums[functions.chosen]
            square = np.square(own, out=square)
            for index in range(k):
                products = moments.within.products(range(*functions.chosen.indices(10**9))[index])
                apart = products[functions.chosen] * (moments.weight > 0) - mean * first[index]
                information[index] += apart @ square
        else:
            apart = functions.second - first * mean
            information[np.arange(k), np.arange(k)] += apart @ square
        score, information = score / noise, information / noise
    feigned = None
    if gain:
        trace = first @ pooling.squared_lengths
        gram = fit.white_arms.T @ fit.white_arms
        feigned = trace[:, None, None] * (fit.alpha[:, None] * gram * fit.noise_covariance)

    def remove(before: Moments, size: Array) -> Moments:
        return _without(before, functions, field, size, gain=gain)

    return OnReadings(remove, rows, score, information, feigned)


def of_each(fit: FittedRows, effect: OnReadings) -> Derivative:
    """Return the derivative of an effect with parameters of each actuator, in the order (K, n)."""
    count, k, n = effect.rows.shape

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        return problem, effect.remove(before, theta.reshape(k, n))

    return Derivative(
        remove,
        arms=-np.tile(fit.scaled_arms, k),
        rows=effect.rows.reshape(count, k * n),
        score=effect.score.ravel(),
        information=effect.information,
        feigned=None if effect.feigned is None else effect.feigned.reshape(k * n, n),
    )


def of_all(fit: FittedRows, effect: OnReadings) -> Derivative:
    """Return the derivative of an effect whose parameters all actuators share."""

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        return problem, effect.remove(before, np.repeat(theta[:, None], fit.problem.n, axis=1))

    return Derivative(
        remove,
        jacobian=-np.einsum("ai,rki->rak", fit.scaled_arms, effect.rows, optimize=True),
        score=effect.score.sum(axis=1),
        information=effect.information.sum(axis=2),
        feigned=None if effect.feigned is None else effect.feigned.sum(axis=1),
    )


def without_direction(derivative: Derivative, direction: Array) -> Derivative:
    """Return an effect whose (K, n) parameters do nothing along one (n,) direction."""
    arms, rows = derivative.arms, derivative.rows
    assert arms is not None and rows is not None  # noqa: PT018  # of each actuator
    n, unit = len(direction), direction / np.linalg.norm(direction)

    def left(values: Array) -> Array:
        each = values.reshape(*values.shape[:-1], -1, n)
        return np.asarray((each - (each @ unit)[..., None] * unit).reshape(values.shape))

    def remove(problem: Problem, before: Moments, theta: Array) -> tuple[Problem, Moments]:
        return derivative.remove(problem, before, left(theta))

    return Derivative(
        remove,
        jacobian=left(arms * rows[:, None]),
        score=left(np.zeros(derivative.count) + derivative.score),
        information=left(
            left(np.zeros((derivative.count,) * 2) + _of_all(derivative.information)).T
        ),
    )


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
