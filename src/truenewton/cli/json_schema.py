"""The JSON Schema of what `--json` prints, from the declared `Values`, records and quantities."""

from __future__ import annotations

import datetime
import functools
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from truenewton.calibration import summary as calibration
from truenewton.calibration.result import CALIBRATION, Calibration
from truenewton.comparison import summary as comparison
from truenewton.estimation.findings.finding import FINDING, VERDICT, Finding, Verdict
from truenewton.files.format import Attribute, TableFormat
from truenewton.files.values import Columns, Values
from truenewton.mirrors.glass import Shell
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import Place
from truenewton.modal import summary as modal
from truenewton.modal.modal_base import Budget
from truenewton.planning import summary as planning
from truenewton.recalibration import summary as recalibration
from truenewton.studies.proof import Proof
from truenewton.tracking import summary as tracking
from truenewton.tracking.law import Validity

Schema = dict[str, Any]
Part = Attribute | Values | Columns
Way = tuple[Part, ...]
VERSION = 2  # of all outputs; it changes if a key changes or is removed
ANY: Schema = {}
TEXT: Schema = {"type": "string"}
TRUTH: Schema = {"type": "boolean"}
COUNT: Schema = {"type": "integer"}
DATE: Schema = {"type": "string", "format": "date-time"}
NUMBER: Schema = {"type": ["number", "null"]}  # null if it is unknown or infinite
SIMPLE = {str: TEXT, bool: TRUTH, int: COUNT, np.int64: COUNT, np.bool_: TRUTH, range: ANY}
SIMPLE |= {datetime.datetime: DATE}
OF_KIND = {"float": float, "bool": bool, "str": str, "date": datetime.datetime}  # others: int


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _or_null(schema: Schema) -> Schema:
    return {"anyOf": [schema, {"type": "null"}]}


def _object(keys: Mapping[str, Schema], optional: tuple[str, ...] = ()) -> Schema:
    required = [key for key in keys if key not in optional]
    return {"type": "object", "properties": dict(keys), "required": required}


def _each(schema: Schema, names: str) -> dict[str, Schema]:
    return dict.fromkeys(names.split(), schema)


