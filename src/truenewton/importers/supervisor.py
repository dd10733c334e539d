"""The feed-forward matrix as the supervisor of the LBT's and Magellan's secondaries keeps it.

`ff_matrix.fits` (m, m) [N/m], forces of actuators in rows; `ff_list.fits`, the m channels of the
electronics; `ff_f_svec.fits`, `ff_p_svec.fits` and `ff_sval.fits`, its singular vectors, one a
column, and values, softest first: matrix = f_svec diag(sval) p_svec'. TRACKNUM in their headers.
`act2mir_act.txt` has for each channel the number of its actuator, counted ring by ring from the
innermost: the k-th of ring r (k from 0, r from 1) of n stands at 90 deg + (k - r) 360 deg / n from
x to y. `shell.txt` has the rings; `act_coordinates.fits` positions of the channels, in mm along the
curved surface.

A configuration folder of opticalib has `ActuatorsCoordinates.fits` (n, 2) [mm], beside which its
mirror's `ff` was saved as `ff_matrix.fits`.
"""

from __future__ import annotations

import datetime
import os
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.calibration.verdict import refuse_unusable
from truenewton.errors import CampaignMismatch, FormatError, UnreadableFile
from truenewton.files.fits import write_fits
from truenewton.files.format import FileFormat, Keyword
from truenewton.files.outputs import folder_beside
from truenewton.importers.selection import Positions, positions_in
from truenewton.importers.stored import Item, read_stored, text_of
from truenewton.statics.layout import Layout, layout, ring_of

MATRIX, CHANNELS = "ff_matrix.fits", "ff_list.fits"
TRACK_NUMBER = re.compile(r"(\d{4})(\d\d)(\d\d)_(\d\d)(\d\d)(\d\d)")
NUMBERS, SHELL, POSITIONS = "act2mir_act.txt", "shell.txt", "act_coordinates.fits"


def find_file(name: str, *folders: Path | None) -> Path | None:
    """Return the first file of a name in folders, or up to two levels down in them."""
    for folder in folders:
        if folder is not None and folder.is_dir():
            for pattern in (name, f"*/{name}", f"*/*/{name}"):
                if found := sorted(folder.glob(pattern)):
                    return found[0]
    return None


def only_array(path: str | os.PathLike[str]) -> Item:
    """Return the one array of a file, axes of length 1 left out."""
    arrays = read_stored(path).arrays
    if len(arrays) != 1:
        raise FormatError(
            f"holds {len(arrays)} arrays", remedy="give one with one array", path=path
        )
    (item,) = arrays.values()
    return Item(np.squeeze(item.values), item.unit)


def channels_of(folder: Path) -> NDArray[np.int64]:
    """Return the (m,) channels of a folder's matrix."""
    return _whole_numbers(np.atleast_1d(only_array(folder / CHANNELS).values), folder / CHANNELS)


def places_of(
    folder: Path, conf: Path | None, mirror: Layout | None, channels: NDArray[np.int64]
) -> tuple[Positions | Layout, Path, str]:
    """Return positions of (m,) channels, the file that gave them, and how, in words."""
    numbers = find_file(NUMBERS, folder, conf)
    shell = find_file(SHELL, folder, conf)
    given = find_file(POSITIONS, folder, conf)
    if mirror is None and given is not None:
        places = positions_in(read_stored(given))
        if places is None:
            raise FormatError("holds no positions", remedy="give (n, 2) or (2, n)", path=given)
        return of_channels(places, channels, given), given, "radii along the surface, in mm"
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
    """Return (m,) the numbers, ring by ring, of channels by a supervisor's table."""
    ring_number = _whole_numbers(only_array(path).values.ravel(), path)
    if channels.max() >= len(ring_number):
        raise FormatError(
            f"has {len(ring_number)} channels, {CHANNELS} names channel {channels.max()}",
            remedy="give that of the same mirror",
            path=path,
        )
    return ring_number[channels]


def supervisor_order(rings: Layout) -> NDArray[np.int64]:
    """Return (n,) which of a layout of rings each number of the supervisor is."""
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
    """Return the rings of a shell.txt, from the innermost, each counter-clockwise from +y."""
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
    """Return the numbers of a structure file: `name type value`, or arrays to `end`."""
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


def of_channels(places: Positions, channels: NDArray[np.int64], path: Path) -> Positions:
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
    return places.part(channels)


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


FIVE = {
    "ff_list": "channels of the electronics",
    "ff_matrix": "true force per displacement, forces in rows",
    "ff_f_svec": "force singular vectors, one a column",
    "ff_p_svec": "position singular vectors, one a column",
    "ff_sval": "singular values, softest first",
}


