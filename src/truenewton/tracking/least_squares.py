"""Linear least squares by orthogonal transformation: as exact as double precision allows.

Held against the certified answers of NIST's Statistical Reference Datasets in
tests/test_least_squares.py, which states the digits that come out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.linalg.lapack import dtrtri

from truenewton.actuators import Array
from truenewton.errors import RankDeficient

SINGULAR = 1e-13  # of the columns at unit length, below which one depends on the others


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares of whitened equations: each right-hand side has variance 1.

    Attributes
    ----------
    values
        (p,) the solution.
    root
        (p, p) upper triangular; covariance = root root'. Its leading (q, q) block is the root of
        the covariance of the first q unknowns where the others are known.
    residual
        (m,) right-hand side less matrix times values.
    orthogonal
        (m, p) orthonormal basis of the columns.
    """

    values: Array
    root: Array
    residual: Array
    orthogonal: Array

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)


def least_squares(matrix: Array, right: Array) -> Solution:
    """Minimise the length of right - matrix @ values.

    Householder's QR of the columns at unit length: squares of the condition, as in the normal
    equations, never arise (Golub and Van Loan, Matrix Computations, section 5.3).

    Parameters
    ----------
    matrix, right
        (m, p) and (m,), m >= p.

    Raises
    ------
    RankDeficient
        A column is a combination of the others.
    """
    length = np.sqrt(np.sum(matrix**2, axis=0))
    if not (length > 0.0).all():
        raise _dependent()
    q, r = scipy.linalg.qr(matrix / length, mode="economic", check_finite=False)
    if np.abs(np.diag(r)).min() < SINGULAR:
        raise _dependent()
    inverse, _ = dtrtri(r)
    values = scipy.linalg.solve_triangular(r, q.T @ right, check_finite=False) / length
    root = np.triu(inverse) / length[:, None]
    return Solution(values, root, right - matrix @ values, q)


def _dependent() -> RankDeficient:
    return RankDeficient(
        "the data cannot tell the unknowns apart", remedy="add days at other temperatures"
    )
