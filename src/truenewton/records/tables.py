"""Cycles from arrays and from long tables, as programs and laboratories have them."""

from __future__ import annotations

import datetime
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import Fault, FormatError, GeometryError, naming
from truenewton.files.fits import refuse_doubles
from truenewton.quantities import in_unit
from truenewton.records.cycle import ARRAYS, ASSUMED, Cycle
from truenewton.rounding import listed
from truenewton.statics.layout import Layout, integers_or_texts, layout
from truenewton.statics.load import GRAVITY, Load

REQUIRED = ("force", "shape", "sign")
OF_CYCLE = (*ARRAYS, "date", "number")
MATRICES = ("force", "position")  # with a value for each actuator
ID_NAMES = ("id", "ids", "actuator", "act", "aktuator", "coil", "index", "number", "no", "nr",
            "channel", "channels", "chan", "ch", "name", "label")  # fmt: skip
LENGTHS = "um|mm|cm|m|in|inch|micron|deg|rad"
UNIT = re.compile(
    rf"(.+?)[\s_]*(?:/|\bin\b)?[\s_]*[\[(]?\b((?i:{LENGTHS})|[kmun]?N|m?s|K|deg_C)[\])]?"
)
LABEL = re.compile(r"([^\W\d]*)[ _-]?(\d+)")  # a number with a word before it, as F17
MAX_DIGITS = 4  # of an ID with zeros before it, as F0017
# Thickness of a disc of glass as large and heavy as the mirror, magnets included: 3 to 3.5 mm for
# P45, MMT336, LBT672 and MAG585. A length that is wrong by a factor of 10 changes it by 100.
GLASS_DENSITY = 2530.0  # [kg/m3]
LIKELY_THICKNESS, POSSIBLE_THICKNESS = (3e-4, 0.03), (3e-6, 3.0)  # [m]


def layout_of(positions: Any, enabled: Any = None, unit: str | None = None) -> Layout:
    """Return a layout, or that of (n,) x and y, of (n, 2) positions [m], or of columns x, y, id."""
    if isinstance(positions, Layout):
        return positions if enabled is None else replace(positions, enabled=enabled)
    every = columns_in(positions)
    if "x" in every and "y" in every:
        named = ("nz", "enabled", "segment", *ID_NAMES)
        found = {name: positions[every[name][0]] for name in named if name in every}
        ids = next((found.pop(name) for name in ID_NAMES if name in found), None)
        x, y = (
            in_unit(positions[of], "m", f"positions, column {of}", has=unit or own or None)
            for of, own in (every["x"], every["y"])
        )
        others = {name: found[name] for name in ("nz", "enabled", "segment") if name in found}
        others |= {} if enabled is None else {"enabled": enabled}
        return layout(x, y, id=ids, **others)
    if every and np.asarray(positions).dtype.kind not in "fiu":
        fault = f"positions have no columns x and y, but {listed(positions)}"
        raise FormatError(fault, remedy="name two of them x and y")
    if len(positions) != 2:
        positions, unit = np.asarray(in_unit(positions, "m", "positions", has=unit)), None
        if positions.shape[1:] != (2,):
            remedy = "give a pair (x, y), (n, 2) positions, or a layout"
            raise FormatError(f"positions have the shape {positions.shape}", remedy=remedy)
        positions = positions.T
    x, y = (in_unit(each, "m", "positions", has=unit) for each in positions)
    return layout(x, y, enabled=enabled)


def size_doubt(actuators: Layout, weight: float) -> Fault | None:
    """Return that positions and the weight [N] hardly fit together, or None."""
    radius, glass = _size(actuators, weight)
    if LIKELY_THICKNESS[0] < glass < LIKELY_THICKNESS[1]:
        return None
    fault = f"actuators are up to {1e3 * radius:.4g} mm from the axis, and the mirror weighs"
    fault += f" {abs(weight):.3g} N, as a disc of glass {1e3 * glass:.2g} mm thick"
    return Fault(fault, "check the unit of the positions, and the weight")


def check_size(actuators: Layout, weight: float) -> str:
    """Return that positions and the weight [N] hardly fit together, or ''; refuse absurd ones."""
    if (doubt := size_doubt(actuators, weight)) is None:
        return ""
    if not POSSIBLE_THICKNESS[0] < _size(actuators, weight)[1] < POSSIBLE_THICKNESS[1]:
        raise GeometryError(doubt.fault, remedy=doubt.remedy)
    return f"{doubt.fault}: {doubt.remedy}"


def _size(actuators: Layout, weight: float) -> tuple[float, float]:
    """Return the largest distance from the axis, and the thickness of a disc of that weight [m]."""
    radius = float(np.hypot(actuators.x, actuators.y).max())
    own = float(np.hypot(actuators.x - actuators.x.mean(), actuators.y - actuators.y.mean()).max())
    return radius, abs(weight) / (GRAVITY * GLASS_DENSITY * np.pi * max(own, 1e-9) ** 2)


