"""The singular value decomposition, made safe."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.actuators import Array


def singular_values_and_vectors(matrix: NDArray[np.floating[Any]]) -> tuple[Array, Array, Array]:
    """Return U, s, V' of a matrix, s descending.

    LAPACK's fast driver (gesdd) fails to converge on a rare matrix; the plain one (gesvd) then
    does.
    """
    try:
        return scipy.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        return scipy.linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
