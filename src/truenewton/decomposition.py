"""Decompositions: made safe, and no more of them than asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from truenewton.actuators import Array

DENSE_UP_TO = 100  # unknowns; below, all of LAPACK is as fast


def singular_values_and_vectors(matrix: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
    """Return U, s, V' of a matrix, s descending.

    LAPACK's fast driver (gesdd) fails to converge on a rare matrix; the plain one (gesvd) then
    does.
    """
    try:
        return scipy.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        return scipy.linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")


def largest_eigenvalue(matrix: Array | LinearOperator) -> tuple[float, Array]:
    """Return the largest eigenvalue of a symmetric matrix, to a millionth, and its vector.

    By Lanczos iteration: a full decomposition costs more than all the rest of a calibration.
    """
    n = matrix.shape[0]
    if n <= DENSE_UP_TO:
        dense = matrix @ np.eye(n) if isinstance(matrix, LinearOperator) else matrix
        values, vectors = scipy.linalg.eigh(dense, subset_by_index=[n - 1, n - 1])
        return float(values[0]), vectors[:, 0]
    start = np.asarray(np.random.default_rng(n).standard_normal(n))
    operator: Any = matrix
    try:
        values, vectors = eigsh(operator, k=1, which="LA", v0=start, tol=1e-3)
    except ArpackNoConvergence:
        dense = matrix @ np.eye(n) if isinstance(matrix, LinearOperator) else matrix
        values, vectors = scipy.linalg.eigh(dense, subset_by_index=[n - 1, n - 1])
    return float(values[0]), vectors[:, 0]
