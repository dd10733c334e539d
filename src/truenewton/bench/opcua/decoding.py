"""Where asyncua 2.1 decodes without end, an end: lengths below zero, and arrays of nothing.

Either makes a message of twenty bytes as many values as it declares, on the server's side and on
the client's. There is no hook for it: the library is put right where this is imported.
"""

from __future__ import annotations

from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer, NotEnoughData
from asyncua.ua import ua_binary

_read, _array = Buffer.read, ua_binary.unpack_uatype_array


def _read_forward(self: Buffer, size: int) -> bytes:
    if size < 0:  # would go back, to read the same again
        raise NotEnoughData(f"a length of {size}")
    data: bytes = _read(self, size)
    return data


def _array_of_something(vtype: ua.VariantType, data: Any) -> list[Any] | None:
    if vtype is ua.VariantType.Null:
        raise ua.UaError("an array of nothing")
    values: list[Any] | None = _array(vtype, data)
    return values


Buffer.read = _read_forward
ua_binary.unpack_uatype_array = _array_of_something
