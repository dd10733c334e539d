"""The variables and methods of a bench's node: what each takes, and what it gives after the fault.

A list is an array. A fault is empty, or three texts: the error's name, what is wrong, the remedy.
"""

from __future__ import annotations

import datetime
from collections.abc import Collection, Iterable
from typing import Any

import numpy as np
from asyncua import ua

from truenewton.errors import BenchFault
from truenewton.rounding import counted
from truenewton.statics.layout import Layout

Type = ua.VariantType
Arguments = list[tuple[str, Any]]
VARIABLES: Arguments = [
    ("Instrument", Type.String), ("Gap", Type.Double), ("Gradients", [Type.Double]),
    ("Id", [Type.Int64]), ("X", [Type.Double]), ("Y", [Type.Double]), ("Nz", [Type.Double]),
    ("Enabled", [Type.Boolean]),
]  # fmt: skip
METHODS: dict[str, tuple[Arguments, Arguments]] = {
    "PutOn": ([("Load", Type.String)], []),
    "Command": (
        [("Load", Type.String), ("Cycle", Type.Int32), ("Number", Type.Int32),
         ("Sign", Type.Int32), ("Position", [Type.Double])],
        [],
    ),
    "Read": (
        [("Samples", Type.Int32)],
        [("Time", Type.DateTime), ("Force", [Type.Double]), ("Position", [Type.Double]),
         ("ForceScatter", [Type.Double]), ("PositionScatter", [Type.Double]),
         ("Temperature", Type.Double), ("Counter", Type.Int64), ("Settled", Type.Boolean),
         ("ForceError", [Type.Double])],
    ),
    "Status": (
        [], [("Ready", Type.Boolean), ("Message", Type.String), ("Counter", Type.Int64)]
    ),
    "Rest": ([], []),
}  # fmt: skip
# What a server may leave out.
OPTIONAL = frozenset({"Gradients", "Enabled", "PutOn", "ForceError"})
PYTHON_TYPES: dict[ua.VariantType, tuple[type, ...]] = {
    Type.String: (str,),
    Type.Boolean: (bool,),
    Type.Int32: (int,),
    Type.Int64: (int,),
    Type.Double: (float, int),
    Type.DateTime: (datetime.datetime,),
}
MAX_MESSAGE = 2 * 2**20  # of 50,000 actuators [bytes]
MAX_TEXT_LENGTH = 1000  # characters, to which texts of a server are cut
COLUMNS = ("Id", "X", "Y", "Nz", "Enabled")  # of the layout


def variants(values: Iterable[Any], kinds: Arguments) -> list[ua.Variant]:
    """Return values, also those of numpy, as OPC UA sends them."""
    sent = []
    for value, (_, kind) in zip(values, kinds, strict=True):
        if value is None and isinstance(kind, list):
            value = []
        plain = value.tolist() if hasattr(value, "tolist") else value
        sent.append(ua.Variant(plain, scalar(kind)))
    return sent


def scalar(kind: Any) -> Any:
    """Return the type of a value, or of an array's values."""
    return kind[0] if isinstance(kind, list) else kind


def received(name: str, value: Any, kind: Any) -> Any:
    """Return a value from a server, an array of numbers as (n,) numpy; refuse another type."""
    type_, array = scalar(kind), isinstance(kind, list)
    values = ([] if value is None else value) if array else [value]
    if not isinstance(values, list) or any(type(one) not in PYTHON_TYPES[type_] for one in values):
        want = f"{type_.name}[]" if array else type_.name
        raise BenchFault(f"gives {name} as {value!r:.60}", remedy=f"it is {want}")
    if array and type_ is Type.Double and values and all(isinstance(one, int) for one in values):
        # Places in whole metres, forces in whole newtons.
        raise BenchFault(f"gives {name} as whole numbers", remedy="it is Double[]")
    if type_ is Type.String:
        values = [one[:MAX_TEXT_LENGTH] for one in values]
        return values if array else values[0]
    if array:
        return np.array(values, dtype=PYTHON_TYPES[type_][0])
    return float(value) if type_ is Type.Double else value


def received_answer(method: str, values: list[Any]) -> tuple[list[str], list[Any]]:
    """Return the fault of a method, and what it gives if there is none."""
    fault = received("Fault", values[0] if values else None, [Type.String])
    given, declared = values[1:], METHODS[method][1]
    if fault:
        if len(fault) != 3 or not fault[1]:
            raise BenchFault(
                f"gives Fault as {fault!r:.60}", remedy="it is empty, or kind, fault and remedy"
            )
        return fault, []
    if declared and declared[-1][0] in OPTIONAL and len(given) == len(declared) - 1:
        given.append(None)
    if len(given) != len(declared):
        raise BenchFault(
            f"gives {counted(given, 'value')} after the fault, where {len(declared)} are due",
            remedy=f"they are {', '.join(name for name, _ in declared) or 'none'}",
        )
    each = zip(given, declared, strict=True)
    return [], [received(name, value, kind) for value, (name, kind) in each]


def mirror_of(
    values: dict[str, Any], methods: Collection[str]
) -> tuple[str, float, tuple[float | None, float | None], Layout]:
    """Return instrument, gap [m], gradients and layout from the nodes of a server."""
    for name in (*dict(VARIABLES), *METHODS):
        if name not in OPTIONAL and name not in values and name not in methods:
            raise BenchFault(f"has no node Bench.{name}", remedy="add it, in urn:truenewton:bench")
    given = {
        name: received(f"Bench.{name}", values[name], kind)
        for name, kind in VARIABLES
        if name in values
    }
    size = len(given["Id"])
    given = {"Enabled": np.ones(size, dtype=bool)} | given
    columns = [given[name] for name in COLUMNS]
    for name, column in zip(COLUMNS, columns, strict=True):
        if len(column) != size or not size:
            raise BenchFault(
                f"gives {counted(column, 'value')} of Bench.{name} for {counted(size, 'actuator')}",
                remedy="one for each actuator",
            )
    gradients = given.get("Gradients", np.full(2, np.nan))
    if len(gradients) != 2:
        raise BenchFault(
            f"gives {counted(gradients, 'value')} of Bench.Gradients",
            remedy="they are two, NaN where unknown",
        )
    coil, bias = (None if np.isnan(value) else float(value) for value in gradients)
    return given["Instrument"], given["Gap"], (coil, bias), Layout(*columns)
