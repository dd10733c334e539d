"""Chances and limits are those of scipy.stats, which is not imported to have them."""

import numpy as np
import pytest
import scipy.stats

from truenewton import chance

X = np.array([-1.0, 0.0, 1e-8, 0.01, 0.5, 1.0, 3.0, 10.0, 50.0, 300.0, 1e4, np.inf, np.nan])
SMALL = np.array([1e-12, 1e-5, 0.001, 0.01, 0.025, 0.25])
TAILS = np.array([1e-30, *SMALL, 0.5, 0.75, 0.975])
DEGREES = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 7.0, 94.0, 1e3, 1e6])[:, None]
BELOW = np.array([1.0, 2.0, 9.0, 100.5, 1e5])[:, None, None]


def logsf_of_f(x, above, below):
    """Return the logarithm without rounding near 1, which f.logsf of SciPy below 1.15 has not."""
    far, near = (f(x, above, below) for f in (scipy.stats.f.sf, scipy.stats.f.cdf))
    with np.errstate(divide="ignore"):
        return np.where(far > 0.5, np.log1p(-near), np.log(far))


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (chance.chi2_sf(X, DEGREES), scipy.stats.chi2.sf(X, DEGREES)),
        (chance.chi2_cdf(X, DEGREES), scipy.stats.chi2.cdf(X, DEGREES)),
        (chance.chi2_isf(TAILS, DEGREES), scipy.stats.chi2.isf(TAILS, DEGREES)),
        (chance.chi2_ppf(TAILS, DEGREES), scipy.stats.chi2.ppf(TAILS, DEGREES)),
        (chance.f_sf(X, DEGREES, BELOW), scipy.stats.f.sf(X, DEGREES, BELOW)),
        (chance.f_logsf(X, DEGREES, BELOW), logsf_of_f(X, DEGREES, BELOW)),
        (chance.normal_sf(np.r_[-X, X]), scipy.stats.norm.sf(np.r_[-X, X])),
        (chance.normal_isf(TAILS), scipy.stats.norm.isf(TAILS)),
        (chance.t_sf(X, DEGREES), scipy.stats.t.sf(X, DEGREES)),
        (chance.t_isf(TAILS, DEGREES), scipy.stats.t.isf(TAILS, DEGREES)),
    ],
    ids=["chi2 sf", "cdf", "isf", "ppf", "F sf", "logsf", "normal sf", "isf", "t sf", "isf"],
)
def test_chances_and_limits_are_those_of_scipy_stats(ours, theirs):
    assert np.allclose(ours, theirs, rtol=1e-13, atol=0.0, equal_nan=True)


def test_the_limit_of_f_gives_its_chance_back():
    """Nearer than that of scipy.stats, which asks for 1 - chance."""
    again = scipy.stats.f.sf(chance.f_isf(SMALL, DEGREES[1:], BELOW), DEGREES[1:], BELOW)
    assert np.allclose(again, SMALL, rtol=1e-9, atol=0.0)


def test_a_number_gives_a_number():
    assert isinstance(chance.chi2_sf(3.0, 2), float)
    assert isinstance(chance.f_isf(0.01, 2, 3), float)
