"""Many tests at once: what chance alone does to one of many actuators, rows or shapes."""

from __future__ import annotations

import numpy as np

FALSE_ALARM = 0.01  # chance that a sound mirror, or campaign, is accused of anything
OF_EACH_KIND = FALSE_ALARM / 4  # by its rows, shapes, effects, or by a fit that is improbable


def chance_of_any(chance: float, tests: int) -> float:
    """Return the chance that any of so many independent tests comes out as rare (Sidak)."""
    return float(-np.expm1(tests * np.log1p(-min(chance, 1 - 1e-16))))
