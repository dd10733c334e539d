"""What reciprocity finds of the sensors."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from truenewton.arrays import Array, spread
from truenewton.estimation.diagnosis import Sensor
from truenewton.estimation.reciprocity.iteration import Fit
from truenewton.estimation.reciprocity.unknowns import OFFSETS, Kind


def sensors_of(fit: Fit, ids: NDArray[np.int64], keep: NDArray[np.bool_]) -> tuple[Sensor, ...]:
    """Return the sensors of a fit to those kept of (n,) IDs; what was not asked has no error."""
    n = int(keep.sum())

    def error(kind: Kind) -> Array:
        if kind not in fit.asked.kinds:
            return np.zeros(n)
        return np.sqrt(np.maximum(np.diag(fit.covariance_of(kind)), 0.0))

    gain, (dx, dy) = fit.values.gain, fit.values.offset
    columns = (gain, gain * error(Kind.GAIN), dx, error(OFFSETS[0]), dy, error(OFFSETS[1]))
    cells = (spread(column, keep).tolist() for column in columns)
    states = np.where(keep, "fitted", "free").tolist()
    return tuple(itertools.starmap(Sensor, zip(ids.tolist(), *cells, states, strict=True)))
