"""The input of an import: arrays, files, or the folder of a supervisor or of opticalib.

Their files are described in docs/import.md. TRACKNUM is in the headers of a supervisor's.
"""

from __future__ import annotations

import datetime
import os
import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError, naming
from truenewton.files.tables import Item, plain, text_of, without_group
from truenewton.importers.selection import (
    Surface,
    in_metres,
    matrix_in,
    positions_in,
    read_positions,
)
from truenewton.importers.stored import Stored, read_stored
from truenewton.records.file import FOREIGN_MATRIX
from truenewton.records.tables import ID_NAMES, Positions, positions_from
from truenewton.rounding import listed
from truenewton.statics.layout import Layout, layout, ring_of

MATRIX, CHANNELS = FOREIGN_MATRIX, "ff_list.fits"
TRACK_NUMBER = re.compile(r"(\d{4})(\d\d)(\d\d)_(\d\d)(\d\d)(\d\d)")
NUMBERS, SHELL, POSITIONS = "act2mir_act.txt", "shell.txt", "act_coordinates.fits"
NAME = "MIRROR"  # if it is unknown
OPTICALIB_POSITIONS = "ActuatorsCoordinates.fits"
MAX_FILES = 10_000  # of a folder that are looked at
Trees = Mapping[Path, Mapping[str, list[Path]]]  # folders, and the files in each by name


class Rings(NamedTuple):
    """The actuators of a known mirror, and its name or ''."""

    layout: Layout
    name: str

    @classmethod
    def of(cls, mirror: Any) -> Rings:
        """Return those of a mirror, or of its layout."""
        return cls(getattr(mirror, "layout", mirror), getattr(mirror, "name", ""))


class NoPositions(FormatError):
    """There are no positions; ``actuators`` is the number of those that they are needed for."""

    def __init__(
        self, fault: str, *, remedy: str = "", path: object = None, actuators: int = 0
    ) -> None:
        super().__init__(fault, remedy=remedy, path=path)
        self.actuators = actuators


@dataclass(frozen=True, eq=False)
class Given:
    """The input of an import.

    Attributes
    ----------
    item, which
        The matrix as stored; a text that names it if its file has several.
    stored
        Its file.
    kind, path
        A text on the kind of folder, and its path; or '', and the path of the file.
    positions, where
        In metres, or None; their file, or ''.
    channels
        (n,) IDs of the rows, or None.
    numbering
        Where these are from.
    by_ring
        Positions if their file is in the supervisor's order of rings, or None.
    mirror
        The known mirror that the positions are from, or None.
    found
        The files of a folder that were found.
    numbers
        The table of the number on the mirror of each channel, or None.
    """

    item: Item
    which: str
    stored: Stored
    kind: str = ""
    path: str = ""
    positions: Positions | None = None
    where: str = ""
    channels: NDArray[np.int64] | None = None
    numbering: str = f"channels in {CHANNELS}"
    by_ring: Positions | None = None
    mirror: Rings | None = None
    found: tuple[str, ...] = ()
    numbers: Path | None = None

    @property
    def name(self) -> str:
        """INSTRUME, or the name of the mirror, or of the file unless it is a track number."""
        stem = Path(self.path).stem
        named = "" if TRACK_NUMBER.search(stem) else stem
        mirror = self.mirror.name if self.mirror is not None else ""
        return str(self.stored.header.get("INSTRUME") or mirror or named or NAME)


def read_given(
    matrix: Any, coordinates: Any, mirror: Rings | None, dataset: str | None, surface: Surface
) -> Given:
    """Read arrays, files or a folder, as `stiffness_from` takes them."""
    if not isinstance(matrix, str | os.PathLike):
        values = plain(getattr(matrix, "value", matrix))
        if values is None:
            raise FormatError("the matrix contains no real numbers", remedy="give an (n, n) array")
        stored = Stored("", {"": Item(values, str(getattr(matrix, "unit", "") or ""))})
    elif Path(matrix).is_dir():
        return _in_folder(Path(matrix), coordinates, mirror, dataset, surface)
    else:
        stored = read_stored(matrix)
    item, which = matrix_in(stored, dataset)
    used = mirror if coordinates is None else None
    found: Any = coordinates if used is None else used.layout
    where = ""
    if isinstance(found, str | os.PathLike):
        found, where = read_positions(found), os.fspath(found)
    elif found is None:
        found, where = positions_in(stored), stored.path
    positions = _in_metres(found, where, surface)
    ids, named = _ids_in(stored, item.values[..., 0].size)
    return Given(item, which, stored, "", stored.path, positions, where, ids, named, mirror=used)


