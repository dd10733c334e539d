"""The feed-forward matrix as the supervisor of the LBT's and Magellan's secondaries keeps it.

`ff_matrix.fits` (m, m) [N/m], forces of actuators in rows; `ff_list.fits`, the m channels of the
electronics; `ff_f_svec.fits`, `ff_p_svec.fits` and `ff_sval.fits`, its singular vectors, one a
column, and values, softest first: matrix = f_svec diag(sval) p_svec'. TRACKNUM in their headers.
`act2mir_act.txt` has for each channel the number of its actuator, counted ring by ring from the
innermost: the k-th of ring r (k from 0, r from 1) of n stands at 90 deg + (k - r) 360 deg / n from
x to y. `shell.txt` has the rings; `act_coordinates.fits` positions of the channels, in mm along the
curved surface.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.foreign.choice import Places, places_in
from truenewton.foreign.stored import Item, Stored, read_stored
from truenewton.foreign.text import text_of
from truenewton.statics.layout import Layout, layout, ring_of

MATRIX, CHANNELS = "ff_matrix.fits", "ff_list.fits"
NUMBERS, SHELL, POSITIONS = "act2mir_act.txt", "shell.txt", "act_coordinates.fits"


def find(name: str, *folders: Path | None) -> Path | None:
    """Return the first file of a name in folders, or up to two levels down in them."""
    for folder in folders:
        if folder is not None and folder.is_dir():
            for pattern in (name, f"*/{name}", f"*/*/{name}"):
                if found := sorted(folder.glob(pattern)):
                    return found[0]
    return None


def only_array(path: str | os.PathLike[str]) -> Item:
    """Return the one array of a file, axes of length 1 left out.

    Raises
    ------
    UnreadableFile, FormatError
    """
    return _only(read_stored(path))


def _only(stored: Stored) -> Item:
    if len(stored.arrays) != 1:
        raise FormatError(
            f"holds {len(stored.arrays)} arrays", remedy="give one with one array", path=stored.path
        )
    (item,) = stored.arrays.values()
    return Item(np.squeeze(item.values), item.unit)


def channels_of(folder: Path) -> NDArray[np.int64]:
    """Return the (m,) channels of a folder's matrix.

    Raises
    ------
    UnreadableFile, FormatError
    """
    return _whole_numbers(np.atleast_1d(only_array(folder / CHANNELS).values), folder / CHANNELS)


def places_of(
    folder: Path, conf: Path | None, mirror: Layout | None, channels: NDArray[np.int64]
) -> tuple[Places | Layout, Path, str]:
    """Return positions of (m,) channels, the file that gave them, and how, in words.

    Raises
    ------
    UnreadableFile, FormatError
    """
    numbers = find(NUMBERS, folder, conf)
    shell = find(SHELL, folder, conf)
    given = find(POSITIONS, folder, conf)
    if mirror is None and given is not None:
        places = places_in(read_stored(given))
        if places is None:
            raise FormatError("holds no positions", remedy="give (n, 2) or (2, n)", path=given)
        return chosen(places, channels, given), given, "radii along the surface, in mm"
    if numbers is None:
        raise FormatError(
            "says not where its channels stand",
            remedy=f"give positions of the channels, or a folder with {POSITIONS}, or with"
            f" {NUMBERS} and {SHELL} (or --mirror)",
            path=folder,
        )
    mine = numbers_of(channels, numbers)
    if mirror is None and shell is None:
        raise FormatError(
            f"there is {NUMBERS}, but no {SHELL}",
            remedy=f"give its folder, or the mirror by --mirror (mirror=), or {POSITIONS}",
            path=folder,
        )
    every = mirror if mirror is not None else shell_layout(shell)  # type: ignore[arg-type]
    if mine.max() >= every.n:
        channel = channels[mine == mine.max()][0]
        raise FormatError(
            f"channel {channel} is actuator {mine.max()} of the rings, which have {every.n}",
            remedy="give the mirror that it is",
            path=numbers,
        )
    at = supervisor_order(every)[mine]
    of = layout(every.x[at], every.y[at], nz=every.nz[at], id=channels)
    return of, numbers, "by the rings " + ("of the mirror" if mirror is not None else f"of {SHELL}")


def numbers_of(channels: NDArray[np.int64], path: Path) -> NDArray[np.int64]:
    """Return (m,) the numbers, ring by ring, of channels by a supervisor's table.

    Raises
    ------
    UnreadableFile, FormatError
    """
    ring_number = _whole_numbers(_only(read_stored(path)).values.ravel(), path)
    if channels.max() >= len(ring_number):
        raise FormatError(
            f"has {len(ring_number)} channels, {CHANNELS} names channel {channels.max()}",
            remedy="give that of the same mirror",
            path=path,
        )
    return ring_number[channels]


def supervisor_order(rings: Layout) -> NDArray[np.int64]:
    """Return (n,) which of a layout of rings each number of the supervisor is.

    Raises
    ------
    FormatError
        The layout has no such rings.
    """
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
    """Return the rings of a shell.txt, from the innermost, each counter-clockwise from +y.

    Raises
    ------
    FormatError
    """
    said = structure(path)
    try:
        counts = [int(n) for n in said["n_act_ring"]]
        angles, first = np.radians(said["angle_ring"]), np.radians(said["angle_act0"])
        radius = float(said["curv_radius"][0]) / 1e3
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


def structure(path: Path) -> dict[str, list[float]]:
    """Return the numbers of a supervisor's structure file: `name type value`, or arrays to `end`.

    Raises
    ------
    UnreadableFile
    """
    lines = (re.split("[;#]", line)[0].split() for line in text_of(path).splitlines())
    words = [line for line in lines if line]
    said: dict[str, list[float]] = {}
    at = 0
    while at < len(words):
        name, *rest = words[at]
        at += 1
        if rest and rest[0].lower() == "array":
            inside: list[str] = []
            while at < len(words) and words[at][0].lower() != "end":
                inside += words[at]
                at += 1
            at += 1
            numbers = inside[2:]  # behind type and size
        else:
            numbers = rest[1:2]
        try:
            said[name.lower()] = [float(word) for word in numbers]
        except ValueError:
            continue  # text
    return said


def decomposed(matrix: Array) -> tuple[Array, Array, Array]:
    """Return (m, m) force vectors, (m,) values, softest first, and (m, m) position vectors."""
    left, values, right = scipy.linalg.svd(matrix)
    return left[:, ::-1], values[::-1], right[::-1].T


def chosen(places: Places, channels: NDArray[np.int64], path: Path) -> Places:
    """Return places of (m,) channels, from those of all channels or of these alone."""
    n = len(np.asarray(places.x).ravel())
    if n == len(channels) or places.ids is not None:  # numbers are matched later
        return places
    if channels.max() >= n:
        raise FormatError(
            f"has {n} positions, {CHANNELS} names channel {channels.max()}",
            remedy="give those of the same mirror",
            path=path,
        )

    def some(values: Any) -> Any:
        return None if values is None else np.asarray(values).ravel()[channels]

    return Places(some(places.x), some(places.y), places.unit, None, some(places.nz))


def _whole_numbers(values: Array, path: Path) -> NDArray[np.int64]:
    """Refuse what does not count from 0, each number once."""
    whole = np.round(values)
    if values.ndim != 1 or not np.array_equal(whole, values) or values.min(initial=0) < 0:
        raise FormatError(
            "holds no numbers of channels", remedy="give whole numbers from 0", path=path
        )
    if np.unique(whole).size != whole.size:
        raise FormatError("names a channel twice", remedy="give each once", path=path)
    return whole.astype(np.int64)
