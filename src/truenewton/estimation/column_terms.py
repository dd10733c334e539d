"""The balance of a matrix's columns at one alpha: what they leave, and what they hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.arrays import Array
from truenewton.errors import RankDeficient

ROUNDING = 1e-13  # of a covariance
LEAST = 0.01  # part of a variance that a fit leaves at least


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a stiffness matrix.

    Attributes
    ----------
    stiffness
        (n, m) forces per displacement [N/m].
    a, sensor_arms
        (3, n) arms of the forces and (3, m) of the sensors, in comparable units.
    disturbance
        (m, 3, 3) covariance of what else disturbs the balance [N^2/m^2].
    start
        (n,) alpha to begin with.
    size
        (n, m) elements with which noise may go in proportion [N/m]; all of the columns unless only
        some of their modes are looked at.
    """

    stiffness: Array
    a: Array
    sensor_arms: Array
    disturbance: Array
    start: Array
    size: Array


@dataclass(frozen=True, eq=False)
class Terms:
    """At one point: residuals of unit covariance, S^1/2, the design, M and gradient.

    (m, 3), (m, 3, 3), (m, 3, n + 9), (n + 9, n + 9) and (n + 9,).
    """

    residual: Array
    root: Array
    design: Array
    m: Array
    gradient: Array


def terms_at(
    c: Columns, alpha: Array, b: Array, variance: Array, held: Array | None = None
) -> Terms:
    """Return the terms at (n,) alpha, (3, 3) b; alpha held in S: of weighted least squares."""
    n, m = c.stiffness.shape
    rho = ((c.a * alpha) @ c.stiffness + b @ c.sensor_arms).T
    s = imbalance_covariances(c.a * (alpha if held is None else held), variance) + c.disturbance
    # A disturbance in one direction may be so large that noise in the others is its rounding.
    s = s + ROUNDING * np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    root = np.linalg.cholesky(s)
    inverse_root = np.linalg.inv(root)
    residual = np.einsum("mkl,ml->mk", inverse_root, rho)
    white = inverse_root @ c.a
    fitted = c.stiffness.T
    if held is None:
        fitted = fitted - (variance * alpha[:, None]).T * np.einsum("mki,mk->mi", white, residual)
    design = np.empty((m, 3, n + 9))
    np.multiply(white, fitted[:, None, :], out=design[:, :, :n])
    design[:, :, n:] = np.einsum("mkl,jm->mklj", inverse_root, c.sensor_arms).reshape(m, 3, 9)
    flat = design.reshape(3 * m, n + 9)
    m_matrix = np.asarray(flat.T @ flat)
    return Terms(residual, np.asarray(root), design, m_matrix, flat.T @ residual.ravel())


def feigned_information(
    c: Columns, alpha: Array, root: Array, variance: Array, left: Array | None = None
) -> Array:
    """Return (n, n), what noise adds to M in the mean: all, or that which the fit leaves of it.

    D = (A' S^-1/2 L S^-1/2 A) o (diag v - v alpha A' S^-1 A alpha v), summed over columns. With
    L = 1 this is E[M] less the information I. But the fit of all other unknowns takes away its part
    of what noise feigns of a pattern, in M as in the gradient. To second order (M - D)^-1 has the
    mean I^-1, and errors of alpha the covariance I^-1 (I + D) I^-1, where L, (m, 3, 3), is what the
    fit leaves of the variance of each column.
    """
    m, n = len(root), len(alpha)
    white = np.linalg.inv(root) @ c.a
    noisy = white * (variance * alpha[:, None]).T[:, None, :]
    some = white if left is None else np.linalg.cholesky(left).transpose(0, 2, 1) @ white
    out = np.diag(np.einsum("mki,mki,mi->i", some, some, variance.T))
    for k in range(3):
        cross = (some[:, k : k + 1] * noisy).reshape(3 * m, n)
        out -= cross.T @ cross
    return np.asarray(out)


def left_of_columns(terms: Terms, inverse: Array, feigned: Array) -> Array:
    """Return the (m, 3, 3) part of each column's unit covariance that the fit leaves.

    1 - X H^-1 X' with the true design X. Noise in that which is at hand makes X H^-1 X' larger, and
    alpha less sure than H^-1, by as much again: in the sum over columns, by the trace of H^-1 D.
    """
    n, (m, _, u) = len(feigned), terms.design.shape
    inverse = inverse - 2.0 * inverse[:, :n] @ feigned @ inverse[:n]
    reached = (terms.design.reshape(3 * m, u) @ inverse).reshape(m, 3, u)
    values, vectors = np.linalg.eigh(np.eye(3) - reached @ terms.design.transpose(0, 2, 1))
    return np.asarray((vectors * np.maximum(values, LEAST)[:, None]) @ vectors.transpose(0, 2, 1))


def imbalance_covariances(scaled_arms: Array, variance: Array) -> Array:
    """Return (m, 3, 3) covariances of the imbalance for (n, m) variances of the elements."""
    pairs = (scaled_arms[:, None] * scaled_arms[None]).reshape(9, -1)
    return np.asarray((pairs @ variance).T.reshape(-1, 3, 3))


def inverse_information(terms: Terms, prior: Array, feigned: Array) -> Array:
    """Return the (n + 9, n + 9) inverse of M - D and prior; the common factor is held.

    Raises
    ------
    RankDeficient
    """
    n = len(prior)
    matrix = terms.m.copy()
    matrix[:n, :n] += prior - feigned + np.trace(terms.m[:n, :n]) / n**2
    try:
        factor = scipy.linalg.cho_factor(matrix, lower=True)
        return np.asarray(scipy.linalg.cho_solve(factor, np.eye(n + 9)))
    except np.linalg.LinAlgError:
        pass
    raise RankDeficient(
        "alpha is not unique: two patterns balance the columns almost equally well",
        remedy="check unit, X, Y and order of actuators; or measure a less noisy matrix",
    )