def _ids_in(stored: Stored, n: int) -> tuple[NDArray[np.int64] | None, str]:
    """Return n distinct integers beside the matrix that are named as IDs, and a text; or None."""
    for name, item in stored.every.items() if "" not in stored.arrays else ():
        values = np.squeeze(item.values)
        if without_group(name.casefold()) in ID_NAMES and values.shape == (n,):
            whole = values.dtype.kind == "f" and np.array_equal(values, np.round(values))
            if whole and np.unique(values).size == n:
                return values.astype(np.int64), f"'{name}' of this file"
    return None, ""


class Places(NamedTuple):
    """Positions, as given or as found in a folder; their file, and a text on how they were found.

    If their file is in the supervisor's order of rings, ``by_ring`` are those of the channels.
    """

    found: Any = None
    file: Path | None = None
    how: str = ""
    by_ring: Positions | None = None


def _in_folder(
    given: Path, coordinates: Any, mirror: Rings | None, dataset: str | None, surface: Surface
) -> Given:
    """Read a supervisor's folder, or a configuration folder of opticalib."""
    path = folder_of_matrix(given)
    stored = read_stored(path / MATRIX)
    item, which = matrix_in(stored, dataset)
    own = Path(coordinates) if isinstance(coordinates, str | os.PathLike) else None
    conf = own if own is not None and own.is_dir() else None
    trees = {each: _tree_of(each) for each in dict.fromkeys((conf, path, given)) if each}
    files = _files_in(trees)
    if conf is not None:
        places = Places()
    else:
        places = Places(coordinates) if own is None else Places(read_positions(own), own)
    kind, channels, numbers = "opticalib's configuration", None, None
    used = mirror if places.found is None else None
    if (path / CHANNELS).is_file():
        kind, channels = "a supervisor's folder", channels_of(path)
        numbers = find_file(NUMBERS, trees)
        if places.found is None:
            places = places_of(trees, mirror, channels, files)
        elif places.file is not None:
            places = _of_matrix(places.found, places.file, channels, numbers)
    elif places.found is None and (file := find_file(OPTICALIB_POSITIONS, trees)) is not None:
        places, used = Places(read_positions(file), file), None
    elif mirror is not None and used is not None:
        places = Places(mirror.layout)
    found, file, how, by_ring = places
    if isinstance(found, Positions) and file is not None and file.name == POSITIONS:
        found, surface = replace(found, unit=found.unit or "mm"), replace(surface, arc=True)
    where = os.fspath(file or "")
    positions = _in_metres(found, where, surface, how)
    by_ring = _in_metres(by_ring, where, surface, f"in the order of {NUMBERS}")
    return Given(
        item, which, stored, f", {kind}", os.fspath(path), positions, where, channels,
        by_ring=by_ring, mirror=used, found=files, numbers=numbers,
    )  # fmt: skip


def _of_matrix(
    every: Positions, file: Path, channels: NDArray[np.int64], numbers: Path | None
) -> Places:
    """Return the positions of (m,) channels in a file, which may be in the order of rings."""
    found, by_ring = of_channels(every, channels, file), None
    if found is not every and numbers is not None:
        by_ring = of_channels(every, numbers_of(channels, numbers), file)
    return Places(found, file, by_ring=by_ring)


def folder_of_matrix(folder: Path) -> Path:
    """Return the folder of the only matrix in a folder or below."""
    tree = _tree_of(folder)
    found = tree.get(MATRIX, [])
    if (folder / MATRIX).is_file() or len(found) == 1:
        return found[0].parent
    if not found:
        there = ", ".join(_files_in({folder: tree})) or "no other file of a supervisor or opticalib"
        first = f" among its first {MAX_FILES} files" * (sum(map(len, tree.values())) >= MAX_FILES)
        raise FormatError(
            f"contains no {MATRIX}{first}; there is {there}",
            remedy=f"give the matrix itself, or a folder with {MATRIX} and {CHANNELS}, or with"
            f" {MATRIX} and {OPTICALIB_POSITIONS}",
            path=folder,
        )
    folders = [str(each.parent.relative_to(folder)) for each in found]
    raise FormatError(
        f"contains {len(found)} measurements: {listed(folders, 9)}",
        remedy="give the folder of one of them, and the configuration after it",
        path=folder,
    )


def _files_in(trees: Trees) -> tuple[str, ...]:
    """Return the known files in folders, each relative to the folder in which it is found."""
    names = (MATRIX, CHANNELS, POSITIONS, NUMBERS, SHELL, OPTICALIB_POSITIONS)
    found: list[str] = []
    for name in names:
        found += [str(t[name][0].relative_to(folder)) for folder, t in trees.items() if name in t][
            :1
        ]
    return tuple(found)


