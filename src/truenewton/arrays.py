"""Arrays as records keep them: read-only, and spread over the actuators that take part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def freeze(record: object, *names: str, dtype: Any = np.float64) -> None:
    """Make arrays of a frozen dataclass, while it is made, read-only, contiguous and of one type.

    They are copied, but for those that are that already.
    """
    for name in names:
        given = getattr(record, name)
        values = np.asarray(given, dtype=dtype, order="C")
        if values is not given or values.flags.writeable:
            values = np.array(values)
            values.setflags(write=False)
            object.__setattr__(record, name, values)


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
