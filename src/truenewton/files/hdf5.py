"""Reading and writing HDF5, with the names of the FITS formats.

Attributes of the root are keywords, a group is a table, its datasets are the columns, a dataset of
the root is an image. Units are in the attribute ``unit`` of a dataset.
"""

from __future__ import annotations

import hashlib
import importlib
import os
from dataclasses import dataclass
from io import BufferedIOBase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, OutputFailed, TrueNewtonError, UnreadableFile, naming
from truenewton.files.content import FitsFile, Image, Table
from truenewton.files.format import FileFormat, TableFormat, columns_of, header_of, value_of
from truenewton.files.opening import open_plain, refuse_too_large
from truenewton.files.outputs import file_beside
from truenewton.files.stored_rows import StoredRows, runs, state_of

SUFFIXES = (".h5", ".hdf5")
MAGIC = b"\x89HDF\r\n\x1a\n"
CHUNK_BYTES = 2**20
UNITS = ("unit", "units", "UNIT", "UNITS")


@dataclass(frozen=True, eq=False)
class Hdf5Rows(StoredRows):
    """Vectors of one dataset, (N, n), left in an HDF5 file, compressed or not."""

    dataset: str = ""  # its name in the file

    def values(self, file: BufferedIOBase, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Read the `span` of some rows, (rows, span); those that follow each other together."""
        if state_of(file) != self.state:
            raise EOFError
        first, last = self.span
        values = np.empty((len(rows), last - first), dtype=self.stored)
        try:
            with _open(self.path) as held:
                dataset = held[self.dataset]
                for run in runs(rows):
                    some = slice(int(rows[run][0]), int(rows[run][-1]) + 1)
                    values[run] = dataset[some, first:last]
        except (OSError, KeyError) as error:
            raise UnreadableFile(
                f"{self.dataset} is damaged", remedy="fetch the file again", path=self.path
            ) from error
        return values


def import_h5py(path: object) -> Any:
    """Return the module, which is an extra."""
    try:
        return importlib.import_module("h5py")
    except ModuleNotFoundError:
        raise UnreadableFile(
            "is HDF5, for which h5py is missing",
            remedy="install the extra: pip install 'truenewton[hdf5]'",
            path=path,
        ) from None


def _open(path: str) -> Any:
    # Of a file system without locks, as clusters have, locking would be refused.
    return import_h5py(path).File(path, "r", locking="best-effort")


def is_hdf5(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file is HDF5, by its name or its first bytes."""
    if os.fspath(path).lower().endswith(SUFFIXES):
        return True
    with open_plain(path) as file:
        return file.peek(len(MAGIC))[: len(MAGIC)] == MAGIC


def read_hdf5(path: str | os.PathLike[str], *, whole: bool = True) -> FitsFile:
    """Read an HDF5 file; if not whole, vector columns are left in it."""
    with naming(path):
        return _read(os.fspath(path), whole=whole)


def _read(path: str, *, whole: bool) -> FitsFile:
    h5py = import_h5py(path)
    with open_plain(path) as file:
        if file.peek(len(MAGIC))[: len(MAGIC)] != MAGIC:
            raise UnreadableFile("is not an HDF5 file", remedy="fetch it again")
        state, digest = state_of(file), hashlib.file_digest(file, "sha256")
    try:
        with _open(path) as held:
            header = {str(k).upper(): _plain(v) for k, v in held.attrs.items()}
            extensions: dict[str, Table | Image | TrueNewtonError] = {}
            for name in held:
                _refuse_links(h5py, held, name)
                if isinstance(held[name], h5py.Group):
                    extensions[name.upper()] = _table(h5py, held[name], path, state, whole=whole)
                elif held[name].ndim == 2:
                    extensions[name.upper()] = Image(_array(held[name], path), unit_of(held[name]))
    except TrueNewtonError:
        raise
    except Exception as error:
        # A damaged file can raise nearly anything inside its library; this is the boundary.
        raise UnreadableFile("is damaged or truncated", remedy="fetch it again") from error
    return FitsFile(path, digest.hexdigest(), header, extensions)


def _refuse_links(h5py: Any, group: Any, name: str) -> None:
    """Refuse data that are in another file, which the checksum does not cover."""
    away = isinstance(group.get(name, getlink=True), h5py.ExternalLink)
    if not away and isinstance(group[name], h5py.Dataset):
        away = group[name].is_virtual or group[name].external is not None
    if away:
        raise FormatError(
            f"{group.name.strip('/')}/{name} stands in another file".lstrip("/"),
            remedy="write all of it into one file (h5repack)",
        )


def _table(h5py: Any, group: Any, path: str, state: tuple[int, int], *, whole: bool) -> Table:
    """Read a group; if not ``whole``, its vectors stay in the file."""
    columns: dict[str, tuple[NDArray[Any] | StoredRows, str]] = {}
    table, rows = group.name.strip("/"), None
    for name in group:
        _refuse_links(h5py, group, name)
        dataset = group[name]
        if not isinstance(dataset, h5py.Dataset) or not dataset.ndim:
            continue
        if rows not in (None, len(dataset)):
            raise FormatError(
                f"{name} of {table} has {len(dataset)} rows, other columns {rows}",
                remedy="end the recording cleanly, or cut all columns to the shortest",
            )
        rows = len(dataset)
        vectors = dataset.ndim == 2 and dataset.dtype.kind in "fiu"
        stay = vectors and not whole
        columns[name.upper()] = (
            Hdf5Rows(
                path, state, 0, 0, dataset.shape, dataset.dtype.newbyteorder("="),
                dataset=dataset.name,
            )
            if stay
            else _array(dataset, path),
            unit_of(dataset),
        )  # fmt: skip
    return Table(rows or 0, columns)


def _array(dataset: Any, path: str) -> NDArray[Any]:
    """Read all of a dataset, in native byte order."""
    refuse_too_large(dataset.nbytes, path, dataset.name.strip("/"))
    if dataset.dtype.kind in "OS":
        return np.array([_plain(text) for text in dataset[()].ravel()], dtype=np.str_)
    return np.array(dataset[()], dtype=dataset.dtype.newbyteorder("="), order="C")


def unit_of(dataset: Any) -> str:
    """Return the unit that a dataset declares, or ''."""
    found = [dataset.attrs[name] for name in UNITS if name in dataset.attrs]
    return str(_plain(found[0])) if found else ""


def _plain(value: Any) -> Any:
    """Return an attribute as a Python value; one of an array of one as well."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value


def write_hdf5(
    path: str | os.PathLike[str], form: FileFormat, record: Any, *, overwrite: bool = False
) -> None:
    """Write a record in a format, chunked, each chunk with its checksum (Fletcher's)."""
    try:
        h5py = import_h5py(path)
    except UnreadableFile as error:
        raise OutputFailed(error.fault, remedy=error.remedy, path=path) from None
    with file_beside(path, overwrite=overwrite) as temporary, h5py.File(temporary, "w") as file:
        for key, value, _ in header_of(record, form):
            file.attrs[key] = value
        for part in form.extensions:
            if isinstance(part, TableFormat):
                group = file.create_group(part.name)
                for name, _, unit, values in columns_of(record, part):
                    _write(group, name, values, unit)
            else:
                _write(file, part.name, np.asarray(value_of(record, part.attribute)), part.unit)


def _write(group: Any, name: str, values: Any, unit: str | None) -> None:
    kept = {}
    if np.size(values):
        shape = np.shape(values)
        row = 8 * int(np.prod(shape[1:]))
        rows = min(shape[0], max(1, CHUNK_BYTES // row))
        kept = {"chunks": (rows, *shape[1:]), "fletcher32": np.asarray(values).dtype.kind != "U"}
    dataset = group.create_dataset(name, data=values, **kept)
    if unit:
        dataset.attrs["unit"] = unit
