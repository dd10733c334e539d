"""What `--json` prints, held against its JSON Schema, which here allows no other keys."""

import json
from functools import cache

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

import truenewton as tn


def forbid_others(schema):
    """Forbid keys that an object of a schema does not name."""
    if isinstance(schema, dict):
        for part in schema.values():
            forbid_others(part)
        if isinstance(schema.get("properties"), dict):
            schema["additionalProperties"] = False
    elif isinstance(schema, list):
        for part in schema:
            forbid_others(part)


@cache
def schema_without_others():
    """Return the schema, which is checked first."""
    schema = tn.json_schema()
    Draft202012Validator.check_schema(schema)
    forbid_others(schema)
    return schema


def checked(output):
    """Return the values of an output after they were checked."""
    values = json.loads(output)
    whole = schema_without_others()
    name = values["schema"].split(".")[1].split("/")[0]
    one = {"$ref": f"#/$defs/{name}", "$defs": whole["$defs"]}
    wrong = best_match(Draft202012Validator(one).iter_errors(values))
    assert wrong is None, f"{wrong.json_path}: {wrong.message[:500]}"
    return values
