"""Each constant that decides about a campaign: a case just below, and a case just above."""

import datetime
from types import SimpleNamespace
from unittest import mock

import numpy as np
import scipy.stats

from helpers.balanced import START
from helpers.thresholds import between
from truenewton.chance import FALSE_ALARM
from truenewton.estimation import checks
from truenewton.estimation.findings import estimate
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import NoiseSource
from truenewton.estimation.findings.finding import about_actuators
from truenewton.estimation.likelihood import smooth_patterns
from truenewton.estimation.paper import svd
from truenewton.estimation.paper.identifiability import similar_loads, unseen_load
from truenewton.estimation.problem import _accidents
from truenewton.estimation.readings.moments import reading_noise
from truenewton.statics.layout import rings

LAYOUT = rings([0.03, 0.06, 0.09, 0.12], [10, 20, 30, 40])
N = LAYOUT.n  # 100
NS = SimpleNamespace


def codes(findings):
    return [finding.code for finding in findings]


# -- alpha and readings of single actuators ------------------------------------------------------


def strange(alpha, error, count=1):
    """Some alphas of 100 and their errors; the others are 1."""
    some = np.arange(N) < count
    campaign = NS(layout=LAYOUT)
    errors = np.where(some, error, 1e-3)
    return codes(checks.strange_alphas(campaign, np.where(some, alpha, 1.0), errors))


def constant(change, noise):
    """The reading of one actuator changes by less than those of others, over 10,000 shapes."""
    sign = np.where(np.arange(10_000) % 2, 1.0, -1.0)[:, None]
    mean = 1.0 + sign * np.append(change, np.ones(N - 1))
    moments = NS(
        weight=np.ones(len(mean)), mean=mean, of_load=np.ones((len(mean), 1)), groups=len(mean),
        labels=np.zeros((len(mean), 3), dtype=int), repeats=10**9,
    )  # fmt: skip
    return codes(checks.constant_actuators(NS(layout=LAYOUT), moments, noise))


def unlike_others(change):
    return constant(change, NS(source=NoiseSource.MINIMUM))


def against_noise(ratio):
    """One reading is noise; the others vary by a multiple of what noise alone reaches."""
    limit = scipy.stats.f.isf(FALSE_ALARM / N, 9_999, 10**9)
    variance = 1.0 / (ratio * limit)
    noise = NS(source=NoiseSource.REPEATS, variance=np.full(N, variance))
    return constant(np.sqrt(0.5 * variance), noise)


# -- order of FORCE and POSITION -----------------------------------------------------------------


def reordered(before, after, gain, moved=8):
    """Asymmetries and mean gain of the elements in a better order."""
    order = np.arange(N)
    order[:moved] = np.roll(order[:moved], 1)
    stiffness = np.eye(N)
    stiffness[np.arange(moved), order[:moved]] = gain
    with (
        mock.patch.object(checks, "stiffness_of_shapes", return_value=stiffness),
        mock.patch.object(checks, "likeliest_order", return_value=order),
        mock.patch.object(checks, "asymmetry", side_effect=[before, after]),
    ):
        return codes(checks.misordered_columns(NS(layout=LAYOUT), None))


# -- files, temperature, weight and noise --------------------------------------------------------


def files_apart(days=0.0, temperature=20.0):
    cycles = [
        NS(
            date=START + datetime.timedelta(days=k * days), name=f"file {k}",
            temperature=np.full(2, temperature), valid=np.ones(2, dtype=bool),
        )
        for k in range(2)
    ]  # fmt: skip
    return codes(checks._cycle_warnings(type("Files", (list,), {"cycles": cycles})()))


def bias(weights):
    """Force of the bias magnets; each actuator holds its share of the weight."""
    campaign = NS(weight=-3.0)
    problem = NS(campaign=campaign, n=N, unknowns=NS(bias=N))
    minimum = NS(values=np.append(np.ones(N), weights * 3.0))
    moments = NS(mean=np.ones((4, N)))
    return codes(checks._weight_warnings(problem, moments, minimum))


def louder(ratio):
    """Scatter of the repeats in units of the declared noise."""
    noise = NS(source=NoiseSource.REPEATS, seen=np.full(N, ratio**2 * 1e-6))
    campaign = NS(loads=(0, 1), cycles=[NS(force_error=1e-3)])
    problem = NS(campaign=campaign, noise=noise, n=N, unknowns=NS(weights=slice(N, N)))
    moments = NS(rounding=np.zeros(N), noise=1e-3, reference=np.zeros(N))
    with (
        mock.patch.object(checks, "_cycle_warnings", return_value=()),
        mock.patch.object(checks, "_weight_warnings", return_value=()),
        mock.patch.object(checks, "_rounding_warnings", return_value=()),
    ):
        return codes(checks.campaign_warnings(problem, moments, NS(values=np.ones(N))))


# -- loads, accidents, noise ---------------------------------------------------------------------


def difference_seen(share):
    """Forces differ by a share of the difference of the loads, 1 N."""
    moments = NS(of_load=np.eye(2), weight=np.ones(2), mean=np.array([[0.0], [share]]))
    return unseen_load(np.ones(1), np.array([-2.0, -3.0]), moments) is None


