"""The result of a calibration."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.estimation.findings.estimate import (
    Diagnosis,
    Goodness,
    RejectedRow,
    Scale,
    ScaleError,
    Sensor,
    UnseenError,
)
from truenewton.estimation.findings.finding import Finding
from truenewton.estimation.matrix.facts import Symmetry
from truenewton.estimation.matrix.modes import Imbalance
from truenewton.estimation.paper.equations import Unknowns
from truenewton.files.format import quantities
from truenewton.records.parts import Parts
from truenewton.records.source import Source
from truenewton.rounding import counted, html_table
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load, check_load

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes

    from truenewton.calibration.verdict import Verdict


LARGEST_ALPHA = 1e9  # true Newton / commanded Newton, and one over the smallest: squares are finite


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
    solved_condition
        Of E as svd solves it, torques in N m; NaN of other methods.
    noise, degrees_of_freedom, chi2
        Estimated standard deviation of one reading [N]; DOF; CHI2 against FORCERR.
    sources
        The files.
    diagnosis, goodness
        How well alpha is determined, of which a file holds the warnings alone; and how well the
        data fit.
    scale_errors
        What limits the common scale, largest first.
    rejected_rows
        The rows left out.
    effects
        What the bench did beside the model, the likeliest first.
    unseen
        What the data cannot show, and would do to the common scale; in none of the errors.
    imbalances
        Of elastic modes, fitted and held out; empty but for a stiffness file.
    sensors
        Gains and places of the sensors by reciprocity; empty by other methods.
    matrix_facts
        Symmetry of a stiffness matrix; None of campaigns, and in older files.
    halves
        (n,) relative alpha fitted on the even modes less that fitted on the odd: cross-validation
        of a matrix; None or NaN where there is none.

    Examples
    --------
    >>> calibration.alpha.shape
    (45,)
    >>> print(calibration.verdict.level)
    usable
    >>> worst = np.argmax(calibration.error / calibration.alpha)
    >>> f"{calibration.error[worst] / calibration.alpha[worst]:.1%}"
    '1.7%'
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
    sources: tuple[Source, ...]
    diagnosis: Diagnosis | None = None
    goodness: Goodness | None = None
    scale_errors: tuple[ScaleError, ...] = ()
    solved_condition: float = float("nan")
    rejected_rows: tuple[RejectedRow, ...] = ()
    effects: tuple[Finding, ...] = ()
    unseen: tuple[UnseenError, ...] = ()
    imbalances: tuple[Imbalance, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    matrix_facts: Symmetry | None = None
    halves: Array | None = None

    def __post_init__(self) -> None:
        freeze(self, "alpha", "reading_error", "systematic_error", "cycle_error", "covariance",
               "systematic_covariance", "torque_y", "torque_x")  # fmt: skip
        on = self.layout.enabled
        if not (on.any() and np.isfinite(self.alpha[on]).all() and np.abs(self.alpha[on]).all()):
            raise FormatError("ALPHA holds no usable numbers", remedy="calibrate again")
        for name, errors in (("E_STAT", self.reading_error), ("E_SYST", self.systematic_error),
                             ("E_CYCLE", self.cycle_error),
                             ("COVARIANCE", np.diag(self.covariance))):  # fmt: skip
            if (errors < 0).any() or np.isinf(errors).any():
                raise FormatError(f"{name} is negative or infinite", remedy="calibrate again")
        if self.weight >= 0.0 or self.weight_error < 0.0:
            raise FormatError("WEIGHT or E_WEIGHT has the wrong sign", remedy="calibrate again")
        if self.scale not in tuple(Scale):
            raise FormatError(f"SCALE is '{self.scale}'", remedy=f"it is {', '.join(Scale)}")
        for sensor in self.sensors:
            sizes = (1.0 / sensor.gain if sensor.gain else np.inf, sensor.x, sensor.y)
            if sensor.state == "fitted" and not np.isfinite(sizes).all():
                raise FormatError("SENSORS holds no usable numbers", remedy="calibrate again")
        for load in self.loads:
            check_load(load)
        known = (self.torque_y, self.torque_x, self.bias_force) if self.loads else ()
        if not all(np.isfinite(each).all() for each in known):
            raise FormatError("BIAS, MY or MX is no number", remedy="calibrate again")
        alpha = np.abs(self.alpha[on])
        sane = alpha.min() > 1 / LARGEST_ALPHA and alpha.max() < LARGEST_ALPHA
        if not (sane and np.isfinite(self.error[on]).all()):
            raise FormatError("ALPHA or its error is absurd", remedy="calibrate again")

    def __repr__(self) -> str:
        on = self.layout.enabled
        return (
            f"<Calibration of {self.instrument}: {counted(int(np.count_nonzero(on)), 'actuator')},"
            f" alpha {self.alpha[on].min():.3g} .. {self.alpha[on].max():.3g}, typical error"
            f" {np.median(self.error[on]):.2g}, method {self.method}, scale {self.scale}>"
        )

    def _repr_html_(self) -> str:
        from truenewton.calibration.summary import headline, summary_rows, warning_lines

        rows = [*summary_rows(self), ("verdict", str(self.verdict.level), "")]
        remarks = warning_lines(self.verdict.faults)
        return html_table(headline(self), rows, remarks)

    @property
    def verdict(self) -> Verdict:
        """Whether the stated errors hold, with all findings; by what a file contains."""
        from truenewton.calibration.verdict import verdict_on

        return verdict_on(self)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that was found, the worst first."""
        return self.verdict.findings

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

    def column(self, name: str) -> Array:
        """Return (n,) a quantity of the actuators by its name, as `Parts.column` does."""
        return np.asarray(getattr(self, name))

    def of_sensors(self, name: str) -> Array:
        """Return (n,) an attribute of the sensors, as 'gain'; NaN of those that are not fitted."""
        fitted = {s.actuator: getattr(s, name) for s in self.sensors if s.state == "fitted"}
        return np.array([fitted.get(actuator, np.nan) for actuator in self.layout.id.tolist()])

    @property
    def table(self) -> QTable:
        """One row per actuator: ID, X, Y, ALPHA and its errors, with units."""
        from truenewton.calibration.file import ACTUATORS

        table = quantities(self, ACTUATORS, without=("NZ",))
        table.meta = {"INSTRUME": self.instrument, "METHOD": self.method, "SCALE": self.scale}
        return table

    def plot_actuators(self, ax: Axes | None = None) -> Axes:
        """Draw alpha per actuator with error bars (paper, fig. 5); return the axes."""
        from truenewton.calibration.figures import plot_actuators
        from truenewton.figures.style import on_screen

        with on_screen():
            return plot_actuators(self, ax)

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw alpha on the map of the actuators (paper, fig. 6); return the axes."""
        from truenewton.figures.maps import plot_map
        from truenewton.figures.style import on_screen

        with on_screen():
            return plot_map(self.layout, self.column("alpha"), ax)

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the calibration in the form that the name ends in (docs/files.md).

        ``.fits`` and ``.fits.gz`` hold all of it, ``.ecsv`` the table with units and the verdict,
        ``.csv`` the table alone, ``.npy`` alpha alone.

        Raises
        ------
        OutputExists, OutputFailed
        """
        from truenewton.calibration.export import write_calibration

        write_calibration(self, path, overwrite=overwrite)


AnyCalibration = Calibration | Parts[Calibration]
