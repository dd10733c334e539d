"""Decompositions: made safe, and no more of them than asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.actuators import Array

CLOSE = 1e-3  # of an eigenvalue, which it may be off by at most
MOST_STEPS = 60  # beyond, a full decomposition is as fast


def singular_values_and_vectors(matrix: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
    """Return U, s, V' of a matrix, s descending.

    LAPACK's fast driver (gesdd) fails to converge on a rare matrix; the plain one (gesvd) then
    does.
    """
    try:
        return scipy.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        return scipy.linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")


def smallest_eigenvalue(
    times: Callable[[Array], Array],
    n: int,
    nearly_solved: Callable[[Array], Array] = lambda residual: residual,
) -> tuple[float, Array]:
    """Return the smallest eigenvalue of a symmetric matrix and its vector, found step by step.

    What the best vector so far leaves over, nearly solved for, widens the space in which the next
    is sought (Davidson, J. Comput. Phys. 17, 87, 1975; without a solution nearby, Lanczos). Some
    eigenvalue is no further away than the remainder is long, at the end a thousandth of it; its
    square counts for the smallest. A full decomposition costs more than all of a calibration.

    Parameters
    ----------
    times, n
        Multiplies (n,) vectors, or the columns of a matrix, by the matrix; its order.
    nearly_solved
        Multiplies (n,) vectors by about the inverse, whatever its scale.
    """
    most = min(n, MOST_STEPS)
    basis, images = np.empty((most, n)), np.empty((most, n))
    new = np.random.default_rng(n).standard_normal(n)
    for k in range(most):
        for _ in range(2):  # once leaves too much of what is in the space already
            new -= (basis[:k] @ new) @ basis[:k]
        basis[k] = new / np.linalg.norm(new)
        images[k] = times(basis[k])
        values, vectors = np.linalg.eigh(basis[: k + 1] @ images[: k + 1].T)
        vector = vectors[:, 0] @ basis[: k + 1]
        residual = vectors[:, 0] @ images[: k + 1] - values[0] * vector
        if np.linalg.norm(residual) <= CLOSE * abs(values[0]):
            return float(values[0]), vector
        new = nearly_solved(residual)
    values, vectors = scipy.linalg.eigh(times(np.eye(n)), subset_by_index=[0, 0])
    return float(values[0]), vectors[:, 0]


def largest_eigenvalue(matrix: Array) -> tuple[float, Array]:
    """Return the largest eigenvalue of a symmetric matrix, as `smallest_eigenvalue`, its vector."""
    value, vector = smallest_eigenvalue(lambda x: -(matrix @ x), len(matrix))
    return -value, vector
