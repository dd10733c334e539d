"""Decompositions and least squares, by LAPACK and BLAS."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri, spotrf, spotri

from truenewton.arrays import Array
from truenewton.errors import RankDeficient

ROWS_AT_ONCE = 96  # a block of rows stays in the processor's cache
ROUNDING = 1e-6  # of the largest eigenvalue of a covariance, which rounding may leave
LARGEST_VARIANCE = 1e30  # beyond, squares overflow
SMALLEST_DEVIATION = 1e-30  # of what has no variance at all
SINGULAR = 1e-13  # of the columns at unit length, below which one depends on the others
CLOSE = 1e-3  # of an eigenvalue, which it may be off by at most
MOST_STEPS = 60  # beyond, a full decomposition is as fast


@functools.cache
def thread_count() -> int:
    """Return the number of threads of BLAS by default, from the cores and the environment."""
    import threadpoolctl  # not at each start

    pools = threadpoolctl.threadpool_info()  # none where BLAS is of a kind that it does not know
    blas = (each["num_threads"] for each in pools if each["user_api"] == "blas")
    return int(max(blas, default=1))


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Limit BLAS to some threads: small products are slower in several than in one."""
    import threadpoolctl

    thread_count()  # what it was before
    with threadpoolctl.threadpool_limits(count, user_api="blas"):
        yield


def assignment(cost: NDArray[Any]) -> NDArray[np.int64]:
    """Return (n,) different columns for the rows of (n, m) costs, n <= m, with least total cost."""
    least = np.argmin(cost, axis=1)
    if np.unique(least).size == len(least):  # usually
        return np.asarray(least, dtype=np.int64)
    import scipy.optimize  # takes a fifth of a second

    return np.asarray(scipy.optimize.linear_sum_assignment(cost)[1], dtype=np.int64)


