"""Arrays as records keep them: read-only, and spread over the actuators that take part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def frozen_array(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only contiguous copy, (...,) as given; the values if they are that already."""
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


def freeze(record: object, *names: str, dtype: Any = np.float64) -> None:
    """Make arrays of a frozen dataclass, while it is made, read-only and of one type."""
    for name in names:
        object.__setattr__(record, name, frozen_array(getattr(record, name), dtype))


def spread(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put (n_enabled, ...) values of the enabled actuators in the order of all (n,), else NaN."""
    out = np.full((on.size, *values.shape[1:]), np.nan)
    out[on] = values
    return out


def spread_square(matrix: Array, on: NDArray[np.bool_]) -> Array:
    """Put an (n_enabled, n_enabled) matrix in the order of all, else NaN; itself if all are on."""
    if on.all():
        return matrix
    out = np.full((on.size, on.size), np.nan)
    out[np.ix_(on, on)] = matrix
    return out
