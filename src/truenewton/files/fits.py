"""FITS in and out, safely: the only importer of astropy.io.fits.

Reading takes the whole file at once, or leaves long rows where they are; it verifies CHECKSUM and
DATASUM where they stand, converts units and byte order, and turns whatever is wrong into one line
that names the file. The same data written twice give the same bytes.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from truenewton.errors import FormatError, TrueNewtonError, UnreadableFile
from truenewton.files.content import FitsFile, Image, Table
from truenewton.files.outputs import file_beside
from truenewton.files.stored_rows import StoredRows, blocks, state_of
from truenewton.files.stored_tables import long_rows, without_columns

if TYPE_CHECKING:
    pass


GZIP, START = b"\x1f\x8b", b"SIMPLE"


def read_fits(path: str | os.PathLike[str], *, whole: bool = True) -> FitsFile:
    """Read a FITS file, plain or gzipped.

    Parameters
    ----------
    path
        The file.
    whole
        If false, vector columns of tables are left in the file, unless it is gzipped.

    Raises
    ------
    UnreadableFile
        It cannot be opened, is not FITS, is truncated, or a checksum does not match.
    """
    path = os.fspath(path)
    try:
        with Path(path).open("rb") as file:
            state = None if whole or file.peek(2)[:2] == GZIP else state_of(file)
            raw = file.read() if state is None else b""
            digest = hashlib.sha256(raw) if raw else hashlib.file_digest(file, "sha256")
    except OSError as error:
        raise UnreadableFile(
            f"cannot be read ({error.strerror or error})", remedy="check the path", path=path
        ) from error
    try:
        if raw[:2] == GZIP:
            raw = gzip.decompress(raw)
        with (
            io.BytesIO(raw) if state is None else Path(path).open("rb") as stream,
            warnings.catch_warnings(record=True) as caught,
        ):
            warnings.simplefilter("always")
            if stream.read(len(START)) != START:
                raise UnreadableFile("is not a FITS file", remedy="give FITS files", path=path)
            stream.seek(0)
            with fits.open(stream, memmap=False) as hdus:
                hdus.readall()
                _refuse_damage(caught, path)
                for hdu in hdus:
                    _verify(stream, hdu, path)
                return _take(_Opened(path, digest.hexdigest(), stream, state), hdus)
    except (UnreadableFile, FormatError):
        raise
    except Exception as error:
        # A damaged file can raise nearly anything inside a FITS reader; this is the boundary.
        raise UnreadableFile(
            "is damaged or truncated", remedy="fetch it again", path=path
        ) from error


@dataclass(frozen=True)
class _Opened:
    """A file that is being read; ``state`` where long rows are to stay in it, else None."""

    path: str
    digest: str
    stream: BufferedIOBase
    state: tuple[int, int] | None


def _refuse_damage(caught: list[warnings.WarningMessage], path: str) -> None:
    """Refuse a file of which astropy only warns that its length is wrong."""
    said = " ".join(str(warning.message) for warning in caught)
    if "truncated" in said:
        raise UnreadableFile("is truncated", remedy="fetch it again", path=path)
    if "corrupted" in said:
        raise UnreadableFile(
            "is damaged, or bytes follow its end", remedy="fetch it again", path=path
        )


def _verify(stream: BufferedIOBase, hdu: Any, path: str) -> None:
    """Compare CHECKSUM and DATASUM, where they stand, with the bytes as they are on disk.

    Astropy sums what it would write itself, and so misses damage to the padding.
    """
    whole, wanted = hdu.header.get("CHECKSUM"), hdu.header.get("DATASUM")
    if not (whole or wanted):
        return
    at = hdu.fileinfo()
    of_data = _sum32(stream, at["datLoc"], at["datSpan"])
    total = _folded(_sum32(stream, at["hdrLoc"], at["datLoc"] - at["hdrLoc"]) + of_data)
    if (whole and total != 0xFFFFFFFF) or (wanted and str(of_data) != str(wanted).strip()):
        raise UnreadableFile(
            "a CHECKSUM or DATASUM does not match",
            remedy="the file was changed or damaged: fetch it again",
            path=path,
        )


def _sum32(stream: BufferedIOBase, start: int, length: int) -> int:
    """Return the sum of 32-bit words in ones' complement (FITS standard, appendix J)."""
    stream.seek(start)
    total = 0
    for some in blocks(length // 4, 4):  # of whole words
        words = np.frombuffer(stream.read(4 * (some.stop - some.start)), dtype=">u4")
        total += int(words.sum(dtype=np.uint64))
    return _folded(total)


def _folded(total: int) -> int:
    """Return a sum in ones' complement of 32 bits: what overflows comes in again below."""
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def _take(opened: _Opened, hdus: Any) -> FitsFile:
    """Copy everything out of open HDUs; what is wrong with an extension waits until asked for."""
    path = opened.path
    tables: dict[str, Table] = {}
    images: dict[str, Image] = {}
    unsound: dict[str, TrueNewtonError] = {}
    for hdu in hdus[1:]:
        name = str(hdu.name).upper()
        if name in tables or name in images:
            unsound[name] = FormatError(f"there are two {name}", remedy="keep one", path=path)
            continue
        try:
            _refuse_doubles(hdu.header.keys(), "keywords", path)
            if isinstance(hdu, fits.BinTableHDU):
                tables[name] = _table(opened, hdu, name)
            elif isinstance(hdu, fits.ImageHDU) and hdu.data is not None:
                unit = hdu.header.get("BUNIT")
                data = _native(hdu.data)
                images[name] = Image(path, name, data, None if unit is None else str(unit))
        except TrueNewtonError as error:
            unsound[name] = error
        except Exception:
            unsound[name] = UnreadableFile(
                f"{name} is damaged", remedy="fetch the file again", path=path
            )
    header = hdus[0].header
    _refuse_doubles(header.keys(), "keywords", path)
    plain = {k: v for k, v in header.items() if not isinstance(v, fits.card.Undefined)}
    return FitsFile(path, opened.digest, plain, tables, images, unsound)


def _refuse_doubles(names: Iterable[str], what: str, path: str) -> None:
    """Refuse a name that stands twice: which one counts is anybody's guess."""
    for name, count in Counter(names).items():
        if count > 1 and name not in ("", "COMMENT", "HISTORY"):
            raise FormatError(f"there are two {what} {name}", remedy="keep one", path=path)


def _table(opened: _Opened, hdu: Any, name: str) -> Table:
    path = opened.path
    if hdu.header["TFIELDS"] > 999:  # the standard's limit; a damaged count may be billions
        raise FormatError(f"{name} has over 999 columns", remedy="leave some out", path=path)
    _refuse_doubles([str(key).upper() for key in hdu.columns.names], "columns", path)
    left: dict[str, StoredRows] = {}
    if opened.state:
        left = long_rows(hdu, path, opened.state)
        hdu = without_columns(opened.stream, hdu, left)
    columns: dict[str, tuple[NDArray[Any] | StoredRows, str | None]] = {}
    for column in hdu.columns:
        values: NDArray[Any] | StoredRows | None = left.get(column.name)
        if values is None:
            values = _native(np.asarray(hdu.data[column.name]))
        unit = None if column.unit is None else str(column.unit)
        columns[str(column.name).upper()] = values, unit
    return Table(path, name, len(hdu.data), columns)


def _native(values: NDArray[Any]) -> NDArray[Any]:
    """Copy to the machine's byte order."""
    return np.array(values, dtype=values.dtype.newbyteorder("="), order="C")


@dataclass(frozen=True, eq=False)
class Sheet:
    """An extension to be written: columns make a table, ``data`` an image.

    Attributes
    ----------
    name
        EXTNAME.
    columns
        (name, FITS format, unit or None, values) of a table.
    data, unit
        Pixels of an image and BUNIT.
    """

    name: str
    columns: tuple[tuple[str, str, str | None, Any], ...] = ()
    data: NDArray[Any] | None = None
    unit: str | None = None


def write_fits(
    path: str | os.PathLike[str],
    header: Mapping[str, tuple[Any, str]],
    sheets: list[Sheet],
    *,
    overwrite: bool = False,
) -> None:
    """Write a FITS file with checksums, beside its target and then renamed.

    Parameters
    ----------
    path
        The target; gzipped where it ends in .gz.
    header
        Primary keywords with value and comment; None and NaN are left out (docs/files.md).
    sheets
        The extensions, in order.

    Raises
    ------
    OutputExists, OutputFailed
    FormatError
        A keyword holds what no FITS header can.
    """
    primary = fits.PrimaryHDU()
    _fill(primary.header, header, path)
    _write_whole(path, [primary, *map(_hdu, sheets)], overwrite=overwrite)


def write_matrix(
    path: str | os.PathLike[str],
    header: Mapping[str, tuple[Any, str]],
    matrix: NDArray[Any],
    *,
    overwrite: bool = False,
) -> None:
    """Write a FITS file that holds one matrix and nothing else, as other programs read it.

    Raises
    ------
    OutputExists, OutputFailed
    FormatError
        A keyword holds what no FITS header can.
    """
    primary = fits.PrimaryHDU(np.asarray(matrix, dtype=">f8"))
    _fill(primary.header, header, path)
    _write_whole(path, [primary], overwrite=overwrite)


def _fill(
    made: fits.Header, header: Mapping[str, tuple[Any, str]], path: str | os.PathLike[str]
) -> None:
    for key, (value, comment) in header.items():
        if value is not None and not (isinstance(value, float) and np.isnan(value)):
            try:
                made.append(_card(key, value, comment), end=True)
            except ValueError:
                raise FormatError(
                    f"{key} is {value!r}",
                    remedy="a FITS header holds finite numbers and ASCII text",
                    path=path,
                    got=value,
                ) from None


def _write_whole(path: str | os.PathLike[str], parts: list[Any], *, overwrite: bool) -> None:
    hdus = fits.HDUList(parts)
    for hdu in hdus:
        # astropy would note the time of writing: the same data shall give the same bytes.
        hdu.add_checksum(when="data unit checksum")
    with file_beside(path, overwrite=overwrite) as temporary, temporary.open("wb") as file:
        if os.fspath(path).endswith(".gz"):
            with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed:
                _write(hdus, packed)
        else:
            _write(hdus, file)


def _write(hdus: fits.HDUList, file: BufferedIOBase) -> None:
    """Write HDUs; a full disk shows as the system's own error, of which astropy makes a riddle."""
    sink = _Sink(file)
    try:
        hdus.writeto(sink)
    except Exception as error:
        raise sink.failure or error from None


class _Sink:
    """A file that astropy can only write to, by Python's own means, and why it could not."""

    def __init__(self, file: BufferedIOBase) -> None:
        self.file, self.flush, self.tell = file, file.flush, file.tell
        self.failure: OSError | None = None

    def write(self, data: bytes) -> int:
        try:
            return self.file.write(data)
        except OSError as error:
            self.failure = error
            raise


def _card(key: str, value: Any, comment: str) -> Any:
    """Return a header card; astropy alone would cut a number to 20 characters."""
    if isinstance(value, float) and len(repr(float(value))) > 20:
        line = f"{key:<8}= {repr(float(value)).upper()} / {comment}"
        return fits.Card.fromstring(line[:80])
    return fits.Card(key, value, comment)


def _hdu(sheet: Sheet) -> Any:
    if sheet.data is None:
        columns = [
            fits.Column(name=name, format=_wide(form, values), unit=unit, array=values)
            for name, form, unit, values in sheet.columns
        ]
        return fits.BinTableHDU.from_columns(columns, name=sheet.name)
    hdu = fits.ImageHDU(np.asarray(sheet.data, dtype=">f8"), name=sheet.name)
    if sheet.unit:
        hdu.header["BUNIT"] = sheet.unit
    return hdu


def _wide(form: str, values: Any) -> str:
    """Return the format, 64 bit where integers do not fit into 32."""
    if form == "J" and np.abs(np.asarray(values, dtype=np.int64)).max(initial=0) > 2**31 - 1:
        return "K"
    return form


def ascii_text(text: str) -> str:
    """FITS holds ASCII only; a file name may hold anything."""
    return text.encode("ascii", "backslashreplace").decode()
