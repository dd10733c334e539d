"""Ways to spoil a file, each by a random generator: bytes, cards and values of FITS, words."""

import re

import numpy as np
from astropy.io import fits

CARD = 80
LAYOUT = re.compile(rb"NAXIS|TFIELDS|TFORM|PCOUNT|BITPIX|GCOUNT|TTYPE")
NUMBERS = (
    *("nan", "inf", "-inf", "0.0", "-1.0", "1e308", "1e-320", "1e155", "-1e30", "1e-15", "1e400"),
    *("1e6", "89.9999999", "0", "1", "-1", "7", "65536", "2147483647", "9" * 40),
)
TEXTS = (
    *("", " ", "x", "%s%n{0}", "../../..", "/", "'", "ring", "modes", "auto", "1,2,3", "[[1]]"),
    *("2026-13-01T00:00:00", "0001-01-01", "a" * 3000, "\u00e9\u4e2d", "\x1b[2J\x07"),
)
CARDS = (
    *(*NUMBERS, "T", "F", "(1.0, 2.0)", "1.5D3", "'open"),
    *(f"'{text[:60]}'" for text in TEXTS),
)


def fits_cards(pick, path):
    """Spoil a card as it stands in the bytes; checksums, which would show it, are taken out."""
    raw = bytearray(path.read_bytes().replace(b"CHECKSUM=", b"CHECKSUX="))
    raw = raw.replace(b"DATASUM =", b"DATASUX =")
    places = range(0, len(raw), CARD)
    cards = [at for at in places if re.match(rb"[A-Z][A-Z0-9-]{1,7} *= ", raw[at : at + 10])]
    layout = [at for at in cards if LAYOUT.match(raw, at)]  # of the table, which readers trust
    at, other = pick.choice(layout if layout and pick.random() < 0.5 else cards), pick.choice(cards)
    own, value = bytes(raw[at : at + CARD]), pick.choice(CARDS)
    new = own[:8] + f"= {value:>20}"[: CARD - 8].ljust(CARD - 8).encode("latin-1", "replace")
    raw[at : at + CARD] = pick.choice((new, new, b"COMMENT".ljust(CARD), raw[other : other + CARD]))
    if pick.random() < 0.2:
        raw[other : other + CARD] = own
    path.write_bytes(raw)


def fits_values(pick, path):
    """Spoil values of a table or an image, or drop rows; write the file anew without checksums."""
    with np.errstate(all="ignore"), fits.open(path, memmap=False) as hdus:
        for hdu in hdus:
            for key in ("CHECKSUM", "DATASUM"):
                hdu.header.remove(key, ignore_missing=True)
        hdu = pick.choice([hdu for hdu in hdus if hdu.data is not None and hdu.data.size])
        table = isinstance(hdu, fits.BinTableHDU)
        values = hdu.data[pick.choice(hdu.columns.names)] if table else hdu.data
        rows = values.reshape(len(values), -1)
        if rows.dtype.kind == "f":
            places = (slice(None), pick.randrange(len(rows)))
            at = pick.choice(places), pick.choice((slice(None), pick.randrange(rows.shape[1])))
            number = float(pick.choice(NUMBERS))
            rows[at] = pick.choice((number, number * rows[at], rows[0][at[1]]))
        elif table:
            hdu.data = hdu.data[pick.sample(range(len(rows)), pick.randrange(len(rows)))]
        hdus.writeto(path, overwrite=True)


def words_of(pick, path):
    """Spoil a word or a line of a text."""
    lines = path.read_text(errors="replace").splitlines() or [""]
    at, odd = pick.randrange(len(lines)), pick.choice((*NUMBERS, *TEXTS))
    words = re.findall(r"\W|\w[\w.+-]*", lines[at]) or [""]
    words[pick.randrange(len(words))] = odd
    lines[at : at + 1] = pick.choice((["".join(words)],) * 3 + ([], [odd], [lines[at]] * 2))
    path.write_text("\n".join(lines) + "\n")


def bytes_of(pick, path):
    """Cut, flip, insert, append or delete bytes."""
    raw = bytearray(path.read_bytes())
    at, odd = pick.randrange(len(raw)), pick.choice((b"\0", b"\xff", b" " * 2880, raw[:2880]))
    kind = pick.choice(("cut", "flip", "insert", "append", "delete"))
    if kind == "cut":
        del raw[at:]
    elif kind == "flip":
        raw[at] ^= 1 << pick.randrange(8)
    elif kind == "delete":
        del raw[at : at + pick.choice((1, CARD, 2880))]
    else:
        at = at if kind == "insert" else len(raw)
        raw[at:at] = odd
    path.write_bytes(raw)


def spoil(pick, path):
    """Spoil a file in one of the ways of its kind."""
    ways = {
        ".fits": (fits_cards, fits_cards, fits_values, fits_values, bytes_of),
        ".npy": (bytes_of,),
    }
    pick.choice(ways.get(path.suffix, (words_of, words_of, words_of, bytes_of)))(pick, path)
