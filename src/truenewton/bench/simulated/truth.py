"""The true values of a simulation, written beside the campaign for scoring only."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from truenewton.arrays import Array
from truenewton.files.fits import read_fits, write_fits
from truenewton.files.format import Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.records.file import ACTUATORS, INSTRUMENT
from truenewton.statics.layout import Layout


class SegmentTruth(NamedTuple):
    """The true values of one segment under one load."""

    number: int  # of the segment
    load: str
    weight: float  # P [N]
    added: float  # Q [N]
    bias_force: float  # B [N]
    torque_y: float  # about the origin of the mirror [N m]
    torque_x: float


@dataclass(frozen=True, eq=False)
class Truth:
    """The true values behind a simulated campaign; of a mirror in segments, summed over them.

    Attributes
    ----------
    instrument, layout
        The mirror.
    alpha
        (n,) true Newton / commanded Newton.
    stiffness
        (n, n) true force per true displacement [N/m], bias magnets not counted. Of a mirror in
        segments (n, widest): in each row the actuators of its own segment, then zeros.
    sensor_gain
        (n,) true displacement / reading.
    weight
        True P [N].
    added, tilt
        (L,) true Q [N] and tilt [deg] of each load.
    loads
        Names of the L loads.
    bias_force
        B, total force of the bias magnets [N].
    torque_y, torque_x
        (L,) M_y and M_x [N m].
    seed
        Of all random numbers.
    segments
        True values of each segment under each load; none for a mirror in one piece.

    Examples
    --------
    >>> error = calibration.alpha / truth.alpha
    >>> f"{np.std(error) / np.mean(error):.1%}"  # without a common factor
    '0.0%'
    """

    instrument: str
    layout: Layout
    alpha: Array
    stiffness: Array
    sensor_gain: Array
    weight: float
    added: Array
    tilt: Array
    loads: tuple[str, ...]
    bias_force: float
    torque_y: Array
    torque_x: Array
    seed: int
    segments: tuple[SegmentTruth, ...] = ()


TRUTH = FileFormat(
    (
        INSTRUMENT,
        Keyword("WEIGHT", "weight", "true weight, P", "N"),
        Keyword("BIAS", "bias_force", "true total force of the bias magnets, B", "N"),
        Keyword("SEED", "seed", "of the simulation", kind="int"),
    ),
    (
        ACTUATORS,
        TableFormat("TRUTH", (Column("ALPHA", "alpha"), Column("SENSOR_GAIN", "sensor_gain"))),
        TableFormat(
            "LOADS",
            (
                Column("LOAD", "loads", kind="str"),
                Column("ADDED", "added", "N"),
                Column("TILT", "tilt", "deg"),
                Column("MY", "torque_y", "N m"),
                Column("MX", "torque_x", "N m"),
            ),
        ),
        TableFormat(
            "SEGMENTS",
            (
                Column("SEGMENT", "number", kind="int"),
                Column("LOAD", "load", kind="str"),
                Column("WEIGHT", "weight", "N"),
                Column("ADDED", "added", "N"),
                Column("BIAS", "bias_force", "N"),
                Column("MY", "torque_y", "N m"),
                Column("MX", "torque_x", "N m"),
            ),
            of="segments",
            optional=True,
        ),
        ImageFormat("TRUE_STIFFNESS", "stiffness", "N/m"),
    ),
)


def truth_path(folder: str | os.PathLike[str]) -> Path:
    """Return the path of the truth of a campaign's folder: DIR.truth.fits."""
    folder = Path(folder)
    return folder.with_name(folder.name + ".truth.fits")


def write_truth(truth: Truth, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the side file."""
    write_fits(path, TRUTH, truth, overwrite=overwrite)


def read_truth(path: str | os.PathLike[str]) -> Truth:
    """Read the side file.

    Parameters
    ----------
    path
        CAMPAIGN.truth.fits, beside a simulated campaign.

    Raises
    ------
    UnreadableFile, FormatError

    Examples
    --------
    >>> tn.read_truth("day.truth.fits").alpha.shape
    (45,)
    """
    file = read_fits(path)
    return file.filled(Truth, file.values(TRUTH))
