"""Arrays and columns in a file of any kind that is read here: its first bytes tell which."""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import TrueNewtonError, UnreadableFile
from truenewton.files.content import Image, Table
from truenewton.files.fits import START, read_fits
from truenewton.files.hdf5 import unit_of
from truenewton.files.opening import GZIP, open_plain
from truenewton.foreign.text import read_text


class Item(NamedTuple):
    """Numbers and the unit that their file declares, or ''; masked ones are NaN."""

    values: NDArray[np.float64]
    unit: str = ""


@dataclass(frozen=True)
class Stored:
    """What a file holds.

    Attributes
    ----------
    path
        Where.
    arrays
        Of one dimension or more, by name; that of a file which has no names is ''.
    columns
        Of tables, (rows,), by name.
    header
        Keywords of a FITS file.
    """

    path: str
    arrays: Mapping[str, Item] = field(default_factory=dict)
    columns: Mapping[str, Item] = field(default_factory=dict)
    header: Mapping[str, Any] = field(default_factory=dict)


def read_stored(path: str | os.PathLike[str]) -> Stored:
    """Read all numbers of a file.

    Raises
    ------
    UnreadableFile, FormatError
    """
    path = os.fspath(path)
    try:
        with open_plain(path) as file:
            start = file.read(16)
        for magic, read in READERS.items():
            if start.startswith(magic):
                return read(path)
        table = read_text(path)
        arrays = {} if table.values is None else {"": Item(table.values)}
        return Stored(path, arrays, {name: Item(c) for name, c in table.columns.items()})
    except TrueNewtonError:
        raise
    except OSError as error:
        raise UnreadableFile(
            f"cannot be read ({error.strerror or error})", remedy="check the path", path=path
        ) from error
    except Exception as error:  # a damaged file can raise nearly anything inside its library
        told = " ".join(str(error).split())[:80]
        remedy = "write it again, or give FITS, .npy or text"
        raise UnreadableFile(f"cannot be read ({told})", remedy=remedy, path=path) from error


def plain(values: Any) -> NDArray[np.float64] | None:
    """Return (...,) numbers as floats, masked ones NaN; None of what is no real numbers."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    numbers = np.asarray(values)
    return numbers.astype(np.float64) if numbers.dtype.kind in "fiub" else None


def _gathered(path: str, named: Mapping[str, Any]) -> Stored:
    """Return what of named values is numbers: arrays of one dimension or more."""
    arrays = {}
    for name, value in named.items():
        numbers = plain(value)
        if numbers is not None and numbers.ndim > 0:
            arrays[name] = Item(numbers)
    return Stored(path, arrays)


def _fits(path: str) -> Stored:
    file = read_fits(path)
    arrays: dict[str, Item] = {}
    columns: dict[str, Item] = {}
    for name, part in file.extensions.items():
        if isinstance(part, Image):
            numbers = plain(part.data)
            if numbers is not None:
                arrays[name] = Item(numbers, part.unit)
        elif isinstance(part, Table):
            for column, (values, unit) in part.columns.items():
                numbers = plain(np.asarray(values))
                if numbers is not None:
                    columns.setdefault(column, Item(numbers, unit))
        else:
            raise part
    return Stored(path, arrays, columns, file.header)


def _numpy(path: str) -> Stored:
    held = np.load(path, allow_pickle=False)
    return _gathered(path, {"": held} if isinstance(held, np.ndarray) else dict(held))


def _hdf5(path: str) -> Stored:
    try:
        h5py = importlib.import_module("h5py")
    except ImportError:
        raise UnreadableFile(
            "is HDF5, for which h5py is missing",
            remedy="pip install 'truenewton[hdf5]'",
            path=path,
        ) from None
    found: dict[str, Item] = {}

    def take(name: str, held: Any) -> None:
        if isinstance(held, h5py.Dataset) and held.dtype.kind in "fiub" and held.ndim:
            # MATLAB's arrays of version 7.3 lie here with their axes reversed.
            values = held[()].T if "MATLAB_class" in held.attrs else held[()]
            found[name] = Item(np.asarray(values, dtype=np.float64), unit_of(held))

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return Stored(path, found)


def _matlab(path: str) -> Stored:
    import scipy.io

    if b"MATLAB 7.3" in Path(path).read_bytes()[:128]:
        return _hdf5(path)
    held = scipy.io.loadmat(path)
    return _gathered(path, {k: v for k, v in held.items() if not k.startswith("__")})


def _idl(path: str) -> Stored:
    import scipy.io

    with warnings.catch_warnings(action="ignore"):
        return _gathered(path, scipy.io.readsav(path))


READERS = {
    START: _fits,
    GZIP: _fits,
    b"\x93NUMPY": _numpy,
    b"PK\x03\x04": _numpy,
    b"\x89HDF": _hdf5,
    b"MATLAB": _matlab,
    b"SR\x00": _idl,
}
