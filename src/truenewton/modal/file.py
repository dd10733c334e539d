"""The modal base in files (docs/files.md): whole, as stiffness files, and as plain matrices."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from truenewton.arrays import Array
from truenewton.files.fits import write_fits
from truenewton.files.format import Attribute, Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.files.outputs import files_together
from truenewton.modal.dissipation import Budget, Dissipation
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import ModalBase
from truenewton.records.file import ACTUATORS, SOURCES, write_stiffness
from truenewton.records.stiffness_matrix import StiffnessMatrix


@dataclass(frozen=True, eq=False)
class _Written:
    """What goes into the files; (N, N) true and commanded forces per true displacement [N/m]."""

    findings: ModalFindings
    base: ModalBase
    limits: Budget
    true: Array
    commanded: Array

    @property
    def cost(self) -> Dissipation:
        """Of the stiffness modes."""
        return self.base.costs[0]


def _over_actuators(quantity: str, cost: int = 0) -> Callable[[_Written], Array]:
    """Return what the modes of a base make at each actuator."""

    def values(written: _Written) -> Array:
        base = written.base
        return base.on_all_actuators(getattr(base.stiffness, quantity) @ base.costs[cost].modes)

    return values


def _states(base: ModalBase) -> list[str]:
    """Return what the optics make of each actuator."""
    stiffness, names = base.stiffness, base.layout.id
    known = (
        (stiffness.layout.id, "commanded"),
        (stiffness.enabled.id[~stiffness.acts], "off"),
        (stiffness.enabled.id, "slaved"),
    )
    return [next((word for ids, word in known if name in ids), "disabled") for name in names]


def _budget(name: str, cost: int, *more: Column) -> TableFormat:
    """Return the table of the first N modes of a base, a row for each N."""

    def of(values: Callable[[Dissipation], Any]) -> Callable[[_Written], Any]:
        return lambda written: values(written.base.costs[cost])

    return TableFormat(
        name,
        (
            Column("N", of(lambda c: np.arange(1, c.residual.size + 1)), kind="int"),
            *more,
            Column("RESIDUAL", of(lambda c: c.residual), "m"),
            Column("FORCE_RMS", of(lambda c: np.sqrt(np.mean(c.force**2, axis=0))), "N"),
            Column("FORCE_WORST", of(lambda c: c.force.max(axis=0)), "N"),
            Column("REACH", of(lambda c: c.reach.max(axis=0)), "N"),
            Column("POWER_MEAN", of(lambda c: c.power.mean(axis=0)), "W"),
            Column("POWER_WORST", of(lambda c: c.power.max(axis=0)), "W"),
        ),
    )


def _plain(axis: str, meaning: str, unit: str | None, matrix: Attribute) -> FileFormat:
    """Return the format of a matrix in the primary HDU, with nothing else."""
    return FileFormat(
        (
            INSTRUMENT,
            Keyword("DATE-OBS", "base.matrix.date", "UTC", kind="date"),
            Keyword("CTYPE1", lambda _: axis, f"columns: {meaning}", kind="str"),
            Keyword("CTYPE2", lambda _: "ACTUATOR", "rows, axis 0 in numpy", kind="str"),
            Keyword("BUNIT", lambda _: unit, "of the matrix", kind="str"),
        ),
        matrix=matrix,
    )


INSTRUMENT = Keyword("INSTRUME", "base.matrix.instrument", "mirror", kind="str")
STATE = Column("STATE", _states, kind="str", width=9)
MODES = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "base.matrix.date", "UTC, of the stiffness", kind="date"),
        Keyword("MISFIT", "findings.measured.misfit", "variance of shapes over repeats"),
        Keyword("RELERR", "findings.measured.relative_error", "of the stiffness, by noise"),
        Keyword(
            "RIGID", "findings.measured.rigid_assumed", "motions taken to cost nothing", kind="int"
        ),
        Keyword("METHOD", "findings.calibration.method", "estimator of alpha", kind="str"),
        Keyword(
            "SCALE",
            "findings.calibration.scale",
            "what fixes the common scale of alpha",
            kind="str",
        ),
        Keyword("SEEING", "base.seen.atmosphere.seeing", "at 500 nm", "arcsec"),
        Keyword("R0", "base.seen.atmosphere.fried_parameter", "at 500 nm", "m"),
        Keyword(
            "L0",
            "base.seen.atmosphere.outer_scale",
            "outer scale; absent if infinite",
            "m",
            absent=np.inf,
        ),
        Keyword("DIAMETER", "base.seen.pupil.diameter", "entrance pupil", "m"),
        Keyword("RADIUS", "base.seen.pupil.radius", "of the mirror that fills it", "m"),
        Keyword("FITTING", "base.seen.fitting_error", "rms wavefront between actuators", "m"),
        Keyword("EFFICIEN", "cost.efficiency", "commanded force per root of power", "N/W^1/2"),
        Keyword("MAXPOWER", "limits.power", "most that a coil may dissipate", "W", absent=np.inf),
        Keyword(
            "MAXTOTAL", "limits.total", "most that all coils may dissipate", "W", absent=np.inf
        ),
        Keyword(
            "MAXFORCE", "limits.force", "most true force, static and 3 sigma", "N", absent=np.inf
        ),
        Keyword(
            "NMODES",
            lambda w: w.cost.modes_within(w.limits),
            "stiffness modes within these limits",
            kind="int",
        ),
    ),
    (
        replace(ACTUATORS, columns=(*ACTUATORS.columns, STATE), of="base"),
        ImageFormat("MODES", _over_actuators("shapes")),
        ImageFormat("FORCE", _over_actuators("forces"), "N/m"),
        ImageFormat("COMMANDED", _over_actuators("feed_forward_commanded"), "N/m"),
        TableFormat(
            "STATIC",
            (
                Column("ID", "base.stiffness.enabled.id", kind="int"),
                Column("FORCE", "cost.static", "N"),
            ),
        ),
        _budget("BUDGET", 0, Column("STIFFNESS", "base.modes.stiffness", "N/m")),
        replace(SOURCES, of="findings.calibration.sources"),
        replace(SOURCES, name="STIFFNESS_SOURCES", of="findings.sources"),
        ImageFormat("ZERNIKE", _over_actuators("shapes", 1)),
        _budget("BUDGET_ZERNIKE", 1),
        ImageFormat("KL", _over_actuators("shapes", 2)),
        _budget("BUDGET_KL", 2),
    ),
)
PLAIN = {
    "ff_v_matrix": _plain("MODE", "displacement per mode", None, _over_actuators("shapes")),
    "ff_matrix": _plain("SENSOR", "commanded N per true m", "N/m", "commanded"),
    "ff_matrix_true": _plain("SENSOR", "true N per true m", "N/m", "true"),
}
BESIDE = ("true", "commanded", *PLAIN)


def modes_paths(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the paths of all that `write_modes` writes: the modal base first."""
    target = Path(path)
    stem = target.name.removesuffix(".gz").removesuffix(".fits")
    return (target, *(target.with_name(f"{stem}.{what}.fits") for what in BESIDE))


def write_modes(
    findings: ModalFindings,
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
    base, stiffness = findings.after, findings.after.stiffness
    true = _square(base, stiffness.acting_stiffness)
    commanded = _square(base, stiffness.acting_stiffness / stiffness.enabled_alpha[:, None])
    acts = np.isin(base.layout.id, stiffness.enabled.id[stiffness.acts])
    matrix = StiffnessMatrix(
        base.matrix.instrument, base.matrix.date, replace(base.layout, enabled=acts), true
    )
    written = _Written(findings, base, limits or Budget(), true, commanded)
    with files_together(paths, overwrite=overwrite) as folder:
        target, for_true, for_commanded, *plain = (folder / path.name for path in paths)
        write_fits(target, MODES, written)
        write_stiffness(matrix, for_true)
        write_stiffness(replace(matrix, stiffness=commanded), for_commanded)
        for target, form in zip(plain, PLAIN.values(), strict=True):
            write_fits(target, form, written)
    return list(paths)


def _square(base: ModalBase, forces: Array) -> Array:
    """Return (N, N) forces per displacement over all actuators from (n, n) over the enabled."""
    on = base.layout.enabled
    square = np.zeros((on.size, on.size))
    square[:, on] = base.on_all_actuators(forces)
    return square
