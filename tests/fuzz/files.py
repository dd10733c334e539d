"""Ways to spoil a file that need not know FITS: TOML, tables of text, bytes, gzip, paths; the door.

Each takes a random generator and the path of a sound file, changes what stands there, and returns
what it did in words.
"""

from __future__ import annotations

import gzip
import json
import os
import random
import shutil
import stat
import tomllib
from pathlib import Path

from .fits import BLOCK, CARD, fits_cards, fits_data
from .foreign import arrays
from .values import INTEGERS, NUMBERS, TEXTS, number

# --- TOML and tables of text --------------------------------------------------------------------


def toml(pick: random.Random, path: Path) -> str:
    """Give a key another value, take it out, or spoil the text."""
    if pick.random() < 0.15:
        return text(pick, path)
    tree = tomllib.loads(path.read_text())
    places = list(_places(tree))
    table, key = pick.choice(places)
    kind = pick.choice(("value", "value", "value", "value", "gone", "extra", "key"))
    if kind == "value":
        table[key] = _toml_value(pick, table[key])
    elif kind == "gone":
        del table[key]
    elif kind == "key" and isinstance(table, dict):
        table[pick.choice(TEXTS)] = table.pop(key)
    elif isinstance(table, dict):
        names = ("turns", "drift", "shapes", "limits", "bench", "outline", "x", "sensor")
        table[pick.choice(names)] = _toml_value(pick, None)
    path.write_text(
        "".join(f"{_quoted(k)} = {_written(v)}\n" for k, v in tree.items()), errors="replace"
    )
    return f"{key}: {kind}"


def _places(tree: dict | list):
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])


def _toml_value(pick: random.Random, old: object) -> object:
    if isinstance(old, float) and pick.random() < 0.6:
        return pick.choice((number(pick), old * pick.choice((1e3, 1e-3, -1, 1.5, 0.1, 10))))
    if isinstance(old, int) and not isinstance(old, bool) and pick.random() < 0.6:
        return pick.choice((*INTEGERS, 10**30, old + 1, old - 1))
    return pick.choice(
        (number(pick), pick.choice(INTEGERS), pick.choice(TEXTS), True, [], {}, [1],
         [number(pick)] * 2, [[[]]], {"a": {"b": 1}}, ["x"] * 1000,
         list(range(20000)), [{}], [[0.0, 0.0]] * 3, 10**400)
    )  # fmt: skip


def _quoted(name: str) -> str:
    return json.dumps(name).replace("\x7f", "\\u007f")