def _in_metres(found: Any, path: str, surface: Surface, how: str = "") -> Positions | None:
    """Return positions in metres, of those in a file, a layout, an array, or None.

    A text on how they were found becomes the first of the notes.
    """
    if found is None:
        return None
    if isinstance(found, Layout):
        note = f"those of the layout, NZ {found.nz.min():.4f} .. {found.nz.max():.4f}"
        at = Positions(found.x, found.y, "m", found.id, found.nz, found.enabled, notes=(note,))
    else:
        with naming(path or "positions"):
            at = in_metres(
                found if isinstance(found, Positions) else positions_from(found), surface
            )
    return replace(at, notes=(how, *at.notes)) if how else at


def _tree_of(folder: Path) -> dict[str, list[Path]]:
    """Return the first `MAX_FILES` files in a folder and below by name, the nearest first."""
    found, seen, count = dict[str, list[Path]](), set[Path](), 0
    queue = deque([folder])
    while queue and count < MAX_FILES:
        at = queue.popleft()
        real = at.resolve()
        if real in seen or not os.access(at, os.R_OK | os.X_OK):
            continue
        seen.add(real)
        for each in sorted(os.scandir(at), key=lambda each: (each.is_symlink(), each.name)):
            if each.is_dir():
                queue.append(Path(each.path))
            else:
                found.setdefault(each.name, []).append(Path(each.path))
                count += 1
    return found


def find_file(name: str, trees: Trees) -> Path | None:
    """Return the file of a name in the first folder that has it; refuse one of several that differ.

    Several mirrors may have their configuration in one tree.
    """
    for folder, tree in trees.items():
        found = tree.get(name, [])
        if found and found[0].parent != folder and len({each.read_bytes() for each in found}) > 1:
            names = [str(each.relative_to(folder)) for each in found]
            raise FormatError(
                f"contains {len(found)} files {name} that differ: {listed(names, 4)}",
                remedy="give the folder of this mirror's configuration after that of the matrix",
                path=folder,
            )
        if found:
            return found[0]
    return None


def only_array(path: str | os.PathLike[str]) -> Item:
    """Return the only array of a file, without axes of length 1."""
    arrays = read_stored(path).arrays
    if len(arrays) != 1:
        raise FormatError(
            f"contains {len(arrays)} arrays", remedy="give one with one array", path=path
        )
    (item,) = arrays.values()
    return Item(np.squeeze(item.values), item.unit)


def channels_of(folder: Path) -> NDArray[np.int64]:
    """Return the (m,) channels of a folder's matrix."""
    return _whole_numbers(np.atleast_1d(only_array(folder / CHANNELS).values), folder / CHANNELS)


def places_of(
    trees: Trees,
    mirror: Rings | None,
    channels: NDArray[np.int64],
    files: Sequence[str],
) -> Places:
    """Return the positions of (m,) channels."""
    if mirror is None and (given := find_file(POSITIONS, trees)) is not None:
        return Places(of_channels(read_positions(given), channels, given), given)
    numbers, folder = find_file(NUMBERS, trees), next(iter(trees))
    if numbers is None and mirror is not None:
        return Places(mirror.layout)
    if numbers is None:
        raise NoPositions(
            f"contains no positions of its channels, but {', '.join(files)}",
            remedy=f"give positions of the channels, or a folder with {POSITIONS}, or with"
            f" {NUMBERS} and {SHELL}, or the mirror by --mirror (mirror=)",
            path=folder,
            actuators=int(channels.max()) + 1,
        )
    mine = numbers_of(channels, numbers)
    shell = find_file(SHELL, trees) if mirror is None else None
    if mirror is None and shell is None:
        raise NoPositions(
            f"there is {NUMBERS}, but no {SHELL}",
            remedy=f"give its folder, or the mirror by --mirror (mirror=), or {POSITIONS}",
            path=folder,
            actuators=int(mine.max()) + 1,
        )
    every = mirror.layout if mirror is not None else shell_layout(shell)  # type: ignore[arg-type]
    if mine.max() >= every.n:
        channel = channels[mine == mine.max()][0]
        raise FormatError(
            f"channel {channel} is actuator {mine.max()} of the rings, which have {every.n}",
            remedy="give the mirror that it is",
            path=numbers,
        )
    at = supervisor_order(every)[mine]
    of = layout(every.x[at], every.y[at], nz=every.nz[at], id=channels)
    rings = "the mirror" if mirror is not None else SHELL
    return Places(of, numbers, f"by the rings of {rings}")


def numbers_of(channels: NDArray[np.int64], path: Path) -> NDArray[np.int64]:
    """Return (m,) numbers, ring by ring, of channels, by a supervisor's table."""
    ring_number = _whole_numbers(only_array(path).values.ravel(), path)
    if channels.max() >= len(ring_number):
        raise FormatError(
            f"has {len(ring_number)} channels, {CHANNELS} names channel {channels.max()}",
            remedy="give that of the same mirror",
            path=path,
        )
    return ring_number[channels]


