"""The JSON Schema of what `--json` prints, from the declared records, columns and quantities.

Each object is declared as the function that makes its values does: by attributes of a record, whose
annotations are the types, and by columns of a table.
"""

from __future__ import annotations

import datetime
import functools
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from truenewton.acquisition.load_order import Mounting, OrderCost
from truenewton.acquisition.plan import CampaignPlan
from truenewton.calibration.result import ACTUATORS, CALIBRATION, Calibration
from truenewton.comparison.calibrations import CHANGE, Change
from truenewton.comparison.pairing import Matching
from truenewton.comparison.result import CHANGES, Comparison
from truenewton.estimation.findings.code import Code, Level
from truenewton.estimation.findings.estimate import Diagnosis, RejectedRow
from truenewton.estimation.findings.finding import Finding, Verdict
from truenewton.estimation.matrix.facts import MatrixFacts
from truenewton.files.format import Column, TableFormat
from truenewton.mirrors.glass import Shell
from truenewton.mirrors.known import Mirror
from truenewton.mirrors.segmented import Place
from truenewton.modal.findings import ModalFindings, ModesComparison
from truenewton.modal.modal_base import SUMMARIES
from truenewton.planning.forces import Strain
from truenewton.planning.plan_prediction import Change as PlanChange
from truenewton.planning.plan_prediction import ThirdLoad
from truenewton.planning.prediction import Prediction
from truenewton.recalibration.fit import Recalibration
from truenewton.records.campaign import Campaign
from truenewton.statics.load import Load
from truenewton.studies.proof import Proof
from truenewton.tracking import law
from truenewton.tracking.law import Tracking, Validity

Schema = dict[str, Any]
VERSION = 2  # of all outputs; it changes if a key changes or is removed
TEXT: Schema = {"type": "string"}
TRUTH: Schema = {"type": "boolean"}
COUNT: Schema = {"type": "integer"}
DATE: Schema = {"type": "string", "format": "date-time"}
SIMPLE = {str: TEXT, bool: TRUTH, int: COUNT, np.int64: COUNT, np.bool_: TRUTH, range: {}}
SIMPLE |= {datetime.datetime: DATE}


def _number(unit: str = "") -> Schema:
    """Return the schema of a number, null if it is unknown or infinite."""
    return {"type": ["number", "null"], **({"unit": unit} if unit else {})}


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _or_null(schema: Schema) -> Schema:
    return {"anyOf": [schema, {"type": "null"}]}


def _object(keys: Mapping[str, Schema], optional: tuple[str, ...] = ()) -> Schema:
    required = [key for key in keys if key not in optional]
    return {"type": "object", "properties": dict(keys), "required": required}


def _array(item: Schema) -> Schema:
    """Return the schema of an array of any number of dimensions."""
    return _list({"anyOf": [item, {"type": "array"}]})


def _of_type(hint: Any, unit: str = "") -> Schema:
    """Return the schema of a value by its annotation."""
    if hint is float or hint is np.float64:
        return _number(unit)
    if hint in SIMPLE:
        return SIMPLE[hint]
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [_of_type(one, unit) for one in inner if one is not types.NoneType]
        one = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
        return _or_null(one) if types.NoneType in inner else one
    if origin is np.ndarray:
        return _array(_of_type(get_args(inner[1])[0], unit))
    if origin in (tuple, list):
        return _list(_of_type(inner[0], unit))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [str(each) for each in hint]}
    if hint in (Verdict, Finding):
        return {"$ref": f"#/$defs/{hint.__name__.lower()}"}
    if hasattr(hint, "as_values"):
        return _of_type(get_type_hints(hint.as_values.fget)["return"])
    if is_dataclass(hint):
        return _object(_of(hint, *(each.name for each in fields(hint) if each.repr)))
    return {}


def _of(kind: Any, *names: str, **others: str) -> dict[str, Schema]:
    """Return the schemas of attributes of a record, as `attributes` returns their values."""
    return {key: _of_path(kind, path) for key, path in ({n: n for n in names} | others).items()}


def _of_path(kind: Any, path: str) -> Schema:
    """Return the schema of an attribute; of a tuple of records on its path, of a list of them."""
    several, absent, unit = False, False, ""
    for part in path.split("."):
        inner = [each for each in get_args(kind) if each not in (types.NoneType, ...)]
        absent |= types.NoneType in get_args(kind)
        several |= get_origin(kind) is tuple
        kind = inner[0] if inner else kind
        unit, owner = _unit_of(kind, part), getattr(kind, part, None)
        getter = getattr(owner, "fget", None) or getattr(owner, "func", None)
        kind = get_type_hints(getter)["return"] if getter else get_type_hints(kind)[part]
    schema = _of_type(kind, unit)
    schema = _list(schema) if several else schema
    return _or_null(schema) if absent else schema


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


