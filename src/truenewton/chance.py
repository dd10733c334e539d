"""Probabilities and quantiles of chi-squared, F, Student's t and normal distributions.

From ``scipy.special``, like ``scipy.stats``, whose import takes as long as a calibration with all
other imports. Arguments are numbers or arrays, broadcast; NaN without degrees of freedom.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special

FALSE_ALARM = 0.01  # chance that a sound mirror, or campaign, is accused of anything
OF_EACH_KIND = FALSE_ALARM / 4  # by its rows, shapes, effects, or by a fit that is improbable

# Numbers or arrays, broadcast; NaN where degrees of freedom are none.


def chi2_sf(x: Any, degrees: Any) -> Any:
    """Return the probability that chi-squared exceeds x."""
    some, x = _some(degrees), np.maximum(x, 0.0)
    return np.where(np.isnan(some), np.nan, special.chdtrc(some, x))[()]  # below SciPy 1.15: 0 or 1


def chi2_cdf(x: Any, degrees: Any) -> Any:
    """Return the probability that chi-squared is below x."""
    some, x = _some(degrees), np.maximum(x, 0.0)
    return np.where(np.isnan(some), np.nan, special.chdtr(some, x))[()]


def chi2_isf(chance: Any, degrees: Any) -> Any:
    """Return the value that chi-squared exceeds with this probability."""
    return special.chdtri(_some(degrees), chance)


def chi2_ppf(chance: Any, degrees: Any) -> Any:
    """Return the value below which chi-squared is with this probability."""
    return 2.0 * special.gammaincinv(0.5 * _some(degrees), chance)


def f_sf(x: Any, above: Any, below: Any) -> Any:
    """Return the probability that F exceeds x; degrees of freedom ``above``, ``below`` the line."""
    return special.fdtrc(above, below, np.maximum(x, 0.0))


def f_logsf(x: Any, above: Any, below: Any) -> Any:
    """Return the natural logarithm of `f_sf`."""
    beyond, within = f_sf(x, above, below), special.fdtr(above, below, np.maximum(x, 0.0))
    with np.errstate(divide="ignore"):
        return np.where(beyond >= 0.5, np.log1p(-within), np.log(beyond))[()]


def f_isf(chance: Any, above: Any, below: Any) -> Any:
    """Return the value that F exceeds with this probability, which is small."""
    part = special.betaincinv(0.5 * below, 0.5 * above, chance)
    return below * (1.0 - part) / (above * part)


def normal_sf(z: Any) -> Any:
    """Return the probability that a standard normal number exceeds z."""
    return special.ndtr(-np.asarray(z))


def normal_isf(chance: Any) -> Any:
    """Return the value that a standard normal number exceeds with this probability."""
    return -special.ndtri(chance)


def t_sf(x: Any, degrees: Any) -> Any:
    """Return the probability that Student's t exceeds x."""
    return special.stdtr(degrees, -np.asarray(x))


def t_isf(chance: Any, degrees: Any) -> Any:
    """Return the value that Student's t exceeds with this probability."""
    return -special.stdtrit(degrees, chance)


def chance_of_any(chance: float, tests: int) -> float:
    """Return the probability that any of several independent tests is as rare (Sidak)."""
    return float(-np.expm1(tests * np.log1p(-min(chance, 1 - 1e-16))))


def _some(degrees: Any) -> Any:
    return np.where(np.asarray(degrees) > 0, degrees, np.nan)
