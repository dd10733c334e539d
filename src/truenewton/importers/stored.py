"""Reading the numbers in a file of any format, which its first bytes determine."""

from __future__ import annotations

import importlib
import math
import os
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.errors import TrueNewtonError, UnreadableFile, located
from truenewton.files.content import Image, Table
from truenewton.files.fits import START, read_fits
from truenewton.files.opening import GZIP, open_plain, refuse_too_large
from truenewton.files.tables import Item, TextTable, columns_in, plain, table_in, text_of

HDF5_UNITS = ("unit", "units", "UNIT", "UNITS")  # attributes of a dataset


@dataclass(frozen=True)
class Stored:
    """The numbers in a file.

    ``arrays`` have one dimension or more, ``columns`` are those of tables, also of texts; both by
    name, which is '' if there is none. ``header`` contains the keywords of a FITS file.
    """

    path: str
    arrays: Mapping[str, Item] = field(default_factory=dict)
    columns: Mapping[str, Item] = field(default_factory=dict)
    header: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def every(self) -> dict[str, Item]:
        """Arrays and columns."""
        return {**self.arrays, **self.columns}

    @cached_property
    def names(self) -> dict[str, tuple[str, str]]:
        """Their names, also short ones (`columns_in`)."""
        return columns_in(self.every)


def read_stored(path: str | os.PathLike[str]) -> Stored:
    """Read all numbers of a file."""
    path = os.fspath(path)
    try:
        with open_plain(path) as file:
            start = file.read(16)
        for magic, read in READERS.items():
            if start.startswith(magic):
                return read(path)
        return _as_stored(path, table_in(text_of(path)))
    except TrueNewtonError as error:
        raise located(error, path) from None
    except Exception as error:  # libraries raise nearly anything for a damaged file
        told = " ".join(str(error).split())[:80]
        remedy = "write it again, or give FITS, .npy or text"
        raise UnreadableFile(f"cannot be read ({told})", remedy=remedy, path=path) from error


def _gathered(path: str, named: Mapping[str, Any]) -> Stored:
    """Return those named values that are arrays of numbers."""
    every = {name: plain(value) for name, value in named.items()}
    return Stored(path, {k: Item(v) for k, v in every.items() if v is not None and v.ndim})


def _fits(path: str) -> Stored:
    file = read_fits(path)
    arrays: dict[str, Item] = {}
    columns: dict[str, Item] = {}
    tables = [part.columns for part in file.extensions.values() if isinstance(part, Table)]
    count = Counter(column for table in tables for column in table)
    for name, part in file.extensions.items():
        if isinstance(part, Image):
            numbers = plain(part.data)
            if numbers is not None:
                arrays[name] = Item(numbers, part.unit)
        elif isinstance(part, Table):
            for column, (values, unit) in part.columns.items():
                cells = np.asarray(values)
                held = cells if cells.dtype.kind == "U" else plain(cells)
                if held is not None:  # of one name in two tables: with that of the table
                    columns[column if count[column] == 1 else f"{name}/{column}"] = Item(held, unit)
        else:
            raise part
    return Stored(path, arrays, columns, file.header)


def _numpy(path: str) -> Stored:
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            refuse_too_large(sum(part.file_size for part in archive.infolist()), path)
    held = np.load(path, allow_pickle=False)
    return _gathered(path, {"": held} if isinstance(held, np.ndarray) else dict(held))


def _zipped(path: str) -> Stored:
    """Read .npz, or the first sheet of an Excel workbook."""
    with zipfile.ZipFile(path) as file:
        if "xl/workbook.xml" not in file.namelist():
            return _numpy(path)
    try:
        import openpyxl
    except ModuleNotFoundError:
        remedy = "pip install 'truenewton[excel]', or save it as CSV"
        raise UnreadableFile("is an Excel workbook, which needs openpyxl", remedy=remedy) from None
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    # Each row is a line, so that their numbers agree.
    rows = (["" if cell is None else " ".join(str(cell).split()) for cell in row] for row in
            book.worksheets[0].iter_rows(values_only=True))  # fmt: skip
    return _as_stored(path, table_in("\n".join("\t".join(row) for row in rows)))


def _as_stored(path: str, table: TextTable) -> Stored:
    return Stored(path, {} if table.values is None else {"": Item(table.values)}, table.columns)


def _hdf5(path: str) -> Stored:
    try:
        h5py: Any = importlib.import_module("h5py")
    except ModuleNotFoundError:
        raise UnreadableFile(
            "is HDF5, for which h5py is missing",
            remedy="install the extra: pip install 'truenewton[hdf5]'",
            path=path,
        ) from None
    found: dict[str, Item] = {}

    def take(name: str, held: Any) -> None:
        if isinstance(held, h5py.Dataset) and held.dtype.kind in "fiub" and held.ndim:
            refuse_too_large(held.nbytes, path, name)
            # MATLAB 7.3 stores arrays with their axes reversed.
            matlab = "MATLAB_class" in held.attrs
            values = held[()].T if matlab else held[()]
            found[name.replace("/", ".") if matlab else name] = Item(
                np.asarray(values, dtype=np.float64), _unit_of(held)
            )

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return Stored(path, found)


def _unit_of(dataset: Any) -> str:
    """Return the unit that a dataset of HDF5 declares, or ''."""
    found = [np.ravel(dataset.attrs[name])[0] for name in HDF5_UNITS if name in dataset.attrs]
    unit = found[0] if found else ""
    return unit.decode("utf-8", "backslashreplace") if isinstance(unit, bytes) else str(unit)


def _matlab(path: str) -> Stored:
    import scipy.io

    if b"MATLAB 7.3" in Path(path).read_bytes()[:128]:
        return _hdf5(path)
    refuse_too_large(sum(8 * math.prod(shape) for _, shape, _ in scipy.io.whosmat(path)), path)
    held = scipy.io.loadmat(path)
    variables = {k: v for k, v in held.items() if not k.startswith("__")}
    return _gathered(path, dict(_fields("", variables)))


def _fields(before: str, variables: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield arrays of MATLAB; those in structs have names as 'sys.ff_matrix' or 'sys(2).ff'."""
    for name, value in variables.items():
        fields = getattr(value.dtype, "names", None)
        if not fields:
            yield before + name, value
            continue
        for k, one in enumerate(value.ravel(), 1):
            of = f"{name}." if value.size == 1 else f"{name}({k})."
            yield from _fields(before + of, {each: np.asarray(one[each]) for each in fields})


def _idl(path: str) -> Stored:
    import scipy.io

    with warnings.catch_warnings(action="ignore"):
        return _gathered(path, scipy.io.readsav(path))


READERS = {
    START: _fits,
    GZIP: _fits,
    b"\x93NUMPY": _numpy,
    b"PK\x03\x04": _zipped,
    b"\x89HDF": _hdf5,
    b"MATLAB": _matlab,
    b"SR\x00": _idl,
}
