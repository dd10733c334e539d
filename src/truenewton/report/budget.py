"""The error budget of alpha: of a typical actuator, and of the common scale source by source."""

from __future__ import annotations

from truenewton.calibration.result import Calibration
from truenewton.estimation.findings.estimate import Scale
from truenewton.estimation.findings.scale_budget import scale_budget, scale_total, typical


def error_budget(c: Calibration) -> dict[str, float]:
    """Return relative standard uncertainties of alpha by name; none where the scale is free."""
    if c.scale == Scale.MEAN_ONE:
        return {}
    parts = {
        "typical actuator, all": typical(c.error, c.alpha),
        "typical actuator, readings": typical(c.reading_error, c.alpha),
        "typical actuator, weights": typical(c.systematic_error, c.alpha),
    }
    if c.scale_errors:
        parts["common scale, all"] = scale_total(c.scale_errors)
        for what, part in scale_budget(c.scale_errors).items():
            parts[f"common scale, {what}"] = part
    return parts