def supervisor_order(rings: Layout) -> NDArray[np.int64]:
    """Return (n,) index in a layout of rings of each number of the supervisor."""
    ring = ring_of(rings)
    order = []
    for r in range(1, int(ring.max()) + 2):
        members = np.flatnonzero(ring == r - 1)
        n = len(members)
        turn = 2 * np.pi / n
        expected = np.pi / 2 + (np.arange(n) - r) * turn
        angle = np.arctan2(rings.y[members], rings.x[members])
        steps = np.round((expected[:, None] - angle) / turn, 6) % n
        at = np.argmin(np.minimum(steps, n - steps), axis=1)
        off = np.minimum(steps, n - steps)[np.arange(n), at]
        if off.max() > 0.1 or np.unique(at).size != n:
            raise FormatError(
                f"ring {r} of the mirror has no actuator on its +y axis, or is not even",
                remedy=f"give positions of the channels, as {POSITIONS}",
            )
        order.append(members[at])
    return np.concatenate(order)


def shell_layout(path: Path) -> Layout:
    """Return the rings of a shell.txt, from the innermost, counter-clockwise from +y."""
    text = re.sub("[;#].*", "", text_of(path))
    try:
        counts = [int(n) for n in _numbers_in(text, "n_act_ring")]
        angles, first = (np.radians(_numbers_in(text, f"angle_{of}")) for of in ("ring", "act0"))
        radius = _numbers_in(text, "curv_radius")[0] / 1e3
        polar = np.repeat(angles, counts)
        turn = [a + 2 * np.pi * np.arange(k) / k for a, k in zip(first, counts, strict=True)]
    except (KeyError, ValueError, IndexError) as error:
        raise FormatError(
            f"gives no rings ({error})",
            remedy="give curv_radius, n_act_ring, angle_ring and angle_act0",
            path=path,
        ) from None
    azimuth = np.pi / 2 + np.concatenate(turn)
    x, y = (radius * np.sin(polar) * f(azimuth) for f in (np.cos, np.sin))
    return layout(x, y, nz=np.cos(polar))


def _numbers_in(text: str, name: str) -> list[float]:
    """Return the numbers of a name: of a line `name type value`, or of an array up to `end`."""
    array_or_value = r"(?:array\s+\w+\s+\d+\s+(.*?)\s+end\b|\w+\s+(\S+))"
    match = re.search(rf"^\s*{name}\s+{array_or_value}", text, re.M | re.S | re.I)
    if match is None:
        raise KeyError(name)
    return [float(word) for word in (match[1] or match[2]).split()]


def of_channels(places: Positions, channels: NDArray[np.int64], path: Path) -> Positions:
    """Return positions of (m,) channels from those of all channels, or of these only."""
    n = len(np.asarray(places.x).ravel())
    if n == len(channels) or places.ids is not None:  # IDs are matched later
        return places
    if channels.max() >= n:
        raise FormatError(
            f"has {n} positions, {CHANNELS} names channel {channels.max()}",
            remedy="give those of the same mirror",
            path=path,
        )
    return places.part(channels)


def _whole_numbers(values: Array, path: Path) -> NDArray[np.int64]:
    """Return channels as integers, if they are distinct numbers from 0."""
    whole = np.round(values)
    if values.ndim != 1 or not np.array_equal(whole, values) or values.min(initial=0) < 0:
        raise FormatError(
            "does not contain numbers of channels", remedy="give integers from 0", path=path
        )
    if np.unique(whole).size != whole.size:
        raise FormatError("names a channel twice", remedy="give each once", path=path)
    return whole.astype(np.int64)


def date_of(given: Given, told: datetime.datetime | None) -> tuple[datetime.datetime, str]:
    """Return the date of the measurement (UTC), and where it is from."""
    if told is not None:
        return told.replace(tzinfo=told.tzinfo or datetime.UTC), "as specified"
    header = given.stored.header
    track = str(header.get("TRACKNUM", "")), Path(given.path).name
    for text in track:
        match = TRACK_NUMBER.search(text)
        if match:
            numbers = [int(part) for part in match.groups()]
            return datetime.datetime(*numbers, tzinfo=datetime.UTC), f"track number {match[0]}"  # type: ignore[misc,arg-type]
    for key in ("DATE-OBS", "DATE"):
        try:
            when = datetime.datetime.fromisoformat(str(header[key]).strip())
        except (KeyError, ValueError):
            continue
        return when.replace(tzinfo=when.tzinfo or datetime.UTC).astimezone(datetime.UTC), key
    if given.path:
        return written_date(given.path), "assumed, that of the file; --date overrides it"
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    return now, "assumed, now; to set it, use --date (date=)"


def written_date(path: str | os.PathLike[str]) -> datetime.datetime:
    """Return when a file was written (UTC), to the second."""
    return datetime.datetime.fromtimestamp(int(Path(path).stat().st_mtime), tz=datetime.UTC)
