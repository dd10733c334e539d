"""The result of tracking: alpha at any temperature and time, its file, and how long it is valid."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truenewton.arrays import Array, freeze
from truenewton.calibration.file import MAX_NUMBER
from truenewton.calibration.result import LARGEST_ALPHA
from truenewton.chance import chi2_sf
from truenewton.errors import FormatError, RankDeficient
from truenewton.estimation.findings.code import Level
from truenewton.files.content import FitsFile
from truenewton.files.fits import read_fits
from truenewton.files.format import (
    Column,
    FileFormat,
    ImageFormat,
    Keyword,
    TableFormat,
    quantities,
)
from truenewton.quantities import taking_units
from truenewton.records.file import ID, INSTRUMENT, NUMBER, NZ, X, Y
from truenewton.records.result import FORMATS, Result
from truenewton.statics.layout import Layout
from truenewton.tracking.days import SAME_TEMPERATURE, YEAR
from truenewton.tracking.lines import expanded
from truenewton.tracking.population import Population

if TYPE_CHECKING:
    from astropy.table import QTable


SAME_TIME = datetime.timedelta(days=1)  # within which alpha does not drift


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
        """Whether the verdict is 'rejected', or its name in an earlier version."""
        return bool(self.verdict) and Level(self.verdict) <= Level.REJECTED


@dataclass(frozen=True)
class Outlier:
    """An actuator that does not belong to the population of the others.

    Attributes
    ----------
    actuator
        ID.
    effect
        'temperature' or 'drift': its coefficient; 'line': its days do not lie on a line; 'moved':
        it disagrees with its earlier calibration.
    sigmas
        Deviation in standard deviations; for 'line' the root of chi2.
    probability
        That by chance any actuator of the mirror deviates as much.
    """

    actuator: int
    effect: str
    sigmas: float
    probability: float


def probability_of(chi2: float, degrees: int) -> float:
    """Return the probability of a larger chi2; NaN without degrees of freedom."""
    return float(chi2_sf(chi2, degrees)) if degrees else float("nan")


@dataclass(frozen=True, eq=False)
class AlphaPrediction:
    """Alpha at one temperature and time.

    Attributes
    ----------
    alpha, error
        (n,) and its standard uncertainty, scatter from day to day included.
    covariance, systematic_covariance
        (n, n) of alpha, and the part from the weights.
    """

    alpha: Array
    error: Array
    covariance: Array
    systematic_covariance: Array


@dataclass(frozen=True, eq=False, repr=False)
class Tracking(Result):
    """alpha_i(T, t) = alpha_i (1 + k_i (T - T0)) + d_i (t - t0).

    Arrays over actuators are in the order of ``layout``, NaN for an actuator that is not enabled in
    every calibration. An effect that the days do not determine is 0 without error, see ``limits``.

    Attributes
    ----------
    instrument, layout
        The mirror.
    temperature, date
        T0 [deg C], NaN if no day has one; t0 (UTC): the middle of the days.
    alpha, coefficient, drift
        (n,) at T0 and t0; k [1/K]; d [1/yr], years of 365.25 days.
    covariance, systematic_covariance
        (3 n, 3 n) of alpha, k, d: total, and the part from the weights.
    effects
        Which of 'temperature' and 'drift' the days determine.
    populations
        The population of each of these.
    outliers
        Actuators that do not belong to it, the most significant first.
    chi2, degrees_of_freedom
        Of the days about the lines of the actuators.
    limits
        Limitations, in sentences.
    days
        The calibrations, in order of time.
    scatter
        (n,) relative scatter of each actuator from day to day, beyond the readings; the same for
        all that are no outliers.
    common_scatter, scatter_degrees
        Scatter of all actuators together, and its degrees of freedom; 0 if there are no more days
        than unknowns, so that neither scatter is known.

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
    populations: tuple[Population, ...]
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
            raise FormatError("ALPHA contains no usable numbers", remedy="track again")
        for name, values in (("K", self.coefficient), ("DRIFT", self.drift),
                             ("SCATTER", self.scatter)):  # fmt: skip
            if not (np.abs(values[on]) < LARGEST_ALPHA).all():
                raise FormatError(f"{name} contains no usable numbers", remedy="track again")
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

    @property
    def span(self) -> tuple[float, float] | None:
        """Lowest and highest temperature of the days [deg C]; None if its effect is not known."""
        degrees = [day.temperature for day in self.days]
        return (min(degrees), max(degrees)) if "temperature" in self.effects else None

    @property
    def probability(self) -> float:
        """Probability of a larger chi2; NaN without degrees of freedom."""
        return probability_of(self.chi2, self.degrees_of_freedom)

    @property
    def common_expanded(self) -> float:
        """Scatter of all together, enlarged for its degrees of freedom."""
        return expanded(self.common_scatter, self.scatter_degrees)

    @property
    def errors(self) -> Array:
        """(3, n) standard uncertainties of alpha, k and d."""
        return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(3, -1))

    @property
    def table(self) -> QTable:
        """One row per actuator: alpha at T0 and t0, k and d with their errors and units."""
        return quantities(self, ACTUATORS, without=("X", "Y", "NZ"))

    @taking_units(temperature="deg_C")
    def alpha_at(
        self, temperature: float | None = None, time: datetime.datetime | None = None
    ) -> AlphaPrediction:
        """Return alpha at a temperature and a time, with its uncertainty.

        Parameters
        ----------
        temperature
            [deg C]; T0 by default.
        time
            UTC; t0 by default.

        Raises
        ------
        RankDeficient
            The days do not determine the effect of this temperature or time.
        """
        away = 0.0 if temperature is None else float(temperature) - self.temperature
        if "temperature" not in self.effects and not abs(away) <= SAME_TEMPERATURE:
            raise RankDeficient(
                f"alpha at {temperature:g} deg C is not known: the days do not determine how it"
                " varies with temperature",
                remedy="add a calibration at another temperature",
            )
        time = self.date if time is None else time
        time = time if time.tzinfo else time.replace(tzinfo=datetime.UTC)
        first, last = self.days[0].date - SAME_TIME, self.days[-1].date + SAME_TIME
        if "drift" not in self.effects and not first <= time <= last:
            raise RankDeficient(
                f"alpha on {time:%Y-%m-%d} is not known: the days do not determine its drift",
                remedy="add a calibration of another time",
            )
        years, n = (time - self.date) / YEAR, self.layout.n
        j = np.stack([1 + self.coefficient * away, self.alpha * away, np.full(n, years)])
        covariance, systematic_covariance = (
            np.einsum("ai,aibj,bj->ij", j, matrix.reshape(3, n, 3, n), j)
            for matrix in (self.covariance, self.systematic_covariance)
        )
        alpha = self.alpha * (1 + self.coefficient * away) + self.drift * years
        common = alpha * self.common_expanded
        covariance += np.diag((self.scatter * alpha) ** 2) + np.outer(common, common)
        return AlphaPrediction(
            alpha, np.sqrt(np.diag(covariance)), covariance, systematic_covariance
        )