def _of_column(column: Column) -> Schema:
    """Return the schema of one value of a column."""
    kinds = {"float": _number(column.unit or ""), "bool": TRUTH, "str": TEXT, "date": DATE}
    return kinds.get(column.kind, COUNT)


def _columns(table: TableFormat, *names: str) -> Schema:
    """Return the schema of columns of a table by names in lower case, of all but NZ by default."""
    known = {column.name.lower(): _list(_of_column(column)) for column in table.columns}
    return _object({name: known[name] for name in names or known if name != "nz"})


def _rows(table: TableFormat, *names: str) -> Schema:
    """Return the schema of rows of a table."""
    known = {column.name.lower(): _of_column(column) for column in table.columns}
    return _list(_object({name: known[name] for name in names}))


def _numbers(unit: str, *names: str) -> dict[str, Schema]:
    return {name: _number(unit) for name in names}


ERRORS = "alpha", "e_alpha", "e_stat", "e_syst", "e_cycle"


def _calibration() -> dict[str, Schema]:
    """Return the keys of a calibration of one body."""
    own = functools.partial(_of, Calibration)
    torques = _numbers("N m", "torque_y", "e_torque_y", "torque_x", "e_torque_x")
    return {
        **own("instrument", "date", "verdict", "method", "scale", shapes="shapes_used"),
        **own("invalid", "rejected", "noise", "condition", "solved_condition", "rank"),
        **own(separation="diagnosis.separation", warnings="diagnosis.warnings.fault"),
        **own("bias_force"), **_numbers("N", "e_bias_force"),
        "loads": _list(_object({"load": TEXT, **torques})),
        "actuators": _columns(ACTUATORS, "id", *ERRORS),
        **own("chi2", "degrees_of_freedom", "goodness", "scale_errors", "effects", "unseen"),
        **own("sensors", weakest="diagnosis.weakest", imbalance="imbalances"),
        **own("halves", matrix="matrix_facts"),
    }  # fmt: skip


def _recalibration() -> dict[str, Schema]:
    others = _object(_of(Recalibration, "chi2", "degrees_of_freedom", "probability", "scatter"))
    return _of(Recalibration, "asked", "moved", "earlier", "limits") | {"others": others}


def _segments(of_one: Mapping[str, Schema], failed: Mapping[str, Schema]) -> Schema:
    """Return the schema of the list of segments: of each its result, or why there is none."""
    numbered = [_object({"segment": COUNT, **keys}) for keys in (of_one, failed)]
    return _list({"anyOf": numbered})


def _in_segments(more: Mapping[str, Schema]) -> dict[str, Schema]:
    """Return the keys of a calibration of several segments, of which each has more."""
    columns = _columns(ACTUATORS, "id", *ERRORS)["properties"]
    return {
        **_of(Calibration, "instrument", "date", "verdict"),
        "actuators": _object({**columns, "segment": _list(COUNT)}),
        "segments": _segments({**_calibration(), **more}, _of(Calibration, "verdict")),
    }


def _info() -> dict[str, dict[str, Schema]]:
    """Return the keys of `info`, by what the data are."""
    of_load = _of(Load, load="name", added="added", e_added="added_error", tilt="tilt")
    of_load |= _numbers("N", "effective_weight")
    of_load |= dict.fromkeys(("cycles", "rows", "invalid"), COUNT)
    rows = {"file": TEXT, "row": COUNT} | _of(RejectedRow, "actuator", "sigmas", "against")
    campaign = {
        "files": _list(TEXT), **_of(Campaign, "weight", e_weight="weight_error"),
        "loads": _list(_object(of_load)), "shapes": COUNT,
        **_numbers("N", "largest_force", "noise"), "strange_rows": _list(_object(rows)),
    }  # fmt: skip
    matrix = _numbers("N/m", "softest", "median", "stiffest") | {"used_modes": COUNT}
    matrix |= _of(MatrixFacts, "asymmetry", "rigid_cost", "imbalance")
    of_data = dict.fromkeys(("actuators", "disabled"), COUNT) | _of(Diagnosis, "separation")
    of_data |= _of(Calibration, "instrument")
    of_data["faults"] = _list(_object({"fault": TEXT, "remedy": TEXT}))
    of_data["verdict"] = _or_null(_of_type(Verdict))
    whole = {"instrument": TEXT, "actuators": COUNT}
    every = {"segment": COUNT, "verdict": of_data["verdict"]}
    return {
        "campaign": campaign | of_data,
        "stiffness": matrix | of_data,
        "segments": whole | {"segments": _list(_object(every))},
        "calibration": _calibration(),
        "segmented calibration": _in_segments({}),
    }


