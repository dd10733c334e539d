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

from truenewton.errors import FormatError, UnreadableFile
from truenewton.importers.selection import (
    Places,
    Positions,
    as_places,
    in_metres,
    matrix_in,
    places_in,
    there_is,
)
from truenewton.importers.stored import Item, Stored, plain, read_stored
from truenewton.importers.supervisor import NUMBERS, TRACK_NUMBER, read_folder
from truenewton.statics.layout import Layout

NAME = "MIRROR"  # where nothing tells it


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


@dataclass(frozen=True)
class Surface:
    """How positions are to be taken: their unit, R [m] or None, radii along the surface."""

    lengths: str | None
    curvature: float | None
    arc: bool


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
        found = places_in(places_file)
        if found is None:
            remedy = f"give columns X and Y, or an (n, 2) or (2, n) array; {there_is(places_file)}"
            raise FormatError("holds no positions", remedy=remedy, path=where)
    elif found is None:
        found, where = places_in(stored), stored.path
    positions = _positions(found, where, surface)
    return Given(item, stored.path, "", stored.header, positions, where, which)


def _in_folder(
    path: Path, coordinates: Any, mirror: Layout | None, dataset: str | None, surface: Surface
) -> Given:
    by_path = isinstance(coordinates, str | os.PathLike)
    folder = read_folder(path, Path(coordinates) if by_path else None, mirror)
    found: Any = folder.places if coordinates is None or by_path else coordinates
    where = os.fspath(folder.where or "")
    lengths, arc = surface.lengths or folder.unit or None, surface.arc or folder.arc
    surface = Surface(lengths, surface.curvature, arc)
    positions = _positions(found, where, surface)
    by_ring = _positions(folder.by_ring if found is folder.places else None, where, surface)
    if by_ring is not None:
        by_ring = replace(by_ring, notes=(f"in the order of {NUMBERS}", *by_ring.notes))
    if positions is not None and folder.how:
        positions = replace(positions, notes=(folder.how, *positions.notes))
    (item, which), header = matrix_in(folder.matrix, dataset), folder.matrix.header
    kind, channels = f", {folder.kind}", folder.channels
    return Given(item, os.fspath(path), kind, header, positions, where, which, channels, by_ring)


def _positions(found: Any, path: str, surface: Surface) -> Positions | None:
    """Return positions in metres of what was found: places, a layout, an array or nothing."""
    if found is None:
        return None
    if isinstance(found, Layout):
        note = f"as laid out, NZ {found.nz.min():.4f} .. {found.nz.max():.4f}"
        return Positions(found.x, found.y, found.nz, found.id, found.enabled, (note,))
    if not isinstance(found, Places):
        unit = str(getattr(found, "unit", "") or "")
        found = as_places(plain(getattr(found, "value", found)), unit)
    return in_metres(found, surface.lengths, surface.curvature, path, arc=surface.arc)


def date_of(given: Given) -> tuple[datetime.datetime, str]:
    """Return when it was measured (UTC), and what says so."""
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
