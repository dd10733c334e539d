"""The error budget of alpha: of a typical actuator, and of the common scale source by source."""

from __future__ import annotations

import numpy as np

from truenewton.arrays import Array
from truenewton.calibration.result import Calibration
from truenewton.estimation.estimate import Scale
from truenewton.estimation.weights import scale_total

NEGLIGIBLE = 1e-5  # sources of a relative error below it are not listed


def error_budget(c: Calibration) -> dict[str, float]:
    """Return relative standard uncertainties of alpha by name; none where the scale is free."""
    if c.scale == Scale.MEAN_ONE:
        return {}
    parts = {
        "typical actuator, all": typical(c.error, c),
        "typical actuator, readings": typical(c.reading_error, c),
        "typical actuator, weights": typical(c.systematic_error, c),
    }
    if c.scale_errors:
        parts["common scale, all"] = scale_total(c.scale_errors)
        for line in c.scale_errors:
            if line.relative > NEGLIGIBLE:
                parts[f"common scale, {line.source}"] = line.relative
    return parts


def typical(error: Array, c: Calibration) -> float:
    """Return the median over actuators of an error (n,) of alpha, in terms of alpha."""
    return float(np.nanmedian(error / np.abs(c.alpha)))