def singular_values_and_vectors(matrix: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
    """Return (m, k) U, (k,) s descending, and (k, n) V' of an (m, n) matrix, k the smaller.

    If LAPACK's fast driver (gesdd) does not converge, which is rare, the plain one (gesvd) does.
    """
    try:
        return scipy.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        return scipy.linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")


def smallest_eigenvalue(
    matrix: Array, inverse: Array | None = None, unit: Array | float = 1.0, *, sign: float = 1.0
) -> tuple[float, Array]:
    """Return the smallest eigenvalue of a symmetric (n, n) matrix, to 1e-3, and its vector.

    ``inverse`` is about that of the matrix, except for a factor, in (n,) other units. ``sign`` -1:
    of minus the matrix. Davidson's method (J. Comput. Phys. 17, 87, 1975; without an inverse,
    Lanczos): the residual of the best vector, times the inverse, extends the space that is
    searched. It stops when the residual is below 1e-3 of the eigenvalue; the error is its square
    for the smallest eigenvalue. A full decomposition would cost more than a calibration.
    """
    n = len(matrix)
    most = min(n, MOST_STEPS)
    basis, images = np.empty((most, n)), np.empty((most, n))
    new = np.random.default_rng(n).standard_normal(n)
    for k in range(most):
        for _ in range(2):  # once leaves too much of what is in the space already
            new -= (basis[:k] @ new) @ basis[:k]
        basis[k] = new / np.linalg.norm(new)
        images[k] = sign * (matrix @ basis[k])
        values, vectors = np.linalg.eigh(basis[: k + 1] @ images[: k + 1].T)
        vector = vectors[:, 0] @ basis[: k + 1]
        residual = vectors[:, 0] @ images[: k + 1] - values[0] * vector
        if np.linalg.norm(residual) <= CLOSE * abs(values[0]):
            return float(values[0]), vector
        new = residual if inverse is None else inverse @ (residual / unit) / unit
    values, vectors = scipy.linalg.eigh(sign * (matrix @ np.eye(n)), subset_by_index=[0, 0])
    return float(values[0]), vectors[:, 0]


def largest_eigenvalue(matrix: Array) -> tuple[float, Array]:
    """Return the largest eigenvalue of an (n, n) symmetric matrix, to 1e-3, and its vector."""
    value, vector = smallest_eigenvalue(matrix, sign=-1.0)
    return -value, vector


def asymmetry(matrix: Array) -> float:
    """Return |K - K'| / |K + K'| of an (n, n) matrix."""
    return float(np.linalg.norm(matrix - matrix.T) / np.linalg.norm(matrix + matrix.T))


def mirrored(upper: Array) -> Array:
    """Copy the upper triangle of an (n, n) matrix into the lower one, in place; return the matrix.

    By blocks: a transposed copy of the whole would miss the cache at every element.
    """
    for start in range(0, len(upper), ROWS_AT_ONCE):
        end = start + ROWS_AT_ONCE
        block = upper[start:end, start:end]
        block[...] = np.triu(block) + np.triu(block, 1).T
        for right in range(end, len(upper), ROWS_AT_ONCE):
            columns = slice(right, right + ROWS_AT_ONCE)
            upper[columns, start:end] = upper[start:end, columns].T
    return upper


def transposed(matrix: Array) -> Array:
    """Transpose an (n, n) matrix in place, by blocks; return it."""
    for start in range(0, len(matrix), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        matrix[some, some] = matrix[some, some].T.copy()
        for right in range(some.stop, len(matrix), ROWS_AT_ONCE):
            others = slice(right, right + ROWS_AT_ONCE)
            above = matrix[some, others].copy()
            matrix[some, others] = matrix[others, some].T
            matrix[others, some] = above.T
    return matrix


def symmetrised(matrix: Array) -> Array:
    """Replace an (n, n) matrix by the mean of it and its transpose, in place; return it."""
    for start in range(0, len(matrix), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        rows = 0.5 * (matrix[some, start:] + matrix[start:, some].T)
        matrix[some, start:], matrix[start:, some] = rows, rows.T
    return matrix


def rearranged(matrix: Array, columns: NDArray[np.int64]) -> Array:
    """Put the columns of a (p, n) matrix in another order, (n,), in place; return it."""
    for start in range(0, len(matrix), ROWS_AT_ONCE):
        rows = matrix[start : start + ROWS_AT_ONCE]
        rows[:] = rows[:, columns]
    return matrix


def eigenvectors(symmetric: Array) -> tuple[Array, Array]:
    """Return (n,) ascending eigenvalues and (n, n) eigenvectors, as columns, of a symmetric matrix.

    It needs memory for one more matrix, and overwrites ``symmetric`` (LAPACK's dsyevr; NumPy's
    dsyevd needs three, and a copy).
    """
    values, vectors = scipy.linalg.eigh(symmetric.T, driver="evr", overwrite_a=True)
    return values, transposed(vectors.T)  # as LAPACK stores them, each is a row in memory


def factor_of(matrix: Array) -> Array:
    """Return (n, m) F with F F' an (n, n) positive semi-definite matrix, without its rounding."""
    values, vectors = scipy.linalg.eigh(matrix)
    real = values > ROUNDING * max(values[-1], 1e-300)
    return np.asarray(vectors[:, real] * np.sqrt(values[real]))


def covariance_fault(matrix: Array, unit: Array | None = None) -> str:
    """Return why an (n, n) matrix is no covariance; '' if it is one.

    Rows and columns of unknowns are NaN. Rounding is relative to the (n,) variances ``unit``, by
    default the diagonal.
    """
    unit = np.diag(matrix) if unit is None else unit
    known = ~np.isnan(unit)
    if np.isinf(matrix).any():
        return "is infinite"
    if (np.isnan(matrix) & np.outer(known, known)).any():
        return "holds NaN among numbers"
    if (np.abs(matrix) > LARGEST_VARIANCE).any() or (unit < 0).any():
        return "holds absurd or negative variances"
    size = np.sqrt(unit[known])
    one = 1 / np.maximum(size, SMALLEST_DEVIATION)
    scaled = matrix[np.ix_(known, known)] * one[:, None] * one
    if (np.abs(scaled - scaled.T) > ROUNDING).any():
        return "is not symmetric"
    try:
        scipy.linalg.cholesky(scaled + ROUNDING * np.eye(len(scaled)), lower=True)
    except np.linalg.LinAlgError:
        return "is not positive semi-definite"
    return ""


def inverse_of_positive(matrix: Array, *, overwrite: bool = False) -> Array:
    """Return the inverse of an (n, n) symmetric positive definite matrix, in its precision.

    With ``overwrite`` in its place. Rows and columns are scaled to a unit diagonal first, so that
    units do not matter (van der Sluis, Numer. Math. 14, 14, 1969: no other scale does much better).
    Raises `numpy.linalg.LinAlgError` if it is not positive definite.
    """
    if not (np.diag(matrix) > 0.0).all():
        raise np.linalg.LinAlgError("an element of the diagonal is not positive")
    size = np.sqrt(np.diag(matrix))
    scaled = matrix if overwrite else matrix.copy()
    scaled /= size
    scaled /= size[:, None]
    potrf = spotrf if scaled.dtype == np.float32 else dpotrf
    factor, fails = potrf(scaled.T, lower=True, overwrite_a=True, clean=False)
    if fails:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    inverse = inverse_of_factor(factor)
    inverse /= size
    inverse /= size[:, None]
    return inverse


def inverse_of_factor(factor: Array) -> Array:
    """Return the inverse of (n, n) L L', in place of L if that is in Fortran order."""
    potri = spotri if factor.dtype == np.float32 else dpotri
    return mirrored(potri(factor, lower=True, overwrite_c=True)[0].T)


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Solution of least squares with right-hand sides of variance 1.

    The leading (q, q) block of ``root`` is that of the first q unknowns if the others are known.
    """

    values: Array  # (p,) the solution
    root: Array  # (p, p) upper triangular; covariance = root root'
    residual: Array  # (m,) right-hand side less matrix times values
    orthogonal: Array  # (m, p) orthonormal basis of the columns

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)


def least_squares(matrix: Array, right: Array) -> LeastSquares:
    """Minimise the length of right - matrix @ values, of (m, p) and (m,), m >= p.

    Householder's QR of the columns at unit length: the condition is not squared as in the normal
    equations (Golub and Van Loan, Matrix Computations, section 5.3). Raises `RankDeficient` if a
    column is a combination of the others.
    """
    length = np.sqrt(np.sum(matrix**2, axis=0))
    length[length == 0.0] = 1.0  # of a column of zeros, whose diagonal in r is 0
    q, r = scipy.linalg.qr(matrix / length, mode="economic", check_finite=False)
    if not np.abs(np.diag(r)).min() >= SINGULAR:
        raise RankDeficient(
            "the data do not determine all unknowns", remedy="add days at other temperatures"
        )
    inverse, _ = dtrtri(r)
    values = scipy.linalg.solve_triangular(r, q.T @ right, check_finite=False) / length
    root = np.triu(inverse) / length[:, None]
    return LeastSquares(values, root, right - matrix @ values, q)
