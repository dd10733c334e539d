"""Cycles from arrays and from long tables, as programs and laboratories have them."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, naming
from truenewton.quantities import in_unit
from truenewton.records.cycle import ARRAYS, Cycle
from truenewton.rounding import listed
from truenewton.statics.layout import Layout, layout
from truenewton.statics.load import Load

REQUIRED = ("force", "shape", "sign")
OF_CYCLE = (*ARRAYS, "date", "number")
OF_TABLE = ("load", "cycle", "actuator", "row", *ARRAYS)


def layout_of(positions: Any, enabled: Any = None) -> Layout:
    """Return a layout, or that of a pair of (n,) x and y [m]."""
    if isinstance(positions, Layout):
        return positions if enabled is None else replace(positions, enabled=enabled)
    if len(positions) != 2:
        raise FormatError("positions are not a pair", remedy="give (x, y), or a layout")
    return layout(*positions, enabled=enabled)


def cycles_from_arrays(
    mirror: Mapping[str, Any],
    loads: Mapping[Load, Sequence[Mapping[str, Any]]],
    date: datetime.datetime | None,
) -> Iterator[Cycle]:
    """Yield cycles; ``mirror`` contains the values of `Cycle` that all have in common.

    A cycle without a date begins one second after the end of the one before.
    """
    start = date or datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    for load, runs in loads.items():
        for number, arrays in enumerate(runs, 1):
            with naming(f"load '{load.name}', cycle {arrays.get('number', number)}"):
                cycle = _cycle_from(arrays, {"number": number, "date": start, "load": load}, mirror)
            yield cycle
            end = float(np.max(cycle.time, where=cycle.valid, initial=0.0))
            start = cycle.date + datetime.timedelta(seconds=end + 1.0)


def _cycle_from(
    arrays: Mapping[str, Any], usual: Mapping[str, Any], mirror: Mapping[str, Any]
) -> Cycle:
    """Return a cycle of arrays with the values that are usual unless they are given."""
    _require_names(arrays, REQUIRED, OF_CYCLE)
    values = {**usual, **{k: v for k, v in arrays.items() if v is not None}}
    rows = np.shape(values["force"])[0]
    time = np.asarray(values.setdefault("time", np.arange(rows, dtype=float)))
    if time.dtype.kind == "M":  # dates
        first = time.min().astype("datetime64[us]").astype(datetime.datetime)
        values["date"] = first.replace(tzinfo=datetime.UTC)
        values["time"] = (time - time.min()) / np.timedelta64(1, "s")
    values.setdefault("valid", np.ones(rows, dtype=bool))
    return Cycle(**mirror, **values)


def _require_names(names: Iterable[str], required: Sequence[str], allowed: Sequence[str]) -> None:
    """Raise FormatError if a required name is missing, or one is not allowed."""
    for name in required:
        if name not in names:
            raise FormatError(f"there is no '{name}'", remedy=f"give {', '.join(required)}")
    for name in names:
        if name not in allowed:
            raise FormatError(f"'{name}' is unknown", remedy=f"choose {', '.join(allowed)}")


def cycles_in_table(
    table: Any,
    actuators: Layout,
    loads: Sequence[Load],
    columns: Mapping[str, str],
    units: Mapping[str, str],
) -> dict[Load, list[dict[str, Any]]]:
    """Return the arrays of each cycle of each load in a table with one row for each reading."""
    import astropy.units as u

    there = list(getattr(table, "columns", table))
    _require_names(columns, (), OF_TABLE)
    known = {name: columns.get(name, name) for name in OF_TABLE}
    used = {name: table[of] for name, of in known.items() if of in there}
    required = ("load", "actuator", *REQUIRED)
    if missing := [known[name] for name in required if name not in used]:
        remedy = f"name it by columns={{...}}; there is {', '.join(map(str, there))}"
        raise FormatError(f"the table has no column '{missing[0]}'", remedy=remedy)
    for name, unit in units.items():
        _require_names([name], (), [one for one in ARRAYS if one in used])
        used[name] = u.Quantity(np.asarray(used[name]), unit)
    values = {
        name: np.asarray(in_unit(column, Cycle.QUANTITIES[name].unit, name))
        if name in ARRAYS
        else np.asarray(column)
        for name, column in used.items()
    }
    of_load = np.array([str(name).strip().casefold() for name in values["load"]])
    if unknown := sorted(set(of_load) - {load.key for load in loads}):
        raise FormatError(
            f"the table has the load '{unknown[0]}'",
            remedy=f"give it in loads; there are {', '.join(load.name for load in loads)}",
        )
    number = values.get("cycle", np.ones(len(of_load), dtype=np.int64))
    found: dict[Load, list[dict[str, Any]]] = {}
    for load in loads:
        mine = of_load == load.key
        if not mine.any():
            raise FormatError(f"the table has no row of the load '{load.name}'", remedy="add it")
        found[load] = []
        for k in np.unique(number[mine]):
            with naming(f"load '{load.name}', cycle {k}"):
                some = mine & (number == k)
                one = {name: column[some] for name, column in values.items()}
                found[load].append({"number": int(k), **wide_rows(one, actuators)})
    return found


def wide_rows(values: Mapping[str, NDArray[Any]], actuators: Layout) -> dict[str, Any]:
    """Return the arrays of one cycle, (rows, n) forces, of a table with (m,) readings.

    Rows are in the order of their first readings.
    """
    at = {name: k for k, name in enumerate(actuators.id.tolist())}
    if unknown := set(values["actuator"].tolist()) - set(at):
        raise FormatError(f"there is no actuator {listed(sorted(unknown), 3)}", remedy="check IDs")
    column = np.array([at[name] for name in values["actuator"].tolist()])
    keys = [name for name in ("shape", "sign", "row") if name in values]
    row, first = _numbered(values, keys)
    if _twice(row, column, actuators.n) is not None and "time" in values:
        row, first = _numbered(values, [*keys, "time"])
    if (twice := _twice(row, column, actuators.n)) is not None:
        raise FormatError(
            f"actuator {values['actuator'][twice]} has two readings of shape"
            f" {values['shape'][twice]} with sign {values['sign'][twice]}",
            remedy="add a column 'row' that numbers the readings of the mirror",
        )
    arrays: dict[str, Any] = {}
    for name in ARRAYS:
        if name in ("force", "position") and name in values:
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
