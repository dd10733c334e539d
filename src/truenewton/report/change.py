"""What changed between two calibrations of one mirror, actuator by actuator."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats
from matplotlib.axes import Axes
from numpy.typing import NDArray

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.errors import CampaignMismatch
from truenewton.estimation.estimate import Scale
from truenewton.estimation.multiple_tests import FALSE_ALARM
from truenewton.estimation.weights import typical


@dataclass(frozen=True, eq=False)
class Change:
    """From one calibration to another, what is common to all actuators taken out.

    Attributes
    ----------
    one, other
        The calibrations.
    ratio, ratio_error
        Median of alpha after over alpha before, and its standard uncertainty; NaN where a scale is
        a convention.
    relative
        (n,) change of alpha beside the ratio, in terms of alpha; NaN where either is disabled.
    sigmas
        (n,) the same in terms of the readings' errors of both (E_STAT), taken as independent.
    limit
        Sigmas that one actuator of all reaches by chance in a hundredth of such comparisons.
    """

    one: Calibration
    other: Calibration
    ratio: float
    ratio_error: float
    relative: Array
    sigmas: Array
    limit: float

    @property
    def changed(self) -> NDArray[np.int64]:
        """(changed,) indices of the actuators beyond the limit, the farthest first."""
        size = np.nan_to_num(np.abs(self.sigmas))
        order = np.argsort(-size, kind="stable")
        return np.asarray(order[size[order] > self.limit])

    def plot_map(self, ax: Axes | None = None) -> Axes:
        """Draw the change in sigmas on the map of the actuators; return the axes."""
        from truenewton.report.figures import plot_change_map

        return plot_change_map(self, ax)

    def plot_actuators(self, ax: Axes | None = None) -> Axes:
        """Draw the change in sigmas per actuator; return the axes."""
        from truenewton.report.figures import plot_change

        return plot_change(self, ax)


def change(one: Calibration, other: Calibration) -> Change:
    """Compare two calibrations of one mirror.

    With r the median of alpha'/alpha, the change of actuator i is alpha'_i / r - alpha_i, with the
    variance E_STAT_i^2 + (E_STAT'_i / r)^2. The errors of the weights move all alphas together, so
    they are in r and not in the change.

    Raises
    ------
    CampaignMismatch
        The calibrations are not of the same actuators.
    """
    a, b = one.layout, other.layout
    # Which are enabled may differ, and what was taken for their direction.
    alike = a.n == b.n and a.same_as(replace(b, enabled=a.enabled, nz=a.nz))
    both = a.enabled & b.enabled if alike else np.zeros(0, dtype=bool)
    if not both.any():
        raise CampaignMismatch(
            f"the calibrations of {one.instrument} and {other.instrument} are not of the same"
            " actuators",
            remedy="compare two calibrations of one mirror",
        )
    ratio = float(np.median(other.alpha[both] / one.alpha[both]))
    moved = np.where(both, other.alpha / ratio - one.alpha, np.nan)
    error = np.hypot(one.reading_error, other.reading_error / ratio)
    scales = [
        typical(c.systematic_error, c.alpha) for c in (one, other) if c.scale != Scale.MEAN_ONE
    ]
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = moved / error
    return Change(
        one=one,
        other=other,
        ratio=ratio,
        ratio_error=ratio * math.hypot(*scales) if len(scales) == 2 else float("nan"),
        relative=moved / one.alpha,
        sigmas=np.where(np.isfinite(sigmas), sigmas, np.nan),
        limit=float(scipy.stats.norm.isf(FALSE_ALARM / 2 / both.sum())),
    )
