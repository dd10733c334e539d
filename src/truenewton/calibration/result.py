"""The result of a calibration, and its file (docs/files.md)."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from truenewton.arrays import Array, frozen_array
from truenewton.errors import FormatError
from truenewton.estimation.diagnosis import Diagnosis, Goodness, RejectedRow, ScaleError
from truenewton.estimation.unknowns import Unknowns
from truenewton.files.fits import Sheet, ascii_text, write_fits
from truenewton.records.file import iso
from truenewton.records.source import UsedSource, sources_sheet
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes


LARGEST_ALPHA = 1e9  # true Newton / commanded Newton; keeps squares finite


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """True Newtons per commanded Newton, with what is needed to trust them.

    Unknown numbers are NaN. Arrays over actuators are in the order of ``layout``, NaN where an
    actuator is disabled; arrays over loads in the order of ``loads``.

    Attributes
    ----------
    instrument, date, date_end
        The mirror; when its data begin and end (UTC).
    method, scale
        'svd', ...; 'weights', 'given' or 'mean 1'.
    layout, loads
        The n actuators; the L loads, empty for a stiffness file.
    alpha
        (n,) true Newton / commanded Newton.
    reading_error, systematic_error, cycle_error
        (n,) E_STAT from reading noise, E_SYST from the weights, E_CYCLE the paper's.
    covariance, systematic_covariance
        (n + 1 + 2L, n + 1 + 2L) of alpha, B, then M_y, M_x of each load; all, and the part from
        the weights.
    bias_force
        B [N], total force of the bias magnets.
    torque_y, torque_x
        (L,) M_y and M_x [N m].
    weight, weight_error
        P and its standard uncertainty [N].
    temperature
        Mean over the rows used [deg C].
    shapes_used, rejected, invalid
        Rows used, rejected as outliers, marked as not valid.
    condition, rank
        Of E, each coordinate in units of its RMS; directions that the data hold above noise.
    noise, degrees_of_freedom, chi2
        Estimated standard deviation of one reading [N]; DOF; CHI2 against FORCERR.
    sources
        The files.
    diagnosis, goodness
        How well alpha is determined, and how well the data fit; None when read from a file.
    scale_errors
        What limits the common scale, largest first; empty when read from a file.
    rejected_rows
        The rows left out; empty when read from a file.
    """

    instrument: str
    date: datetime.datetime
    date_end: datetime.datetime
    method: str
    scale: str
    layout: Layout
    loads: tuple[Load, ...]
    alpha: Array
    reading_error: Array
    systematic_error: Array
    cycle_error: Array
    covariance: Array
    systematic_covariance: Array
    bias_force: float
    torque_y: Array
    torque_x: Array
    weight: float
    weight_error: float
    temperature: float
    shapes_used: int
    rejected: int
    invalid: int
    condition: float
    rank: int
    noise: float
    degrees_of_freedom: int | None
    chi2: float
    sources: tuple[UsedSource, ...]
    diagnosis: Diagnosis | None = None
    goodness: Goodness | None = None
    scale_errors: tuple[ScaleError, ...] = ()
    rejected_rows: tuple[RejectedRow, ...] = ()

    def __post_init__(self) -> None:
        for name in ("alpha", "reading_error", "systematic_error", "cycle_error", "covariance",
                     "systematic_covariance", "torque_y", "torque_x"):  # fmt: skip
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        on = self.layout.enabled
        if not (on.any() and np.isfinite(self.alpha[on]).all() and np.abs(self.alpha[on]).all()):
            raise FormatError("ALPHA holds no usable numbers", remedy="calibrate again")
        for name, errors in (("E_STAT", self.reading_error), ("E_SYST", self.systematic_error),
                             ("E_CYCLE", self.cycle_error),
                             ("COVARIANCE", np.diag(self.covariance))):  # fmt: skip
            if (errors < 0).any() or np.isinf(errors).any():
                raise FormatError(f"{name} is negative or infinite", remedy="calibrate again")
        if not np.isfinite(self.error[on]).all() or np.abs(self.alpha[on]).max() > LARGEST_ALPHA:
            raise FormatError("ALPHA or its error is absurd", remedy="calibrate again")

    def __repr__(self) -> str:
        on = self.layout.enabled
        return (
            f"<Calibration of {self.instrument}: {np.count_nonzero(on)} actuators, alpha"
            f" {self.alpha[on].min():.3g} .. {self.alpha[on].max():.3g}, typical error"
            f" {np.median(self.error[on]):.2g}, method {self.method}, scale {self.scale}>"
        )

    @property
    def error(self) -> Array:
        """(n,) E_ALPHA, the standard uncertainty of alpha, everything included."""
        return np.asarray(np.hypot(self.reading_error, self.systematic_error))

    @property
    def bias_force_error(self) -> float:
        """Standard uncertainty of B [N]."""
        bias = Unknowns(self.layout.n, len(self.loads)).bias
        return float(np.sqrt(self.covariance[bias, bias])) if self.loads else float("nan")

    @property
    def torque_errors(self) -> Array:
        """(L, 2) standard uncertainties of M_y and M_x [N m]."""
        unknowns = Unknowns(self.layout.n, len(self.loads))
        variances = np.diag(self.covariance)[unknowns.torques]
        return np.asarray(np.sqrt(variances).reshape(-1, 2))

    @property
    def table(self) -> QTable:
        """One row per actuator: ID, X, Y, ALPHA and its errors, with units."""
        import astropy.units as u
        from astropy.table import QTable

        table = QTable()
        for name, form, unit, values in self._columns():
            table[name] = np.array(values) if form == "J" else u.Quantity(values, unit or "")
            if form != "J":
                table[name].info.format = ".5g"
        table.meta = {"INSTRUME": self.instrument, "METHOD": self.method, "SCALE": self.scale}
        return table

    def _columns(self) -> tuple[tuple[str, str, str | None, Any], ...]:
        return (
            ("ID", "J", None, self.layout.id),
            ("X", "D", "m", self.layout.x),
            ("Y", "D", "m", self.layout.y),
            ("ALPHA", "D", None, self.alpha),
            ("E_ALPHA", "D", None, self.error),
            ("E_STAT", "D", None, self.reading_error),
            ("E_SYST", "D", None, self.systematic_error),
            ("E_CYCLE", "D", None, self.cycle_error),
        )

    def plot_actuators(self, ax: Axes | None = None) -> Axes:
        """Draw alpha per actuator with error bars (paper, fig. 5); return the axes."""
        from truenewton.calibration.figures import plot_actuators

        return plot_actuators(self, ax)

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw alpha on the map of the actuators (paper, fig. 6); return the axes."""
        from truenewton.figures.maps import plot_map

        return plot_map(self.layout, self.alpha, ax)

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the calibration file.

        Raises
        ------
        OutputExists, OutputFailed
        """
        errors = self.torque_errors
        names = [ascii_text(load.name) for load in self.loads]
        tools = [ascii_text(load.tool or "") for load in self.loads]
        loads = Sheet(
            "LOADS",
            columns=(
                ("LOAD", f"{max(map(len, names), default=1)}A", None, names),
                ("ADDED", "D", "N", [load.added for load in self.loads]),
                ("E_ADDED", "D", "N", [load.added_error for load in self.loads]),
                ("TILT", "D", "deg", [load.tilt for load in self.loads]),
                ("MY", "D", "N m", self.torque_y),
                ("E_MY", "D", "N m", errors[:, 0]),
                ("MX", "D", "N m", self.torque_x),
                ("E_MX", "D", "N m", errors[:, 1]),
                ("TOOL", f"{max([1, *map(len, tools)])}A", None, tools),
            ),
        )
        sheets = [
            Sheet("CALIBRATION", columns=(*self._columns(), ("NZ", "D", None, self.layout.nz))),
            loads,
            Sheet("COVARIANCE", data=self.covariance),
            Sheet("SYSTEMATIC", data=self.systematic_covariance),
            sources_sheet(self.sources),
        ]
        write_fits(path, self._header(), sheets, overwrite=overwrite)

    def _header(self) -> dict[str, tuple[Any, str]]:
        return {
            "INSTRUME": (self.instrument, "mirror"),
            "DATE-OBS": (iso(self.date), "UTC, start of the data"),
            "DATE-END": (iso(self.date_end), "UTC, end of the data"),
            "TEMPERAT": (self.temperature, "[deg_C] mean over the rows used"),
            "WEIGHT": (self.weight, "[N] weight of the mirror, P"),
            "E_WEIGHT": (self.weight_error, "[N] standard uncertainty of WEIGHT"),
            "BIAS": (self.bias_force, "[N] total force of the bias magnets, B"),
            "E_BIAS": (self.bias_force_error, "[N] standard uncertainty of BIAS"),
            "METHOD": (self.method, "estimator"),
            "SCALE": (self.scale, "what fixes the common scale"),
            "NSHAPES": (self.shapes_used, "rows used"),
            "NREJECT": (self.rejected, "rows rejected as outliers"),
            "NINVALID": (self.invalid, "rows marked as not valid"),
            "CONDITIO": (self.condition, "condition of E, coordinates in units of RMS"),
            "RANK": (self.rank, "directions held above noise"),
            "NOISE": (self.noise, "[N] standard deviation of one force reading"),
            "DOF": (self.degrees_of_freedom, "degrees of freedom"),
            "CHI2": (self.chi2, "against FORCERR"),
        }
