"""What lies in a folder of other software: which layout it is, its matrix and its positions.

A supervisor's (`supervisor`), or of opticalib: a configuration folder with
`ActuatorsCoordinates.fits` (n, 2) [mm], beside which its mirror's `ff` was saved as
`ff_matrix.fits`; the data of its simulated DP, `dp_ffwd.fits` and `dp_coords.fits` (n, 2) [m],
positions of both shells mixed; or of its simulated M4, `m4_data.h5`.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truenewton.errors import FormatError
from truenewton.foreign import supervisor
from truenewton.foreign.choice import Places, places_in
from truenewton.foreign.stored import Stored, read_stored
from truenewton.statics.layout import Layout

OPTICALIB_POSITIONS = "ActuatorsCoordinates.fits"
DP_MATRIX, DP_POSITIONS = "dp_ffwd.fits", "dp_coords.fits"
M4_DATA = "m4_data.h5"


class Folder(NamedTuple):
    """What a folder gave.

    Attributes
    ----------
    kind
        Of layout, in words.
    matrix
        Its file, read.
    places, where, how
        Positions as they stand or in metres, or None; their file; in words.
    unit
        Of lengths, where the layout fixes it, or ''.
    arc
        Radii are measured along the surface.
    channels
        (m,) names of the actuators, or None.
    by_ring
        Places if their file counts ring by ring, and a supervisor's table is there; or None.
    """

    kind: str
    matrix: Stored
    places: Places | Layout | None
    where: Path | None
    how: str = ""
    unit: str = ""
    arc: bool = False
    channels: NDArray[np.int64] | None = None
    by_ring: Places | None = None


def read_folder(folder: Path, positions: Path | None, mirror: Layout | None) -> Folder:
    """Read a folder of a known layout.

    Parameters
    ----------
    folder
        Holds the matrix.
    positions
        A file of positions, a folder of the configuration, or None: then they are in the folder.
    mirror
        Rings of a known mirror, or None.

    Raises
    ------
    UnreadableFile, FormatError
    """
    conf = positions if positions is not None and positions.is_dir() else None
    file = None if conf is positions else positions
    there = {path.name: path for path in folder.iterdir()}
    if supervisor.MATRIX in there and supervisor.CHANNELS in there:
        matrix, channels = read_stored(there[supervisor.MATRIX]), supervisor.channels_of(folder)
        kind = "a supervisor's folder"
        if file is None:
            of, where, how = supervisor.places_of(folder, conf, mirror, channels)
            by_file = isinstance(of, Places)
            unit = "mm" if by_file else ""
            return Folder(kind, matrix, of, where, how, unit, by_file, channels)
        found = places_in(read_stored(file))
        chosen = None if found is None else supervisor.chosen(found, channels, file)
        by_channel = file.name == supervisor.POSITIONS
        unit = "mm" if by_channel else ""
        numbers = supervisor.find(supervisor.NUMBERS, folder, None)
        by_ring = None
        if found is not None and chosen is not found and numbers is not None:
            by_ring = supervisor.chosen(found, supervisor.numbers_of(channels, numbers), file)
        return Folder(kind, matrix, chosen, file, "", unit, by_channel, channels, by_ring)
    if DP_MATRIX in there:
        matrix = read_stored(there[DP_MATRIX])
        at = file or there.get(DP_POSITIONS)
        places = None if at is None else _by_shell(places_in(read_stored(at)))
        return Folder("opticalib's DP", matrix, places, at, "by shell", "m")
    if supervisor.MATRIX in there:
        matrix = read_stored(there[supervisor.MATRIX])
        at = file or supervisor.find(OPTICALIB_POSITIONS, folder, conf)
        places = None if at is None else places_in(read_stored(at))
        return Folder("opticalib's configuration", matrix, places, at)
    if M4_DATA in there:
        matrix = read_stored(there[M4_DATA])
        at = file or there[M4_DATA]
        return Folder("opticalib's M4", matrix, places_in(read_stored(at) if file else matrix), at)
    raise FormatError(
        "is a folder of no layout that is known here",
        remedy=f"give the matrix itself, or a folder with {supervisor.MATRIX} and"
        f" {supervisor.CHANNELS}, with {supervisor.MATRIX} and {OPTICALIB_POSITIONS}, with"
        f" {DP_MATRIX} and {DP_POSITIONS}, or with {M4_DATA}",
        path=folder,
    )


def _by_shell(places: Places | None) -> Places | None:
    """Return positions of the upper shell before those of the lower, as opticalib sorts them."""
    if places is None:
        return None
    y = np.asarray(places.y, dtype=float).ravel()
    upper = y > y.max() / 2
    order = np.concatenate([np.flatnonzero(upper), np.flatnonzero(~upper)])
    x = np.asarray(places.x, dtype=float).ravel()
    return Places(x[order], y[order], places.unit)
