"""Actuators that a user excludes: their force stays in the balance, their alpha is not given."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truenewton.calibration.result import Calibration
from truenewton.errors import UnknownName
from truenewton.records.campaign import Campaign
from truenewton.records.stiffness_matrix import StiffnessMatrix
from truenewton.rounding import named
from truenewton.statics.layout import Layout


def require_known(layout: Layout, ids: Collection[int]) -> None:
    """Refuse IDs that no actuator has.

    Raises
    ------
    UnknownName
    """
    unknown = sorted(set(ids) - set(layout.id.tolist()))
    if unknown:
        raise UnknownName(
            f"there is no {named('actuator', unknown, 5)} to exclude",
            remedy=f"IDs run from {layout.id.min()} to {layout.id.max()}",
            got=unknown,
        )


def disabled(data: Campaign | StiffnessMatrix, ids: Sequence[int]) -> Campaign | StiffnessMatrix:
    """Return data in which excluded actuators are disabled, as far as the balance allows.

    Those of a matrix are released (`matrix.screen.released`). One of a campaign is disabled if its
    FORCE never changes; the force of others is part of the balance, and alpha is fitted to it.
    """
    if not ids:
        return data
    if isinstance(data, StiffnessMatrix):
        return replace(data, layout=_without(data.layout, np.isin(data.layout.id, ids)))
    out = np.isin(data.layout.id, ids)
    for cycle in data.cycles:
        out &= np.ptp(np.asarray(cycle.force)[np.asarray(cycle.valid)], axis=0) == 0.0
    if not out.any():
        return data
    cycles = tuple(replace(c, layout=_without(c.layout, out)) for c in data.cycles)
    matrix = data.stiffness
    if matrix is not None:
        matrix = replace(matrix, layout=_without(matrix.layout, out))
    return replace(data, cycles=cycles, stiffness=matrix)


def without(calibration: Calibration, ids: Sequence[int]) -> Calibration:
    """Return a calibration that gives no alpha of some actuators, by their IDs."""
    layout = calibration.layout
    out = np.isin(layout.id, ids) & layout.enabled
    if not out.any():
        return calibration
    names = ("alpha", "reading_error", "systematic_error", "cycle_error", "halves")
    values = {name: getattr(calibration, name) for name in names}
    changed: dict[str, Any] = {
        k: np.where(out, np.nan, v) for k, v in values.items() if v is not None
    }
    for name in ("covariance", "systematic_covariance"):
        matrix = np.array(getattr(calibration, name))
        matrix[: layout.n][out] = np.nan
        matrix[:, : layout.n][:, out] = np.nan
        changed[name] = matrix
    return replace(calibration, layout=_without(layout, out), **changed)


def _without(layout: Layout, out: NDArray[np.bool_]) -> Layout:
    return replace(layout, enabled=layout.enabled & ~out)