def columns_in(table: Any) -> dict[str, tuple[str, str]]:
    """Return the columns of a table or dictionary by name; also in lower case, without the unit.

    Each is the name in the table, and the unit in it or ''. There are none in other data. A name of
    HDF5 or MATLAB is found without its group or struct, too. A short name that two columns have
    finds none.
    """
    every = getattr(table, "columns", table if isinstance(table, Mapping) else ())
    names = [name for name in every if isinstance(name, str)]
    pandas = hasattr(table, "iloc")  # its read_csv calls the second of two columns F1 'F1.1'
    refuse_doubles([name.removesuffix(".1") if pandas else name for name in names], "columns")
    known, found = {name: name_and_unit(name) for name in names}, dict[str, set[str]]()
    for name, (plain, _) in known.items():
        for short in (name, plain, without_group(name)):
            found.setdefault(short.casefold(), set()).add(name)
    alone = {short: name for short, (name, *others) in found.items() if not others}
    every_name = alone | {name: name for name in names}
    return {short: (name, known[name][1]) for short, name in every_name.items()}


def without_group(name: str) -> str:
    """Return the name of an array without its group in HDF5 or struct in MATLAB."""
    return re.split(r"[/.]", name)[-1]


def name_and_unit(name: str) -> tuple[str, str]:
    """Return name and unit of a column, from names as 'force [mN]', 'x / mm', 'x (mm)', 'x mm'."""
    match = UNIT.fullmatch(name.strip())
    if not match:
        return name.strip(), ""
    lower = match[2].lower()
    return match[1], lower if lower in LENGTHS.split("|") else match[2]


def columns_by_id(template: str, actuators: Layout, there: Collection[str]) -> list[str]:
    """Return the column of each actuator, named by a template as 'F{id}' with its ID or text.

    Numbers may have zeros before them, and a text may begin with the word of the template.
    """
    names = actuators.names.tolist()
    ways = [
        [template.replace("{id}", name.zfill(digits)) for name in names]
        for digits in range(1, MAX_DIGITS + 1)
    ]
    return next((way for way in (*ways, names) if all(name in there for name in way)), ways[0])


def refuse_other_order(columns: Iterable[object], actuators: Layout) -> None:
    """Refuse columns of actuators, by their names in the order of the table, in another order."""
    numbers = numbers_of_labels(columns)
    if numbers is None or np.array_equal(numbers, actuators.id):
        return
    if np.array_equal(np.sort(numbers), np.sort(actuators.id)):
        raise FormatError(
            f"columns are in the order {listed(columns, 4)}, and actuators are"
            f" {listed(actuators.names, 4)}",
            remedy="put both in one order. If positions are in the order of the columns, give them"
            " a column ID",
        )


def numbers_of_labels(labels: Iterable[object]) -> NDArray[np.int64] | None:
    """Return (m,) numbers of texts as F17, if all have the same word before it; or None."""
    found = [LABEL.fullmatch(str(label).strip()) for label in labels]
    if not all(found) or len({match[1] for match in found if match}) != 1:
        return None
    return np.array([int(match[2]) for match in found if match])


def cycles_from_arrays(
    mirror: Mapping[str, Any],
    loads: Any,
    date: datetime.datetime | None,
    units: Mapping[str, str],
) -> Iterator[Cycle]:
    """Yield cycles; ``mirror`` contains the values of `Cycle` that all have in common.

    A cycle without a date begins one second after the end of the one before: its times are assumed.
    """
    start = date or datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    if not isinstance(loads, Mapping):
        raise FormatError("loads is no dictionary", remedy="give {load: [cycle, ...], ...}")
    require_loads(loads)
    _require_names(units, (), ("positions", *ARRAYS))
    for load, runs in loads.items():
        for number, arrays in enumerate([runs] if isinstance(runs, Mapping) else runs, 1):
            if not isinstance(arrays, Mapping):
                remedy = "give a dictionary with force, shape and sign"
                raise FormatError(f"a cycle of load '{load.name}' is {type(arrays)}", remedy=remedy)
            with naming(f"load '{load.name}', cycle {arrays.get('number', number)}"):
                usual = {"number": number, "date": start, "load": load}
                usual["times"] = None if date is not None and start == date else ASSUMED
                cycle = _cycle_from(_in_si(arrays, units), usual, mirror)
            yield cycle
            end = float(np.max(cycle.time, where=cycle.valid, initial=0.0))
            start = cycle.date + datetime.timedelta(seconds=end + 1.0)


