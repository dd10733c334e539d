"""What tracking finds: alpha at any temperature and time."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truenewton.arrays import Array, freeze
from truenewton.calibration.result import LARGEST_ALPHA
from truenewton.chance import chi2_sf
from truenewton.errors import FormatError, RankDeficient
from truenewton.estimation.findings.code import Level
from truenewton.files.fits import write_fits
from truenewton.files.format import quantities
from truenewton.quantities import taking_units
from truenewton.rounding import html_table
from truenewton.statics.layout import Layout
from truenewton.tracking.days import SAME_TEMPERATURE, YEAR
from truenewton.tracking.family import Family
from truenewton.tracking.scatter import expanded

if TYPE_CHECKING:
    from astropy.table import QTable


SAME_TIME = datetime.timedelta(days=1)


@dataclass(frozen=True, eq=False)
class DayRecord:
    """One calibration that was tracked.

    Attributes
    ----------
    name, date, temperature
        Its file, the middle of its data (UTC), their mean temperature [deg C].
    alpha, error
        (n,) and E_STAT.
    verdict
        Its level; 'limited', 'not to be used' or '' in older files.
    """

    name: str
    date: datetime.datetime
    temperature: float
    alpha: Array
    error: Array
    verdict: str = ""

    @property
    def rejected(self) -> bool:
        """Whether its calibration was rejected, in the words of this or an earlier version."""
        return bool(self.verdict) and Level.read(self.verdict) <= Level.REJECTED


@dataclass(frozen=True)
class Outlier:
    """An actuator that does not belong to the population of the others.

    Attributes
    ----------
    actuator
        ID.
    effect
        'temperature' or 'drift', its coefficient; 'line', its days lie on no line; 'moved', it no
        longer agrees with its earlier calibration.
    sigmas
        How far, in standard deviations; for 'line' the root of chi2.
    probability
        That chance alone makes any actuator of the whole mirror stand out as far.
    """

    actuator: int
    effect: str
    sigmas: float
    probability: float


@dataclass(frozen=True, eq=False)
class AlphaPrediction:
    """Alpha at one temperature and time.

    Attributes
    ----------
    alpha, error
        (n,) and its standard uncertainty, everything included: the scatter from day to day, too.
    covariance, systematic_covariance
        (n, n) of alpha, and the part from the weights.
    """

    alpha: Array
    error: Array
    covariance: Array
    systematic_covariance: Array


@dataclass(frozen=True, eq=False, repr=False)
class Tracking:
    """alpha_i(T, t) = alpha_i (1 + k_i (T - T0)) + d_i (t - t0).

    Arrays over actuators are in the order of ``layout``, NaN where an actuator is not enabled in
    every calibration. An effect that the days cannot tell is 0, without error: ``limits`` says so.

    Attributes
    ----------
    instrument, layout
        The mirror.
    temperature, date
        T0 [deg C], NaN where no day has one; t0 (UTC): the middle of the days.
    alpha, coefficient, drift
        (n,) at T0 and t0; k [1/K]; d [1/yr], years of 365.25 days.
    covariance, systematic_covariance
        (3 n, 3 n) of alpha, k, d; all, and the part from the weights.
    effects
        Which of 'temperature' and 'drift' the days determine.
    families
        The population of each of these.
    outliers
        Actuators that do not belong to it, the surest first.
    chi2, degrees_of_freedom
        Of the days about the lines of the actuators.
    limits
        What cannot be said, in words.
    days
        The calibrations, in the order of time.
    scatter
        (n,) by how much alpha of an actuator scatters from day to day by itself, relative, beyond
        the readings (see `scatter`); one and the same but for those that lie on no line.
    common_scatter, scatter_degrees
        The same of all actuators together, and its degrees of freedom; 0 where there are no more
        days than unknowns, and nothing is known of either.

    Examples
    --------
    >>> tracking = tn.track(calibration, warm)
    >>> tracking.effects
    ('temperature',)
    >>> tracking.alpha_at(temperature=25.0).alpha.shape
    (45,)
    """

    instrument: str
    layout: Layout
    temperature: float
    date: datetime.datetime
    alpha: Array
    coefficient: Array
    drift: Array
    covariance: Array
    systematic_covariance: Array
    effects: tuple[str, ...]
    families: tuple[Family, ...]
    outliers: tuple[Outlier, ...]
    chi2: float
    degrees_of_freedom: int
    limits: tuple[str, ...]
    days: tuple[DayRecord, ...]
    scatter: Array
    common_scatter: float = 0.0
    scatter_degrees: int = 0

    def __post_init__(self) -> None:
        freeze(self, "alpha", "coefficient", "drift", "covariance", "systematic_covariance",
               "scatter")  # fmt: skip
        on = self.layout.enabled & np.isfinite(self.alpha)
        alpha = np.abs(self.alpha[on])
        if not (on.any() and alpha.min() > 1 / LARGEST_ALPHA and alpha.max() < LARGEST_ALPHA):
            raise FormatError("ALPHA holds no usable numbers", remedy="track again")
        for name, values in (("K", self.coefficient), ("DRIFT", self.drift),
                             ("SCATTER", self.scatter)):  # fmt: skip
            if not (np.abs(values[on]) < LARGEST_ALPHA).all():
                raise FormatError(f"{name} holds no usable numbers", remedy="track again")
        if (self.scatter[on] < 0).any() or self.common_scatter < 0 or self.scatter_degrees < 0:
            raise FormatError("SCATTER is negative", remedy="track again")
        if not set(self.effects) <= {"temperature", "drift"}:
            raise FormatError(
                f"EFFECT is {', '.join(self.effects)}", remedy="it is 'temperature' or 'drift'"
            )
        degrees = [self.temperature, *(day.temperature for day in self.days)]
        if "temperature" in self.effects and not np.isfinite(degrees).all():
            raise FormatError("TEMPERAT is missing, or a TEMPERATURE of DAYS", remedy="track again")

    def __repr__(self) -> str:
        return (
            f"<Tracking of {self.instrument}: {len(self.days)} calibrations,"
            f" {' and '.join(self.effects)}>"
        )

    def _repr_html_(self) -> str:
        from truenewton.tracking.summary import headline, remarks, summary_rows

        return html_table(headline(self), summary_rows(self), remarks(self))

    @property
    def span(self) -> tuple[float, float] | None:
        """Coldest and warmest of the days [deg C]; None where they do not tell temperature."""
        degrees = [day.temperature for day in self.days]
        return (min(degrees), max(degrees)) if "temperature" in self.effects else None

    @property
    def probability(self) -> float:
        """Chance of a larger chi2; NaN without degrees of freedom."""
        degrees = self.degrees_of_freedom
        return float(chi2_sf(self.chi2, degrees)) if degrees else float("nan")

    @property
    def errors(self) -> Array:
        """(3, n) standard uncertainties of alpha, k and d."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(3, -1))

    @property
    def table(self) -> QTable:
        """One row per actuator: alpha at T0 and t0, k and d with their errors and units."""
        from truenewton.tracking.file import ACTUATORS

        return quantities(self, ACTUATORS, without=("X", "Y", "NZ"))

    @taking_units(temperature="deg_C")
    def alpha_at(
        self, temperature: float | None = None, time: datetime.datetime | None = None
    ) -> AlphaPrediction:
        """Return alpha on a day, at a temperature and a time, with its uncertainty.

        Parameters
        ----------
        temperature
            [deg C]; T0 unless given.
        time
            UTC; t0 unless given.

        Raises
        ------
        RankDeficient
            What is asked for lies where the days say nothing.
        """
        away = 0.0 if temperature is None else float(temperature) - self.temperature
        if "temperature" not in self.effects and not abs(away) <= SAME_TEMPERATURE:
            raise RankDeficient(
                f"alpha at {temperature:g} deg C is not known: the days do not tell how it varies"
                " with temperature",
                remedy="add a calibration at another temperature",
            )
        time = self.date if time is None else time
        time = time if time.tzinfo else time.replace(tzinfo=datetime.UTC)
        first, last = self.days[0].date - SAME_TIME, self.days[-1].date + SAME_TIME
        if "drift" not in self.effects and not first <= time <= last:
            raise RankDeficient(
                f"alpha on {time:%Y-%m-%d} is not known: the days do not tell how it drifts",
                remedy="add a calibration of another time",
            )
        years, n = (time - self.date) / YEAR, self.layout.n
        j = np.stack([1 + self.coefficient * away, self.alpha * away, np.full(n, years)])
        covariance, systematic_covariance = (
            np.einsum("ai,aibj,bj->ij", j, matrix.reshape(3, n, 3, n), j)
            for matrix in (self.covariance, self.systematic_covariance)
        )
        alpha = self.alpha * (1 + self.coefficient * away) + self.drift * years
        common = alpha * expanded(self.common_scatter, self.scatter_degrees)
        covariance += np.diag((self.scatter * alpha) ** 2) + np.outer(common, common)
        return AlphaPrediction(
            alpha, np.sqrt(np.diag(covariance)), covariance, systematic_covariance
        )

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the tracking file (docs/files.md).

        Raises
        ------
        OutputExists, OutputFailed
        """
        from truenewton.tracking.file import TRACKING

        write_fits(path, TRACKING, self, overwrite=overwrite)
