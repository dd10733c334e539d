"""What reciprocity finds of the sensors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.estimation.diagnosis import Sensor
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.unknowns import OFFSETS, Kind


def errors_of_sensors(fit: Fit) -> dict[Kind, Array]:
    """Return (n,) errors of log g and of offsets [m], if asked for, as a fit states them."""
    return {
        kind: np.sqrt(np.maximum(np.diag(fit.covariance_of(kind)), 0.0))
        for kind in fit.asked.kinds[1:]
    }


def sensors_of(
    fit: Fit,
    errors: Mapping[Kind, Array],
    ids: NDArray[np.int64],
    keep: NDArray[np.bool_],
) -> tuple[Sensor, ...]:
    """Return the sensors of a fit to those kept of (n,) IDs; what was not asked has no error."""
    none = np.zeros(int(keep.sum()))
    of_gain, of_x, of_y = (errors.get(kind, none) for kind in (Kind.GAIN, *OFFSETS))
    gain, (dx, dy) = fit.values.gain, fit.values.offset
    columns = (gain, gain * of_gain, dx, of_x, dy, of_y)
    cells = (spread(column, keep).tolist() for column in columns)
    states = np.where(keep, "fitted", "free").tolist()
    return tuple(itertools.starmap(Sensor, zip(ids.tolist(), *cells, states, strict=True)))
