"""Ways to spoil a FITS file: its values, columns, extensions and cards."""

from __future__ import annotations

import random
import re
import warnings
from pathlib import Path

import numpy as np
from astropy.io import fits

from .values import INTEGERS, TEXTS, number

CARD, BLOCK = 80, 2880
CARDS = (
    "NaN", "Infinity", "1E400", "-1E400", "1E-320", "1E308", "-1E308", "0", "0.0", "-0.0", "1",
    "-1", "T", "F", "", "'text'", "''", "'   '", "(1.0, 2.0)", "4294967296", "9223372036854775808",
    "1" + "0" * 40, "2147483647", "65536", "1000000", "-8", "7", "99", "1000", "'" + "x" * 60 + "'",
    "'2026-02-30'", "'9999-12-31T23:59:59'", "'1950-01-01'", "2026-11-21", "'\\x1b[2J'", "1.5D3",
    "0x10", "1_000", "'unterminated", "/ no value", "'nan'", "100000.0", "1E155", "1E-155", "89.99",
)  # fmt: skip
ODD_CARDS = (
    b"END", b"CONTINUE", b"HIERARCH a b = 1", b"TNULL1  = 1", b"TSCAL1  = 0.0", b"TZERO2  = 1E308",
    b"EXTEND  = F", b"\xff\xfe\x00", b"TDIM3   = '(0,9)'", b"ZIMAGE  = T", b"INHERIT = T",
    b"BLANK   = 0", b"THEAP   = 1",
)  # fmt: skip
STRUCTURAL = re.compile(rb"NAXIS|TFIELDS|TFORM|PCOUNT|BITPIX|GCOUNT|TDIM|TTYPE")
UNITS = (None, "", "m", "N", "kN", "GN", "deg_C", "K", "mag(N)", "nonsense", "1e300 N", "m**1e9",
         "1e-300 m", "N/m", "deg", "arcsec", "10**400 N", "((((", "V", "yr")  # fmt: skip
FORMATS = ("D", "E", "J", "I", "K", "B", "L", "8A", "M", "C", "2D", "PD()", "X", "0D", "1000A", "A")


# --- FITS, by its tables and images -------------------------------------------------------------


def fits_data(pick: random.Random, path: Path) -> str:
    """Spoil values, columns or extensions, and write the file anew with sound checksums or none."""
    with (
        warnings.catch_warnings(action="ignore"),
        np.errstate(all="ignore"),
        fits.open(path, memmap=False) as hdus,
    ):
        for hdu in hdus:
            hdu.data  # noqa: B018 - astropy loads late
            for key in ("CHECKSUM", "DATASUM"):
                hdu.header.remove(key, ignore_missing=True)
        ways = (_values, _values, _values, _values, _column, _rows, _extensions, _image)
        said = pick.choice(ways)(pick, hdus)
        checksum = pick.random() < 0.5
        hdus.writeto(path, overwrite=True, checksum=checksum, output_verify="ignore")
    return said


def spoil_array(pick: random.Random, values: np.ndarray) -> str:
    """Change an array in place."""
    flat = values.reshape(-1)
    if not flat.size:
        return "empty"
    if values.dtype.kind == "b":
        some = pick.choice((slice(None), slice(pick.randrange(flat.size), None, 2)))
        flat[some] = pick.random() < 0.5
        return "logicals"
    if values.dtype.kind in "SU":
        some = pick.choice((slice(None), pick.randrange(flat.size)))
        flat[some] = pick.choice(TEXTS[:9]).encode("ascii", "replace")
        return "texts"
    if values.dtype.kind in "iu":
        low, high = int(np.iinfo(values.dtype).min), int(np.iinfo(values.dtype).max)
        new = min(max(pick.choice(INTEGERS), low), high)
    elif values.dtype.kind == "f":
        new = number(pick)
    else:
        return "nothing"
    rows = values.reshape(len(values), -1)
    row, column = pick.randrange(rows.shape[0]), pick.randrange(rows.shape[1])
    places = {"one": (row, column), "row": row, "column": (slice(None), column), "all": ...}
    kind = pick.choice(("one", *places, "times", "permuted", "doubled", "constant", "add"))
    if kind in places:
        rows[places[kind]] = new
    elif kind in ("times", "add"):
        rows[:] = (rows * new if kind == "times" else rows + new).astype(values.dtype)
    elif kind == "permuted":
        rows[:] = rows[pick.sample(range(len(rows)), len(rows))]
    else:
        rows[:] = rows[row] if kind == "doubled" else rows[:, column][:, None]
    return f"{kind} {new:g}"


def _parts(hdus: fits.HDUList, kind: type) -> list:
    return [hdu for hdu in hdus[1:] if isinstance(hdu, kind) and hdu.data is not None]


def _values(pick: random.Random, hdus: fits.HDUList) -> str:
    tables = _parts(hdus, fits.BinTableHDU)
    if not tables:
        return _image(pick, hdus)
    table = pick.choice(tables)
    name = pick.choice(table.columns.names)
    column = table.data[name]
    values = np.array(column)
    said = spoil_array(pick, values)
    column[...] = values
    return f"{table.name}.{name}: {said}"


def _image(pick: random.Random, hdus: fits.HDUList) -> str:
    images = _parts(hdus, fits.ImageHDU)
    if not images:
        return _column(pick, hdus)
    image = pick.choice(images)
    data = np.array(image.data, dtype=image.data.dtype.newbyteorder("="))
    kind = said = pick.choice(("values", "values", "values", "shape", "type", "unit"))
    if kind == "values":
        said = spoil_array(pick, data)
    elif kind == "shape":
        ways = (data[:-1], data[:, :1], data.ravel(), data[None], data[:0], data[:1, :1], data.T)
        data = np.ascontiguousarray(pick.choice(ways))
    elif kind == "type":
        data = data.astype(pick.choice(("f4", "i2", "u1", "i8")))
    else:
        image.header["BUNIT"] = pick.choice(UNITS[1:])
    image.data = data
    if pick.random() < 0.05:
        image.header["BSCALE"], image.header["BZERO"] = number(pick), 1.0
    return f"{image.name}: {said}"


