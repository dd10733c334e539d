"""Arrays: in blocks, of records read-only, as JSON, of enabled actuators in the order of all."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError
from truenewton.quantities import mask_of, numbers_of, other_unit, unit_of

Array = NDArray[np.float64]
BLOCK_BYTES = 2**24  # of the rows that are taken at once


def blocks(rows: int, row_bytes: int) -> list[slice]:
    """Cut rows into slices of `BLOCK_BYTES` at most, of one row at least."""
    step = max(1, BLOCK_BYTES // max(row_bytes, 1))
    return [slice(start, min(start + step, rows)) for start in range(0, rows, step)]


def jsonable(value: Any) -> Any:
    """Return values for JSON, which has no NaN; of a record the fields that its repr shows.

    A record may define other values by a property ``as_values``.
    """
    if hasattr(value, "as_values"):
        return jsonable(value.as_values)
    if dataclasses.is_dataclass(value):
        shown = (each.name for each in dataclasses.fields(value) if each.repr)
        return {name: jsonable(getattr(value, name)) for name in shown}
    if isinstance(value, Mapping):
        return {key: jsonable(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, datetime.datetime):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def freeze(record: object, *names: str, dtype: Any = np.float64) -> None:
    """Make arrays of a new frozen dataclass read-only, contiguous and of one type.

    They are copied unless they are that already. Raises `FormatError` if one of them has a unit, or
    is masked: neither would be kept.
    """
    for name in names:
        given = getattr(record, name)
        plain = type(given) is np.ndarray  # which has neither a unit nor a mask
        if not plain and (unit := unit_of(given)) is not None:
            raise other_unit(name, str(unit), "")
        if not plain and mask_of(given) is not None:
            raise FormatError(f"{name.upper()} is masked", remedy="give all of it, or leave it out")
        if hasattr(given, "isna") and np.any(given.isna()) and np.dtype(dtype) == float:
            given = given.to_numpy(dtype=float, na_value=np.nan)  # missing ones of pandas
        values = numbers_of(given, name, dtype) if dtype is not None else given
        if values is not given or values.flags.writeable:
            values = np.array(values)
            values.setflags(write=False)
            object.__setattr__(record, name, values)


def rms(values: Array) -> float:
    """Return the root of the mean square of (...,) numbers."""
    return float(np.sqrt(np.mean(values**2)))


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


def spread_covariance(values: Array, on: NDArray[np.bool_]) -> Array:
    """Put an (n_enabled + rest, ...) covariance in the order of all (n,), read-only, else NaN."""
    rest = np.ones(len(values) - int(on.sum()), dtype=bool)
    out = spread_square(values, np.concatenate([on, rest]))
    out.setflags(write=False)  # so that a record need not copy it
    return out