def require_loads(loads: Iterable[object]) -> None:
    """Raise FormatError for anything but a load."""
    for load in loads:
        if not isinstance(load, Load):
            weight = "" if load == "bare" else ", added, added_error"
            raise FormatError(
                f"loads names {load!r} without its added weight",
                remedy=f"give tn.Load({str(load)!r}{weight}) instead of the name",
            )


def _in_si(arrays: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """Return arrays of a cycle in the units of `Cycle`, if they have another unit."""
    return {
        name: in_unit(values, Cycle.QUANTITIES[name].unit, name, has=units.get(name) or None)
        if name in ARRAYS
        else values
        for name, values in arrays.items()
    }


def _cycle_from(
    arrays: Mapping[str, Any], usual: Mapping[str, Any], mirror: Mapping[str, Any]
) -> Cycle:
    """Return a cycle of arrays with the values that are usual unless they are given."""
    _require_names(arrays, REQUIRED, OF_CYCLE)
    values = {**usual, **{k: v for k, v in arrays.items() if v is not None}}
    rows = len(np.atleast_1d(values["shape"]))
    if arrays.get("date") is not None:
        values["times"] = None
    if "time" not in values:
        values["times"] = ASSUMED
    time = np.asarray(values.setdefault("time", np.arange(rows, dtype=float)))
    if time.dtype.kind == "M":  # dates
        values["times"] = None
        first = time.min().astype("datetime64[us]").astype(datetime.datetime)
        values["date"] = first.replace(tzinfo=datetime.UTC)
        values["time"] = (time - time.min()) / np.timedelta64(1, "s")
    values.setdefault("valid", np.ones(rows, dtype=bool))
    for name in MATRICES:
        refuse_other_order(getattr(values.get(name), "columns", ()), mirror["layout"])
    return Cycle(**mirror, **values)


def _require_names(names: Iterable[str], required: Sequence[str], allowed: Sequence[str]) -> None:
    """Raise FormatError if a required name is missing, or one is not allowed."""
    for name in required:
        if name not in names:
            raise FormatError(f"there is no '{name}'", remedy=f"give {', '.join(required)}")
    for name in names:
        if name not in allowed:
            raise FormatError(f"'{name}' is unknown", remedy=f"choose {', '.join(allowed)}")


def wide_rows(values: Mapping[str, NDArray[Any]], actuators: Layout) -> dict[str, Any]:
    """Return the arrays of one cycle, (rows, n) forces, of a table with (m,) readings.

    Rows are in the order of their first readings.
    """
    at = {name: k for k, name in enumerate(actuators.names.tolist())}
    ids = integers_or_texts(values["actuator"])
    if not set(at) >= set(ids.astype(np.str_).tolist()) and ids.dtype.kind == "U":
        numbers = numbers_of_labels(ids.tolist())  # F17 of an actuator that is 17 in the layout
        ids = ids if numbers is None else numbers
    texts = ids.astype(np.str_).tolist()
    if unknown := [text for text in dict.fromkeys(texts) if text not in at]:
        raise FormatError(
            f"there is no actuator {listed(unknown, 3)}",
            remedy=f"give the IDs of the positions, {listed(at, 3)}; columns id, x and"
            " y of a table of positions, or tn.layout(x, y, id=...), may have any texts",
        )
    column = np.array([at[text] for text in texts])
    keys = [name for name in ("shape", "sign", "row") if name in values]
    row, first = _numbered(values, keys)
    if _twice(row, column, actuators.n) is not None and "time" in values:
        row, first = _numbered(values, [*keys, "time"])
    if (twice := _twice(row, column, actuators.n)) is not None:
        shape, sign = (str(values[name][twice]).removesuffix(".0") for name in ("shape", "sign"))
        raise FormatError(
            f"actuator {values['actuator'][twice]} has two readings of shape {shape} with sign"
            f" {sign}",
            remedy="add a column 'row' that numbers the readings of the mirror",
        )
    arrays: dict[str, Any] = {}
    for name in ARRAYS:
        if name in MATRICES and name in values:
            arrays[name] = np.full((len(first), actuators.n), np.nan)
            arrays[name][row, column] = values[name]
        elif name in values:
            arrays[name] = values[name][first]
    return arrays


def _numbered(
    values: Mapping[str, NDArray[Any]], keys: Sequence[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (m,) the row of each reading, and the first reading of each row, in its order."""
    every = [np.unique(values[key], return_inverse=True)[1] for key in keys]
    _, first, row = np.unique(np.stack(every), axis=1, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return np.argsort(order)[np.ravel(row)], first[order]


def _twice(row: NDArray[np.int64], column: NDArray[np.int64], n: int) -> int | None:
    """Return the first of (m,) readings whose row and column are those of an earlier one."""
    _, first = np.unique(row * n + column, return_index=True)
    again = np.setdiff1d(np.arange(row.size), first)
    return int(again[0]) if again.size else None
