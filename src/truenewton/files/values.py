"""The keys of JSON objects, declared once for their values and for the JSON Schema."""

from __future__ import annotations

from typing import Any

from truenewton.files.format import Attribute, TableFormat, value_of

Key = str | tuple[Any, ...]


class Values:
    """A JSON object made of a record, or of each of a tuple of records.

    A key is the name of an attribute; or its name, the attribute (a path or a function; `Values` or
    `Columns` for an object in the object) and, if its annotation is too general, its type.

    Examples
    --------
    >>> from truenewton.files.values import Values
    >>> Values(tn.Load, ("load", "name"), "added").of(tn.Load("ring", -2.0, 0.001))
    {'load': 'ring', 'added': -2.0}
    """

    def __init__(self, kind: type, *keys: Key, path: Attribute = "") -> None:
        self.kind, self.path = kind, path
        triples = ((key, key) if isinstance(key, str) else key for key in keys)
        self.keys = {name: (attribute, *hint) for name, attribute, *hint in triples}

    def of(self, record: Any) -> Any:
        """Return the values of a record; a list if its path leads to a tuple, None to None."""
        found = value_of(record, self.path)
        if isinstance(found, tuple):
            return [self._of(one) for one in found]
        return None if found is None else self._of(found)

    def _of(self, record: Any) -> dict[str, Any]:
        return {
            name: key.of(record) if isinstance(key, Values | Columns) else value_of(record, key)
            for name, (key, *_) in self.keys.items()
        }


class Columns:
    """A JSON object of columns of a table by their names in lower case; by default all but NZ."""

    def __init__(self, table: TableFormat, *names: str) -> None:
        known = {column.name.lower(): column for column in table.columns}
        self.table = table
        self.columns = {name: known[name] for name in names or known if name != "nz"}

    def of(self, record: Any) -> dict[str, Any]:
        """Return the columns of a record."""
        rows = value_of(record, self.table.of)
        return {name: value_of(rows, column.attribute) for name, column in self.columns.items()}
