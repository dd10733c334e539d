"""Each constant that decides about data: a case just below, and a case just above."""

import datetime
from dataclasses import make_dataclass
from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.balanced import START
from helpers.thresholds import between, outcome
from truenewton.tracking import fit
from truenewton.tracking.days import _by_temperature
from truenewton.tracking.fit import _limits_of, _refuse_other_units, _settings
from truenewton.tracking.lines import Scatter
from truenewton.tracking.population import populations_from

N = 20


def day(temperature, years=0.0):
    calibration = SimpleNamespace(
        temperature=temperature, alpha=np.ones(5), statistical_error=np.zeros(5),
        loads=(), weight=-1.0, weight_error=0.0,
    )  # fmt: skip
    date = START + datetime.timedelta(days=365.25 * years)
    return SimpleNamespace(name="day", date=date, calibration=calibration)


def effects(warmer):
    """Which effects two days of one year apart determine."""
    return _settings([day(20.0), day(20.0 + warmer, 1.0)])[1]


def effects_of_mixed(share):
    """The part of the squares of time that is independent of temperature is ``share``."""
    time = np.array([-1.0, 1.0, 1.0, -1.0])
    across = np.array([-1.0, -1.0, 1.0, 1.0])
    away = np.sqrt(1.0 - share) * time + np.sqrt(share) * across
    days = [day(20.0 + 5.0 * w, t) for w, t in zip(away, time, strict=True)]
    days.sort(key=lambda day: day.date)
    return _settings(days)[1]


def alpha_of_another_day(change):
    """Alpha of two of three actuators changed, up and down, relative to the middle one."""
    other = day(20.0, 1.0)
    other.calibration.alpha = np.array([1 - change, 1 - change, 1.0, 1 + change, 1 + change])
    return outcome(lambda: _refuse_other_units([day(20.0), other], np.ones(5, dtype=bool)))


def parts_by_temperature(warmer):
    cycles = tuple(
        SimpleNamespace(temperature=np.full(2, t), valid=np.ones(2, dtype=bool))
        for t in (20.0, 20.0 + warmer)
    )
    return len(_by_temperature(make_dataclass("Campaign", ["cycles"])(cycles)))


def limits_of_scatter(degrees):
    days = [day(20.0), day(30.0)]
    return len(list(_limits_of(days, np.ones(5, dtype=bool), Scatter(degrees=degrees), 1)))


def outliers(*chances):
    """How many outliers are named if the chances of the farthest of 20 actuators are these."""
    given = iter([*chances, *[1.0] * 20])
    found = SimpleNamespace(effects=np.zeros((1, N)), actuator_degrees=0)
    with (
        mock.patch.object(fit, "_effects_of", return_value=(None, None, None)),
        mock.patch.object(fit, "fit_population"),
        mock.patch.object(fit, "most_outlying", side_effect=lambda *_: (0, 9.0, next(given))),
    ):
        return len(fit._outliers(found, ("drift",), np.arange(N), [])[0])


def masked_by(count):
    return outliers(*[1.0] * (count - 1), 1e-12)


def more_outliers_than(count):
    return outliers(*[1e-12] * N) > count


def interval_reaches_less_than(sigmas):
    """95 % of a mean with many degrees of freedom: 1.96 errors."""
    found = SimpleNamespace(
        variance=np.array([1.0]), variance_covariance=np.array([[2e-6]]),
        mean=np.array([0.0]), mean_covariance=np.array([[1.0]]),
    )  # fmt: skip
    (drift,) = populations_from(("drift",), found, np.array([1_000_001]))
    return drift.mean_interval[1] < sigmas


BOTH = ("temperature", "drift")
CASES = [
    ("SAME_TEMPERATURE", effects, 0.99, ("drift",), 1.01, ("temperature",)),
    ("SAME_TEMPERATURE of cycles", parts_by_temperature, 0.99, 1, 1.01, 2),
    ("OTHER_UNIT", alpha_of_another_day, 0.029, "accepted", 0.031, "refused"),
    ("MIN_INDEPENDENT_FRACTION", effects_of_mixed, 0.009, ("temperature",), 0.011, BOTH),
    ("MAX_MASKING", masked_by, 2, 2, 3, 0),
    ("MAX_OUTLIER_FRACTION", more_outliers_than, 4, True, 5, False),
    ("MIN_SCATTER_DEGREES", limits_of_scatter, 2, 1, 3, 0),
    ("TAIL", interval_reaches_less_than, 1.95, False, 1.97, True),
]

test_a_threshold_is_between = between(CASES)
