"""Magnets whose positions have a declared uncertainty (columns E_X and E_Y)."""

from __future__ import annotations

import numpy as np

from truenewton.estimation.effects.catalogue import POSITIONS
from truenewton.estimation.effects.correction import correction, with_error
from truenewton.estimation.effects.derivative import scored
from truenewton.estimation.effects.examination import MOST_ACTUATORS
from truenewton.estimation.effects.examined import Examined
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.minimum import Minimum
from truenewton.statics.layout import Layout


def positions_are_unsure(layout: Layout) -> bool:
    """Tell whether the positions of the magnets have a declared uncertainty, and are not too many.

    Beyond `MOST_ACTUATORS` the error that it makes is not taken into account.
    """
    declared = layout.x_error is not None or layout.y_error is not None
    return declared and int(layout.enabled.sum()) <= MOST_ACTUATORS


def with_positions_unsure(left: Examined) -> Minimum:
    """Return the minimum of an examined fit with what unsure positions add to its covariance.

    How far magnets stand off the data say themselves where they can; else as far as is declared.
    """
    if any(effect.name == POSITIONS.name for effect in left.effects):
        return left.minimum  # they are unknowns already
    fit = FittedRows(left.problem, left.moments, left.minimum, independent=True)
    taken_out = correction(fit, POSITIONS)
    if taken_out is not None:
        return taken_out.minimum
    derivative = POSITIONS.derivative(fit)
    if derivative is None:
        return left.minimum
    layout = left.problem.campaign.layout
    errors = np.concatenate(
        [
            np.zeros(fit.problem.n) if error is None else error[layout.enabled]
            for error in (layout.x_error, layout.y_error)
        ]
    )
    return with_error(fit, scored(fit, derivative).moves, np.diag(errors**2))
