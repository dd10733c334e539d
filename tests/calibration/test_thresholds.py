"""Each constant of the verdict and of the file: a case just below, and a case just above."""

from types import SimpleNamespace
from unittest import mock

import numpy as np

from helpers.thresholds import between, outcome
from truenewton.calibration import verdict
from truenewton.calibration.file import _refuse_disagreement
from truenewton.calibration.verdict import (
    _of_data,
    _of_result,
    _rejecting,
    _senseless,
    scale_faults,
    unit_fault,
)
from truenewton.estimation.findings.code import Code
from truenewton.estimation.findings.estimate import Scale
from truenewton.statics.layout import rings
from truenewton.statics.load import Load

LAYOUT = rings([0.03, 0.06, 0.09, 0.12], [10, 20, 30, 40])
N = LAYOUT.n  # 100
LOADS = (Load("bare"), Load("ring", -0.5, 0.005, tool="ring"))
SPREAD = 1.0 + 0.01 * np.sin(np.arange(N))


def calibration(**changes):
    """Return what a verdict reads of a sound calibration of 100 actuators, alpha near 1."""
    sound = {
        "layout": LAYOUT, "alpha": SPREAD, "statistical_error": np.full(N, 1e-3),
        "systematic_error": np.full(N, 1.5e-3), "error": np.full(N, 2e-3),
        "loads": LOADS, "weight": -3.0, "weight_error": 0.01, "scale": Scale.WEIGHTS,
        "scale_errors": (), "goodness": None, "imbalances": (), "effects": (), "method": "ml",
        "rejected": 0, "rejected_rows": (), "shapes_used": 100,
        "diagnosis": SimpleNamespace(warnings=()),
    }  # fmt: skip
    return SimpleNamespace(**sound | changes)


def says(code, judge):
    """Return a function of changes that tells whether a code is among what is found."""

    def found(**changes):
        return code in {finding.code for finding in judge(calibration(**changes))}

    return found


def unit(**changes):
    return unit_fault(calibration(**changes)) is not None


senseless_error = says(Code.ERROR_TOO_LARGE, _senseless)
senseless_misfit = says(Code.MISFIT_SENSELESS, _senseless)
negative = says(Code.MANY_NEGATIVE, _rejecting)
held_out = says(Code.HELD_OUT_IMBALANCE, _of_result)
misfit = says(Code.MISFIT, _of_result)
rejected = says(Code.MANY_ROWS_REJECTED, _of_result)
outlier = says(Code.ALPHA_OUTLIER, _of_result)
by_weights = says(Code.SCALE_BY_WEIGHTS, scale_faults)
without_errors = says(Code.WEIGHTS_WITHOUT_ERRORS, scale_faults)


def alpha_with(count, value):
    return np.where(np.arange(N) < count, value, SPREAD)


def goodness(reduced=1.0, probability=0.5):
    return SimpleNamespace(reduced=reduced, probability=probability)


def lines(ratio):
    return SimpleNamespace(before=9.0, after=1.0), SimpleNamespace(before=9.0, after=ratio)


def one_outlier(spreads):
    """Five robust standard deviations of the others, whose median is 1."""
    deviations = np.linspace(-1.0, 1.0, N)  # median |deviation| 0.5
    alpha = 1.0 + 1e-2 * deviations
    robust = 1.4826 * np.median(np.abs(alpha - np.median(alpha)))
    alpha[-1] = np.median(alpha) + spreads * robust
    return outlier(alpha=alpha, statistical_error=np.zeros(N))


def gain_by_load(size):
    """A corrected gain difference, in units of E_ALPHA, about which the verdict is doubtful."""
    effect = SimpleNamespace(corrected=True, code=Code.GAIN_BY_LOAD, size=size * 2e-3)
    with mock.patch.object(verdict, "replace") as graded:
        list(_of_data(calibration(effects=(effect,))))
    return graded.called


def disagreement(relative):
    error = np.full(2, 0.1)
    covariance = np.diag(error**2 * (1.0 + relative))
    values = {
        "alpha": np.ones(2), "statistical_error": error, "systematic_error": np.zeros(2),
        "covariance": covariance, "systematic_covariance": np.zeros((2, 2)),
    }  # fmt: skip
    return outcome(lambda: _refuse_disagreement(SimpleNamespace(path="a.fits"), values))


def names_millinewton(median):
    finding = unit_fault(calibration(alpha=median * 1e-3 * SPREAD, scale=Scale.GIVEN))
    return "in mN" in finding.fault


def counts(value):
    """Alpha of 85 of 100 actuators is 100, of the others another."""
    return unit(alpha=alpha_with(15, value * 100.0) * np.where(np.arange(N) < 15, 1.0, 100.0))


def like_others(count):
    """Alpha of some of 100 actuators is 100, of the others 1."""
    return unit(alpha=np.where(np.arange(N) < count, 100.0, 1.0))


CASES = [
    ("relative_error", lambda x: senseless_error(statistical_error=x * SPREAD),
     0.32, False, 0.35, True),
    ("reduced_chi2", lambda x: senseless_misfit(goodness=goodness(x)), 9e3, False, 1.1e4, True),
    ("bad_fraction", lambda k: negative(alpha=alpha_with(k, -1.0)), 3, False, 4, True),
    ("lowest_alpha", lambda x: unit(alpha=x * SPREAD), 0.49, True, 0.51, False),
    ("highest_alpha", lambda x: unit(alpha=x * SPREAD), 1.98, False, 2.02, True),
    ("held_out_ratio", lambda x: held_out(imbalances=lines(x)), 2.4, False, 2.6, True),
    ("fit_probability", lambda x: misfit(goodness=goodness(2.0, x)), 0.9e-3, True, 1.1e-3, False),
    ("rejected_fraction", lambda k: rejected(rejected=k, shapes_used=100 - k), 10, False, 11, True),
    ("outlier_spreads", one_outlier, 4.9, False, 5.1, True),
    ("scale_share", lambda x: by_weights(systematic_error=x * 1e-3 * np.ones(N)),
     1.9, False, 2.1, True),
    ("load_gain", gain_by_load, 3.9, False, 4.1, True),
    ("NO_ERROR", lambda x: without_errors(systematic_error=x * SPREAD),
     0.9e-6, True, 1.1e-6, False),
    ("VARIANCE_TOLERANCE", disagreement, 0.9e-3, "accepted", 1.1e-3, "refused"),
    ("NEAR_ONE", names_millinewton, 0.59, False, 0.61, True),
    ("MAX_DEVIATION", counts, 0.52, True, 0.48, False),
    ("MIN_LIKE_OTHERS", like_others, 89, False, 90, True),
]  # fmt: skip

test_a_threshold_is_between = between(CASES)
