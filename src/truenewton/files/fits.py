"""Reading and writing FITS: the only importer of astropy.io.fits.

CHECKSUM and DATASUM are verified if there are any,
and any fault becomes one line that names the file. The same data written twice give the same bytes.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import math
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from io import BufferedIOBase, BufferedReader
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from truenewton.arrays import blocks
from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile, located, naming
from truenewton.files.content import PRIMARY, FitsFile, Image, Table
from truenewton.files.format import (
    Attribute,
    FileFormat,
    ImageFormat,
    TableFormat,
    columns_of,
    header_of,
    value_of,
)
from truenewton.files.opening import GZIP, open_plain, refuse_too_large, unpacked
from truenewton.files.outputs import file_beside
from truenewton.rounding import listed

SUFFIXES = (".fits", ".fits.gz")
START = b"SIMPLE"
BLOCK, CARD = 2880, 80  # bytes
MAX_COLUMNS = 999  # the standard's limit
MAX_HEADER_BLOCKS = 2000  # 72,000 cards
DAMAGE = {"truncated": "is truncated", "corrupted": "is damaged, or bytes follow its end"}


def read_fits(path: str | os.PathLike[str]) -> FitsFile:
    """Read a FITS file."""
    with naming(path):
        return _read(os.fspath(path))


def _read(path: str) -> FitsFile:
    try:
        with open_plain(path) as file:
            packed = file.peek(2)[:2] == GZIP
            if not packed:  # before all of it is read
                _check_start(file, path)
            raw = file.read()
            digest = hashlib.sha256(raw)
        if packed:
            raw = unpacked(raw, path)
            _check_start(io.BytesIO(raw), path)
        with io.BytesIO(raw) as stream, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with fits.open(stream, memmap=False) as hdus:
                hdus.readall()
                # Of a wrong length astropy only warns.
                warned = " ".join(str(warning.message) for warning in caught)
                for word, fault in DAMAGE.items():
                    if word in warned:
                        raise UnreadableFile(fault, remedy="fetch it again")
                for hdu in hdus:
                    _verify_checksums(stream, hdu)
                refuse_doubles(hdus[0].header.keys(), "keywords")
                plain = _plain(hdus[0].header)
                extensions = _extensions(hdus, path)
                return FitsFile(path, digest.hexdigest(), plain, extensions)
    except (UnreadableFile, FormatError):
        raise
    except Exception as error:
        # A damaged file can raise nearly anything inside a FITS reader; this is the boundary.
        raise UnreadableFile("is damaged or truncated", remedy="fetch it again") from error


def _check_start(stream: io.BytesIO | BufferedReader, path: str) -> None:
    """Refuse a stream that is not FITS or is truncated; go back to its start."""
    start = stream.read(len(START))
    if start != START:
        raise UnreadableFile(
            "is not a FITS file" + ("" if start else ", but empty"),
            remedy="give FITS files; `truenewton import` converts a matrix, and a campaign as"
            " `truenewton import --example` describes it"
            if start
            else "fetch it again",
        )
    _check_sizes(stream, path)


def _check_sizes(stream: BufferedIOBase, path: str) -> None:
    """Refuse a file whose headers declare more data than it contains; go back to the start.

    A damaged header may declare 2^63 axes, rows or columns, for which astropy works for minutes or
    asks for all memory (FITS Standard 4.0, sections 3.1, 4.4 and 7.3).
    """
    end, start, index = stream.seek(0, 2), 0, 0
    while start + BLOCK <= end:
        stream.seek(start)
        header = _header(stream)
        part = str(header.get("EXTNAME") or f"part {index}")
        size, left = _data_size(header, part, path), end - stream.tell()
        if size > left:
            raise UnreadableFile(
                f"is truncated, or damaged: {part} declares {size} bytes of data, and {left}"
                " follow",
                remedy="fetch it again",
            )
        start = stream.tell() + -(-size // BLOCK) * BLOCK
        index += 1
    stream.seek(0)


def _header(stream: BufferedIOBase) -> Any:
    """Return the header that begins here."""
    raw = b""
    for _ in range(MAX_HEADER_BLOCKS):
        block = stream.read(BLOCK)
        raw += block
        cards = (block[k : k + CARD].rstrip() for k in range(0, len(block), CARD))
        if b"END" in cards:
            return fits.Header.fromstring(raw)
        if len(block) < BLOCK:
            break
    raise UnreadableFile("is damaged: a header does not end", remedy="fetch the file again")


def _data_size(header: Any, part: str, path: str) -> int:
    """Return the bytes of data that follow a header, |BITPIX| GCOUNT (PCOUNT + product of axes)."""

    def number(key: str, default: int | None = None, low: int = 0, high: int = 2**63 - 1) -> int:
        value = header.get(key, default)
        if not isinstance(value, int) or not low <= value <= high:
            fault = f"is damaged: {key} of {part} is {'missing' if value is None else value}"
            raise UnreadableFile(fault, remedy="fetch the file again")
        return value

    def pixels(prefix: str) -> int:
        """Return the product of the axes."""
        count = number(f"{prefix}NAXIS", high=999)
        return math.prod(number(f"{prefix}NAXIS{k + 1}") for k in range(count)) if count else 0

    def pixel_size(key: str) -> int:
        return abs(number(key, low=-64, high=64)) // 8

    if number("TFIELDS", 0) > MAX_COLUMNS:
        raise FormatError(f"{part} has over {MAX_COLUMNS} columns", remedy="leave some out")
    if header.get("ZIMAGE") is True:  # tiles of a compressed image
        refuse_too_large(pixels("Z") * pixel_size("ZBITPIX"), path, part)
    words = number("GCOUNT", 1, high=2**31) * (number("PCOUNT", 0) + pixels(""))
    return words * pixel_size("BITPIX")


def _verify_checksums(stream: BufferedIOBase, hdu: Any) -> None:
    """Compare CHECKSUM and DATASUM, if there are any, with the bytes on disk (appendix J).

    Astropy sums what it would write itself, and so does not see damage to the padding.
    """
    whole, wanted = hdu.header.get("CHECKSUM"), hdu.header.get("DATASUM")
    if not (whole or wanted):
        return
    at = hdu.fileinfo()
    of_data = _sum32(stream, at["datLoc"], at["datSpan"])
    of_header = _sum32(stream, at["hdrLoc"], at["datLoc"] - at["hdrLoc"])
    total = (of_header + of_data) % 0xFFFFFFFF  # 0 stands for all ones, too
    if (whole and total) or (wanted and str(of_data) != str(wanted).strip()):
        raise UnreadableFile(
            "a CHECKSUM or DATASUM does not match",
            remedy="the file was changed or damaged: fetch it again",
        )


def _sum32(stream: BufferedIOBase, start: int, length: int) -> int:
    """Return the sum of 32-bit words in ones' complement."""
    stream.seek(start)
    total = 0
    for some in blocks(length // 4, 4):  # of whole words
        words = np.frombuffer(stream.read(4 * (some.stop - some.start)), dtype=">u4")
        total += int(words.sum(dtype=np.uint64))
    return (total - 1) % 0xFFFFFFFF + 1 if total else 0  # what overflows comes in again below


def _plain(header: Any) -> dict[str, Any]:
    return {k: v for k, v in header.items() if not isinstance(v, fits.card.Undefined)}


Extensions = dict[str, Table | Image | TrueNewtonError]


def _extensions(hdus: Any, path: str) -> Extensions:
    """Copy everything out of open HDUs; what is wrong with an extension waits until asked for."""
    extensions: Extensions = {}
    if hdus[0].data is not None and hdus[0].is_image:
        extensions[PRIMARY] = Image(_native(hdus[0].data), str(hdus[0].header.get("BUNIT", "")))
    for hdu in hdus[1:]:
        name = str(hdu.name).upper()
        if name in extensions:
            extensions[name] = FormatError(f"there are two {name}", remedy="keep one", path=path)
        elif (held := _held(hdu, name, path)) is not None:
            extensions[name] = held
    return extensions


def _held(hdu: Any, name: str, path: str) -> Table | Image | TrueNewtonError | None:
    """Return the contents of an extension, or its fault; None for other kinds."""
    try:
        refuse_doubles(hdu.header.keys(), "keywords")
        if isinstance(hdu, fits.BinTableHDU):
            return _table(hdu)
        if isinstance(hdu, fits.ImageHDU) and hdu.data is not None:
            return Image(_native(hdu.data), str(hdu.header.get("BUNIT", "")))
    except TrueNewtonError as error:
        return located(error, path)
    except Exception:
        return UnreadableFile(f"{name} is damaged", remedy="fetch the file again", path=path)
    return None


def refuse_doubles(names: Iterable[str], what: str) -> None:
    """Refuse names that occur twice."""
    counts = Counter(names)
    doubles = [n for n in counts if counts[n] > 1 and n not in ("", "COMMENT", "HISTORY")]
    if doubles:
        raise FormatError(f"there are two {what} {listed(doubles, 3)}", remedy="keep one of each")


def _table(hdu: Any) -> Table:
    """Copy a table."""
    refuse_doubles([str(key).upper() for key in hdu.columns.names], "columns")
    if hdu.columns.dtype.itemsize != hdu.header["NAXIS1"]:
        fault = f"is damaged: the columns of {hdu.name} do not make its rows"
        raise UnreadableFile(fault, remedy="fetch the file again")
    columns: dict[str, tuple[NDArray[Any], str]] = {}
    for column in hdu.columns:
        if str(column.format).lstrip("0123456789")[:1] in ("P", "Q"):
            values = np.empty(len(hdu.data), dtype=object)  # no format of ours has such vectors
        else:
            values = _native(np.asarray(hdu.data[column.name]))
        columns[str(column.name).upper()] = values, str(column.unit or "")
    return Table(len(hdu.data), columns)


def _native(values: NDArray[Any]) -> NDArray[Any]:
    """Copy to the machine's byte order, read-only so that a record need not copy it again."""
    # By its name: a dtype that is swapped back is another object, for which numpy copies again.
    copy = np.array(values, dtype=values.dtype.newbyteorder("=").str, order="C")
    copy.setflags(write=False)
    return copy


def write_fits(
    path: str | os.PathLike[str],
    form: FileFormat,
    record: Any,
    *,
    overwrite: bool = False,
) -> None:
    """Write a record in a format, with checksums; gzipped if the name of the file ends in .gz."""
    hdus = _hdus(record, form, path)
    with file_beside(path, overwrite=overwrite) as temporary, temporary.open("wb") as file:
        if os.fspath(path).endswith(".gz"):
            with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed:
                packed.writelines(map(_bytes, hdus))
        else:
            file.writelines(map(_bytes, hdus))


def _hdus(record: Any, form: FileFormat, path: str | os.PathLike[str]) -> Iterator[Any]:
    """Yield the header-data units of a file; each is in memory only while it is written.

    Extensions that are optional and have nothing are left out.
    """
    primary = fits.PrimaryHDU(None if form.matrix is None else _pixels(record, form.matrix))
    for key, value, comment in header_of(record, form):
        try:
            primary.header.append(_card(key, value, comment), end=True)
        except ValueError:
            raise FormatError(
                f"{key} is {value!r}",
                remedy="use finite numbers and ASCII text, as a FITS header requires",
                path=path,
            ) from None
    yield primary
    for part in form.extensions:
        if isinstance(part, ImageFormat) or not part.optional or value_of(record, part.of):
            yield _hdu(record, part)


def _bytes(hdu: Any) -> memoryview:
    """Return header and data of a unit as in a file.

    Of a full disk astropy makes a riddle: Python meets it, when it writes these.
    """
    # astropy would note the time of writing: the same data shall give the same bytes.
    hdu.add_checksum(when="data unit checksum")
    first = isinstance(hdu, fits.PrimaryHDU)
    whole = io.BytesIO()
    fits.HDUList([hdu] if first else [fits.PrimaryHDU(), hdu]).writeto(whole)
    return whole.getbuffer()[0 if first else BLOCK :]


def _card(key: str, value: Any, comment: str) -> Any:
    """Return a header card; astropy alone would cut a number to 20 characters."""
    if isinstance(value, float) and len(repr(float(value))) > 20:
        line = f"{key:<8}= {repr(float(value)).upper()} / {comment}"
        return fits.Card.fromstring(line[:80])
    return fits.Card(key, value, comment)


def _hdu(record: Any, extension: TableFormat | ImageFormat) -> Any:
    if isinstance(extension, TableFormat):
        columns = [
            fits.Column(name=name, format=form, unit=unit, array=values)
            for name, form, unit, values in columns_of(record, extension)
        ]
        return fits.BinTableHDU.from_columns(columns, name=extension.name)
    pixels = _pixels(record, extension.attribute)
    hdu = fits.ImageHDU(pixels, name=extension.name)
    if extension.unit:
        hdu.header["BUNIT"] = extension.unit
    return hdu


def _pixels(record: Any, attribute: Attribute) -> NDArray[Any]:
    values = np.asarray(value_of(record, attribute))
    return values.astype(">i4" if values.dtype.kind == "i" else ">f8")