def _column(pick: random.Random, hdus: fits.HDUList) -> str:
    tables = _parts(hdus, fits.BinTableHDU)
    if not tables:
        return "nothing"
    table = pick.choice(tables)
    parts = [
        {"name": c.name, "format": c.format, "unit": c.unit, "array": np.array(table.data[c.name])}
        for c in table.columns
    ]
    part = pick.choice(parts)
    name = part["name"]
    odd = {
        "name": (f" {name}", name.lower(), "X", "ID", "FORCE", "\t", "a b"),
        "unit": UNITS,
        "null": (0, 1, -1),
        "bscale": (number(pick),),
        "bzero": (number(pick),),
        "dim": ("(2,3)", "(1)", "(999999,1)", "x"),
    }
    kind = pick.choice((*odd, "missing", "twice", "format", "width"))
    if kind in odd:
        part[kind] = pick.choice(odd[kind])
    elif kind == "missing":
        parts.remove(part)
    elif kind == "twice":
        parts.append(dict(part))
    elif kind == "format":
        new, rows = pick.choice(FORMATS), len(table.data)
        array = {"A": ["1"] * rows, "L": np.ones(rows, bool), "2": np.ones((rows, 2))}
        part.update(format=new, array=array.get(new[-1], array.get(new[0], np.ones(rows))))
        if new == "PD()":
            part["array"] = np.array([np.ones(k % 3 + 1) for k in range(rows)], object)
    elif part["array"].ndim == 2:
        part["array"] = pick.choice((part["array"][:, :-1], np.hstack([part["array"]] * 2)))
        part["format"] = f"{part['array'].shape[1]}D"
    index = hdus.index_of(table)
    try:
        columns = [fits.Column(**one) for one in parts]
        hdus[index] = fits.BinTableHDU.from_columns(columns, name=table.name)
    except Exception:  # astropy would not write it
        part["format"] = "D"
    return f"{table.name}.{name}: {kind}"


def _rows(pick: random.Random, hdus: fits.HDUList) -> str:
    tables = [table for table in _parts(hdus, fits.BinTableHDU) if len(table.data)]
    if not tables:
        return "nothing"
    table = pick.choice(tables)
    order = list(range(len(table.data)))
    kind, keep = pick.choice(
        (
            ("none", []), ("one", order[:1]), ("half", order[::2]), ("last missing", order[:-1]),
            ("reversed", order[::-1]), ("twice", order * 2), ("first only", order[:1] * len(order)),
            ("permuted", pick.sample(order, len(order))), ("many", order * 300),
        )
    )  # fmt: skip
    table.data = table.data[keep]
    return f"{table.name} rows: {kind}"


def _extensions(pick: random.Random, hdus: fits.HDUList) -> str:
    if len(hdus) < 2:
        return "nothing"
    index = pick.randrange(1, len(hdus))
    name = hdus[index].name
    kind = pick.choice(("gone", "twice", "moved", "renamed", "image", "empty"))
    if kind == "gone":
        hdus.pop(index)
    elif kind == "twice":
        hdus.append(hdus[index].copy())
    elif kind == "moved":
        hdus.append(hdus.pop(index))
    elif kind == "renamed":
        names = [hdu.name for hdu in hdus[1:]]
        hdus[index].name = pick.choice((*names, "STIFFNESS", "CALIBRATION", "TRUTH", "X" * 60))
    else:
        data = np.ones((3, 3)) if kind == "image" else None
        hdus[index] = fits.ImageHDU(data, name=name)
    return f"{name}: {kind}"


# --- FITS, by its cards -------------------------------------------------------------------------


def fits_cards(pick: random.Random, path: Path) -> str:
    """Spoil cards as they stand in the bytes; checksums, which would tell, are taken out."""
    raw = bytearray(path.read_bytes().replace(b"CHECKSUM=", b"CHECKSUX="))
    raw = raw.replace(b"DATASUM =", b"DATASUX =")
    places = range(0, len(raw), CARD)
    cards = [at for at in places if re.match(rb"[A-Z][A-Z0-9-]{1,7} *= ", raw[at : at + 10])]
    if not cards:
        return "nothing"
    structural = [at for at in cards if STRUCTURAL.match(raw[at : at + 8])]
    at = pick.choice(structural if structural and pick.random() < 0.3 else cards)
    key = bytes(raw[at : at + 8]).decode().strip()
    kind = pick.choice(("value",) * 4 + ("gone", "twice", "swap", "key", "bytes"))
    new = bytes(raw[at : at + CARD])
    if kind == "value":
        value = pick.choice(CARDS)
        new = f"{key:<8}= {value:>20}"[:CARD].ljust(CARD).encode("latin-1")
        kind = value
    elif kind == "gone":
        new = b"COMMENT".ljust(CARD)
    elif kind == "twice":
        other = pick.choice(cards)
        raw[other : other + CARD] = new
    elif kind == "swap":
        other = pick.choice(cards)
        new, raw[other : other + CARD] = bytes(raw[other : other + CARD]), new
    elif kind == "key":
        new = pick.choice(ODD_CARDS).ljust(CARD)
    else:
        hurt = bytearray(new)
        hurt[pick.randrange(CARD)] = pick.randrange(256)
        new = bytes(hurt)
    raw[at : at + CARD] = new
    path.write_bytes(raw)
    return f"card {key}: {kind}"