FORM = FileFormat(
    (
        Keyword("DATE", "date", "UTC, when this file was made", kind="date"),
        Keyword("TRACKNUM", "track", "", kind="str"),
        Keyword("BUNIT", "unit", "", kind="str"),
        Keyword("CONTENT", "content", "", kind="str"),
        Keyword("ALPHA", "alpha", "what forces were corrected by", kind="str"),
    ),
    matrix="values",
)


def export_supervisor(
    folder: str | os.PathLike[str],
    calibration: Calibration,
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    force: bool = False,
) -> tuple[str, ...]:
    """Write a supervisor's five files anew, each row of the matrix times alpha of its actuator.

    For electronics into which alpha is loaded: what they are then commanded is true. The sign is
    that of the files. TRACKNUM is the track number in the name of the output, else that of the
    files. Rows of actuators without alpha stay as they are.

    Parameters
    ----------
    folder
        With `ff_matrix.fits` and `ff_list.fits`.
    calibration
        Its IDs are channels, as in a stiffness file that was imported from such a folder.
    output
        Folder to write.
    overwrite, force
        Replace what stands there; go on although the verdict is 'rejected'.

    Returns
    -------
    tuple of str
        What was done, in words.

    Raises
    ------
    UnreadableFile, FormatError, CampaignMismatch, NotToBeUsed, OutputExists, OutputFailed

    Examples
    --------
    >>> from astropy.io import fits
    >>> fits.writeto("ff_matrix.fits", matrix.stiffness)
    >>> fits.writeto("ff_list.fits", layout.id)
    >>> done = tn.export_supervisor(".", calibration, "in-true-newtons")
    """
    refuse_unusable(calibration, force=force)
    folder = Path(folder)
    channels, matrix = _measured(folder)
    alpha = _alpha_of(channels, calibration, folder)
    stored = read_stored(folder / MATRIX)
    known = np.isfinite(alpha)
    corrected = np.where(known, alpha, 1.0)[:, None] * matrix
    forces, values, positions = decomposed(corrected)
    named = TRACK_NUMBER.search(Path(output).name)
    track = named[0] if named else str(stored.header.get("TRACKNUM", "")).strip() or None
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    parts: dict[str, tuple[Any, str | None]] = {
        "ff_list": (channels, None),
        "ff_matrix": (corrected, "N/m"),
        "ff_f_svec": (forces, None),
        "ff_p_svec": (positions, None),
        "ff_sval": (values, "N/m"),
    }
    by = f"{calibration.instrument} {calibration.method}"[:60]
    with folder_beside(output, (".fits",), overwrite=overwrite) as temporary:
        for name, (numbers, unit) in parts.items():
            record = SimpleNamespace(
                values=numbers, track=track, date=now, unit=unit, content=FIVE[name], alpha=by
            )
            write_fits(temporary / f"{name}.fits", FORM, record)
    lines = [
        f"{folder}: {len(channels)} channels, rows times alpha of {calibration.instrument}, which"
        f" is {np.nanmin(alpha):.3f} .. {np.nanmax(alpha):.3f}",
        "  forces are true Newtons: load alpha into the electronics too",
        f"  TRACKNUM {track or 'unknown'}",
    ]
    if not known.all():
        ids = ", ".join(map(str, channels[~known][:12].tolist()))
        lines.append(f"  without alpha, as they were: {ids}")
    return tuple(lines)


def _measured(folder: Path) -> tuple[NDArray[np.int64], Array]:
    """Return (m,) channels of a supervisor's folder and the (m, m) matrix, as stored."""
    if not (folder / MATRIX).is_file():
        raise UnreadableFile(
            f"holds no {MATRIX}",
            remedy="give the supervisor's folder of a measurement, named by its track number",
            path=folder,
        )
    channels = channels_of(folder)
    matrix = only_array(folder / MATRIX).values
    if matrix.shape != (len(channels), len(channels)):
        raise CampaignMismatch(
            f"is {' x '.join(map(str, matrix.shape))} for {len(channels)} channels",
            remedy="give ff_matrix.fits and ff_list.fits of one measurement",
            path=folder / MATRIX,
        )
    return channels, matrix


def _alpha_of(channels: NDArray[np.int64], calibration: Calibration, folder: Path) -> Array:
    """Return (m,) alpha of channels; NaN where a calibration has none."""
    at = {name: k for k, name in enumerate(calibration.layout.id.tolist())}
    missing = [c for c in channels.tolist() if c not in at]
    if missing:
        raise CampaignMismatch(
            f"the calibration has no actuator {missing[0]}, which is a channel of the matrix",
            remedy="give that of the stiffness file that `truenewton import` made of this folder",
            path=folder,
        )
    return np.asarray(calibration.alpha[[at[c] for c in channels.tolist()]])
