"""The modal basis in files (docs/files.md): whole, as stiffness files, and as plain matrices."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.errors import FormatError
from truenewton.files.fits import write_fits
from truenewton.files.format import Attribute, Column, FileFormat, ImageFormat, Keyword, TableFormat
from truenewton.files.outputs import files_together
from truenewton.modal.findings import ModalFindings
from truenewton.modal.modal_base import SUMMARIES, Budget, Dissipation, ModalBase
from truenewton.records.file import ACTUATORS, SOURCES, write_stiffness
from truenewton.records.stiffness_matrix import StiffnessMatrix, StoredAs


@dataclass(frozen=True, eq=False)
class _Written:
    """The content of the files, ``cost`` that of the stiffness modes."""

    findings: ModalFindings
    limits: Budget

    @property
    def base(self) -> ModalBase:
        """The modal basis with alpha."""
        return self.findings.after

    @property
    def cost(self) -> Dissipation | None:
        """The cost of the stiffness modes; None without turbulence."""
        return self.base.costs[0] if self.base.costs else None

    @property
    def alpha(self) -> Array:
        """(n, 1) alpha of the enabled actuators."""
        return self.base.stiffness.enabled_alpha[:, None]

    @property
    def true(self) -> Array:
        """(N, N) true forces per true displacement [N/m]."""
        return self._square(self.base.stiffness.acting_stiffness)

    @property
    def commanded(self) -> Array:
        """(N, N) commanded forces per true displacement [N/m]."""
        return self._square(self.base.stiffness.acting_stiffness / self.alpha)

    def as_imported(self, forces: Array) -> Array:
        """Return (n, n) forces per true displacement [N/m] as the imported file stores its matrix.

        They become forces per sensor reading, in its sign, unit, order and orientation.
        """
        square = self._square(self.base.stiffness.per_reading(forces))
        return square if self.stored is None else self.stored.array(square)

    @property
    def stored(self) -> StoredAs | None:
        """How the file that was imported stores the matrix; None of cycles."""
        return self.base.matrix.stored

    @property
    def read_modes(self) -> Array:
        """(N, m) readings of the sensors for each mode, in the rows of the imported file."""
        base = self.base
        readings = self.whole(base.stiffness.read(self.displacements()))
        if self.stored is None:
            return readings
        everywhere = np.zeros((self.stored.size, readings.shape[1]))
        everywhere[self.stored.rows] = readings
        return everywhere

    def _square(self, forces: Array) -> Array:
        """Return (N, N) forces of all actuators from (n, n) of the enabled, read-only."""
        all_of_them = self.whole(self.whole(forces).T).T
        all_of_them.setflags(write=False)  # so that a record need not copy it
        return all_of_them

    def whole(self, values: Array) -> Array:
        """Return (N, m) values of all actuators from (n, m) of the enabled; 0 for others."""
        on = self.base.layout.enabled
        if on.all():
            return values
        everywhere = np.zeros((on.size, values.shape[1]))
        everywhere[on] = values
        return everywhere

    def displacements(self, cost: int | None = None) -> Array:
        """Return (n, m) displacements of the enabled actuators for the modes of a basis."""
        base = self.base
        modes = base.modes.modes if cost is None else base.costs[cost].modes
        return base.stiffness.displaced(modes)

    @property
    def forces(self) -> Array:
        """(n, m) true forces of the enabled actuators for each mode [N/m]."""
        return self.base.stiffness.acting_stiffness @ self.displacements()


def _states(base: ModalBase) -> NDArray[np.str_]:
    """Return (N,) the role of each actuator."""
    followers = np.where(base.stiffness.acts, "slaved", "off")
    states = np.full(base.layout.n, "disabled", dtype="U9")
    states[base.layout.enabled] = np.where(base.stiffness.commanded, "commanded", followers)
    return states


def _budget(name: str, base: int, *more: Column) -> TableFormat:
    """Return the table of the first N modes of a basis, a row for each N."""

    def of(values: Callable[[Dissipation], Any]) -> Callable[[_Written], Any]:
        return lambda written: values(written.base.costs[base]) if written.cost else None

    number = Column("N", lambda w: np.arange(1, w.base.modes.stiffness.size + 1), kind="int")
    summaries = (Column(key.upper(), of(values), unit) for key, unit, values in SUMMARIES)
    return TableFormat(name, (number, *more, *summaries))


def _plain(meaning: str, matrix: Attribute, *, forces: bool) -> FileFormat:
    """Return the format of a matrix in the primary HDU, with nothing else, for electronics."""

    def axes(w: _Written) -> tuple[str, str]:
        """Return the kinds of its columns and rows."""
        if not forces:
            return "MODE", "ACTUATOR"
        turned = w.stored is not None and w.stored.transposed
        return ("ACTUATOR", "SENSOR") if turned else ("SENSOR", "ACTUATOR")

    def unit(w: _Written) -> str | None:
        return "N/m" if w.stored is None else w.stored.unit or None

    def sign(w: _Written) -> int:
        return -1 if w.stored is not None and w.stored.factor < 0.0 else 1

    return FileFormat(
        (
            INSTRUMENT,
            Keyword("DATE-OBS", "base.matrix.date", "UTC", kind="date"),
            _text("CONTENT", lambda _: meaning, "sign, unit, order as imported"),
            _text("CTYPE1", lambda w: axes(w)[0], "columns"),
            _text("CTYPE2", lambda w: axes(w)[1], "rows, axis 0 in numpy"),
            _text("BUNIT", lambda w: unit(w) if forces else None, "of the matrix"),
            _integer(
                "SIGN", lambda w: sign(w) if forces else None, "1: positive diagonal, -1: neg."
            ),
            _text("DISPLACE", "base.matrix.displaced", "displacements: read or true"),
        ),
        matrix=matrix,
    )


_text = partial(Keyword, kind="str")
_integer = partial(Keyword, kind="int")
_finite = partial(Keyword, absent=np.inf)
INSTRUMENT = _text("INSTRUME", "base.matrix.instrument", "mirror")
STATE = Column("STATE", _states, kind="str", width=9)
MODES = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "base.matrix.date", "UTC, of the stiffness", kind="date"),
        Keyword("MISFIT", "findings.measured.misfit", "variance of shapes over repeats"),
        Keyword("RELERR", "findings.measured.relative_error", "of the stiffness, by noise"),
        _integer("RIGID", "findings.measured.rigid_assumed", "motions taken to cost nothing"),
        _text("METHOD", "findings.calibration.method", "estimator of alpha"),
        _text("SCALE", "findings.calibration.scale", "what fixes the common scale of alpha"),
        _text("VERDICT", lambda w: str(w.findings.calibration.verdict.level), "on alpha"),
        Keyword("SEEING", "base.seen.atmosphere.seeing", "at 500 nm", "arcsec"),
        Keyword("R0", "base.seen.atmosphere.fried_parameter", "at 500 nm", "m"),
        _finite("L0", "base.seen.atmosphere.outer_scale", "outer scale; absent if infinite", "m"),
        Keyword("DIAMETER", "base.seen.pupil.diameter", "entrance pupil", "m"),
        Keyword("RADIUS", "base.seen.pupil.radius", "of the mirror that fills it", "m"),
        Keyword("FITTING", "base.seen.fitting_error", "rms wavefront between actuators", "m"),
        Keyword("EFFICIEN", "cost.efficiency", "commanded force per root of power", "N/W^1/2"),
        _finite("MAXPOWER", "limits.power", "most that a coil may dissipate", "W"),
        _finite("MAXTOTAL", "limits.total", "most that all coils may dissipate", "W"),
        _finite("MAXFORCE", "limits.force", "most true force, static and 3 sigma", "N"),
        _integer(
            "NMODES",
            lambda w: w.cost and w.cost.modes_within(w.limits),
            "stiffness modes within these limits",
        ),
    ),
    (
        replace(ACTUATORS, columns=(*ACTUATORS.columns, STATE), of="base"),
        ImageFormat("MODES", lambda w: w.whole(w.displacements())),
        ImageFormat("READING", lambda w: w.whole(w.base.stiffness.read(w.displacements()))),
        ImageFormat("FORCE", lambda w: w.whole(w.forces), "N/m"),
        ImageFormat("COMMANDED", lambda w: w.whole(w.forces / w.alpha), "N/m"),
        TableFormat(
            "STATIC",
            (
                Column("ID", "base.stiffness.enabled.id", kind="int"),
                Column("FORCE", "base.static", "N"),
            ),
        ),
        _budget("BUDGET", 0, Column("STIFFNESS", "base.modes.stiffness", "N/m")),
        replace(SOURCES, of="findings.calibration.sources"),
        replace(SOURCES, name="STIFFNESS_SOURCES", of="findings.sources"),
        ImageFormat("ZERNIKE", lambda w: w.whole(w.displacements(1))),
        _budget("BUDGET_ZERNIKE", 1),
        ImageFormat("KL", lambda w: w.whole(w.displacements(2))),
        _budget("BUDGET_KL", 2),
    ),
)
BY_TURBULENCE = 4  # extensions at the end
PLAIN = {
    "ff_v_matrix": _plain("displacements of each mode", "read_modes", forces=False),
    "ff_matrix": _plain(
        "commanded force per displacement",
        lambda w: w.as_imported(w.base.stiffness.acting_stiffness / w.alpha),
        forces=True,
    ),
    "ff_matrix_true": _plain(
        "true force per displacement",
        lambda w: w.as_imported(w.base.stiffness.acting_stiffness),
        forces=True,
    ),
}
BESIDE = ("true", "commanded", *PLAIN)


def modes_paths(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the paths of all files of `write_modes`: the modal basis first."""
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
    """Write the modal basis, and feed-forward and modes as plain matrices; return the paths.

    The other files are MODES.true.fits and MODES.commanded.fits, stiffness files of the force per
    true displacement in true and in commanded Newtons; and one plain matrix each for electronics:
    MODES.ff_v_matrix.fits (the modes), MODES.ff_matrix.fits (commanded), MODES.ff_matrix_true.fits.
    These are per sensor reading, in sign, unit and order of the file that was imported.

    Parameters
    ----------
    findings
        From `find_modes`.
    path
        MODES.fits.
    limits
        Of power and force; the number of modes within them is written, too, with turbulence.
    overwrite
        Replace existing files.

    Raises
    ------
    OutputExists, OutputFailed
    FormatError
        Limits without turbulence, or of power without the efficiency of the coils.

    Examples
    --------
    >>> files = tn.write_modes(tn.find_modes(campaign, calibration), "modes.fits")
    >>> [file.name for file in files[:3]]
    ['modes.fits', 'modes.true.fits', 'modes.commanded.fits']
    """
    if limits and not findings.after.costs:
        raise FormatError("limits need turbulence", remedy="give find_modes a diameter")
    paths = modes_paths(path)
    with files_together(paths, overwrite=overwrite) as folder:
        _write_into(folder, paths, findings, limits or Budget())
    return [*paths]


def _write_into(
    folder: Path, paths: Sequence[Path], findings: ModalFindings, limits: Budget
) -> None:
    """Write the modal basis into a folder, under the names of the paths."""
    base, stiffness, written = findings.after, findings.after.stiffness, _Written(findings, limits)
    acts = np.isin(base.layout.id, stiffness.enabled.id[stiffness.acts])
    matrix = StiffnessMatrix(
        base.matrix.instrument,
        base.matrix.date,
        replace(base.layout, enabled=acts),
        written.true,
        displaced="true",
    )
    target, for_true, for_commanded, *plain = (folder / path.name for path in paths)
    kept = len(MODES.extensions) - (0 if base.costs else BY_TURBULENCE)
    write_fits(target, replace(MODES, extensions=MODES.extensions[:kept]), written)
    write_stiffness(matrix, for_true)
    write_stiffness(replace(matrix, stiffness=written.commanded), for_commanded)
    for target, form in zip(plain, PLAIN.values(), strict=True):
        write_fits(target, form, written)
