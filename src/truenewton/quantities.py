"""Quantities: each is declared once, next to its record, with its unit and range.

A class declares them as ``QUANTITIES``, by the names of its fields. `convert_quantities` converts
numbers with units, `check_quantities` refuses numbers outside their range.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError

Given = ParamSpec("Given")
Returned = TypeVar("Returned")
MAX_MAGNITUDE = 1e15  # of any number in SI units, stiff glass included: its square stays finite


@dataclass(frozen=True)
class Quantity:
    """The unit and range of a number, and the error of a number outside that range.

    Attributes
    ----------
    unit
        Unit in the record; '' of plain numbers.
    low, high
        Range, limits included.
    why, fault
        Remedy and fault of a number outside, as 'ADDED is {:g} N'; by default made from the range
        and the name of the field.
    of_mass
        Factor from a mass [kg], where one is accepted instead.
    """

    unit: str = ""
    low: float = -MAX_MAGNITUDE
    high: float = MAX_MAGNITUDE
    why: str = ""
    fault: str = ""
    of_mass: float = 0.0

    def check(self, value: Any, name: str = "") -> None:
        """Raise FormatError if a number, or one in a nested tuple, is outside the range."""
        if -self.low == self.high == np.inf:  # any number, NaN where it is unknown
            return
        for number in _numbers(value):
            if not self.low <= number <= self.high:
                shown = list(value) if isinstance(value, tuple) else f"{number:g}"
                raise FormatError(
                    self.fault.format(number) if self.fault else f"{name} is {shown}",
                    remedy=self._remedy(number),
                )

    def _remedy(self, number: float) -> str:
        if number > self.high == MAX_MAGNITUDE or number < self.low == -MAX_MAGNITUDE:
            return f"check its unit; numbers are in SI units, up to {MAX_MAGNITUDE:g}"
        if self.why:
            return self.why
        if self.low < 0.0:
            return f"give {self.low:g} to {self.high:g}"
        words = "zero or more," if self.low == 0.0 else f"a positive number, {self.low:g}"
        return f"give {words} to {self.high:g}"


def _numbers(value: Any) -> Iterator[float]:
    """Yield a number, or the numbers in nested tuples."""
    if isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif value is not None:
        yield value


def convert_quantities(record: object) -> None:
    """Convert the quantities of a frozen dataclass to plain numbers, while it is made.

    Raises
    ------
    FormatError
        As of `in_units`.
    """
    kinds = {field.name: str(field.type) for field in fields(record)}  # type: ignore[arg-type]
    quantities = type(record).QUANTITIES  # type: ignore[attr-defined]
    for name, value in in_units(vars(record), quantities).items():
        if value is not getattr(record, name):
            if np.ndim(value) == 1 and "tuple" in kinds[name]:
                value = tuple(value.tolist())
            object.__setattr__(record, name, value)


def check_quantities(record: object, inside: str = "") -> None:
    """Raise FormatError for the first number outside its range in a record and the records in it.

    A field's default is always allowed. A record checks its arrays itself, as invalid rows may
    contain anything. Messages name fields with ``inside`` before their names.
    """
    kind = type(record)
    for name, quantity in getattr(kind, "QUANTITIES", {}).items():
        value = getattr(record, name)
        if isinstance(value, tuple) or (np.ndim(value) == 0 and value != getattr(kind, name, None)):
            quantity.check(value, inside + name)
    if is_dataclass(record):
        for field in fields(record):
            if is_dataclass(value := getattr(record, field.name)):
                check_quantities(value, f"{inside}{field.name}.")


def in_units(given: Mapping[str, Any], quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """Return the values of these quantities, by name, as plain numbers in their units.

    Raises
    ------
    FormatError
        A unit does not convert, or a weight is a mass and its error has no unit.
    """
    made = {}
    for name, quantity in quantities.items():
        value = given[name]
        made[name] = in_unit(value, quantity.unit, name, quantity.of_mass)
        if quantity.of_mass and _is_mass(value):
            of_it = f"{name}_error"
            error = given.get(of_it)
            if not isinstance(error, str) and unit_of(error) is None and error:
                raise FormatError(  # it may be in the unit of the mass
                    f"{of_it} is {error:g} without a unit, but {name} is a mass",
                    remedy=f"give {of_it} a unit, such as '{error:g} g'",
                )
    return made


def _is_mass(value: Any) -> bool:
    """Return whether a value that `in_unit` converts is a mass."""
    if not isinstance(value, str) and unit_of(value) is None:
        return False
    import astropy.units as u

    return bool(u.Quantity(value).unit.is_equivalent(u.kg))


def in_unit(value: Any, unit: str, name: str, of_mass: float = 0.0, has: Any = None) -> Any:
    """Return a number or (...,) numbers converted to a unit, as plain numbers; masks are kept.

    ``value`` is a Quantity, a text, a list of Quantities, a column of a table, or plain numbers in
    the unit ``has``, which are returned unchanged without it. ``of_mass`` is as of `Quantity`.

    Raises
    ------
    FormatError
        The unit does not convert; the message contains ``name``.
    """
    wanted = f"{unit}, g" if of_mass else unit
    listed = isinstance(value, list | tuple) and any(getattr(one, "unit", None) for one in value)
    if listed or isinstance(value, str):
        import astropy.units as u

        try:
            value = u.Quantity(value)
        except (TypeError, ValueError):
            raise other_unit(name, "several units" if listed else f"'{value}'", wanted) from None
    own = unit_of(value)
    own = has if own is None else own
    if own is None:
        return value
    import astropy.units as u

    mask = mask_of(value)
    try:
        plain = u.Quantity(numbers_of(getattr(value, "unmasked", value), name), own)
        if of_mass and plain.unit.is_equivalent(u.kg):
            plain = of_mass * plain.to_value(u.kg) * u.Unit(unit)
        numbers = plain.to_value(u.Unit(unit), equivalencies=u.temperature())
    except FormatError:
        raise
    except (u.UnitsError, TypeError, ValueError):
        raise other_unit(name, str(own) or "numbers without unit", wanted) from None
    if mask is not None:
        return np.ma.masked_array(numbers, mask)
    return float(numbers) if np.ndim(numbers) == 0 else np.asarray(numbers)


def numbers_of(value: Any, name: str, dtype: Any = None) -> NDArray[Any]:
    """Return (...,) numbers, of a type if it is given; texts among them are refused."""
    try:
        with np.errstate(invalid="raise"):  # no integer is NaN
            numbers = np.asarray(value, dtype=dtype, order="C")
            return numbers.astype(float) if numbers.dtype.kind in "OSU" else numbers
    except (TypeError, ValueError, FloatingPointError) as error:
        raise FormatError(
            f"{name.upper()} is not numbers ({error})", remedy="give numbers"
        ) from None


def taking_units(
    **units: str,
) -> Callable[[Callable[Given, Returned]], Callable[Given, Returned]]:
    """Decorate a function: the arguments named are converted to these units (`in_unit`)."""

    def decorate(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def call(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
            bound = signature.bind(*args, **kwargs)
            for name in [name for name in units if name in bound.arguments]:
                bound.arguments[name] = in_unit(bound.arguments[name], units[name], name)
            return function(*bound.args, **bound.kwargs)

        return call

    return decorate


def mask_of(value: Any) -> NDArray[np.bool_] | None:
    """Return the (...,) mask of masked numbers; None if nothing is masked."""
    mask = getattr(value, "mask", None)
    if callable(mask):  # a method of pandas, whose missing numbers are NaN
        return None
    return np.asarray(mask, dtype=np.bool_) if mask is not None and np.any(mask) else None


def unit_of(value: Any) -> Any:
    """Return the unit of numbers, of astropy or in ``attrs`` of xarray and pandas; or None."""
    if isinstance(attrs := getattr(value, "attrs", None), Mapping):
        if hasattr(value, "iloc") and value.size:  # pandas may contain Quantities
            attrs = {"unit": getattr(value.iloc[(0,) * value.ndim], "unit", None), **attrs}
        return attrs.get("units", attrs.get("unit"))
    return getattr(value, "unit", None)


def other_unit(name: str, has: str, want: str) -> FormatError:
    """Return the error of a value in a unit that does not convert to the one wanted."""
    remedy = f"give it in {want} or a unit that converts to it" if want else "give plain numbers"
    return FormatError(f"{name.upper()} is in {has}", remedy=remedy)