# -- its file -------------------------------------------------------------------------------------

UNITS = {"temperature": "1/K", "drift": "1/yr"}

ACTUATORS = TableFormat(
    "TRACKING",
    (
        ID,
        X,
        Y,
        NUMBER,
        NZ,
        Column("ALPHA", "alpha"),
        Column("E_ALPHA", lambda t: t.errors[0]),
        Column("K", "coefficient", "1/K"),
        Column("E_K", lambda t: t.errors[1], "1/K"),
        Column("DRIFT", "drift", "1/yr"),
        Column("E_DRIFT", lambda t: t.errors[2], "1/yr"),
        Column("SCATTER", "scatter", absent=0.0),
    ),
)
FAMILIES = TableFormat(
    "FAMILIES",
    (
        Column("EFFECT", "effect", kind="str", width=11),
        Column("UNIT", lambda population: UNITS[population.effect], kind="str", width=4),
        Column("MEAN", "mean"),
        Column("E_MEAN", "mean_error"),
        Column("MEAN_LO", "mean_interval.0"),
        Column("MEAN_HI", "mean_interval.1"),
        Column("SPREAD", "spread"),
        Column("SPREAD_LO", "spread_interval.0"),
        Column("SPREAD_HI", "spread_interval.1"),
        Column("MEMBERS", "members", kind="int"),
    ),
    of="populations",
)
DEPARTURES = TableFormat(
    "DEPARTURES",
    (
        Column("ID", "actuator", kind="int"),
        Column("EFFECT", "effect", kind="str", width=11),
        Column("SIGMAS", "sigmas"),
        Column("CHANCE", "probability"),
    ),
    of="outliers",
)
DAYS = TableFormat(
    "DAYS",
    (
        Column("FILE", "name", kind="str"),
        Column("DATE", "date", kind="date", width=26),
        Column("TEMPERATURE", "temperature", "deg_C"),
        Column("ALPHA", "alpha", each="TRACKING"),
        Column("E_STAT", "error", each="TRACKING"),
        Column("VERDICT", "verdict", kind="str", absent=""),
    ),
    of="days",
)
TRACKING = FileFormat(
    (
        INSTRUMENT,
        Keyword(
            "DATE-OBS", lambda t: t.days[0].date, "UTC, middle of the first day's data", kind="date"
        ),
        Keyword(
            "DATE-END", lambda t: t.days[-1].date, "UTC, middle of the last day's data", kind="date"
        ),
        Keyword("DATE-REF", "date", "UTC, t0: ALPHA holds here", kind="date"),
        Keyword("TEMPERAT", "temperature", "T0: ALPHA holds here", "deg_C", absent=np.nan),
        Keyword("CHI2", "chi2", "of the days about the lines"),
        Keyword("DOF", "degrees_of_freedom", "degrees of freedom", kind="int"),
        Keyword("SCATTER", "common_scatter", "from day to day, of all in common", absent=0.0),
        Keyword("SCATDOF", "scatter_degrees", "its degrees of freedom", kind="int", absent=0),
    ),
    (
        ACTUATORS,
        ImageFormat("COVARIANCE", "covariance"),
        ImageFormat("SYSTEMATIC", "systematic_covariance"),
        FAMILIES,
        DEPARTURES,
        DAYS,
        TableFormat("LIMITS", (Column("TEXT", "limits", kind="str"),)),
    ),
)