def bias_of_svd(ratio):
    """Bias relative to the scatter of alpha."""
    campaign = NS(layout=NS(enabled=np.ones(N, dtype=bool)))
    with (
        mock.patch.multiple(
            svd, fit=mock.DEFAULT, weight_errors=mock.DEFAULT, weight_changes=mock.DEFAULT,
            diagnose=mock.Mock(return_value=NS(faults=())),
            scatter_covariance=mock.Mock(return_value=np.eye(N)),
            noise_bias=mock.Mock(return_value=np.full(N, ratio)),
        ),
        mock.patch.object(svd, "replace", side_effect=InterruptedError) as found,
    ):  # fmt: skip
        try:
            svd.solve_campaign(campaign, NS(repeats=9, noise=1.0))
        except InterruptedError:
            return codes(found.call_args.kwargs["warnings"])


def similar(share):
    return similar_loads(np.array([-3.0, -3.0 * (1.0 - share)])) is not None


def accidents(count):
    problem = NS(noise=NS(source=NoiseSource.MINIMUM))
    return _accidents(np.arange(100) >= count, None, (problem, None))


def has_noise_of_each(repeats):
    scatter = repeats * np.array([1e-6, 3e-6])
    moments = NS(
        mean=np.ones((4, 2)), squares=np.ones(2), weight=np.ones(4), repeats=repeats,
        scatter=scatter, rounding=np.zeros(2), step=np.zeros(2), rows=np.ones(4), groups=4,
        typical_variance=1.0,
    )  # fmt: skip
    return np.ptp(reading_noise(NS(cycles=()), moments).variance) > 0.0


def patterns(n):
    return smooth_patterns(np.random.default_rng(1).standard_normal((3, n))).shape[1]


def named_one_by_one(count):
    finding = about_actuators(LAYOUT, Code.STUCK_READING, range(count), many="actuators")
    return " of 100" not in finding.where


def temperatures_count(difference):
    campaign = NS(loads=(NS(name="a", coil_shift_error=None),) * 2, effective_weights=-np.ones(2))
    with mock.patch.object(
        estimate, "load_temperatures", return_value=np.array([20.0, 20.0 + difference])
    ):
        return len(estimate.errors_between_loads(campaign, np.array([1.0, 2.0])))


def bias_changes_by(change):
    """Whether B changes by more than a part of itself per degree, of two magnets each."""
    load = NS(name="a", coil_shift_error=None)
    campaign = NS(loads=(load, load), effective_weights=np.array([-2.0, -3.0]))
    with mock.patch.object(estimate, "load_temperatures", return_value=np.array([20.0, 21.0])):
        (changed,) = estimate.errors_between_loads(campaign, np.array([1.0, 2.0])).values()
    return abs(np.ptp(changed)) > 2 * change  # B = 1 N


ORDER, DEAD = [Code.ORDER_OF_POSITION], [Code.DEAD_ALPHA_ZERO]
CASES = [
    ("MAX_ALPHA_SIGMAS", lambda x: strange(x * 0.01, 0.01), 2.9, DEAD, 3.1, []),
    ("WELL_KNOWN_ERROR", lambda x: strange(0.0, x), 0.099, DEAD, 0.101, []),
    ("bad_fraction", lambda k: len(strange(0.0, 0.01, k)), 3, 3, 4, 0),
    ("MIN_RELATIVE_CHANGE", unlike_others, 0.029, [Code.STUCK_READING], 0.031, []),
    ("MIN_VARIANCE_RATIO", against_noise, 99.0, [], 101.0, [Code.STUCK_READING]),
    ("MIN_SHAPE_ASYMMETRY", lambda x: reordered(x, 0.0, 9.0), 0.19, [], 0.21, ORDER),
    ("MAX_REMAINING_ASYMMETRY", lambda x: reordered(1.0, x, 9.0), 0.49, ORDER, 0.51, []),
    ("MIN_LOG_GAIN_OF_ORDER", lambda x: reordered(1.0, 0.0, x), 1.49, [], 1.51, ORDER),
    ("MAX_DAYS_APART", lambda x: files_apart(days=x), 29.9, [], 30.1, [Code.DATES_APART]),
    ("WARM_TEMPERATURE", lambda x: files_apart(temperature=x),
     49.0, [], 51.0, [Code.TEMPERATURE_IMPLAUSIBLE]),
    ("MAX_BIAS_TO_WEIGHT", bias, 2.9, [], 3.1, [Code.WEIGHT_BELOW_BIAS]),
    ("MIN_SCATTER_RATIO", louder, 1.4, [], 1.6, [Code.NOISE_ABOVE_DECLARED]),
    ("WEIGHED_NOISE", louder, 1.4, [], 1.6, [Code.NOISE_ABOVE_DECLARED]),
    ("MAX_UNSEEN_LOAD", difference_seen, 0.09, False, 0.11, True),
    ("svd_bias", bias_of_svd, 0.9, [Code.SVD_BIAS], 1.1, [Code.SVD_BIAS_LARGE]),
    ("SIMILAR_LOADS_FRACTION", similar, 0.009, True, 0.011, False),
    ("MAX_OUTLYING_FRACTION", accidents, 12, True, 13, False),
    ("MIN_REPEATS", has_noise_of_each, 29, False, 30, True),
    ("MIN_SMOOTH_ACTUATORS", patterns, 99, 6, 100, 15),
    ("MAX_NAMED_ACTUATORS", named_one_by_one, 4, True, 5, False),
    ("SAME_TEMPERATURE", temperatures_count, 0.04, 0, 0.06, 1),
    ("MAGNET_COEFFICIENT", bias_changes_by, 1.0e-3, True, 1.2e-3, False),
]  # fmt: skip

test_a_threshold_is_between = between(CASES)
