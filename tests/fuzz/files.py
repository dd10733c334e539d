"""Ways to spoil a file that need not know FITS: TOML, tables of text, bytes, gzip, paths; the door.

Each takes a random generator and the path of a sound file, changes what stands there, and returns
what it did in words.
"""

from __future__ import annotations

import gzip
import json
import os
import random
import re
import shutil
import stat
from pathlib import Path

from .fits import BLOCK, CARD, fits_cards, fits_data
from .foreign import arrays
from .values import INTEGERS, NUMBERS, TEXTS, number

VALUE = re.compile(r'(?<== )("[^"]*"|[-\w.+]+|\[[^\[\]]*\]|\{[^{}]*\})')  # of a key in TOML
ODD_VALUES = ("true", "[]", "{}", "[1]", "[[[]]]", "{a = {b = 1}}", "[{}]", "[[0.0, 0.0]]",
              "1" * 400, f"{['x'] * 1000}", f"{[*range(20000)]}")  # fmt: skip

# --- TOML and tables of text --------------------------------------------------------------------


def toml(pick: random.Random, path: Path) -> str:
    """Give a key another value, or spoil the text."""
    content = path.read_text()
    values = [*VALUE.finditer(content)]
    if not values or pick.random() < 0.3:
        return text(pick, path)
    old = pick.choice(values)
    numbers = (number(pick), number(pick), pick.choice(INTEGERS))
    quoted = json.dumps(pick.choice(TEXTS)).replace("\x7f", "\\u007f")
    new = pick.choice((*map(repr, numbers), quoted, pick.choice(ODD_VALUES)))
    path.write_text(content[: old.start()] + new + content[old.end() :], errors="replace")
    return f"{old[0][:20]}: {new[:20]}"


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
        odd = (b"\0", b"\xff", b" " * BLOCK, b"\0" * BLOCK, b"\r\n", pick.randbytes(9))
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
        )
    )  # fmt: skip
    path.write_bytes(new)
    return f"gzip: {kind}"


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
    elif suffixes.endswith((".csv", ".ecsv", ".txt", ".pem", ".log")):
        way = pick.choices((text, bytes_of), (85, 15))[0]
    else:
        way = bytes_of
    try:
        return way(pick, path)
    except Exception as error:  # spoilt before, and too odd to be spoilt by its structure
        return f"{bytes_of(pick, path)} (for {type(error).__name__})"
