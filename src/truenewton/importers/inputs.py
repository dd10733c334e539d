"""What was given to import: read, positions in metres, and when it was measured."""

from __future__ import annotations

import datetime
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError, UnreadableFile, naming
from truenewton.importers.selection import (
    Positions,
    Surface,
    in_metres,
    matrix_in,
    positions_in,
    positions_of,
    there_is,
)
from truenewton.importers.stored import Item, Stored, plain, read_stored
from truenewton.importers.supervisor import (
    CHANNELS,
    MATRIX,
    NUMBERS,
    POSITIONS,
    TRACK_NUMBER,
    channels_of,
    find_file,
    numbers_of,
    of_channels,
    places_of,
)
from truenewton.statics.layout import Layout

NAME = "MIRROR"  # where nothing tells it
OPTICALIB_POSITIONS = "ActuatorsCoordinates.fits"


@dataclass(frozen=True, eq=False)
class Given:
    """What was given.

    Attributes
    ----------
    item
        The matrix as it stands.
    path, kind
        Its file or folder, or ''; which layout that is, in words.
    which
        Of several matrices of its file, in words.
    header
        Of its file.
    positions, where
        In metres, or None; their file, or ''.
    channels
        (n,) names of its rows, or None.
    by_ring
        Positions if their file counts as the supervisor does, or None.
    """

    item: Item
    path: str
    kind: str
    header: Mapping[str, Any]
    positions: Positions | None
    where: str
    which: str = ""
    channels: NDArray[np.int64] | None = None
    by_ring: Positions | None = None

    @property
    def name(self) -> str:
        """INSTRUME, or the name of the file; a track number is none."""
        stem = Path(self.path).stem
        named = "" if TRACK_NUMBER.search(stem) else stem
        return str(self.header.get("INSTRUME") or named or NAME)


def read_given(
    matrix: Any, coordinates: Any, mirror: Layout | None, dataset: str | None, surface: Surface
) -> Given:
    """Read arrays, files or a folder, as `stiffness_from` takes them."""
    if not isinstance(matrix, str | os.PathLike):
        unit = str(getattr(matrix, "unit", "") or "")
        values = plain(getattr(matrix, "value", matrix))
        if values is None:
            raise FormatError("the matrix holds no real numbers", remedy="give an (n, n) array")
        stored = Stored("", {"": Item(values, unit)})
        item, which = matrix_in(stored, None)
    elif Path(matrix).is_dir():
        return _in_folder(Path(matrix), coordinates, mirror, dataset, surface)
    else:
        stored = read_stored(matrix)
        item, which = matrix_in(stored, dataset)
    where, found = "", coordinates if coordinates is not None else mirror
    if isinstance(found, str | os.PathLike):
        where = os.fspath(found)
        if Path(where).is_dir():
            raise UnreadableFile("is a folder", remedy="give a file of positions", path=where)
        places_file = read_stored(where)
        found = positions_in(places_file)
        if found is None:
            remedy = f"give columns X and Y, or an (n, 2) or (2, n) array; {there_is(places_file)}"
            raise FormatError("holds no positions", remedy=remedy, path=where)
    elif found is None:
        found, where = positions_in(stored), stored.path
    positions = _in_metres(found, where, surface)
    return Given(item, stored.path, "", stored.header, positions, where, which)


def _in_folder(
    path: Path, coordinates: Any, mirror: Layout | None, dataset: str | None, surface: Surface
) -> Given:
    """Read a supervisor's folder, or a configuration folder of opticalib.

    Positions are in a file of their own, or in the folder, or in one of the configuration.
    """
    if not (path / MATRIX).is_file():
        raise FormatError(
            "is a folder of no layout that is known here",
            remedy=f"give the matrix itself, or a folder with {MATRIX} and {CHANNELS}, or with"
            f" {MATRIX} and {OPTICALIB_POSITIONS}",
            path=path,
        )
    stored = read_stored(path / MATRIX)
    item, which = matrix_in(stored, dataset)
    own = Path(coordinates) if isinstance(coordinates, str | os.PathLike) else None
    conf, file = (own, None) if own is not None and own.is_dir() else (None, own)
    found: Any = coordinates
    if file is not None:
        found = positions_in(read_stored(file))
    elif conf is not None:
        found = None
    kind, how, channels, by_ring = "opticalib's configuration", "", None, None
    if (path / CHANNELS).is_file():
        kind, channels = "a supervisor's folder", channels_of(path)
        if found is None and file is None:
            found, file, how = places_of(path, conf, mirror, channels)
        elif file is not None and found is not None:
            every, found = found, of_channels(found, channels, file)
            numbers = find_file(NUMBERS, path)
            if found is not every and numbers is not None:
                by_ring = of_channels(every, numbers_of(channels, numbers), file)
    elif found is None and file is None:
        file = find_file(OPTICALIB_POSITIONS, path, conf)
        found = mirror if file is None else positions_in(read_stored(file))
    if file is not None and file.name == POSITIONS:
        surface = Surface(surface.lengths or "mm", surface.curvature, True)
    where = os.fspath(file or "")
    positions, by_ring = (_in_metres(each, where, surface) for each in (found, by_ring))
    if by_ring is not None:
        by_ring = replace(by_ring, notes=(f"in the order of {NUMBERS}", *by_ring.notes))
    if positions is not None and how:
        positions = replace(positions, notes=(how, *positions.notes))
    return Given(
        item,
        os.fspath(path),
        f", {kind}",
        stored.header,
        positions,
        where,
        which,
        channels,
        by_ring,
    )


def _in_metres(found: Any, path: str, surface: Surface) -> Positions | None:
    """Return positions in metres of what was found: in a file, a layout, an array or nothing."""
    if found is None:
        return None
    if isinstance(found, Layout):
        note = f"as laid out, NZ {found.nz.min():.4f} .. {found.nz.max():.4f}"
        return Positions(found.x, found.y, "m", found.id, found.nz, found.enabled, notes=(note,))
    with naming(path or "positions"):
        if not isinstance(found, Positions):
            values = np.asarray(plain(getattr(found, "value", found)), dtype=float)
            found = positions_of(Item(values, str(getattr(found, "unit", "") or "")))
        return in_metres(found, surface)


def date_of(given: Given, told: datetime.datetime | None) -> tuple[datetime.datetime, str]:
    """Return when it was measured (UTC), and what says so."""
    if told is not None:
        return told.replace(tzinfo=told.tzinfo or datetime.UTC), "as told"
    track = str(given.header.get("TRACKNUM", "")), Path(given.path).name
    for text in track:
        match = TRACK_NUMBER.search(text)
        if match:
            numbers = [int(part) for part in match.groups()]
            return datetime.datetime(*numbers, tzinfo=datetime.UTC), f"track number {match[0]}"  # type: ignore[misc,arg-type]
    for key in ("DATE-OBS", "DATE"):
        try:
            when = datetime.datetime.fromisoformat(str(given.header[key]).strip())
        except (KeyError, ValueError):
            continue
        return when.replace(tzinfo=when.tzinfo or datetime.UTC).astimezone(datetime.UTC), key
    if given.path:
        seconds = Path(given.path).stat().st_mtime
        when = datetime.datetime.fromtimestamp(int(seconds), tz=datetime.UTC)
        return when, "of the file; --date knows better"
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    return now, "now; date= knows better"
