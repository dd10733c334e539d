"""Positions and cycles from arrays and tables, as programs and laboratories have them."""

from __future__ import annotations

import datetime
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import Fault, FormatError, GeometryError, naming
from truenewton.files.tables import LENGTHS, Item, columns_in, name_and_unit, without_group
from truenewton.quantities import in_unit, numbers_of, unit_of
from truenewton.records.cycle import ARRAYS, ASSUMED, Cycle
from truenewton.rounding import listed
from truenewton.statics.layout import Layout, integers_or_texts, layout
from truenewton.statics.load import GRAVITY, Load

REQUIRED = ("force", "shape", "sign")
OF_CYCLE = (*ARRAYS, "date", "number")
MATRICES = ("force", "position")  # with a value for each actuator
ID_NAMES = ("id", "ids", "actuator", "act", "aktuator", "coil", "index", "number", "no", "nr",
            "channel", "channels", "chan", "ch", "name", "label")  # fmt: skip
USED = ("x", "y", "nz", "enabled", "segment", *ID_NAMES)  # columns of positions
POLAR = {"r", "rho", "radius"}, {"theta", "phi", "angle", "azimuth"}
LABEL = re.compile(r"([^\W\d]*)[ _-]?(\d+)")  # a number with a word before it, as F17
MAX_DIGITS = 4  # of an ID with zeros before it, as F0017
# Thickness of a disc of glass as large and heavy as the mirror, magnets included: 3 to 3.5 mm for
# P45, MMT336, LBT672 and MAG585. A length that is wrong by a factor of 10 changes it by 100.
GLASS_DENSITY = 2530.0  # [kg/m3]
LIKELY_THICKNESS, POSSIBLE_THICKNESS = (3e-4, 0.03), (3e-6, 3.0)  # [m]


@dataclass(frozen=True, eq=False)
class Positions:
    """Positions as in a file, or in metres.

    Attributes
    ----------
    x, y, unit
        (n,) in a unit; '' if the file declares none.
    ids, nz, enabled, segment
        (n,) or None; IDs are integers or texts, NZ is the cosine between force and +z.
    columns
        Names of all columns of numbers in the file, if they have names.
    notes
        Texts on what was found and done.
    """

    x: Any
    y: Any
    unit: str = ""
    ids: NDArray[Any] | None = None
    nz: Any = None
    enabled: NDArray[np.bool_] | None = None
    segment: NDArray[np.int64] | None = None
    columns: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def part(self, rows: Any) -> Positions:
        """Return the positions of some rows."""
        some: dict[str, Any] = {
            name: None if (values := getattr(self, name)) is None else np.asarray(values)[rows]
            for name in ("x", "y", "nz", "ids", "enabled", "segment")
        }
        return replace(self, **some)

    def layout(self) -> Layout:
        """Return the actuators, at places in metres if there is no unit."""
        x, y = (in_unit(each, "m", "positions", has=self.unit or None) for each in (self.x, self.y))
        others = {"id": self.ids, "nz": self.nz, "enabled": self.enabled, "segment": self.segment}
        return layout(x, y, **others)


def positions_of(item: Item) -> Positions:
    """Return positions of an (n, 2) or (2, n) array, or of columns ID, X, Y."""
    values = item.values
    if values.ndim != 2 or (2 not in values.shape and 3 not in values.shape):
        raise FormatError(
            f"contains an array of shape {values.shape}, which are no positions",
            remedy="give (n, 2) or (2, n), or columns named X and Y",
        )
    if values.shape[1] not in (2, 3) or (values.shape[0] in (2, 3) and values.shape[1] > 3):
        values = values.T
    if values.shape[1] == 3:
        first = values[:, 0]
        if not _integers(first) or np.unique(first).size != first.size:
            raise FormatError(
                "has three columns without names, the first no numbers of actuators",
                remedy="name them in the first line: X, Y, NZ or ID, X, Y",
            )
        return Positions(values[:, 1], values[:, 2], item.unit, ids=first.astype(np.int64))
    return Positions(values[:, 0], values[:, 1], item.unit)


