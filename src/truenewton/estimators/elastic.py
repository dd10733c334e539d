"""Relative alpha from a stiffness matrix alone: elastic forces balance by themselves (k = 0).

The left singular vectors of the measured stiffness are force patterns on which weight, bias and
torques cancel. With equal weight each, alpha is the pattern that best balances them all: the
smallest singular vector of the stacked A diag(u), its mean set to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from truenewton.actuators import Array
from truenewton.balance import balance_rows, enabled_arms
from truenewton.errors import RankDeficient
from truenewton.measurements import StiffnessMatrix

# Softer modes mix with the rigid motions through the bias magnets' gradient [N/m].
SOFTEST = 1e3


@dataclass(frozen=True, eq=False)
class ElasticSolution:
    """Alpha that balances elastic modes.

    Attributes
    ----------
    alpha
        (n,) with mean 1.
    error
        (n,) standard uncertainty from the imbalance that remains, to first order.
    singular_values
        (n,) of the stacked system, ascending; the first belongs to alpha.
    condition
        Largest over second smallest: the smallest is the solution.
    covariance
        (n, n) of alpha.
    """

    alpha: Array
    covariance: Array
    singular_values: Array


@dataclass(frozen=True)
class Imbalance:
    """Rms imbalance of elastic modes, each of unit length, over modes and the three equations."""

    modes: str
    before: float
    after: float


def elastic_modes(matrix: StiffnessMatrix) -> Array:
    """Return (m, n_enabled) force patterns of unit length, softest left out, stiffest first."""
    on = matrix.layout.enabled
    left, values, _ = scipy.linalg.svd(matrix.stiffness[np.ix_(on, on)])
    return np.asarray(left[:, values > SOFTEST].T)


def comparable_arms(matrix: StiffnessMatrix) -> Array:
    """Return the (3, n_enabled) arms with lengths in units of the RMS distance from the axis."""
    a = enabled_arms(matrix.layout)
    length = np.sqrt(np.mean(a[1] ** 2 + a[2] ** 2))
    return np.asarray(a / np.array([[1.0], [length], [length]]))


def balance_modes(modes: Array, a: Array) -> ElasticSolution:
    """Return the alpha that balances the modes best.

    Its error is that of equal noise in all elements of the modes, as large as the imbalance left
    over says: to first order it turns the smallest singular vector v_1 toward every other v_k by
    v_k' E' dE v_1 / sigma_k^2, where the three equations of a mode share the covariance
    S = A diag(alpha^2) A' of their noise dE v_1.

    Raises
    ------
    RankDeficient
        The modes are too few, or a second pattern balances them as well.
    """
    n = a.shape[1]
    if len(modes) * 3 < n + 1:
        raise RankDeficient(
            f"only {len(modes)} modes are stiffer than {SOFTEST:g} N/m, for {n} actuators",
            remedy="measure a stiffness matrix of full rank, in N/m",
            got=len(modes),
            want=n - 3,
        )
    rows = balance_rows(modes, a)
    triangle = scipy.linalg.qr(rows, mode="r")[0][:n]
    _, values, right = scipy.linalg.svd(triangle)
    values, right = values[::-1], right[::-1]
    # Below this the second pattern is decided by the same noise as the first.
    if values[1] < 1.5 * max(values[0], 1e-10 * values[-1]):
        raise RankDeficient(
            f"a second pattern of alpha balances the modes as well ({values[1]:.2g} after"
            f" {values[0]:.2g})",
            remedy="check unit, X, Y and order of actuators; or measure a less noisy matrix",
            got=float(values[1]),
        )
    mean = right[0].mean()
    alpha = right[0] / mean
    if abs(mean) * np.sqrt(n) < 0.1 or (alpha <= 0).any():
        raise RankDeficient(
            "the alpha that balances the modes is not positive for every actuator",
            remedy="check X, Y, NZ and the order of rows and columns in STIFFNESS",
        )
    s = (a * alpha**2) @ a.T
    root = np.linalg.cholesky(s).T
    # Columns: root(S) E v_k / sigma_k, what noise does to the imbalance that each v_k can absorb.
    absorbed = (root @ (rows @ right[1:].T).reshape(3, -1)).reshape(-1, n - 1) / values[1:]
    left_over = len(modes) * np.trace(s) - np.sum(absorbed**2)
    variance = (values[0] / mean) ** 2 / left_over
    turned = (absorbed / values[1:]) @ right[1:]
    # The mean is 1 by definition, so what is common to all actuators is no error.
    turned -= np.outer(turned.mean(axis=1), alpha)
    return ElasticSolution(alpha, variance * turned.T @ turned, values)


def orientation_warning(matrix: StiffnessMatrix) -> tuple[tuple[str, str], ...]:
    """Warn of a transposed matrix: a rigid displacement must cost little force.

    K {1, x, y} vanishes but for the scatter of the sensor gains and the bias magnets, and
    {1, x, y}' K but for that of alpha, which is larger; transposed, they change places.
    """
    on = matrix.layout.enabled
    k, rigid = matrix.stiffness[np.ix_(on, on)], np.linalg.qr(enabled_arms(matrix.layout).T)[0]
    if np.linalg.norm(rigid.T @ k) >= 0.5 * np.linalg.norm(k @ rigid):
        return ()
    return (
        (
            "STIFFNESS looks transposed: rigid displacements cost more than their forces are out of"
            " balance",
            "store [i, j], the force of actuator i per displacement of sensor j",
        ),
    )


def rms_imbalance(modes: Array, alpha: Array, a: Array) -> float:
    """Return the rms of A diag(alpha) u over modes of unit length and the three equations."""
    return float(np.sqrt(np.mean((modes * alpha @ a.T) ** 2)))


def imbalances(matrix: StiffnessMatrix) -> tuple[Imbalance, ...]:
    """Return the imbalance with alpha = 1 and with alpha fitted: on all modes, and held out.

    Held out: fitted on every second mode and judged on the others, both ways round.
    """
    modes, a = elastic_modes(matrix), comparable_arms(matrix)
    ones = np.ones(a.shape[1])

    def judged(name: str, fitted: Array, judge: Array) -> Imbalance:
        alpha = balance_modes(fitted, a).alpha
        return Imbalance(name, rms_imbalance(judge, ones, a), rms_imbalance(judge, alpha, a))

    even, odd = modes[0::2], modes[1::2]
    return (
        judged("all modes, fitted", modes, modes),
        judged("odd modes, fitted on the even", even, odd),
        judged("even modes, fitted on the odd", odd, even),
    )
