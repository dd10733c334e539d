"""Which of a file's arrays is the matrix, and which are the positions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from truenewton.errors import FormatError
from truenewton.foreign.stored import Item, Stored
from truenewton.foreign.text import LENGTHS

MATRIX_NAMES = ("stiffness", "ffwd", "ff_matrix", "ff", "ffmatrix", "feedforward", "feed_forward")
POSITION_NAMES = ("coordinates", "coords", "act_coordinates", "act_coord", "positions", "xy")
UNIT = re.compile(rf"(.*?)[\s_]*(?:/|\bin\b)?[\s_]*[\[(]?\b({LENGTHS})[\])]?")
POLAR = {"r", "rho", "radius"}, {"theta", "phi", "angle", "azimuth"}
ID_NAMES = ("id", "ids", "actuator", "act", "aktuator", "coil", "index", "number", "no", "nr",
            "channel", "ch")  # fmt: skip
MOST_NAMED = 8  # arrays and columns of a file


class Places(NamedTuple):
    """Positions as they stand in a file: their unit or ''; what else stands beside them.

    `columns` are the names of all columns of numbers, if positions have names.
    """

    x: Any
    y: Any
    unit: str = ""
    ids: Any = None
    nz: Any = None
    enabled: Any = None
    columns: tuple[str, ...] = ()


def matrix_in(stored: Stored, dataset: str | None) -> tuple[Item, str]:
    """Return the (n, n) matrix of a file, or (shells, n, n) matrices; which of several, in words.

    Raises
    ------
    FormatError
        There is none, or several.
    """
    items = {name: Item(np.squeeze(item.values), item.unit) for name, item in stored.arrays.items()}
    if dataset is not None:
        named = [item for name, item in items.items() if name.lower() == dataset.lower()]
        if not named:
            raise FormatError(
                f"has no array '{dataset}'", remedy=there_is(stored), path=stored.path
            )
        items = {dataset: named[0]}
    square = {
        name: item
        for name, item in items.items()
        if item.values.ndim in (2, 3)
        and item.values.shape[-1] == item.values.shape[-2]
        and item.values.shape[-1] > 2
    }
    every = square
    if len(square) > 1:
        known = {n: i for n, i in square.items() if n.lower().split("/")[-1] in MATRIX_NAMES}
        square = known or square
    if len(square) != 1:
        fault = f"holds {len(square)} square matrices" if square else "holds no square matrix"
        many = "say which by --dataset (dataset=): " + ", ".join(square)
        raise FormatError(fault, remedy=many if square else _none_square(stored), path=stored.path)
    ((name, item),) = square.items()
    return item, f", '{name}' of {', '.join(every)}" if len(every) > 1 else ""


def places_in(stored: Stored) -> Places | None:
    """Return the positions of a file: columns X and Y, or an (n, 2) or (2, n) array; or None.

    Raises
    ------
    FormatError
        An array may be read in two ways.
    """
    every = {name: Item(np.squeeze(item.values), item.unit) for name, item in stored.arrays.items()}
    vectors = {name: item for name, item in every.items() if item.values.ndim == 1}
    named = _by_columns({**vectors, **stored.columns}, stored.path)
    if named is not None:
        return named
    arrays = {name: item for name, item in every.items() if item.values.ndim == 2}
    known = {n: i for n, i in arrays.items() if n.lower().split("/")[-1] in POSITION_NAMES}
    fitting = known or {n: i for n, i in arrays.items() if min(i.values.shape) in (2, 3)}
    if not fitting:
        return None
    if len(fitting) > 1:
        remedy = "give positions in a file of their own"
        several = f"several arrays may be positions: {', '.join(fitting)}"
        raise FormatError(several, remedy=remedy, path=stored.path)
    return _by_array(next(iter(fitting.values())), stored.path)


def as_places(values: Any, unit: str = "") -> Places:
    """Return positions of an (n, 2) or (2, n) array.

    Raises
    ------
    FormatError
    """
    return _by_array(Item(np.asarray(values, dtype=float), unit), "positions")


def _by_array(item: Item, path: str) -> Places:
    values = item.values
    if values.ndim != 2 or (2 not in values.shape and 3 not in values.shape):
        raise FormatError(
            f"holds an array of shape {values.shape}, which are no positions",
            remedy="give (n, 2) or (2, n), or columns named X and Y",
            path=path,
        )
    if values.shape[1] not in (2, 3) or (values.shape[0] in (2, 3) and values.shape[1] > 3):
        values = values.T
    if values.shape[1] == 3:
        first = values[:, 0]
        if not _integers(first) or np.unique(first).size != first.size:
            raise FormatError(
                "has three columns without names, the first no numbers of actuators",
                remedy="name them in the first line: X, Y, NZ or ID, X, Y",
                path=path,
            )
        return Places(values[:, 1], values[:, 2], item.unit, ids=first.astype(np.int64))
    return Places(values[:, 0], values[:, 1], item.unit)


def _by_columns(columns: Mapping[str, Item], path: str) -> Places | None:
    """Return positions from columns whose names say what they are."""
    known: dict[str, Item] = {}
    for name, item in columns.items():
        plain, unit = _name_and_unit(name)
        known.setdefault(plain, Item(item.values, item.unit or unit))
    if "x" not in known or "y" not in known:
        if POLAR[0].intersection(known) and POLAR[1].intersection(known):
            raise FormatError(
                f"holds polar coordinates, {' and '.join(columns)}",
                remedy="give X and Y, both in a unit of length",
                path=path,
            )
        return None
    x, y = known["x"], known["y"]
    numbers = [known[n].values for n in ID_NAMES if n in known and _integers(known[n].values)]
    nz, enabled = known.get("nz"), known.get("enabled")
    if y.unit != x.unit:
        raise FormatError(
            f"X is in '{x.unit}' and Y in '{y.unit}'", remedy="give both in one unit", path=path
        )
    return Places(
        x.values,
        y.values,
        x.unit,
        numbers[0].astype(np.int64) if numbers else None,
        None if nz is None else nz.values,
        None if enabled is None else enabled.values != 0,
        tuple(columns),
    )


def _name_and_unit(name: str) -> tuple[str, str]:
    """Return what a column is for and its unit, of names as 'x [mm]', 'x / mm', 'X_mm'."""
    text = name.strip().lower()
    match = UNIT.fullmatch(text) or re.fullmatch(rf"(.*?)_({LENGTHS})", text)
    plain, unit = (match[1], match[2]) if match and match[1] else (text, "")
    for word in ("pos", "position", "coord", "coordinate", "act", "actuator"):
        for axis in "xy":
            if re.sub(r"[\s_]", "", plain) in (axis + word, word + axis):
                return axis, unit
    return plain.strip(" _[]()"), unit


def _integers(values: Any) -> bool:
    return bool(np.isfinite(values).all() and (values == np.round(values)).all())


def _none_square(stored: Stored) -> str:
    """Return what to do about a file without a square matrix."""
    shapes = [item.values.shape for item in stored.arrays.values()]
    twice = any(len(shape) == 2 and shape[1] == 2 * shape[0] for shape in shapes)
    commas = ": where commas are decimal ones too, put semicolons between columns" if twice else ""
    return f"give as many rows as columns{commas}; {there_is(stored)}"


def there_is(stored: Stored) -> str:
    """Say which arrays and columns of numbers a file has."""
    parts = [f"{n or 'one'} {item.values.shape}" for n, item in stored.arrays.items()]
    parts += [f"column '{name}'" for name in stored.columns]
    return f"there is {', '.join(parts[:MOST_NAMED])}" if parts else "there are no arrays in it"
