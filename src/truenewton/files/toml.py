"""TOML tables, checked against the dataclass that they fill."""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile, naming
from truenewton.files.opening import read_text
from truenewton.rounding import counted

Filled = TypeVar("Filled")
NAMES = {float: "a number", int: "an integer", str: "text", bool: "true or false",
         datetime.datetime: "a date and time"}  # fmt: skip


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the tables of a TOML file."""
    try:
        return tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UnreadableFile(
            f"is not TOML ({error})", remedy="correct it; key = value, text in quotes", path=path
        ) from error


def filled(kind: type[Filled], table: Mapping[str, Any], path: object) -> Filled:
    """Return a dataclass filled from a table of a file; the values must have its types.

    The fields are numbers, texts, tuples, other such dataclasses, or tuples of them.
    """
    with naming(path):
        return _filled(kind, table, "", ())


def _filled(
    kind: type[Filled], table: Mapping[str, Any], where: str, above: Sequence[str]
) -> Filled:
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    prefix = _prefix(where)
    check_keys(table, tuple(fields), where, above)
    hints, values = get_type_hints(kind), {}
    for name, field in fields.items():
        if name in table:
            inside = f"{where}.{name}" if where else name
            values[name] = _value(hints[name], table[name], inside, tuple(fields))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise FormatError(f"{prefix}lacks '{name}'", remedy="add it")
    try:
        return kind(**values)
    except TrueNewtonError as error:
        raise error.changed(fault=f"{prefix}{error.fault}") from None


def check_keys(
    table: Mapping[str, Any], known: Sequence[str], where: str, above: Sequence[str] = ()
) -> None:
    """Refuse the first key of a table that is none of those known; it may belong ``above``."""
    for key in table:
        if key in known:
            continue
        meant = f"the keys are {', '.join(known)}"
        if key in above:
            meant = f"write it above [{where}]"
        elif close := get_close_matches(key, known, 1):
            meant = f"did you mean '{close[0]}'? {meant}"
        raise FormatError(f"{_prefix(where)}knows no '{key}'", remedy=meant)


def _prefix(where: str) -> str:
    return f"[{where}] " if where else ""


def _value(kind: Any, value: Any, where: str, above: Sequence[str]) -> Any:
    if get_origin(kind) in (Union, UnionType):
        kinds = [part for part in get_args(kind) if part is not type(None)]
        kind = next((part for part in kinds if type(value) is part), kinds[0])
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        if isinstance(value, Mapping):
            return _filled(kind, value, where, above)
        raise _wrong(where, "a table", value)
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        if not isinstance(value, list) or (inner[-1] is not ... and len(value) != len(inner)):
            raise _wrong(where, "a list" if inner[-1] is ... else counted(inner, "value"), value)
        return tuple(_value(inner[0], part, where, above) for part in value)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if abs(value) < 1e300 else math.inf
    if isinstance(value, str) and "\0" in value:  # no name of a file can hold it
        raise _wrong(where, "text without null characters", value)
    if type(value) is not kind or (kind is float and math.isnan(value)):
        raise _wrong(where, NAMES[kind], value)
    return value


def toml_text(record: Any) -> str:
    """Return a dataclass as TOML that `filled` takes back; None is left out."""
    return "\n".join(_lines(record, "")) + "\n"


def _lines(record: Any, where: str) -> list[str]:
    own, below = [], []
    for field in dataclasses.fields(record):
        name, value = field.name, getattr(record, field.name)
        inside = f"{where}.{name}" if where else name
        if dataclasses.is_dataclass(value):
            below += ["", f"[{inside}]", *_lines(value, inside)]
        elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            for part in value:
                below += ["", f"[[{inside}]]", *_lines(part, inside)]
        elif value is not None:
            own.append(f"{name} = {_written(value)}")
    return own + below


def _written(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, float):
        return repr(float(value))
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _wrong(where: str, want: str, got: Any) -> FormatError:
    shown = repr(got)[:60]
    return FormatError(f"{where} is {shown}", remedy=f"give {want}")
