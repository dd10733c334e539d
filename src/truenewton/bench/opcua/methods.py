"""The variables and methods of a bench's node: what each takes and, after the fault, gives.

A list is an array. A fault is no text or three: the error's name, what is wrong, the remedy.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from asyncua import ua

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
         ("Temperature", Type.Double), ("Counter", Type.Int64), ("Settled", Type.Boolean)],
    ),
    "Status": (
        [], [("Ready", Type.Boolean), ("Message", Type.String), ("Counter", Type.Int64)]
    ),
    "Rest": ([], []),
}  # fmt: skip


def variants(values: Iterable[Any], kinds: Arguments) -> list[ua.Variant]:
    """Return values, numpy's too, as OPC UA sends them."""
    return [
        ua.Variant(value.tolist() if hasattr(value, "tolist") else value, scalar(kind))
        for value, (_, kind) in zip(values, kinds, strict=True)
    ]


def scalar(kind: Any) -> Any:
    """Return the type of a value, or of an array's values."""
    return kind[0] if isinstance(kind, list) else kind
