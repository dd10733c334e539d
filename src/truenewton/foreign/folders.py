"""What lies in a folder of other software: which layout it is, its matrix and its positions.

A supervisor's (`supervisor`), or a configuration folder of opticalib with
`ActuatorsCoordinates.fits` (n, 2) [mm], beside which its mirror's `ff` was saved as
`ff_matrix.fits`.
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
    if supervisor.MATRIX in there:
        matrix = read_stored(there[supervisor.MATRIX])
        at = file or supervisor.find(OPTICALIB_POSITIONS, folder, conf)
        places = None if at is None else places_in(read_stored(at))
        return Folder("opticalib's configuration", matrix, places, at)
    raise FormatError(
        "is a folder of no layout that is known here",
        remedy=f"give the matrix itself, or a folder with {supervisor.MATRIX} and"
        f" {supervisor.CHANNELS}, or with {supervisor.MATRIX} and {OPTICALIB_POSITIONS}",
        path=folder,
    )
