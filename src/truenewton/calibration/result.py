"""The result of a calibration, and the columns of its file (docs/files.md)."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truenewton.arrays import Array, freeze
from truenewton.errors import FormatError
from truenewton.estimation.findings.estimate import (
    EstimateFacts,
    Scale,
    typical,
)
from truenewton.estimation.findings.finding import Finding, Verdict
from truenewton.estimation.matrix.facts import Symmetry
from truenewton.estimation.matrix.modes import Imbalance
from truenewton.estimation.paper.equations import Unknowns
from truenewton.files.format import (
    Column,
    FileFormat,
    ImageFormat,
    Keyword,
    TableFormat,
    quantities,
)
from truenewton.records.cycle import Source
from truenewton.records.file import ID, INSTRUMENT, NUMBER, NZ, SOURCES, X, Y
from truenewton.records.result import Result, verdict_of
from truenewton.rounding import counted, percent
from truenewton.statics.layout import Layout
from truenewton.statics.load import Load, check_load

if TYPE_CHECKING:
    import pandas as pd
    from astropy.table import QTable, Row
    from matplotlib.axes import Axes


LARGEST_ALPHA = 1e9  # true Newton / commanded Newton, and one over the smallest: squares are finite


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Calibration(Result, EstimateFacts):
    """Alpha of every actuator with its uncertainties, and what is needed to trust them.

    Unknown numbers are NaN. Arrays over actuators are in the order of ``layout``, NaN if an
    actuator is disabled; arrays over loads in the order of ``loads``.

    Attributes
    ----------
    instrument, date, date_end
        The mirror; start and end of its data (UTC).
    method, scale
        'svd', ...; 'weights', 'given' or 'mean 1'.
    layout, loads
        The n actuators; the L loads, empty for a stiffness file.
    alpha
        (n,) true Newton / commanded Newton.
    statistical_error, systematic_error, cycle_error
        (n,) E_STAT from the readings, E_SYST from the weights, E_CYCLE as in the paper.
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
        Of E, each coordinate in units of its RMS; directions that the data determine.
    solved_condition
        Of E as svd solves it, torques in N m; NaN of other methods.
    noise, degrees_of_freedom, chi2
        Estimated standard deviation of one reading [N]; DOF; CHI2 against FORCERR.
    sources
        The files.
    diagnosis, goodness
        How well alpha is determined (a file contains only the warnings), and how well the data
        fit.
    scale_errors
        Budget of the common scale, largest first.
    rejected_rows
        The rows left out.
    effects
        Findings about files, columns and actuators, then bench effects, the most likely first.
    unseen
        Effects that the data cannot show, with their change of the common scale; in none of the
        errors.
    imbalances
        Of elastic modes, fitted and held out; empty except for a stiffness file.
    sensors
        Gains and positions of the sensors by reciprocity; empty by other methods.
    matrix_facts
        Symmetry of a stiffness matrix; None of campaigns, and in older files.
    halves
        (n,) relative alpha fitted on the even modes less that fitted on the odd: cross-validation
        of a matrix; None or NaN if there is none.

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
    layout: Layout
    alpha: Array
    statistical_error: Array
    systematic_error: Array
    covariance: Array
    systematic_covariance: Array
    cycle_error: Array
    loads: tuple[Load, ...] = ()
    bias_force: float = float("nan")
    torque_y: Array = field(default_factory=lambda: np.empty(0))
    torque_x: Array = field(default_factory=lambda: np.empty(0))
    weight: float = float("nan")
    weight_error: float = float("nan")
    temperature: float = float("nan")
    shapes_used: int
    rejected: int = 0
    invalid: int = 0
    sources: tuple[Source, ...]
    imbalances: tuple[Imbalance, ...] = ()
    matrix_facts: Symmetry | None = None
    halves: Array | None = None

    def __post_init__(self) -> None:
        freeze(self, "alpha", "statistical_error", "systematic_error", "cycle_error", "covariance",
               "systematic_covariance", "torque_y", "torque_x")  # fmt: skip
        fault = next(self._faults(), None)
        if fault:
            raise FormatError(fault, remedy="calibrate again")
        if self.scale not in tuple(Scale):
            raise FormatError(f"SCALE is '{self.scale}'", remedy=f"it is {', '.join(Scale)}")
        for load in self.loads:
            check_load(load)

    def _faults(self) -> Iterator[str]:
        """Yield which numbers cannot be."""
        alpha = np.abs(self.alpha[self.layout.enabled])
        if not (alpha.size and np.isfinite(alpha).all() and alpha.all()):
            yield "ALPHA contains no usable numbers"
        for name, errors in (("E_STAT", self.statistical_error), ("E_SYST", self.systematic_error),
                             ("E_CYCLE", self.cycle_error),
                             ("COVARIANCE", np.diag(self.covariance))):  # fmt: skip
            if (errors < 0).any() or np.isinf(errors).any():
                yield f"{name} is negative or infinite"
        if self.weight >= 0.0 or self.weight_error < 0.0:
            yield "WEIGHT or E_WEIGHT has the wrong sign"
        for sensor in self.sensors:
            sizes = (1.0 / sensor.gain if sensor.gain else np.inf, sensor.x, sensor.y)
            if sensor.state == "fitted" and not np.isfinite(sizes).all():
                yield "SENSORS contains no usable numbers"
        known = (self.torque_y, self.torque_x, self.bias_force) if self.loads else ()
        if not all(np.isfinite(each).all() for each in known):
            yield "BIAS, MY or MX is no number"
        sane = alpha.min() > 1 / LARGEST_ALPHA and alpha.max() < LARGEST_ALPHA
        if not (sane and np.isfinite(self.error[self.layout.enabled]).all()):
            yield "ALPHA or its error is absurd"

    def __repr__(self) -> str:
        on = self.layout.enabled
        return (
            f"<Calibration of {self.instrument}: {counted(int(np.count_nonzero(on)), 'actuator')},"
            f" alpha {self.alpha[on].min():.3g} .. {self.alpha[on].max():.3g}, typical error"
            f" {percent(typical(self.error, self.alpha))}, method {self.method},"
            f" scale {self.scale}>"
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the stated errors are valid, with all findings; from what a file contains."""
        verdict: Verdict = verdict_of(self)
        if self.layout.has_texts:  # which messages add to the IDs
            called = dict(zip(self.layout.id.tolist(), self.layout.shown.tolist(), strict=True))
            findings = tuple(replace(each, called=called) for each in verdict.findings)
            return replace(verdict, findings=findings)
        return verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, the worst first."""
        return self.verdict.findings

    @property
    def error(self) -> Array:
        """(n,) E_ALPHA, the standard uncertainty of alpha, everything included."""
        return np.asarray(np.hypot(self.statistical_error, self.systematic_error))

    @property
    def degrees_of_freedom(self) -> int | None:
        """Degrees of freedom of the fit; None if it was not judged."""
        return self.goodness.degrees_of_freedom if self.goodness else None

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

    def of_sensors(self, name: str) -> Array:
        """Return (n,) an attribute of the sensors, as 'gain'; NaN of those that are not fitted."""
        fitted = {s.actuator: getattr(s, name) for s in self.sensors if s.state == "fitted"}
        return np.array([fitted.get(actuator, np.nan) for actuator in self.layout.id.tolist()])

    def __len__(self) -> int:
        return self.layout.n

    def __iter__(self) -> Iterator[int]:
        """Iterate over the IDs of the actuators."""
        return iter(self.layout.id.tolist())

    def __getitem__(self, actuator: int | str) -> Row:
        """Return the row of `table` of an actuator by its ID, or by its text in NUMBER.

        Examples
        --------
        >>> calibration[17]["ID", "ALPHA", "E_ALPHA"].colnames
        ['ID', 'ALPHA', 'E_ALPHA']
        """
        return self.table[self._places_of([actuator])][0]

    def alpha_of(self, ids: ArrayLike) -> Array:
        """Return (k,) alpha of actuators by their (k,) IDs, or texts in NUMBER.

        Raises
        ------
        UnknownName
            There is no such actuator.
        """
        return np.asarray(self.alpha[self._places_of(ids)])

    def _places_of(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Return (k,) indices of actuators by their (k,) IDs."""
        wanted = self.layout.ids_of(np.atleast_1d(ids).tolist())
        at = {actuator: k for k, actuator in enumerate(self.layout.id.tolist())}
        return np.array([at[actuator] for actuator in wanted], dtype=np.int64)

    def to_true(self, commanded: ArrayLike) -> Array:
        """Return true forces, alpha times commanded: (..., n) [N], NaN of disabled actuators.

        Examples
        --------
        >>> calibration.to_true(np.ones(45)).shape
        (45,)
        """
        return np.asarray(self.alpha * np.asarray(commanded, dtype=float))

    def to_commanded(self, true: ArrayLike) -> Array:
        """Return the commands that give (..., n) true forces, these over alpha [N]."""
        return np.asarray(np.asarray(true, dtype=float) / self.alpha)

    def true_stiffness(self, commanded: ArrayLike) -> Array:
        """Return (n, n) true force per displacement, diag(alpha) K, of commanded force K [N/m].

        Sensor gains stay in it; `true_stiffness` of `tn` removes them, too.
        """
        return np.asarray(self.alpha[:, None] * np.asarray(commanded, dtype=float))

    def to_pandas(self) -> pd.DataFrame:
        """Return `table` as a pandas table, whose index is the ID; pandas must be installed."""
        return self.table.to_pandas(index="ID")

    @property
    def table(self) -> QTable:
        """One row per actuator: ID, X, Y, ALPHA and its errors, with units."""
        table = quantities(self, ACTUATORS, without=("NZ",))
        table.meta = {"INSTRUME": self.instrument, "METHOD": self.method, "SCALE": self.scale}
        return table

    def plot_actuators(self, ax: Axes | None = None) -> Axes:
        """Draw alpha per actuator with error bars (paper, fig. 5); return the axes."""
        from truenewton.calibration.figures import plot_actuators
        from truenewton.figures.style import on_screen

        with on_screen():
            return plot_actuators(self, ax)

    def plot(
        self, layer: str = "alpha", *, cmap: str | None = None, vmin: float | None = None,
        vmax: float | None = None, annotate: bool = False, ax: Axes | None = None,
    ) -> Axes:  # fmt: skip
        """Draw a quantity on the map of the actuators (paper, fig. 6); return the axes.

        Parameters
        ----------
        layer
            'alpha', 'e_alpha', 'e_stat', 'e_syst', 'e_cycle', 'leverage', 'sensor_gain',
            'sensor_dx', 'sensor_dy', 'halves', 'mirror_number' or 'findings', as in the report.
        cmap, vmin, vmax
            Colour map of matplotlib, and its ends, instead of those of the report.
        annotate
            Write the values, too, on up to a hundred actuators.
        ax
            Axes to draw on; by default new ones, one column wide.

        Raises
        ------
        UnknownName
            The calibration has no such quantity; the message lists those it has.

        Examples
        --------
        >>> axes = calibration.plot("e_stat", cmap="viridis")
        """
        from truenewton.calibration.layers import plot_layer

        return plot_layer(self, layer, ax, cmap=cmap, vmin=vmin, vmax=vmax, annotate=annotate)


def _optional(name: str, of: str, *columns: Column) -> TableFormat:
    """Return a table of the records ``of`` a calibration that a file may lack."""
    return TableFormat(name, columns, of, optional=True)


ACTUATORS = TableFormat(
    "CALIBRATION",
    (
        ID,
        X,
        Y,
        Column("ALPHA", "alpha"),
        Column("E_ALPHA", lambda c: c.error),
        Column("E_STAT", "statistical_error"),
        Column("E_SYST", "systematic_error"),
        Column("E_CYCLE", "cycle_error"),
        Column("HALVES", "halves", absent=None),
        NUMBER,
        NZ,
    ),
)
CALIBRATION = FileFormat(
    (
        INSTRUMENT,
        Keyword("DATE-OBS", "date", "UTC, start of the data", kind="date"),
        Keyword("DATE-END", "date_end", "UTC, end of the data", kind="date"),
        Keyword("TEMPERAT", "temperature", "mean over the rows used", "deg_C", absent=np.nan),
        Keyword("WEIGHT", "weight", "weight of the mirror, P", "N", absent=np.nan),
        Keyword("E_WEIGHT", "weight_error", "standard uncertainty of WEIGHT", "N", absent=np.nan),
        Keyword("BIAS", "bias_force", "total force of the bias magnets, B", "N", absent=np.nan),
        Keyword("E_BIAS", lambda c: c.bias_force_error, "standard uncertainty of BIAS", "N"),
        Keyword("METHOD", "method", "estimator", kind="str"),
        Keyword("SCALE", "scale", "what fixes the common scale", kind="str"),
        Keyword("NSHAPES", "shapes_used", "rows used", kind="int"),
        Keyword("NREJECT", "rejected", "rows rejected as outliers", kind="int"),
        Keyword("NINVALID", "invalid", "rows marked as not valid", kind="int"),
        Keyword(
            "CONDITIO", "condition", "condition of E, coordinates in units of RMS", absent=np.nan
        ),
        Keyword("SOLVCOND", "solved_condition", "condition of E as svd solves it", absent=np.nan),
        Keyword("RANK", "rank", "directions held above noise", kind="int"),
        Keyword("NOISE", "noise", "standard deviation of one force reading", "N", absent=np.nan),
        Keyword(
            "DOF", "goodness.degrees_of_freedom", "degrees of freedom", kind="count", absent=None
        ),
        Keyword("CHI2", "chi2", "against FORCERR", absent=np.nan),
        Keyword("FITCHI2", "goodness.chi2", "of the balance against FITNOISE", absent=np.nan),
        Keyword("FITNOISE", "goodness.against", "source of the noise", kind="str", absent=""),
        Keyword("FITPROB", "goodness.probability", "of a larger FITCHI2", absent=np.nan),
        Keyword("ASYM", "matrix_facts.asymmetry", "asymmetry as commanded", absent=np.nan),
        Keyword(
            "ASYMALPH", "matrix_facts.asymmetry_with_alpha", "asymmetry with ALPHA", absent=np.nan
        ),
        Keyword(
            "ASYMGAIN", "matrix_facts.asymmetry_with_gains", "and with sensor gains", absent=np.nan
        ),
        Keyword("UNIQUE", "diagnosis.separation", "second singular value / first", absent=np.nan),
        Keyword("VERDICT", lambda c: str(c.verdict.level), "on this calibration", kind="str"),
    ),
    (
        ACTUATORS,
        TableFormat(
            "LOADS",
            (
                Column("LOAD", "loads.name", kind="str"),
                Column("ADDED", "loads.added", "N"),
                Column("E_ADDED", "loads.added_error", "N"),
                Column("TILT", "loads.tilt", "deg"),
                Column("MY", "torque_y", "N m"),
                Column("E_MY", lambda c: c.torque_errors[:, 0], "N m"),
                Column("MX", "torque_x", "N m"),
                Column("E_MX", lambda c: c.torque_errors[:, 1], "N m"),
                Column("TOOL", "loads.tool", kind="str", absent=None),
            ),
        ),
        ImageFormat("COVARIANCE", "covariance"),
        ImageFormat("SYSTEMATIC", "systematic_covariance"),
        SOURCES,
        _optional(
            "REJECTED",
            "rejected_rows",
            Column("CYCLE", "cycle", kind="int"),
            Column("ROW", "row", kind="int"),
            Column("ACTUATOR", "actuator", kind="int"),
            Column("SIGMAS", "sigmas"),
            Column("AGAINST", "against", kind="str"),
        ),
        _optional(
            "EFFECTS",
            "effects",
            Column("CODE", "code", kind="str"),
            Column("LEVEL", "level", kind="str"),
            Column("EFFECT", "name", kind="str"),
            Column("DETAIL", "detail", kind="str"),
            Column("PLACE", "where", kind="str"),
            Column("ACTUATORS", "ids", kind="str"),
            Column("PROBABILITY", "probability"),
            Column("SIZE", "size"),
            Column("UNIT", "unit", kind="str"),
            Column("CORRECTED", "corrected", kind="bool"),
            Column("REMEDY", "remedy", kind="str"),
        ),
        _optional(
            "WARNINGS",
            "diagnosis.warnings",
            Column("CODE", "code", kind="str"),
            Column("LEVEL", "level", kind="str"),
            Column("FAULT", "fault", kind="str"),
            Column("REMEDY", "remedy", kind="str"),
            Column("VALUES", "stored", kind="str"),
        ),
        _optional(
            "BUDGET",
            "scale_errors",
            Column("KIND", "source.kind.name", kind="str"),
            Column("NAME", "source.name", kind="str", absent=""),
            Column("RELATIVE", "relative", finite=True),
        ),
        _optional(
            "UNSEEN",
            "unseen",
            Column("WHAT", "name", kind="str"),
            Column("RELATIVE", "relative", finite=True),
        ),
        _optional(
            "IMBALANCE",
            "imbalances",
            Column("MODES", "modes", kind="str"),
            Column("BEFORE", "before"),
            Column("AFTER", "after"),
        ),
        _optional(
            "SENSORS",
            "sensors",
            Column("ID", "actuator", kind="int"),
            Column("GAIN", "gain"),
            Column("E_GAIN", "gain_error"),
            Column("DX", "x", "m"),
            Column("E_DX", "x_error", "m"),
            Column("DY", "y", "m"),
            Column("E_DY", "y_error", "m"),
            Column("STATE", "state", kind="str"),
        ),
    ),
)
