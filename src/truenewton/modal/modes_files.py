"""The modal base in files (docs/files.md): whole, as stiffness files, and as plain matrices."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.actuators import Array
from truenewton.campaign_files import actuators_sheet, iso, write_stiffness
from truenewton.fitsfiles import Sheet, write_fits, write_matrix
from truenewton.measurements import StiffnessMatrix
from truenewton.modal.dissipation import Dissipation, Limits
from truenewton.modal.modal_base import ModalBase
from truenewton.outputs import refuse_existing

BESIDE = ("true", "commanded", "ff_v_matrix", "ff_matrix", "ff_matrix_true")


def modes_paths(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the paths of all that `write_modes` writes: the modal base first."""
    target = Path(path)
    stem = target.name.removesuffix(".gz").removesuffix(".fits")
    return (target, *(target.with_name(f"{stem}.{what}.fits") for what in BESIDE))


def write_modes(
    base: ModalBase,
    path: str | os.PathLike[str],
    limits: Limits | None = None,
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Write the modal base, and the feed-forward and the modes as others read them.

    Beside MODES.fits stand MODES.true.fits and MODES.commanded.fits, stiffness files of the force
    per true displacement in true and in commanded Newtons; and MODES.ff_v_matrix.fits (the modes),
    MODES.ff_matrix.fits (commanded) and MODES.ff_matrix_true.fits, one plain matrix each.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    OutputExists, OutputFailed
    """
    paths = modes_paths(path)
    for target in paths:
        refuse_existing(target, overwrite=overwrite)
    stiffness, modes = base.stiffness, base.modes.modes
    write_fits(paths[0], _header(base, limits or Limits()), _sheets(base), overwrite=overwrite)
    feed_forward = (stiffness.forces, stiffness.feed_forward_commanded)
    layout = replace(
        base.layout, enabled=np.isin(base.layout.id, stiffness.enabled.id[stiffness.acts])
    )
    for target, forces in zip(paths[1:3], feed_forward, strict=True):
        record = StiffnessMatrix(base.instrument, base.date, layout, _square(base, forces))
        write_stiffness(record, target, overwrite=overwrite)
    plain = (
        (base.on_all_actuators(stiffness.shapes @ modes), "MODE", None, "displacement per mode"),
        (_square(base, feed_forward[1]), "SENSOR", "N/m", "commanded N per true m"),
        (_square(base, feed_forward[0]), "SENSOR", "N/m", "true N per true m"),
    )
    for target, (matrix, columns, unit, comment) in zip(paths[3:], plain, strict=True):
        header = {
            "INSTRUME": (base.instrument, "mirror"),
            "DATE-OBS": (iso(base.date), "UTC"),
            "CTYPE1": (columns, f"columns: {comment}"),
            "CTYPE2": ("ACTUATOR", "rows, axis 0 in numpy"),
            "BUNIT": (unit, "of the matrix"),
        }
        write_matrix(target, header, matrix, overwrite=overwrite)
    return list(paths)


def _square(base: ModalBase, forces: Array) -> Array:
    """Return (N, N) forces per displacement over all actuators, 0 where one is not commanded."""
    square = np.zeros((base.layout.n, base.layout.n))
    square[:, np.isin(base.layout.id, base.stiffness.layout.id)] = base.on_all_actuators(forces)
    return square


def _header(base: ModalBase, limits: Limits) -> dict[str, tuple[Any, str]]:
    atmosphere, cost = base.seen.atmosphere, base.costs[0]
    return {
        "INSTRUME": (base.instrument, "mirror"),
        "DATE-OBS": (iso(base.date), "UTC, of the stiffness"),
        "SEEING": (atmosphere.seeing, "[arcsec] at 500 nm"),
        "R0": (atmosphere.fried_parameter, "[m] at 500 nm"),
        "L0": (_finite(atmosphere.outer_scale), "[m] outer scale; absent if infinite"),
        "DIAMETER": (base.seen.pupil.diameter, "[m] entrance pupil"),
        "RADIUS": (base.seen.pupil.radius, "[m] of the mirror that fills it"),
        "EFFICIEN": (cost.efficiency, "[N/W^1/2] commanded force per root of power"),
        "MAXPOWER": (_finite(limits.power), "[W] most that a coil may dissipate"),
        "MAXFORCE": (_finite(limits.force), "[N] most true force, static and 3 sigma"),
        "NMODES": (cost.modes_within(limits), "stiffness modes within these limits"),
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _sheets(base: ModalBase) -> list[Sheet]:
    stiffness, modes = base.stiffness, base.modes
    sheets = [
        actuators_sheet(base.layout),
        Sheet("MODES", data=base.on_all_actuators(stiffness.shapes @ modes.modes)),
        Sheet("FORCE", data=base.on_all_actuators(stiffness.forces @ modes.modes), unit="N/m"),
        Sheet(
            "COMMANDED",
            data=base.on_all_actuators(stiffness.feed_forward_commanded @ modes.modes),
            unit="N/m",
        ),
        Sheet("STATIC", columns=(("ID", "J", None, stiffness.enabled.id),
                                 ("FORCE", "D", "N", base.costs[0].static))),
        _budget(base.costs[0], "BUDGET", modes.stiffness),
    ]  # fmt: skip
    for cost, name in zip(base.costs[1:], ("ZERNIKE", "KL"), strict=True):
        sheets.append(Sheet(name, data=base.on_all_actuators(stiffness.shapes @ cost.modes)))
        sheets.append(_budget(cost, f"BUDGET_{name}"))
    return sheets


def _budget(cost: Dissipation, name: str, stiffness: Array | None = None) -> Sheet:
    """Return a table of the first N modes of a base, a row for each N."""
    columns: list[tuple[str, str, str | None, Any]] = [
        ("N", "J", None, np.arange(1, cost.residual.size + 1))
    ]
    if stiffness is not None:
        columns.append(("STIFFNESS", "D", "N/m", stiffness))
    figures = (
        ("RESIDUAL", "m", cost.residual),
        ("FORCE_RMS", "N", np.sqrt(np.mean(cost.force**2, axis=0))),
        ("FORCE_WORST", "N", cost.force.max(axis=0)),
        ("REACH", "N", cost.reach.max(axis=0)),
        ("POWER_MEAN", "W", cost.power.mean(axis=0)),
        ("POWER_WORST", "W", cost.power.max(axis=0)),
    )
    columns += [(what, "D", unit, values) for what, unit, values in figures]
    return Sheet(name, columns=tuple(columns))
