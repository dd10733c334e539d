"""What a simulation knows and keeps to itself; written beside the campaign, for scoring only."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truenewton.arrays import Array
from truenewton.files.fits import Sheet, read_fits, write_fits
from truenewton.records.file import actuators_sheet, layout_from
from truenewton.statics.layout import Layout


@dataclass(frozen=True, eq=False)
class Truth:
    """The true values behind a simulated campaign.

    Attributes
    ----------
    instrument, layout
        The mirror.
    alpha
        (n,) true Newton / commanded Newton.
    stiffness
        (n, n) true force per true displacement [N/m], bias magnets not counted.
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
        What everything random came from.
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


def truth_path(folder: str | os.PathLike[str]) -> Path:
    """Return where the truth of a campaign's folder is kept: DIR.truth.fits."""
    folder = Path(folder)
    return folder.with_name(folder.name + ".truth.fits")


def write_truth(truth: Truth, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the side file."""
    header = {
        "INSTRUME": (truth.instrument, "mirror"),
        "WEIGHT": (truth.weight, "[N] true weight, P"),
        "BIAS": (truth.bias_force, "[N] true total force of the bias magnets, B"),
        "SEED": (truth.seed, "of the simulation"),
    }
    loads = Sheet(
        "LOADS",
        columns=(
            ("LOAD", f"{max(map(len, truth.loads))}A", None, list(truth.loads)),
            ("ADDED", "D", "N", truth.added),
            ("TILT", "D", "deg", truth.tilt),
            ("MY", "D", "N m", truth.torque_y),
            ("MX", "D", "N m", truth.torque_x),
        ),
    )
    sheets = [
        actuators_sheet(truth.layout),
        Sheet(
            "TRUTH",
            columns=(
                ("ALPHA", "D", None, truth.alpha),
                ("SENSOR_GAIN", "D", None, truth.sensor_gain),
            ),
        ),
        loads,
        Sheet("TRUE_STIFFNESS", data=truth.stiffness, unit="N/m"),
    ]
    write_fits(path, header, sheets, overwrite=overwrite)


def read_truth(path: str | os.PathLike[str]) -> Truth:
    """Read the side file."""
    file = read_fits(path)
    loads = file.table("LOADS")
    return Truth(
        instrument=file.text("INSTRUME"),
        layout=layout_from(file),
        alpha=file.table("TRUTH").column("ALPHA"),
        sensor_gain=file.table("TRUTH").column("SENSOR_GAIN"),
        stiffness=file.image("TRUE_STIFFNESS").values("N/m"),
        weight=file.number("WEIGHT"),
        added=loads.column("ADDED", unit="N"),
        tilt=loads.column("TILT", unit="deg"),
        loads=tuple(str(name).strip() for name in np.atleast_1d(loads.column("LOAD", "str"))),
        bias_force=file.number("BIAS"),
        torque_y=loads.column("MY", unit="N m"),
        torque_x=loads.column("MX", unit="N m"),
        seed=file.integer("SEED"),
    )
