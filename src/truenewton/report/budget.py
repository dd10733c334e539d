"""The error budget as bars: of the common scale, source by source, and of an actuator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truenewton.calibration.result import Calibration
from truenewton.estimation.estimate import Scale
from truenewton.estimation.weights import scale_total
from truenewton.rounding import percent


@dataclass(frozen=True)
class BudgetLine:
    """A line of a budget: name, relative size, that as text, and its share of the largest."""

    name: str
    size: float
    text: str
    share: float


def budget_bars(c: Calibration) -> tuple[BudgetLine, ...]:
    """Return the budget of a calibration whose scale the weights give; none of one without."""
    if c.scale == Scale.MEAN_ONE:
        return ()
    weights = float(np.nanmedian(c.systematic_error / np.abs(c.alpha)))
    readings = float(np.nanmedian(c.reading_error / np.abs(c.alpha)))
    total = typical_error(c)
    lines = [("typical actuator, all", total), ("typical actuator, readings", readings),
             ("typical actuator, weights", weights)]  # fmt: skip
    if c.scale_errors:
        lines.append(("common scale, all", scale_total(c.scale_errors)))
        lines += [
            (f"common scale, {line.source}", line.relative)
            for line in c.scale_errors
            if line.relative > 1e-5
        ]
    largest = max(size for _, size in lines)
    return tuple(BudgetLine(name, size, percent(size), size / largest) for name, size in lines)


def typical_error(c: Calibration) -> float:
    """Return the median over actuators of the relative standard uncertainty of alpha."""
    return float(np.nanmedian(c.error / np.abs(c.alpha)))