def _written(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_quoted(k)} = {_written(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_written, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def text(pick: random.Random, path: Path) -> str:
    """Spoil a line or a word of a text."""
    lines = path.read_text(errors="replace").splitlines()
    if not lines:
        return bytes_of(pick, path)
    at = pick.randrange(len(lines))
    kind = pick.choice(("word", "word", "word", "gone", "twice", "swap", "odd", "deep", "alias"))
    words = lines[at].replace(",", " , ").split() or ["x"]
    if kind == "word":
        odd = (*map(repr, NUMBERS), *map(str, INTEGERS), *TEXTS[:12], "1" * 400, "0x1", "")
        words[pick.randrange(len(words))] = pick.choice(odd)
        lines[at] = " ".join(words).replace(" , ", ",")
    elif kind == "gone":
        del lines[at]
    elif kind == "twice":
        lines.insert(at, lines[at])
    elif kind == "swap":
        lines[at], lines[0] = lines[0], lines[at]
    elif kind == "deep":
        lines.insert(at, "x = " + "[" * 5000)
    elif kind == "alias":
        lines.insert(at, "# - &a [*a, !!python/object/apply:os.system ['true']]")
    else:
        lines.insert(at, pick.choice(TEXTS))
    path.write_bytes("\n".join(lines).encode("utf-8", "surrogateescape") + b"\n")
    return f"line {at}: {kind}"


# --- anything -----------------------------------------------------------------------------------


def bytes_of(pick: random.Random, path: Path) -> str:
    """Cut, flip, insert or append bytes."""
    raw = bytearray(path.read_bytes())
    if pick.random() < 0.5:
        raw = raw.replace(b"CHECKSUM=", b"CHECKSUX=").replace(b"DATASUM =", b"DATASUX =")
    at = pick.randrange(len(raw) + 1)
    kind = pick.choice(("cut", "flip", "insert", "append", "delete", "zero", "noise"))
    if kind == "cut":
        del raw[pick.choice((at, at // BLOCK * BLOCK)) :]
    elif kind == "flip" and raw:
        for _ in range(pick.choice((1, 1, 5))):
            raw[pick.randrange(len(raw))] ^= 1 << pick.randrange(8)
    elif kind == "insert":
        odd = (b"\0", b"\xff", b" " * BLOCK, b"\0" * BLOCK, b"\r\n", os.urandom(9))
        raw[at:at] = pick.choice(odd)
    elif kind == "append":
        raw += pick.choice((b"\0", b"x", b"\0" * BLOCK, b"x" * BLOCK, raw[:BLOCK], bytes(raw)))
    elif kind == "delete":
        del raw[at : at + pick.choice((1, CARD, BLOCK))]
    else:
        size = pick.choice((1, 8, CARD, BLOCK))
        raw[at : at + size] = bytes(size) if kind == "zero" else pick.randbytes(size)
    path.write_bytes(raw)
    return f"bytes: {kind} at {at}"


def packed(pick: random.Random, path: Path) -> str:
    """Gzip a file under its name, soundly or not; or give it what unpacks to gigabytes."""
    squeezed, zeros = gzip.compress(path.read_bytes(), 1), gzip.compress(bytes(2**24), 9)
    at = pick.randrange(len(squeezed))
    kind, new = pick.choice(
        (
            ("sound", squeezed), ("cut", squeezed[:at]), ("followed", squeezed + b"x" * 99),
            ("twice", squeezed + squeezed), ("nested", gzip.compress(squeezed)),
            ("flipped", squeezed[:at] + bytes([squeezed[at] ^ 4]) + squeezed[at + 1 :]),
            ("bomb", squeezed + zeros * 300),
            ("declared bomb", gzip.compress(_huge()) + zeros * 300),
        )
    )  # fmt: skip
    path.write_bytes(new)
    return f"gzip: {kind}"


def _huge() -> bytes:
    """Return headers that declare an image of 4.8 GB."""
    primary = {"SIMPLE": "T", "BITPIX": "-64", "NAXIS": "0", "EXTEND": "T"}
    image = {"XTENSION": "'IMAGE   '", "BITPIX": "-64", "NAXIS": "2", "NAXIS1": "24576"}
    image |= {"NAXIS2": "24576", "PCOUNT": "0", "GCOUNT": "1", "EXTNAME": "'STIFFNESS'"}
    headers = ([f"{key:<8}= {value:>20}" for key, value in one.items()] for one in (primary, image))
    return b"".join(
        "".join(card.ljust(CARD) for card in (*cards, "END")).ljust(BLOCK).encode()
        for cards in headers
    )


def path_of(pick: random.Random, path: Path) -> str:
    """Put something else where the file was."""
    links = {"loop": path.name, "itself": ".", "dangling": "nowhere", "null": "/dev/null",
             "zero": "/dev/zero"}  # fmt: skip
    kind = pick.choice((*links, "folder", "fifo", "empty", "gone", "sparse"))
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    if kind in links:
        path.symlink_to(links[kind])
    elif kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "empty":
        path.touch()
    elif kind == "sparse":
        with path.open("wb") as file:
            file.write(b"SIMPLE  =                    T".ljust(BLOCK))
            file.truncate(2**40)
    return f"path: {kind}"


def spoil(pick: random.Random, path: Path) -> str:
    """Spoil a file in one of the ways that its kind knows."""
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > 2**26:
        return "spoilt already"
    suffixes = "".join(path.suffixes)
    if pick.random() < 0.04:
        return path_of(pick, path)
    if path.read_bytes()[:2] == b"\x1f\x8b":  # packed, and may unpack to gigabytes
        way = bytes_of
    elif suffixes.endswith((".fits", ".fits.gz")):
        way = pick.choices((fits_data, fits_cards, bytes_of, packed), (60, 30, 8, 2))[0]
    elif suffixes.endswith(".toml"):
        way = pick.choices((toml, bytes_of), (95, 5))[0]
    elif suffixes.endswith((".npy", ".npz", ".mat", ".h5")):
        way = pick.choices((arrays, bytes_of), (80, 20))[0]
    elif suffixes.endswith((".csv", ".ecsv", ".txt", ".pem", ".log", ".yaml", ".yml")):
        way = pick.choices((text, bytes_of), (85, 15))[0]
    else:
        way = bytes_of
    try:
        return way(pick, path)
    except Exception as error:  # spoilt before, and too odd to be spoilt by its structure
        return f"{bytes_of(pick, path)} (for {type(error).__name__})"