def read_tracking(path: str | os.PathLike[str]) -> Tracking:
    """Read a tracking file.

    Parameters
    ----------
    path
        As `Tracking.write` wrote it.

    Raises
    ------
    UnreadableFile, FormatError

    Examples
    --------
    >>> tn.track(calibration, warm).write("track.fits")
    >>> tn.read_tracking("track.fits")
    <Tracking of P45: 2 calibrations, temperature>
    """
    return tracking_from(read_fits(path))


def tracking_from(file: FitsFile) -> Tracking:
    """Return the law of an open tracking file."""
    values = file.values(TRACKING, MAX_NUMBER)
    alpha = values["alpha"]
    file.require_covariances(3 * alpha.size, "ALPHA, K and DRIFT", "track again")
    if not values["days"]["name"]:
        raise FormatError("DAYS is empty", remedy="track again", path=file.path)
    values["layout"]["enabled"] = file.enabled(alpha, "track again")
    values["effects"] = values["populations"]["effect"]
    return file.filled(Tracking, values)


FORMATS[Tracking] = TRACKING


# -- when to calibrate again ----------------------------------------------------------------------


@dataclass(frozen=True)
class Validity:
    """How long alpha is valid for a wanted accuracy.

    Errors of the weights are not included: the same weights would repeat them. Nothing is
    extrapolated: temperatures are limited to those of the days, times to one duration of the days
    after the last.

    Attributes
    ----------
    accuracy
        Wanted: standard uncertainty relative to alpha, rms over actuators.
    now
        Accuracy of the latest calibration.
    temperatures, until
        Temperatures [deg C] between which, and the date (UTC) until which, the latest calibration
        is valid without correction; None if the effect is not known.
    law_temperatures, law_until
        The same for `Tracking.alpha_at`, which corrects for temperature and time.
    reach, reach_until
        The limits of extrapolation; None if the effect is not known.

    Examples
    --------
    >>> validity = tn.validity_of(tn.track(calibration, warm), accuracy=0.005)
    >>> validity.until is None  # one day does not determine the drift
    True
    """

    accuracy: float
    now: float
    temperatures: tuple[float, float] | None
    until: datetime.datetime | None
    law_temperatures: tuple[float, float] | None
    law_until: datetime.datetime | None
    reach: tuple[float, float] | None
    reach_until: datetime.datetime | None