def _of_type(hint: Any, way: Way = (), unit: str = "") -> Schema:
    """Return the schema of what a path leads to from a value, by the annotation of the value."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [_of_type(one, way, unit) for one in inner if one is not types.NoneType]
        one = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
        return _or_null(one) if types.NoneType in inner else one
    if origin in (tuple, list):
        return _list(_of_type(inner[0], way, unit))
    if way:
        return _of_part(hint, *way)
    if hint is float or hint is np.float64:
        return NUMBER | ({"unit": unit} if unit else {})
    if origin is np.ndarray:  # of any number of dimensions
        return _list({"anyOf": [_of_type(get_args(inner[1])[0], (), unit), {"type": "array"}]})
    if hint in SIMPLE:
        return SIMPLE[hint]
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [str(each) for each in hint]}
    if hint in (Verdict, Finding):
        return {"$ref": f"#/$defs/{hint.__name__.lower()}"}
    if hasattr(hint, "as_values"):
        return _of_part(hint, "as_values")
    return _object(_of_fields(hint)) if is_dataclass(hint) else ANY


def _of_part(kind: Any, part: Part, *others: Part) -> Schema:
    """Return the schema of what the other parts of a path lead to from a part of a record."""
    if isinstance(part, Columns):
        columns = part.columns.items()
        return _object({name: _list(_of_type(OF_KIND.get(each.kind, int), unit=each.unit or ""))
                        for name, each in columns})  # fmt: skip
    if isinstance(part, Values):
        return _object(_of(part))
    if callable(part):
        return _of_type(get_type_hints(part).get("return"), others)
    owner = getattr(kind, part, None)
    getter = getattr(owner, "fget", None) or getattr(owner, "func", None)
    hint = get_type_hints(getter)["return"] if getter else get_type_hints(kind)[part]
    return _of_type(hint, others, _unit_of(kind, part))


def _of_fields(kind: Any) -> dict[str, Schema]:
    """Return the schemas of the fields of a record that its repr shows."""
    return {each.name: _of_part(kind, each.name) for each in fields(kind) if each.repr}


def _of(declared: Values) -> dict[str, Schema]:
    """Return the schemas of the keys of declared values."""
    return {
        name: _of_type(hint[0]) if hint else _of_type(declared.kind, _way(key))
        for name, (key, *hint) in declared.keys.items()
    }


def _way(key: Part) -> Way:
    """Return the parts of a path; at the end of one to `Values` these themselves."""
    if isinstance(key, Values):
        return (*_way(key.path), key)
    return tuple(filter(None, key.split("."))) if isinstance(key, str) else (key,)


@functools.cache
def _declared_units() -> dict[str, str]:
    """Return the units of the attributes of a calibration, as its file declares them."""
    named = {str(each.attribute): each.unit or "" for each in CALIBRATION.keywords}
    tables = (each for each in CALIBRATION.extensions if isinstance(each, TableFormat))
    return {str(each.attribute): each.unit or "" for t in tables for each in t.columns} | named


def _unit_of(kind: Any, name: str) -> str:
    """Return the unit of an attribute of a record: its quantity, or that of a file."""
    quantity = getattr(kind, "QUANTITIES", {}).get(name)
    return quantity.unit if quantity else _declared_units().get(name, "") * (kind is Calibration)


def _info(calibrated: Schema) -> dict[str, Schema]:
    """Return the keys of `info`, by what the data are."""
    known = {"instrument": TEXT, "actuators": COUNT}
    of_data = known | {"disabled": COUNT, "separation": NUMBER, "faults": _list(ANY)}
    of_data["verdict"] = _or_null(_of_type(Verdict))
    campaign = {"files": _list(TEXT), "shapes": COUNT, **_each(_list(ANY), "loads strange_rows")}
    campaign |= _each(NUMBER, "weight e_weight largest_force noise")
    matrix = _each(NUMBER, "softest median stiffest asymmetry rigid_cost imbalance")
    return {
        "campaign": of_data | campaign,
        "stiffness": of_data | matrix | {"used_modes": COUNT},
        "calibration": calibrated,
    }


def _mirrors() -> list[Schema]:
    """Return the schemas of a mirror in one piece, and of one in segments."""
    one = {"actuators": COUNT, "outline": ANY, **_of_fields(Shell), **_of_fields(Mirror)}
    del one["shell"], one["layout"]
    placed = _object(_of_fields(Place) | one, ("outline",))
    whole = {"name": TEXT, "actuators": COUNT, "segments": _list(placed)}
    return [_object(one, ("outline",)), _object(whole)]


def _outputs() -> dict[str, list[Schema]]:
    """Return the schemas of each output, several if its keys depend on the data."""
    calibrated, moved = _of(calibration.VALUES), _of(recalibration.VALUES)
    tracked = _of(tracking.VALUES) | {"validity": _of_type(Validity)}
    compared = _of(comparison.VALUES)
    modes = _of(modal.VALUES) | {"bases": _list(ANY), "limits": _object(_of_fields(Budget))}
    modes |= {"measured": _object(_of(modal.MEASURED))}
    typical, mirrors = _each(NUMBER, " ".join(planning.TYPICAL)), _mirrors()
    planned = _of(planning.VALUES) | typical | {"target": NUMBER, "reciprocity": ANY}
    planned["ways"] = _list(_object(_of(planning.WAYS)))
    found: Schema = {"type": "object"}
    lines = {"verdict": TEXT, "lines": _list(TEXT), "written": TEXT}
    acquired = {"folder": TEXT, "before": TRUTH, "loads": _list(TEXT), "cycles": COUNT}
    imported = {"instrument": TEXT, "actuators": COUNT, "found": found}
    proofs = _list(_object(_of_fields(Proof) | {"ratio": NUMBER}))
    proven = {"mirror": TEXT, "limit": NUMBER, "passed": TRUTH, "worst": NUMBER, "proofs": proofs}
    info = _info(calibrated).items()
    of_segment = _object({"segment": COUNT, "result": found, "error": TEXT}, ("result", "error"))
    return {
        "info": [_object({"holds": {"const": what}, **keys}) for what, keys in info],
        "calibrate": [_object(calibrated)],
        "recalibrate": [_object(calibrated | moved)],
        "track": [_object(tracked, ("validity",))],
        "compare": [_object(compared), _object(_of(comparison.CHANGE_VALUES))],
        "modes": [_object(modes, ("measured",))],
        "plan": [_object(planned)],
        "acquire": [_object({**acquired, "invalid": found})],
        "import": [_object(imported)],
        "report": [_object(lines)],
        "figures": [_object({"verdict": TEXT, "written": _list(TEXT)})],
        "prove": [_object(proven)],
        "mirrors": [_object({"mirrors": _list(mirrors[0]), "segmented": _list(mirrors[1])})],
        "mirror": mirrors,
        "segments": [_object({"segments": _list(of_segment)})],
    }


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of everything that ``--json`` prints.

    The key ``schema`` of an output is the name of its definition, with its version. Numbers have
    their ``unit``. Keys may be added, so that no schema refuses others.

    Examples
    --------
    >>> schema = tn.json_schema()
    >>> schema["$defs"]["calibrate"]["anyOf"][0]["properties"]["noise"]
    {'type': ['number', 'null'], 'unit': 'N'}
    """
    definitions: Schema = {"finding": _object(_of(FINDING)), "verdict": _object(_of(VERDICT))}
    outputs = _outputs()
    for name, kinds in outputs.items():
        const = {"schema": {"const": f"truenewton.{name}/{VERSION}"}}
        every = (each | {"properties": const | each["properties"]} for each in kinds)
        named = [each | {"required": ["schema", *each["required"]]} for each in every]
        definitions[name] = {"anyOf": named}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Output of truenewton --json",
        "anyOf": [{"$ref": f"#/$defs/{name}"} for name in outputs],
        "$defs": definitions,
    }
