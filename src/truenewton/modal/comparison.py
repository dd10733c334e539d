"""How two sets of modes differ: by what the first N of each span, and mode by mode.

The first N modes are what a loop with N modes corrects, so it is their span that counts: a pair of
equal stiffness may be turned within itself without any harm. Of two spans the angles between them
tell all (Bjorck and Golub, Math. Comp. 27, 1973); with C = V' W the matrix of overlaps, the mean
cos^2 over the N angles is the sum of squares of C's leading N x N block, divided by N, for all N by
one cumulative sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import svds

from truenewton.arrays import Array

NEAR_EQUAL = 0.01  # relative difference of stiffness, up to which two modes are a pair
ROUNDING = 1e-9  # of the stiffest, by which rigid motions may differ from 0
FEW = 200  # modes whose angles are all quickly found
MOST_ORDERS = 32  # at which the largest angle is taken; each is a decomposition


@dataclass(frozen=True, eq=False)
class ModesComparison:
    """Two sets of k modes, order by order.

    Attributes
    ----------
    overlap
        (k,) mean cos^2 of the N angles between the spans of the first N modes, N = 1..k.
    rms_angle
        (k,) [rad]; rms sine of these angles, from the part that leaks out, so that it is exact
        where it is small: sin^2 = 1 - cos^2.
    orders, largest_angle
        (q,) some N, all where k is at most `MOST_ORDERS`; largest of the angles there [rad].
    cuts
        (k,) true where mode N and N + 1 are of nearly the same stiffness, so that chance decides
        what the first N span; false where no stiffness is given.
    distance
        One number [rad]: rms of ``rms_angle`` over the orders N < n that cut no pair. 0 for equal
        modes; modes turned at random come near 1/2^1/2.
    """

    overlap: Array
    rms_angle: Array
    orders: NDArray[np.int64]
    largest_angle: Array
    cuts: NDArray[np.bool_]
    distance: float


def compare_modes(one: Array, other: Array, stiffness: Array | None = None) -> ModesComparison:
    """Compare two sets of k modes of n actuators, in their order.

    Parameters
    ----------
    one, other
        (n, k) one mode a column; where modes are not orthogonal, what each adds to the span of
        those before it counts.
    stiffness
        (k,) of the modes of one of them, best the truth: marks the orders that cut a pair.

    Raises
    ------
    ValueError
        Shapes that differ.
    """
    if one.shape != other.shape or one.ndim != 2 or one.shape[1] > one.shape[0]:
        raise ValueError(f"modes of shapes {one.shape} and {other.shape} cannot be compared")
    n, k = one.shape
    if stiffness is not None and np.shape(stiffness) != (k,):
        raise ValueError(f"{np.shape(stiffness)} stiffnesses for {k} modes")
    v, w = (np.linalg.qr(modes)[0] for modes in (one, other))
    c = v.T @ w
    left = w @ c.T
    np.subtract(v, left, out=left)
    outside = np.einsum("ij,ij->j", left, left)  # of each v, what no w reaches
    # Of each v, what later w take; no difference, which would round. In place: n may be thousands.
    beyond = np.square(c, out=left) if n == k else c**2
    backwards = beyond[:, ::-1]
    np.cumsum(backwards, axis=1, out=backwards)
    # Leak of the first N: of each v in them, what w N+1 .. k take; and what no w reaches.
    np.cumsum(beyond, axis=0, out=beyond)
    number = np.arange(1, k + 1)
    leak = np.cumsum(outside)
    leak[:-1] += np.diagonal(beyond, 1)
    del left, beyond, backwards
    sine = np.sqrt(np.clip(leak / number, 0.0, 1.0))
    cuts = np.zeros(k, dtype=bool)
    if stiffness is not None:
        size = np.maximum(np.abs(stiffness[1:]), np.abs(stiffness[:-1]))
        cuts[:-1] = (
            np.abs(np.diff(stiffness)) <= NEAR_EQUAL * size + ROUNDING * np.abs(stiffness).max()
        )
    uncut = number[~cuts & (number < n)]
    orders = uncut
    if k > MOST_ORDERS and uncut.size:
        wanted = np.geomspace(1, uncut[-1], MOST_ORDERS)
        orders = uncut[np.unique(np.abs(uncut[:, None] - wanted).argmin(axis=0))]
    return ModesComparison(
        overlap=1.0 - sine**2,
        rms_angle=sine,
        orders=orders,
        largest_angle=np.array([_largest_angle(v, w, c, int(order)) for order in orders]),
        cuts=cuts,
        distance=float(np.sqrt(np.mean(sine[uncut - 1] ** 2))) if uncut.size else float("nan"),
    )


def _largest_angle(v: Array, w: Array, c: Array, order: int) -> float:
    """Return the largest angle between the spans of the first modes, from its sine."""
    left = v[:, :order] - w[:, :order] @ c[:order, :order].T
    if order <= FEW:
        sine = float(np.linalg.norm(left, 2))
    else:  # to a thousandth, in a few products: all singular values would take minutes
        start = np.random.default_rng(0).standard_normal(order)
        sine = float(svds(left, k=1, tol=1e-3, v0=start, return_singular_vectors=False)[0])
    return float(np.arcsin(min(sine, 1.0)))