def _track() -> dict[str, Schema]:
    scatter = _of(Tracking, own="scatter", common="common_scatter")
    scatter |= _of(Tracking, degrees_of_freedom="scatter_degrees")
    return {
        **_of(Tracking, "instrument", "temperature", "date", "effects", families="populations"),
        "scatter": _object(scatter),
        **_of(Tracking, "outliers", "chi2", "degrees_of_freedom", "probability", "limits"),
        "days": _rows(law.DAYS, "file", "date", "temperature", "verdict"),
        "actuators": _columns(
            law.ACTUATORS, "id", "alpha", "e_alpha", "k", "e_k", "drift", "e_drift"
        ),
        "validity": _of_type(Validity),
    }


def _comparisons() -> list[dict[str, Schema]]:
    """Return the keys of two matrices, and of two calibrations."""
    coupling = {"actuator": COUNT, "sensor": COUNT, "change": _number()}
    return [
        {
            **_of(Comparison, "instrument", "common", "common_error", "alpha_scatter"),
            **_of(Comparison, "sensor_scatter", "noise_law", "relative_noise", "pattern"),
            **_of(Comparison, "tails", "resemblance", "excess"),
            "actuators": _columns(CHANGES),
            "couplings": _list(_object(coupling)),
            **_of_type(Matching)["properties"],
            "undetectable": {},
            "verdict": _of_type(Verdict),
        },
        {
            "instrument": TEXT,
            **_of(Change, "ratio", "ratio_error", "limit"),
            "actuators": _columns(CHANGE),
            "changed": _list(COUNT),
        },
    ]


def _modes() -> dict[str, Schema]:
    base = functools.partial(_of, ModalFindings)
    cost = {"base": TEXT} | {name: _list(_number(unit)) for name, unit, _ in SUMMARIES}
    cost |= {"modes_within": COUNT, "modes_between": _list(COUNT)}
    cost["modes_within_uncalibrated"] = _or_null(COUNT)
    measured = base(shapes="measured.shapes", rows="measured.rows", misfit="measured.misfit")
    measured |= base(residual="measured.residual", relative_error="measured.relative_error")
    measured |= base(rigid_assumed="measured.rigid_assumed") | {"rejected": COUNT}
    apart = _of(ModesComparison, "distance", "overlap", "orders", "largest_angle")
    seen = "after.seen"
    return {
        **base(instrument="after.matrix.instrument", date="after.matrix.date"),
        **_of(Calibration, "method", "scale", "verdict"),
        **base(seeing=f"{seen}.atmosphere.seeing", outer_scale=f"{seen}.atmosphere.outer_scale"),
        **base(fried_parameter=f"{seen}.atmosphere.fried_parameter"),
        **base(diameter=f"{seen}.pupil.diameter", radius=f"{seen}.pupil.radius"),
        **_numbers("N/W^1/2", "efficiency"), **base(fitting_error=f"{seen}.fitting_error"),
        **base(static_force="after.static", stiffness="after.modes.stiffness"),
        **base("asymmetry", "imbalance"), "rigid_stiffness": _list(_number("N/m")),
        **base(sensor_gain="after.stiffness.enabled_gain"),
        **base(sensor_offset="after.stiffness.enabled_offset"),
        "uncalibrated_modes": _or_null(_object(apart)),
        "limits": _object({**_numbers("W", "power", "total"), **_numbers("N", "force")}),
        "warnings": _list(_list(TEXT)), "bases": _list(_object(cost)),
        "measured": _object(measured),
    }  # fmt: skip


