"""A recalibration in text for the terminal, and in values for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from truenewton.calibration.summary import summary_lines, summary_values
from truenewton.files.values import Values
from truenewton.recalibration.fit import Recalibration
from truenewton.rounding import chance_text, percent, table_lines, with_error


def lines(made: Recalibration) -> Iterator[str]:
    """Yield the lines of the terminal: the calibration, and the actuators that changed."""
    yield from summary_lines(made.calibration, _changes(made))


def _changes(made: Recalibration) -> Iterator[str]:
    """Yield a table of the actuators that were estimated from the run, and what the others show."""
    c = made.calibration
    changed = dict.fromkeys(made.asked, "replaced")
    for one in made.moved:
        chance = chance_text(one.probability)
        changed[one.actuator] = f"CHANGED: {abs(one.sigmas):.1f} sigma, {chance}"
    rows = [("actuator", "before", "now", "change", "")]
    for name, words in changed.items():
        actuator_index = int((c.layout.id == name).argmax())
        before, now, error = (
            float(values[actuator_index]) for values in (made.earlier, c.alpha, c.error)
        )
        was, change = f"{before:.4g}", f"{100 * (now / before - 1):+.2f} %"
        if not math.isfinite(before):
            was, change = "-", "no earlier value"
        rows.append(
            (str(c.layout.shown[actuator_index]), was, with_error(now, error), change, words)
        )
    yield from table_lines("  changed:", *rows) if changed else ["  no actuator changed"]
    yield (
        "  other actuators relative to their earlier calibration: chi2/DOF ="
        f" {made.chi2 / max(made.degrees_of_freedom, 1):.3g}, DOF {made.degrees_of_freedom},"
        f" probability {made.probability:.2g}; "
        + ("they agree" if made.moved else "none has changed (false alarms on 1 % of mirrors)")
    )
    if made.scatter:
        yield f"  each changed by {percent(made.scatter)} since then; errors include this change"


VALUES = Values(
    Recalibration, "asked", "moved", "earlier",
    ("others", Values(Recalibration, "chi2", "degrees_of_freedom", "probability", "scatter")),
    "limits",
)  # fmt: skip


def values(made: Recalibration) -> dict[str, Any]:
    """Return the same values for a script."""
    return {**summary_values(made.calibration), **VALUES.of(made)}