def validity_of(tracking: Tracking, accuracy: float) -> Validity:
    """Return how far from its temperature and date the latest calibration is valid.

    Without correction it is off by k (T - T_last) + d (t - t_last), its E_STAT, and the scatter of
    two days; the mean square over actuators is a parabola in T - T_last and in t - t_last. The
    uncertainty of the law, with the scatter of one day, is a parabola in T - T0 and t - t0.

    Parameters
    ----------
    tracking
        The law.
    accuracy
        Wanted: standard uncertainty relative to alpha, rms over actuators.

    Examples
    --------
    >>> validity = tn.validity_of(tn.track(calibration, warm), accuracy=0.005)
    >>> "from {:.0f} to {:.0f} deg C".format(*validity.temperatures or ())
    'from 25 to 30 deg C'
    """
    t, last = tracking, tracking.days[-1]
    day_variance = float(np.nanmean(t.scatter**2)) + t.common_expanded**2
    on, form = np.isfinite(t.alpha), _law_variance(t, day_variance)
    now = float(np.mean((last.error[on] / last.alpha[on]) ** 2)) + 2 * day_variance
    k = float(np.mean(t.coefficient[on] ** 2) + form[1, 1])
    d = float(np.mean((t.drift[on] / t.alpha[on]) ** 2) + form[2, 2])
    spare = max(accuracy**2 - now, 0.0)
    warm, late = "temperature" in t.effects, "drift" in t.effects
    reach = float(np.sqrt(spare / k)) if k > 0 else np.inf if spare else 0.0
    away = last.temperature - t.temperature if warm else 0.0
    years = (last.date - t.date) / YEAR if late else 0.0
    span = _roots(form, accuracy**2, 1, years) if warm else None
    end = _roots(form, accuracy**2, 2, away) if late else None
    coldest, warmest = t.span or (0.0, 0.0)
    latest = last.date + (last.date - t.days[0].date)

    def within(low: float, high: float) -> tuple[float, float] | None:
        span = max(low, coldest), min(high, warmest)
        return span if span[0] <= span[1] else None

    def by(start: datetime.datetime, away: float) -> datetime.datetime:
        return latest if away >= (latest - start) / YEAR else start + away * YEAR

    return Validity(
        accuracy=accuracy,
        now=float(np.sqrt(now)),
        temperatures=within(last.temperature - reach, last.temperature + reach) if warm else None,
        until=by(last.date, float(np.sqrt(spare / d)) if d > 0 else np.inf) if late else None,
        law_temperatures=within(t.temperature + span[0], t.temperature + span[1]) if span else None,
        law_until=by(t.date, end[1]) if end else None,
        reach=t.span,
        reach_until=latest if late else None,
    )


def _law_variance(tracking: Tracking, day_variance: float) -> Array:
    """Return (3, 3) the mean relative variance of `alpha_at` as a form in (1, T - T0, t - t0).

    It includes the readings and the (scalar) scatter of a day; k multiplies alpha, d does not.
    """
    on, n = np.isfinite(tracking.alpha), tracking.layout.n
    alpha = tracking.alpha[on]
    scale = np.array([1 / alpha, np.ones_like(alpha), 1 / alpha])
    blocks = (tracking.covariance - tracking.systematic_covariance).reshape(3, n, 3, n)
    own = np.einsum("aibi->abi", blocks)[:, :, on]
    form = np.asarray(np.mean(own * scale[:, None] * scale[None], axis=2))
    form[0, 0] += day_variance
    return form


def _roots(form: Array, limit: float, axis: int, other: float) -> tuple[float, float] | None:
    """Return where the form equals the limit along one axis; None if it is always above."""
    at = np.array([1.0, 0.0, 0.0])
    at[3 - axis] = other
    a, b, c = form[axis, axis], form[axis] @ at, at @ form @ at - limit
    if a <= 0.0 or b * b - a * c < 0.0:
        return None
    root = np.sqrt(b * b - a * c)
    return float((-b - root) / a), float((-b + root) / a)
