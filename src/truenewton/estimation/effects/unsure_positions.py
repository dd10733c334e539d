"""Magnets whose positions have a declared uncertainty (columns E_X and E_Y)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truenewton.estimation.effects.catalogue import POSITIONS, parts_of_positions
from truenewton.estimation.effects.correction import correction, with_error
from truenewton.estimation.effects.derivative import scored
from truenewton.estimation.effects.examined import Examined
from truenewton.estimation.effects.fitted import FittedRows
from truenewton.estimation.minimum import Minimum
from truenewton.statics.layout import Layout


def positions_are_unsure(layout: Layout) -> bool:
    """Tell whether the positions of the magnets have a declared uncertainty."""
    return layout.x_error is not None or layout.y_error is not None


def with_positions_unsure(left: Examined) -> Minimum:
    """Return the minimum of an examined fit with what unsure positions add to its covariance.

    How far magnets stand off the data say themselves where they can; else as far as is declared.
    """
    if any(effect.code == POSITIONS.code for effect in left.effects):
        return left.minimum  # they are unknowns already
    fit = FittedRows(left.problem, left.moments, left.minimum, independent=True)
    taken_out = correction(fit, POSITIONS)
    if taken_out is not None:
        return taken_out.minimum
    layout = left.problem.campaign.layout
    errors = np.array(
        [
            np.zeros(fit.problem.n) if error is None else error[layout.enabled]
            for error in (layout.x_error, layout.y_error)
        ]
    )
    minimum, first = left.minimum, 0
    for part in parts_of_positions(fit):  # what all of them move does not fit into one array
        those = errors[:, first : first + part.count // 2]
        first += part.count // 2
        at = replace(fit, minimum=minimum)
        minimum = with_error(at, scored(fit, part).moves, np.diag(those.ravel() ** 2))
    return minimum
