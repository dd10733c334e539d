"""The modal base in files (docs/files.md): whole, as stiffness files, and as plain matrices."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.files.fits import Sheet, write_fits, write_matrix
from truenewton.files.outputs import files_together
from truenewton.modal.dissipation import Budget, Dissipation
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.records.file import actuators_sheet, iso, write_stiffness
from truenewton.records.source import sources_sheet
from truenewton.records.stiffness_matrix import StiffnessMatrix

BESIDE = ("true", "commanded", "ff_v_matrix", "ff_matrix", "ff_matrix_true")


def modes_paths(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the paths of all that `write_modes` writes: the modal base first."""
    target = Path(path)
    stem = target.name.removesuffix(".gz").removesuffix(".fits")
    return (target, *(target.with_name(f"{stem}.{what}.fits") for what in BESIDE))


def write_modes(
    found: ModalFindings,
    path: str | os.PathLike[str],
    limits: Budget | None = None,
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
    with files_together(paths, overwrite=overwrite) as folder:
        _write_all(found, [folder / target.name for target in paths], limits or Budget())
    return list(paths)


def _write_all(found: ModalFindings, paths: list[Path], limits: Budget) -> None:
    base = found.after
    stiffness, modes = base.stiffness, base.modes.modes
    write_fits(paths[0], _header(found, limits), _sheets(found))
    true = _square(base, stiffness.acting_stiffness)
    commanded = _square(base, stiffness.acting_stiffness / stiffness.enabled_alpha[:, None])
    layout = replace(
        base.layout, enabled=np.isin(base.layout.id, stiffness.enabled.id[stiffness.acts])
    )
    for target, forces in zip(paths[1:3], (true, commanded), strict=True):
        record = StiffnessMatrix(base.instrument, base.date, layout, forces)
        write_stiffness(record, target)
    plain = (
        (base.on_all_actuators(stiffness.shapes @ modes), "MODE", None, "displacement per mode"),
        (commanded, "SENSOR", "N/m", "commanded N per true m"),
        (true, "SENSOR", "N/m", "true N per true m"),
    )
    for target, (matrix, columns, unit, comment) in zip(paths[3:], plain, strict=True):
        header = {
            "INSTRUME": (base.instrument, "mirror"),
            "DATE-OBS": (iso(base.date), "UTC"),
            "CTYPE1": (columns, f"columns: {comment}"),
            "CTYPE2": ("ACTUATOR", "rows, axis 0 in numpy"),
            "BUNIT": (unit, "of the matrix"),
        }
        write_matrix(target, header, matrix)


def _square(base: ModalBase, forces: Array) -> Array:
    """Return (N, N) forces per displacement over all actuators from (n, n) over the enabled."""
    square = np.zeros((base.layout.n, base.layout.n))
    square[:, np.isin(base.layout.id, base.stiffness.enabled.id)] = base.on_all_actuators(forces)
    return square


def _header(found: ModalFindings, limits: Budget) -> dict[str, tuple[Any, str]]:
    base, measured = found.after, found.measured
    atmosphere, cost = base.seen.atmosphere, base.costs[0]
    return {
        "INSTRUME": (base.instrument, "mirror"),
        "DATE-OBS": (iso(base.date), "UTC, of the stiffness"),
        "MISFIT": (measured.misfit if measured else None, "variance of shapes over repeats"),
        "RELERR": (measured.relative_error if measured else None, "of the stiffness, by noise"),
        "RIGID": (measured.rigid_assumed if measured else None, "motions taken to cost nothing"),
        "METHOD": (found.calibration.method, "estimator of alpha"),
        "SCALE": (found.calibration.scale, "what fixes the common scale of alpha"),
        "SEEING": (atmosphere.seeing, "[arcsec] at 500 nm"),
        "R0": (atmosphere.fried_parameter, "[m] at 500 nm"),
        "L0": (_finite(atmosphere.outer_scale), "[m] outer scale; absent if infinite"),
        "DIAMETER": (base.seen.pupil.diameter, "[m] entrance pupil"),
        "RADIUS": (base.seen.pupil.radius, "[m] of the mirror that fills it"),
        "FITTING": (base.seen.fitting_error, "[m] rms wavefront between actuators"),
        "EFFICIEN": (cost.efficiency, "[N/W^1/2] commanded force per root of power"),
        "MAXPOWER": (_finite(limits.power), "[W] most that a coil may dissipate"),
        "MAXTOTAL": (_finite(limits.total), "[W] most that all coils may dissipate"),
        "MAXFORCE": (_finite(limits.force), "[N] most true force, static and 3 sigma"),
        "NMODES": (cost.modes_within(limits), "stiffness modes within these limits"),
    }


def _states(base: ModalBase) -> list[str]:
    """Return what the optics make of each actuator."""
    stiffness, names = base.stiffness, base.layout.id
    known = (
        (stiffness.layout.id, "commanded"),
        (stiffness.enabled.id[~stiffness.acts], "off"),
        (stiffness.enabled.id, "slaved"),
    )
    return [next((word for ids, word in known if name in ids), "disabled") for name in names]


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _sheets(found: ModalFindings) -> list[Sheet]:
    base, c = found.after, found.calibration
    stiffness, modes = base.stiffness, base.modes
    actuators = actuators_sheet(base.layout)
    states = ("STATE", "9A", None, _states(base))
    sheets = [
        replace(actuators, columns=(*actuators.columns, states)),
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
    sheets.append(sources_sheet(c.sources))
    sheets.append(sources_sheet(found.sources, "STIFFNESS_SOURCES"))
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
    power = cost.power
    figures = (
        ("RESIDUAL", "m", cost.residual),
        ("FORCE_RMS", "N", np.sqrt(np.mean(cost.force**2, axis=0))),
        ("FORCE_WORST", "N", cost.force.max(axis=0)),
        ("REACH", "N", cost.reach.max(axis=0)),
        ("POWER_MEAN", "W", power.mean(axis=0)),
        ("POWER_WORST", "W", power.max(axis=0)),
    )
    columns += [(what, "D", unit, values) for what, unit, values in figures]
    return Sheet(name, columns=tuple(columns))