def positions_by_columns(columns: Mapping[str, Item]) -> Positions | None:
    """Return positions from columns named X and Y, with ID, NZ and ENABLED if they exist."""
    known: dict[str, Item] = {}
    for name, item in columns.items():
        plain, unit = _axis_and_unit(without_group(name))
        if plain in USED and plain in known:
            some = [n for n in columns if _axis_and_unit(without_group(n))[0] == plain]
            fault = f"several columns may be {plain.upper()}: {', '.join(some)}"
            raise FormatError(fault, remedy="keep one of them")
        known[plain] = item._replace(unit=item.unit or unit)
    if "x" not in known or "y" not in known:
        if POLAR[0].intersection(known) and POLAR[1].intersection(known):
            raise FormatError(
                f"contains polar coordinates, {' and '.join(columns)}",
                remedy="give X and Y, both in a unit of length",
            )
        return None
    x, y = known["x"], known["y"]
    if y.unit != x.unit:
        raise FormatError(f"X is in '{x.unit}' and Y in '{y.unit}'", remedy="give both in one unit")
    nz, enabled, segment = (
        known[name].numbers(name.upper()) if name in known else None
        for name in ("nz", "enabled", "segment")
    )
    named = {name: known[name].values for name in ID_NAMES if name in known}
    ids = [v for name, v in named.items()
           if name == "id" or np.asarray(v).dtype.kind != "f" or _integers(v)]  # fmt: skip
    return Positions(
        x.numbers("X"),
        y.numbers("Y"),
        x.unit,
        integers_or_texts(ids[0]) if ids else None,
        nz,
        None if enabled is None else np.asanyarray(enabled) != 0,
        None if segment is None else np.asanyarray(segment).astype(np.int64),
        tuple(columns),
    )


def _axis_and_unit(name: str) -> tuple[str, str]:
    """Return axis, or name, and unit of a column, from names as 'x [mm]', 'X_mm', 'pos_x'."""
    plain, unit = name_and_unit(name.lower())
    if match := re.fullmatch(rf"(.+?)_({LENGTHS})", plain):
        plain, unit = match.groups()
    for word in ("pos", "position", "coord", "coordinate", "act", "actuator"):
        for axis in "xy":
            if re.sub(r"[\s_]", "", plain) in (axis + word, word + axis):
                return axis, unit
    return plain.strip(" _[]()"), unit


def _integers(values: Any) -> bool:
    exact = np.abs(values) < 2.0**53  # as all integers below it; not NaN or inf
    return bool(exact.all() and (values == np.round(values)).all())


def positions_from(given: Any, unit: str = "") -> Positions:
    """Return the positions in columns x and y, in a pair (x, y), or in an array."""
    if isinstance(given, tuple | list) and len(given) == 2:
        at: Positions | None = Positions(*given)
    else:
        columns = {name: given[name] for name, _ in columns_in(given).values()}
        items = {name: c if isinstance(c, Item) else Item(c) for name, c in columns.items()}
        at, table = positions_by_columns(items), isinstance(given, Mapping)
        if at is None and (table or (columns and np.asarray(given).dtype.kind not in "fiu")):
            fault = f"positions have no columns x and y, but {listed(columns) or 'no names'}"
            raise FormatError(fault, remedy="name two columns x and y")
    if at is None:
        values = numbers_of(getattr(given, "value", given), "positions", float)
        return positions_of(Item(values, str(unit_of(given) or unit)))
    own = any(unit_of(each) is not None for each in (at.x, at.y))
    has = unit or at.unit
    x, y = (in_unit(each, "m", "positions", has=has or None) for each in (at.x, at.y))
    return replace(at, x=x, y=y, unit="m" if has or own else "")


def layout_of(positions: Any, enabled: Any = None, unit: str = "") -> Layout:
    """Return a layout, or that of positions, which are in metres if they have no unit."""
    made = positions if isinstance(positions, Layout) else positions_from(positions, unit).layout()
    return made if enabled is None else replace(made, enabled=enabled)


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
