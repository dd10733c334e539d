"""Arrays as records keep them: read-only, and spread over the actuators that take part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def frozen_array(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only contiguous copy of ``values``; themselves if they are that already."""
    if (
        isinstance(values, np.ndarray)
        and values.dtype == dtype
        and values.flags.c_contiguous
        and not values.flags.writeable
    ):
        return values
    array: NDArray[Any] = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def spread(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put values of the enabled actuators in the order of all, NaN elsewhere.

    Parameters
    ----------
    values
        (n_enabled, ...), one of each enabled actuator.
    on
        (n,) who is enabled.
    """
    out = np.full((on.size, *values.shape[1:]), np.nan)
    out[on] = values
    return out


def spread_square(matrix: Array, on: NDArray[np.bool_]) -> Array:
    """Put a matrix over the enabled in the order of all, as `spread`; itself where all are."""
    if on.all():
        return matrix
    out = np.full((on.size, on.size), np.nan)
    out[np.ix_(on, on)] = matrix
    return out