def _plan() -> dict[str, Schema]:
    typical = _numbers("", "typical_error", "typical_e_stat", "typical_e_syst")
    errors = dict.fromkeys(("alpha", "e_alpha", "e_stat", "e_syst"), _list(_number()))
    sensors = {"e_alpha": errors["alpha"], "e_stat": errors["alpha"]}
    sensors |= {"e_gain": _list(_number()), "e_offset": {}}
    curve = dict.fromkeys(("cycles", "error", "e_stat"), _list(_number()))
    every = curve | {"e_syst": _list(_number())}
    by_factor = {{"cycles": "added_factor"}.get(name, name): each for name, each in every.items()}
    curves = {"cycles": _object(every), "added_factor": _object(by_factor)}
    reciprocity = [
        {"why_not": TEXT},
        {**typical, "actuators": _object(sensors), "cycles": _object(curve)},
    ]
    mounting = {"load": TEXT, "cycles": _list(COUNT)} | _of(Mounting, "start", "end")
    cost = _of_type(OrderCost)["properties"] | _numbers("", "error")
    return {
        "instrument": TEXT, "shapes": COUNT, **_of(CampaignPlan, "cycles", "loads", "turns"),
        **typical, **_of(Prediction, "scale_errors"),
        "actuators": _object({"id": _list(COUNT), **errors}),
        "reciprocity": {"anyOf": [_object(each) for each in reciprocity]},
        **_of(Diagnosis, "weakest", "undetermined"),
        **_numbers("s", "duration"), "mountings": _list(_object(mounting)),
        "orders": _list(_object(cost)), "third_load": _or_null(_of_type(ThirdLoad)),
        **_numbers("N", "largest_force", "force_at_worst"), **_of(Strain, "actuator", "load"),
        **_numbers("m", "largest_stroke", "gap"), "curves": _object(curves),
        "warnings": _list(TEXT), "target": _number(),
        "ways": _list(_object(_of(PlanChange, "what", "reached", "change", "error", "duration"))),
    }  # fmt: skip


def _mirrors() -> list[dict[str, Schema]]:
    """Return the keys of a mirror in one piece, and of one in segments."""
    one = {"actuators": COUNT, "outline": {}, **_of_type(Shell)["properties"]}
    one |= _of_type(Mirror)["properties"]
    del one["shell"], one["layout"]
    placed = {**_of_type(Place)["properties"], **one}
    whole = {"name": TEXT, "actuators": COUNT, "segments": _list(_object(placed, ("outline",)))}
    return [one, whole]


def _outputs() -> dict[str, list[Schema]]:
    """Return the schemas of each output, several if its keys depend on the data."""
    one, whole = (_object(keys, ("outline",)) for keys in _mirrors())
    found: Schema = {"type": "object"}
    lines = {"verdict": TEXT, "lines": _list(TEXT), "written": TEXT}
    proof = _of_type(Proof)["properties"] | _numbers("", "ratio")
    acquired = {"folder": TEXT, "before": TRUTH, "loads": _list(TEXT), "cycles": COUNT}
    proven = {"mirror": TEXT, "limit": _number(), "passed": TRUTH, "worst": _number()}
    failed = {"faults": _list({})}
    compared = _segments(_comparisons()[0], failed)
    in_segments = _segments(_modes(), {"fault": {}})
    return {
        "info": [
            _object({"holds": {"const": what}, **keys}) for what, keys in _info().items()
        ],
        "calibrate": [_object(_calibration())],
        "calibrate-segments": [_object(_in_segments({}))],
        "recalibrate": [_object({**_calibration(), **_recalibration()})],
        "recalibrate-segments": [_object(_in_segments(_recalibration()))],
        "track": [_object(_track(), ("validity",))],
        "track-segments": [_object({"instrument": TEXT, "segments": _segments(_track(), failed)})],
        "compare": [_object(each) for each in _comparisons()],
        "compare-segments": [_object({"instrument": TEXT, "segments": compared})],
        "modes": [_object(_modes(), ("measured",))],
        "modes-segments": [_object({"segments": in_segments})],
        "plan": [_object(_plan())],
        "acquire": [_object({**acquired, "invalid": found})],
        "import": [
            _object({"instrument": TEXT, "actuators": COUNT, "found": found,
                     "calibration": _or_null(_object(_calibration()))})
        ],
        "report": [_object(lines)],
        "figures": [_object({"verdict": TEXT, "written": _list(TEXT)})],
        "prove": [_object({**proven, "proofs": _list(_object(proof))})],
        "mirrors": [_object({"mirrors": _list(one), "segmented": _list(whole)})],
        "mirror": [one, whole],
    }  # fmt: skip


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
    finding = {
        "code": _of_type(Code), "level": _of_type(Level),
        **_of(Finding, "fault", "remedy", "actuators", "name", "detail", "where", "probability"),
        **_of(Finding, "size", "unit", "corrected"), "values": {"type": "object"},
    }  # fmt: skip
    verdict = {"level": _of_type(Level), **_of(Verdict, "findings")}
    definitions: Schema = {"finding": _object(finding), "verdict": _object(verdict)}
    outputs = _outputs()
    for name, kinds in outputs.items():
        const = {"schema": {"const": f"truenewton.{name}/{VERSION}"}}
        every = [_object({**const, **each["properties"]}) for each in kinds]
        for new, each in zip(every, kinds, strict=True):
            new["required"] = ["schema", *each["required"]]
        definitions[name] = {"anyOf": every}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Output of truenewton --json",
        "anyOf": [{"$ref": f"#/$defs/{name}"} for name in outputs],
        "$defs": definitions,
    }
