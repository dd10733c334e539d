"""Numbers as records keep them: plain, in one unit, arrays read-only; spread over actuators."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError

Array = NDArray[np.float64]
Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def jsonable(value: Any) -> Any:
    """Return what JSON can hold of numbers, arrays, lists and mappings: it knows no NaN."""
    if isinstance(value, Mapping):
        return {key: jsonable(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def in_unit(value: Any, unit: str, name: str) -> Any:
    """Return a number or (...,) numbers without their unit, in the one wanted.

    What has no unit is taken as it stands. Masks stay.

    Parameters
    ----------
    value
        A Quantity, a list of them, a column of a table, or plain numbers.
    unit
        Wanted; '' of what has none.
    name
        Of the value, for people.

    Raises
    ------
    FormatError
        It is in a unit of another kind.
    """
    if isinstance(value, list | tuple) and any(getattr(one, "unit", None) for one in value):
        import astropy.units as u

        try:
            value = u.Quantity(value)
        except (u.UnitsError, TypeError):
            raise _foreign(name, "several units", unit) from None
    own = getattr(value, "unit", None)
    if own is None:
        return value
    import astropy.units as u

    mask = mask_of(value)
    try:
        plain = np.asarray(getattr(value, "unmasked", value)) * own
        numbers = u.Quantity(plain).to_value(u.Unit(unit), equivalencies=u.temperature())
    except (u.UnitsError, TypeError, ValueError):
        raise _foreign(name, str(own) or "numbers without unit", unit) from None
    if mask is not None:
        return np.ma.masked_array(numbers, mask)
    return float(numbers) if np.ndim(numbers) == 0 else np.asarray(numbers)


def in_units(record: object, units: Mapping[str, str]) -> None:
    """Take units off fields of a frozen dataclass, while it is made: all are those named.

    Raises
    ------
    FormatError
    """
    kinds = getattr(record, "__dataclass_fields__", {})
    for name, unit in units.items():
        given = getattr(record, name)
        value = in_unit(given, unit, name)
        if value is not given:
            if np.ndim(value) == 1 and "tuple" in str(getattr(kinds.get(name), "type", "")):
                value = tuple(value.tolist())
            object.__setattr__(record, name, value)


def taking_units(
    **units: str,
) -> Callable[[Callable[Given, Returned]], Callable[Given, Returned]]:
    """Decorate a function so that it takes some arguments as Quantities too: in these units."""

    def decorate(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
        names = list(inspect.signature(function).parameters)

        @functools.wraps(function)
        def call(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
            plain: Any = [
                in_unit(value, units[name], name) if name in units else value
                for name, value in zip(names, args, strict=False)
            ]
            named: Any = {
                name: in_unit(value, units[name], name) if name in units else value
                for name, value in kwargs.items()
            }
            plain += args[len(plain) :]
            return function(*plain, **named)

        return call

    return decorate


def mask_of(value: Any) -> NDArray[np.bool_] | None:
    """Return the (...,) mask of masked numbers; None where nothing is masked."""
    mask = getattr(value, "mask", None)
    return np.asarray(mask, dtype=np.bool_) if mask is not None and np.any(mask) else None


def freeze(record: object, *names: str, dtype: Any = np.float64) -> None:
    """Make arrays of a frozen dataclass, while it is made, read-only, contiguous and of one type.

    They are copied, but for those that are that already.

    Raises
    ------
    FormatError
        One of them has a unit, or is masked: neither would be kept.
    """
    for name in names:
        given = getattr(record, name)
        if getattr(given, "unit", None) is not None:
            raise _foreign(name, str(given.unit), "")
        if mask_of(given) is not None:
            raise FormatError(f"{name.upper()} is masked", remedy="give all of it, or leave it out")
        values = np.asarray(given, dtype=dtype, order="C")
        if values is not given or values.flags.writeable:
            values = np.array(values)
            values.setflags(write=False)
            object.__setattr__(record, name, values)


def _foreign(name: str, has: str, want: str) -> FormatError:
    remedy = f"give it in {want}, or in what converts to that" if want else "give plain numbers"
    return FormatError(f"{name.upper()} is in {has}", remedy=remedy, got=has, want=want)


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
